"""Somebody else's DBC file: the log of a real device."""

from __future__ import annotations

import gzip
import math
from itertools import pairwise
from typing import Any

import cantools.database
import numpy as np
import pytest

from bridge.drivers.dbc_map import DbcMap
from bridge.frame import RawFrame
from bridge.importers.candump import parse_line
from nav.types import GnssFix, ImuFlag, ImuSample
from tests.drivers.made import rejects
from tests.drivers.vendor import DEG, mapped
from tests.recordings import DATA, needs_recording

LOG = DATA / "can_gnss_imu_log"
needs_log = needs_recording("can_gnss_imu_log")

REAL_IMU = """
[imu]
rate_hz = 101
valid = { ImuValid = 1 }
gyro = { x = "AngularRateX", y = "AngularRateY", z = "AngularRateZ" }
accel = { x = "AccelerationX", y = "AccelerationY", z = "AccelerationZ" }
"""
REAL_GNSS = """
[gnss]
lat = "Latitude"
lon = "Longitude"
height = "Altitude"
sigma_horizontal = { signal = "PositionAccuracy", scale = 0.7071 }
sigma_up = "AltitudeAccuracy"
speed = "Speed"
course = "Heading"
sigma_speed = "SpeedAccuracy"
sigma_course = "HeadingAccuracy"
sigma_vel_up = { value = 0.5, unit = "m/s" }
valid = { PositionValid = 1, AltitudeValid = 1, TimeValid = 1 }
velocity_valid = { SpeedValid = 1, AttitudeValid = 1 }
fix_type = { signal = "FixType", values = { 3 = "FIX_3D", 4 = "FIX_3D" } }
satellites = "Satellites"
time = "Epoch"
utc = "Epoch"
"""


@pytest.fixture(scope="module")
def log() -> tuple[DbcMap, DbcMap, list[ImuSample], list[GnssFix], list[RawFrame]]:
    dbc = (LOG / "canmod-gps.dbc").read_bytes()
    imu, gnss = (mapped("canmod-gps.dbc", dbc, text) for text in (REAL_IMU, REAL_GNSS))
    takers = {key: taker for taker in (imu, gnss) for _, key in taker.keys}
    samples: list[ImuSample] = []
    fixes: list[GnssFix] = []
    frames = []
    with gzip.open(LOG / "drive.log.gz", "rt") as stream:
        for number, text in enumerate(stream):
            line = parse_line(text.strip())
            assert line is not None
            if line.channel == "can2" and line.key in takers:
                raw = RawFrame(number, line.stamp_ns, 1, line.key, line.data)
                frames.append(raw)
                for sample in takers[line.key].feed(raw):
                    (samples if isinstance(sample, ImuSample) else fixes).append(sample)  # type: ignore[arg-type]
    return imu, gnss, samples, fixes, frames


@needs_log
def test_real_log_every_frame_is_a_sample_or_counted(log: Any) -> None:
    imu, gnss, samples, fixes, frames = log
    db = cantools.database.load_file(LOG / "canmod-gps.dbc")
    valid = [
        f
        for f in frames
        if f.key == 9 and db.decode_message(9, f.data, decode_choices=False)["ImuValid"] == 1
    ]
    measured = [s for s in samples if not s.flags & ImuFlag.BRIDGED]
    assert len(measured) == len(valid) == imu.counters.samples
    # every other frame of the IMU says itself that it is not valid
    assert rejects(imu) == {"INVALID": imu.counters.frames - len(valid)}
    assert imu.counters.frames == sum(f.key == 9 for f in frames) == 60_775

    # six frames make a fix; all of them are valid in this log, and none is left over
    assert gnss.counters.frames == 6 * len(fixes) == 6 * 571
    assert rejects(gnss) == {}


@needs_log
def test_real_log_values_are_those_of_the_parser(log: Any) -> None:
    _, _, samples, fixes, frames = log
    db = cantools.database.load_file(LOG / "canmod-gps.dbc")

    def decoded(key: int) -> list[dict[str, Any]]:
        return [db.decode_message(key, f.data, decode_choices=False) for f in frames if f.key == key]

    measured = [s for s in samples if not s.flags & ImuFlag.BRIDGED]
    values = [v for v in decoded(9) if v["ImuValid"]]
    for sample, v in zip(measured, values, strict=True):
        rate = [v["AngularRateX"], v["AngularRateY"], v["AngularRateZ"]]
        force = [v["AccelerationX"], v["AccelerationY"], v["AccelerationZ"]]
        assert np.abs(sample.dtheta / sample.dt - np.array(rate) * DEG).max() < 1e-12
        assert np.abs(sample.dv / sample.dt - force).max() < 1e-12
    for fix, p, h, v, a in zip(fixes, decoded(3), decoded(4), decoded(7), decoded(5), strict=True):
        assert (fix.lat, fix.lon) == pytest.approx((p["Latitude"] * DEG, p["Longitude"] * DEG), abs=1e-14)
        assert fix.height == h["Altitude"]
        assert np.hypot(fix.v_g[0], fix.v_g[1]) == pytest.approx(v["Speed"], abs=1e-12)
        assert fix.sigma_position[2] == max(h["AltitudeAccuracy"], 0.5)
        assert fix.satellites is not None
        if v["Speed"] > 0.0:
            assert math.atan2(fix.v_g[0], fix.v_g[1]) % (2 * math.pi) == pytest.approx(
                a["Heading"] * DEG % (2 * math.pi)
            )


@needs_log
def test_real_log_obeys_physics(log: Any) -> None:
    _, _, samples, fixes, frames = log
    total = sum(s.dt for s in samples[1:])
    stamps = [f.rx_ns for f in frames if f.key == 9]
    # no interval is lost: what the loop over arrivals holds back is at most its lag of some milliseconds
    assert total == pytest.approx((stamps[-1] - stamps[0]) * 1e-9, abs=0.05)
    mean_force = np.sum([s.dv for s in samples], axis=0) / total
    # gravity, to the zero-g offset of a consumer sensor (some 50 mg)
    assert np.linalg.norm(mean_force) == pytest.approx(9.81, abs=0.5)
    # positions 1 s apart agree with speed and course: a swapped axis or sign would be metres a second off
    errors = []
    for a, b in pairwise(fixes):
        dt = (b.t_ns - a.t_ns) * 1e-9
        if dt < 1.5:
            north = (b.lat - a.lat) * 6.38e6 / dt
            east = (b.lon - a.lon) * 6.38e6 * math.cos(a.lat) / dt
            mean_v = (a.v_g + b.v_g) / 2.0
            errors.append(math.hypot(east - mean_v[0], north - mean_v[1]))
    # quantisation of a position is 0.11 m, the receiver's own noise of differences some decimetres
    assert np.median(errors) < 0.3
    # the stamps follow the GPS time of the fixes to the drift of a crystal
    gps = np.array([f.gps_ns for f in fixes])
    assert np.all(np.diff(gps) > 0)
    engine = np.array([f.t_ns for f in fixes])
    assert np.abs((engine - engine[0]) - (gps - gps[0])).max() < 50e6
