"""A master that speaks MAVLink: axes, times, places in a local frame, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.master_mavlink import MasterMavlink, MasterMavlinkOptions
from bridge.frame import RawFrame
from bridge.geoid import undulation
from bridge.mavlink.ned import LocalFrame
from bridge.strict import convert
from nav.rotation import euler_from_quat, quat_conjugate, quat_multiply, rotvec_from_quat
from nav.types import MasterState, S
from tests.drivers.made import context, flipped, rejects
from tests.drivers.test_sensors_mavlink import of
from tests.sinks.made import out, quaternion, solution
from tests.sinks.test_mavlink_telemetry import telemetry

MS = 1_000_000
LAT, LON = 48.14, 11.58


def driver(**options: Any) -> MasterMavlink:
    table = {"driver": "master_mavlink", "source": "link", "system_id": 7, **options}
    return MasterMavlink(convert(table, MasterMavlinkOptions, "t.toml"), context("boss"))


def angle(k_ms: int, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0), **sender: int) -> RawFrame:
    message = dialect.MAVLink_attitude_quaternion_message(k_ms, *q, 0.1, 0.2, 0.3)
    return of("ATTITUDE_QUATERNION", message, 10**9 + k_ms * MS, **sender)


def place(k_ms: int, v: tuple[int, int, int] = (300, 400, -50), alt_mm: int = 600_000) -> RawFrame:
    where = round(LAT * 1e7), round(LON * 1e7), alt_mm, 0
    return of(
        "GLOBAL_POSITION_INT",
        dialect.MAVLink_global_position_int_message(k_ms, *where, *v, 0),
        10**9 + k_ms * MS,
    )


def rolled(degrees: float) -> tuple[float, ...]:
    """Front-right-down to north-east-down: rolled about front alone."""
    half = math.radians(degrees) / 2.0
    return math.cos(half), math.sin(half), 0.0, 0.0


def fed(made: MasterMavlink, *frames: RawFrame) -> list[MasterState]:
    return [state for frame in frames for state in made.feed(frame)]


def test_north_east_down_becomes_east_north_up() -> None:
    (state,) = fed(driver(), angle(100, rolled(20.0)), place(100))
    assert state.device == "boss"
    assert state.t_ns == 10**9 + 100 * MS
    assert np.degrees([state.lat, state.lon]) == pytest.approx([LAT, LON], abs=1e-7)
    assert state.height == pytest.approx(600.0 + undulation(math.radians(LAT), math.radians(LON)))
    # 3 m/s north, 4 east, 0.5 up
    assert state.v_g == pytest.approx([4.0, 3.0, 0.5])
    heading, pitch, roll = np.degrees(euler_from_quat(state.q_ga))
    # heads north, right side down
    assert [(heading + 180.0) % 360.0 - 180.0, pitch, roll] == pytest.approx([0.0, 0.0, 20.0], abs=1e-5)
    # rates about front, right, down become right, forward, up
    assert state.w_ia_a == pytest.approx([0.2, 0.1, -0.3])
    assert state.f_a is None
    assert state.valid


@given(
    angles=st.tuples(st.floats(-179, 179), st.floats(-85, 85), st.floats(0, 359)),
    v=st.tuples(*[st.floats(-250, 250)] * 3),
    lat=st.floats(-85, 85),
    lon=st.floats(-179, 179),
)
@settings(max_examples=40, deadline=None)
def test_our_own_telemetry_comes_back_as_it_was(
    angles: tuple[float, ...], v: tuple[float, ...], lat: float, lon: float
) -> None:
    roll, pitch, heading = angles
    s = solution(lat_deg=lat, lon_deg=lon, v=v, roll_deg=roll, pitch_deg=pitch, heading_deg=heading)
    for message, options in (("ATTITUDE_QUATERNION", {}), ("ODOMETRY", {"message": "ODOMETRY"})):
        made = driver(**options)
        sent = telemetry(GPS_GLOBAL_ORIGIN=1.0).consume([out(s)])
        by_key = {frame.key: RawFrame(0, s.t_ns, 1, frame.key, frame.data) for frame in sent}
        order = [key for _, key in made.keys]
        if message == "ODOMETRY":
            order = order[::-1]  # the origin first
        (state,) = fed(made, *(by_key[key] for key in order))
        # 1 cm/s of GLOBAL_POSITION_INT, single precision of ODOMETRY
        assert state.v_g == pytest.approx(s.v_g, abs=0.0051 if message != "ODOMETRY" else 1e-4)
        true = quaternion(*np.radians([roll, pitch, heading]))
        off = rotvec_from_quat(quat_multiply(state.q_ga, quat_conjugate(true)))
        assert np.abs(off).max() < 1e-6
        # 1e-7 deg, and across the meridian of the antipodes
        assert state.lat == pytest.approx(s.lat, abs=2e-9)
        assert math.remainder(state.lon - s.lon, math.tau) == pytest.approx(0.0, abs=2e-9)
        assert state.height == pytest.approx(s.height, abs=0.002)
        assert state.w_ia_a == pytest.approx(s.state[S.W], abs=1e-7)
        if message == "ODOMETRY":
            # north 0.5, east 0.4: the larger stands for both
            assert state.sigma_position == pytest.approx([0.5, 0.5, 0.9], rel=1e-5)


def test_a_place_between_two_attitudes_gets_the_one_in_between() -> None:
    made = driver()
    assert fed(made, angle(100, rolled(10.0)), place(140)) == []
    (state,) = fed(made, angle(200, rolled(20.0)))
    assert state.t_ns == 10**9 + 140 * MS
    assert np.degrees(euler_from_quat(state.q_ga)[2]) == pytest.approx(14.0, abs=1e-5)
    assert rejects(made) == {}


def test_a_place_without_attitudes_around_it_is_counted_and_dropped() -> None:
    made = driver()
    assert fed(made, place(50), angle(100), angle(600), place(400)) == []
    # one before the first attitude, one in a gap of half a second
    assert rejects(made) == {"INCOMPLETE": 2}


def test_odometry_far_from_its_origin_is_turned_to_where_it_is() -> None:
    """North-east-down a hundred kilometres to the north is tilted by a sixty-fourth of a radian."""
    origin = LocalFrame(math.radians(LAT), math.radians(LON), 500.0)
    lat = math.radians(LAT + 0.9)
    n, e, d = origin.position(lat, math.radians(LON), 5000.0)
    assert n == pytest.approx(100_100.0, abs=300.0)
    # level there, as seen from the origin: pitched down by the difference of latitudes
    half = -math.radians(0.9) / 2.0
    q = [math.cos(half), 0.0, math.sin(half), 0.0]
    made = driver(message="ODOMETRY")
    unknown, still = [math.nan] * 21, (0.0, 0.0, 0.0)
    message = dialect.MAVLink_odometry_message(
        5_000_000, 1, 12, n, e, d, q, 100.0, 0.0, 0.0, *still, unknown, unknown, 0, 0, 0
    )
    alt = 500.0 - undulation(math.radians(LAT), math.radians(LON))
    where = round(LAT * 1e7), round(LON * 1e7), round(alt * 1000)
    set_up = of("GPS_GLOBAL_ORIGIN", dialect.MAVLink_gps_global_origin_message(*where), 10**9)
    frame = of("ODOMETRY", message, 2 * 10**9)
    assert fed(made, frame) == []
    assert rejects(made) == {"INCOMPLETE": 1}
    message.time_usec = 5_020_000
    later = of("ODOMETRY", message, 2 * 10**9 + 20 * MS)
    (state,) = fed(made, set_up, later)
    assert state.lat == pytest.approx(lat, abs=1e-9)
    assert state.height == pytest.approx(5000.0, abs=0.02)  # single precision of 100 km
    _, pitch, roll = np.degrees(euler_from_quat(state.q_ga))
    assert [pitch, roll] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert state.v_g == pytest.approx([0.0, 100.0, 0.0], abs=1e-3)
    assert state.sigma_velocity == pytest.approx([0.5] * 3)
    body = dialect.MAVLink_odometry_message(
        5_040_000, 20, 12, n, e, d, q, 1.0, 0.0, 0.0, *still, unknown, unknown, 0, 0, 0
    )
    assert fed(made, of("ODOMETRY", body, 2 * 10**9 + 40 * MS)) == []
    assert rejects(made) == {"INCOMPLETE": 1, "UNKNOWN": 1}


def test_what_is_wrong_is_counted_by_reason() -> None:
    made = driver()
    assert fed(made, angle(100, system=9), flipped(angle(100)), angle(100)._replace(data=b"\xfd")) == []
    assert rejects(made) == {"UNKNOWN": 1, "CRC": 1, "LENGTH": 1}
    assert fed(made, angle(100, (2.0, 0.0, 0.0, 0.0)), angle(110, (math.nan, 0.0, 0.0, 0.0))) == []
    assert rejects(made)["RANGE"] == 2
    fed(made, angle(120), place(120))
    assert fed(made, place(120)) == []
    assert rejects(made)["STALE"] == 1
    beyond = dialect.MAVLink_global_position_int_message(140, 910_000_000, 0, 0, 0, 0, 0, 0, 0)
    assert fed(made, of("GLOBAL_POSITION_INT", beyond, 2 * 10**9)) == []
    assert rejects(made)["RANGE"] == 3


def test_component_matters_where_it_is_named() -> None:
    made = driver(component_id=3)
    assert fed(made, angle(100, component=1), place(100)) == []
    assert rejects(made) == {"UNKNOWN": 2}
