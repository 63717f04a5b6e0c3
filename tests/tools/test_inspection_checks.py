"""The checks of plausibility: silent on a sound drive, and each mistake is named."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from bridge.inspection_checks import (
    DistanceColumns,
    FixColumns,
    ImuColumns,
    check_baro,
    check_distance,
    check_fixes,
    check_imu,
    check_turns,
)
from nav.earth import ecef, geodetic, position_quat
from nav.rotation import quat_conjugate, quat_rotate
from nav.types import BaroSample, Vector

RADIUS = 6_371_000.0
LAT, LON = math.radians(40.1), math.radians(-105.1)


def drive(seconds: float = 240.0, rate_hz: float = 100.0) -> tuple[ImuColumns, FixColumns, DistanceColumns]:
    """A minute at rest, then curves at up to 12 m/s; right, forward, up; plane Earth of a sphere's size."""
    rng = np.random.default_rng(5)
    dt = 1.0 / rate_hz
    t = dt * np.arange(1, int(seconds * rate_hz) + 1)
    moving = np.clip((t - 60.0) / 10.0, 0.0, 1.0)
    v = 12.0 * moving * (1.0 + 0.2 * np.sin(0.2 * t))
    turn = 0.25 * np.sin(0.15 * t) * moving  # rad/s clockwise
    heading = np.cumsum(turn * dt)
    noise = rng.standard_normal((len(t), 6))
    force = np.column_stack([v * turn, np.gradient(v, dt), np.full(len(t), 9.80665)]) + 0.02 * noise[:, :3]
    rate = np.column_stack([np.zeros(len(t)), np.zeros(len(t)), -turn]) + 0.002 * noise[:, 3:]
    east, north = (np.cumsum(v * f(heading) * dt) for f in (np.sin, np.cos))
    fix = slice(0, len(t), 25)
    count = len(t[fix])
    fixes = FixColumns(
        t[fix],
        LAT + north[fix] / RADIUS,
        LON + east[fix] / RADIUS / math.cos(LAT),
        1600.0 + np.cumsum(np.full(count, 0.0)) + 20.0 * np.sin(0.05 * t[fix]),
        np.full((count, 3), 0.01),
        np.column_stack([(v * np.sin(heading))[fix], (v * np.cos(heading))[fix], np.cos(0.05 * t[fix])]),
        np.full((count, 3), 0.05),
    )
    return (
        ImuColumns(t, np.full(len(t), dt), rate * dt, force * dt),
        fixes,
        DistanceColumns(t, np.cumsum(v * dt)),
    )


IMU, FIXES, ROLLED = drive()


def texts(
    imu: ImuColumns = IMU, fixes: FixColumns = FIXES, rolled: DistanceColumns = ROLLED, mounting: bool = True
) -> list[str]:
    found = [
        *check_imu("imu", imu, mounting),
        *check_fixes("gnss", fixes),
        *check_turns("imu", imu, fixes),
        *check_distance("odometer", rolled, fixes),
    ]
    return [f"{finding.device}: {finding.text}" for finding in found]


def test_a_sound_drive_has_no_findings() -> None:
    assert texts() == []


@pytest.mark.parametrize(("lat", "lon"), [(math.pi / 2, 0.3), (LAT, math.pi)])
def test_nor_has_one_at_a_pole_or_across_the_date_line(lat: float, lon: float) -> None:
    # the same way over ground, the place half way along it being moved
    half = len(FIXES.t) // 2
    east = (FIXES.lon - FIXES.lon[half]) * RADIUS * math.cos(LAT)
    north = (FIXES.lat - FIXES.lat[half]) * RADIUS
    q_es = position_quat(lat, lon)
    flat = np.column_stack([east, north, np.zeros_like(east)])
    place = geodetic(ecef(lat, lon, 0.0) + quat_rotate(q_es, flat))
    q_ge = quat_conjugate(position_quat(place[0], place[1]))
    v_g = quat_rotate(q_ge, quat_rotate(q_es, FIXES.v_g))
    assert texts(fixes=FIXES._replace(lat=place[0], lon=place[1], v_g=v_g)) == []


def scaled(imu: ImuColumns, gyro: float = 1.0, accel: float = 1.0) -> ImuColumns:
    return imu._replace(dtheta=imu.dtheta * gyro, dv=imu.dv * accel)


def along(value: Vector, axis: int, number: float) -> Vector:
    changed = value.copy()
    changed[:, axis] *= number
    return changed


@pytest.mark.parametrize(
    ("imu", "expected"),
    [
        (
            scaled(IMU, accel=1 / 9.80665),
            "imu: specific force when quiet is 1 m/s^2, expected 9.8; looks like g",
        ),
        (scaled(IMU, accel=9.80665), "m/s^2 where g is meant"),
        (scaled(IMU, accel=0.5), "looks like half of the value"),
        (scaled(IMU, accel=1.15), "expected 9.8"),
        (scaled(IMU, gyro=math.degrees(1)), "degrees where radians are meant"),
        (scaled(IMU, gyro=math.radians(1)), "radians where degrees are meant"),
        (IMU._replace(dtheta=along(IMU.dtheta, 2, -1.0)), "turns against the course"),
        (IMU._replace(dtheta=along(IMU.dtheta, 1, 0.0)), "gyro y gives the same rate in every sample"),
        (IMU._replace(dv=IMU.dv[:, [2, 1, 0]]), "gravity lies along +x, expected +z"),
        (
            IMU._replace(dtheta=IMU.dtheta + np.array([0.1, 0.0, 0.0]) * 0.01),
            "angular rate when quiet is 5.7",
        ),
    ],
)
def test_mistakes_of_the_imu_are_named(imu: ImuColumns, expected: str) -> None:
    found = texts(imu=imu)
    assert any(expected in text for text in found), found


def test_any_direction_of_gravity_will_do_where_the_mounting_is_found() -> None:
    turned = IMU._replace(dv=IMU.dv[:, [2, 1, 0]], dtheta=IMU.dtheta[:, [2, 1, 0]])
    assert texts(imu=turned, mounting=False) == []


@pytest.mark.parametrize(
    ("fixes", "expected"),
    [
        (FIXES._replace(lat=FIXES.lon, lon=FIXES.lat), "latitude and longitude look swapped"),
        (FIXES._replace(v_g=FIXES.v_g[:, [1, 0, 2]]), "velocity east and north look swapped"),
        (FIXES._replace(v_g=along(FIXES.v_g, 0, -1.0)), "velocity east has the wrong sign"),
        (
            FIXES._replace(v_g=FIXES.v_g * 3.6),
            "3.6 times the change of position, expected 1; looks like km/h",
        ),
        (FIXES._replace(v_g=along(FIXES.v_g, 2, -1.0)), "vertical velocity falls where height rises"),
        (
            FIXES._replace(sigma_position=along(FIXES.sigma_position, 1, 0.0)),
            "fixes say a position sigma of zero",
        ),
        (FIXES._replace(lat=FIXES.lat * 0, lon=FIXES.lon * 0), "latitude 0, longitude 0"),
        (FIXES._replace(height=FIXES.height * 1000), "perhaps another unit"),
    ],
)
def test_mistakes_of_the_receiver_are_named(fixes: FixColumns, expected: str) -> None:
    found = texts(fixes=fixes)
    assert any(text.startswith("gnss") and expected in text for text in found), found


def test_a_fix_without_velocity_is_no_mistake() -> None:
    unknown = np.full_like(FIXES.v_g, np.nan)
    assert texts(fixes=FIXES._replace(v_g=unknown, sigma_velocity=unknown)) == []


def test_a_wrong_wheel_is_found() -> None:
    found = texts(rolled=ROLLED._replace(distance=ROLLED.distance * 2.0))
    # the way is measured by chords, which the curves make shorter than the wheel's
    assert len(found) == 1
    assert re.fullmatch(
        r"odometer: distance is 2(\.0\d)? times the way .*; looks like twice the value", found[0]
    )


def test_little_data_gives_no_verdict() -> None:
    nothing = ImuColumns(*(part[:0] for part in IMU))
    few = FixColumns(*(part[:2] for part in FIXES))
    assert texts(imu=nothing, fixes=few, rolled=DistanceColumns(*(part[:1] for part in ROLLED))) == []


def test_pressure_in_the_wrong_unit_is_found() -> None:
    sample = BaroSample(0, 44_000.0, 1.0, "baro")
    assert "perhaps hPa for Pa" in next(iter(check_baro("baro", [sample]))).text
