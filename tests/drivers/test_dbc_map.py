"""Somebody else's DBC file: a made-up vendor's with everything a DBC can have, and a real device's log."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import cantools.database
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.dbc_map import DbcMap, DbcMapOptions
from bridge.errors import ConfigError
from bridge.frame import CAN_EFF, RawFrame
from bridge.importers.candump import parse_line
from bridge.strict import convert, parse
from nav.types import FixType, GnssFix, ImuFlag, ImuSample, OdoSample, SpeedSample
from tests.drivers.made import context, rejects
from tests.recordings import DATA, needs_recording

VENDOR = """VERSION ""
NS_ :
BS_:
BU_: UNIT

BO_ 2147484689 Rates: 8 UNIT
 SG_ RateFwd : 7|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ RateLeft : 23|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ RateUp : 39|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ Count : 51|4@0+ (1,0) [0|14] "" UNIT
 SG_ Ok : 52|1@0+ (1,0) [0|1] "" UNIT

BO_ 1042 Forces: 8 UNIT
 SG_ AccFwd : 0|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ AccLeft : 16|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ AccUp : 32|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ Count : 48|4@1+ (1,0) [0|14] "" UNIT
 SG_ Ok : 52|1@1+ (1,0) [0|1] "" UNIT

BO_ 1043 Single: 8 UNIT
 SG_ W : 0|16@1- (0.01,0) [0|0] "deg/s" UNIT
 SG_ A : 16|16@1- (0.01,0) [0|0] "m/s^2" UNIT
 SG_ Stamp : 32|16@1+ (0.1,0) [0|0] "ms" UNIT
 SG_ Count : 48|8@1+ (1,0) [0|0] "" UNIT
 SG_ Ok : 56|1@1+ (1,0) [0|1] "" UNIT

BO_ 1060 Position: 8 UNIT
 SG_ Lat : 0|32@1- (1E-007,0) [-90|90] "°" UNIT
 SG_ Lon : 32|32@1- (1E-007,0) [-180|180] "°" UNIT

BO_ 1061 Motion: 8 UNIT
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" UNIT
 SG_ Height m0 : 8|24@1- (0.01,0) [0|0] "m" UNIT
 SG_ HAcc m0 : 32|16@1+ (1,0) [0|0] "mm" UNIT
 SG_ VAcc m0 : 48|16@1+ (1,0) [0|0] "mm" UNIT
 SG_ VelN m1 : 8|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ VelE m1 : 24|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ VelD m1 : 40|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ Fix m1 : 56|4@1+ (1,0) [0|15] "" UNIT
 SG_ VelOk m1 : 60|1@1+ (1,0) [0|1] "" UNIT

BO_ 1070 Wheel: 6 UNIT
 SG_ Ticks : 0|16@1+ (1,0) [0|0] "" UNIT
 SG_ Back : 16|1@1+ (1,0) [0|1] "" UNIT
 SG_ Stop : 17|1@1+ (1,0) [0|1] "" UNIT
 SG_ Trip : 24|16@1+ (0.1,0) [0|0] "m" UNIT

BO_ 1071 Speedo: 4 UNIT
 SG_ Kmh : 0|16@1+ (0.01,0) [0|300] "km/h" UNIT
 SG_ Back : 16|1@1+ (1,0) [0|1] "" UNIT

BO_ 1072 Floats: 8 UNIT
 SG_ Fast : 0|32@1- (1,0) [0|0] "m/s" UNIT
 SG_ Odd : 32|32@1- (1,0) [-10|10] "smoot" UNIT

SIG_VALTYPE_ 1072 Fast : 1;
SIG_VALTYPE_ 1072 Odd : 1;
"""
DB = cantools.database.load_string(VENDOR, "dbc")
MS = 1_000_000
DEG = math.pi / 180.0
G = 9.80665

TWO_FRAME_IMU = """
[imu]
rate_hz = 100
counter = "Count"
valid = { "Rates.Ok" = 1, "Forces.Ok" = 1 }
gyro = { x = "-RateLeft", y = "RateFwd", z = "RateUp" }
accel = { x = "-AccLeft", y = "AccFwd", z = "AccUp" }
"""
ONE_FRAME_IMU = """
[imu]
rate_hz = 100
valid = { "Single.Ok" = 1 }
gyro = { x = "W", y = "W", z = "-W" }
accel = { x = "A", y = "-A", z = "A" }
"""
GNSS = """
[gnss]
lat = "Lat"
lon = "Lon"
height = "Height"
sigma_horizontal = { signal = "HAcc", scale = 0.5 }
sigma_up = "VAcc"
vel_east = "VelE"
vel_north = "VelN"
vel_up = "-VelD"
sigma_speed = { value = 5, unit = "cm/s" }
sigma_vel_up = { value = 0.2, unit = "m/s" }
velocity_valid = { VelOk = 1 }
fix_type = { signal = "Fix", values = { 0 = "NO_FIX", 3 = "FIX_3D", 9 = "RTK_FIXED" } }
window_ms = 30
"""


def made(text: str, **more: Any) -> DbcMap:
    table = {
        "driver": "dbc_map",
        "source": "can0",
        "dbc": "vendor.dbc",
        **more,
        **parse(text.encode(), "test.toml"),
    }
    options = convert(table, DbcMapOptions, "test.toml", "device.dev")
    return DbcMap(options, context(files={"vendor.dbc": VENDOR.encode("cp1252")}))


def frame(message: str, rx_ns: int, **values: float) -> RawFrame:
    m = DB.get_message_by_name(message)
    zero = {s.name: 0 for s in m.signals}
    key = m.frame_id | (CAN_EFF if m.is_extended_frame else 0)
    return RawFrame(0, rx_ns, 1, key, m.encode({**zero, **values}, strict=False))


def feed(driver: DbcMap, *frames: RawFrame) -> list[Any]:
    return [sample for f in frames for sample in driver.feed(f)]


# --- inertial


def pair(count: int, rx_ns: int, ok: int = 1, **values: float) -> tuple[RawFrame, RawFrame]:
    rates = {k: v for k, v in values.items() if k.startswith("Rate")}
    forces = {k: v for k, v in values.items() if k.startswith("Acc")}
    return (
        frame("Rates", rx_ns, Count=count % 15, Ok=ok, **rates),
        frame("Forces", rx_ns + MS, Count=count % 15, Ok=1, **forces),
    )


def test_rates_become_increments_in_body_axes_and_si() -> None:
    driver = made(TWO_FRAME_IMU, latency_ms=2.0)
    assert set(driver.keys) == {(1, 1041 | CAN_EFF), (1, 1042)}
    values = {"RateFwd": 10.0, "RateLeft": -20.0, "RateUp": 30.0, "AccFwd": 0.1, "AccLeft": 0.2, "AccUp": 1.0}
    first, second = feed(driver, *pair(0, 100 * MS, **values), *pair(1, 110 * MS, **values))
    assert isinstance(first, ImuSample)
    for sample in (first, second):
        assert sample.dt == pytest.approx(0.01)
        assert sample.dtheta == pytest.approx(np.array([20.0, 10.0, 30.0]) * DEG * 0.01)
        assert sample.dv == pytest.approx(np.array([-0.2, 0.1, 1.0]) * G * 0.01)
        assert sample.flags == ImuFlag.OK
    # the arrival of the epoch's first frame, less the latency
    assert (first.t_ns, second.t_ns) == (98 * MS, 108 * MS)
    assert (driver.counters.frames, driver.counters.samples) == (4, 2)
    assert rejects(driver) == {}


def test_frames_are_tied_by_their_counter_alone() -> None:
    driver = made(TWO_FRAME_IMU)
    a0, b0 = pair(14, 0)
    a1, b1 = pair(15, 10 * MS)
    # the order inside an epoch is free, and a late half does not join another epoch
    assert len(feed(driver, b0, a0)) == 1
    assert feed(driver, a1) == []
    assert feed(driver, b0) == []
    assert rejects(driver) == {"INCOMPLETE": 1}
    assert driver.counters.duplicates == 1
    assert feed(driver, b1) == []  # its other half has been given up
    assert len(feed(driver, a1)) == 1


def test_a_repeated_frame_is_a_duplicate_and_a_frozen_counter_is_refused() -> None:
    driver = made(TWO_FRAME_IMU)
    a, b = pair(3, 0, RateUp=1.0)
    changed, _ = pair(3, 10 * MS, RateUp=2.0)
    assert len(feed(driver, a, a, b)) == 1
    assert driver.counters.duplicates == 1
    assert feed(driver, changed) == []
    assert rejects(driver) == {"COUNTER": 1}


def test_a_short_gap_is_bridged_and_counted() -> None:
    driver = made(TWO_FRAME_IMU)
    samples = feed(driver, *pair(0, 0, RateUp=10.0), *pair(4, 40 * MS, RateUp=18.0))
    assert [s.flags for s in samples] == [0, ImuFlag.BRIDGED, ImuFlag.BRIDGED, ImuFlag.BRIDGED, 0]
    assert [s.t_ns for s in samples] == [0, 10 * MS, 20 * MS, 30 * MS, 40 * MS]
    assert [s.dtheta[2] / DEG / s.dt for s in samples] == pytest.approx([10.0, 12.0, 14.0, 16.0, 18.0])
    assert sum(s.dt for s in samples[1:]) == pytest.approx(0.04)
    assert (driver.counters.missing, driver.counters.bridged, driver.counters.samples) == (3, 3, 2)


def test_a_long_gap_is_flagged() -> None:
    driver = made(TWO_FRAME_IMU + "bridge_samples = 2\n")
    samples = feed(driver, *pair(0, 0), *pair(4, 40 * MS))
    assert [s.flags for s in samples] == [0, ImuFlag.GAP]
    assert (driver.counters.missing, driver.counters.bridged) == (3, 0)


def test_a_gap_longer_than_the_counter_is_measured_by_time() -> None:
    driver = made(TWO_FRAME_IMU)
    feed(driver, *pair(0, 0), *pair(1, 200 * MS))
    assert driver.counters.missing == 19


def test_what_the_device_marks_invalid_is_refused_and_its_time_is_bridged() -> None:
    driver = made(TWO_FRAME_IMU)
    samples = feed(driver, *pair(0, 0), *pair(1, 10 * MS, ok=0), *pair(2, 20 * MS))
    assert [s.flags for s in samples] == [0, ImuFlag.BRIDGED, 0]
    assert rejects(driver) == {"INVALID": 1}


def test_the_end_of_the_range_is_saturation_and_beyond_the_declared_range_is_refused() -> None:
    driver = made(TWO_FRAME_IMU)
    (sample,) = feed(driver, *pair(0, 0, AccUp=32.767))
    assert sample.flags == ImuFlag.SATURATED
    assert rejects(driver) == {"SATURATED": 1}
    assert feed(driver, *pair(1, 10 * MS, RateUp=327.5)) == []
    assert rejects(driver) == {"SATURATED": 1, "RANGE": 1}


def singles(
    stamps_ms: list[float], counts: list[int] | None = None, jitter_ms: float = 0.0
) -> Iterator[RawFrame]:
    rng = np.random.default_rng(5)
    for i, ms in enumerate(stamps_ms):
        rx = 1000.0 + ms + jitter_ms * rng.random()
        extra = {} if counts is None else {"Count": counts[i]}
        yield frame("Single", round(rx * MS), W=1.0, A=2.0, Ok=1, Stamp=ms % 6553.6, **extra)


def test_device_time_gives_the_intervals_over_its_wrap() -> None:
    driver = made(ONE_FRAME_IMU + 'time = "Stamp"\n')
    times = [10.0 * i + (0.5 if i % 2 else 0.0) for i in range(2000)]  # 20 s: three wraps of 6.5536 s
    samples = feed(driver, *singles(times, jitter_ms=4.0))
    assert len(samples) == 2000
    dt = np.array([s.dt for s in samples[1:]])
    # the device's own intervals, whatever the arrivals did; 0.1 ms is its resolution
    assert dt == pytest.approx(np.diff(times) * 1e-3, abs=1e-9)
    assert driver.counters.missing == 0
    engine = np.array([s.t_ns for s in samples[1000:]]) / MS - 1000.0
    # once the line has settled the stamps stay inside the jitter of the bus
    assert np.all(np.abs(engine - times[1000:] - 0.0) < 4.0)


def test_arrivals_are_smoothed_and_no_time_is_lost() -> None:
    driver = made(ONE_FRAME_IMU)
    times = [9.9 * i for i in range(3000)]  # 1 % faster than rate_hz says
    samples = feed(driver, *singles(times, jitter_ms=3.0))
    dt = np.array([s.dt for s in samples[500:]])
    # uniform jitter of 3 ms has differences of 1.22 ms rms; the loop passes a tenth of it
    assert dt.std() < 0.2e-3
    assert dt.mean() == pytest.approx(9.9e-3, rel=1e-3)
    assert sum(s.dt for s in samples[1:]) == pytest.approx((samples[-1].t_ns - samples[0].t_ns) * 1e-9)
    assert driver.counters.missing == 0


def test_a_gap_without_counter_and_time_is_seen_by_arrival() -> None:
    driver = made(ONE_FRAME_IMU)
    samples = feed(driver, *singles([0.0, 10.0, 20.0, 60.0, 70.0]))
    assert driver.counters.missing == 3
    assert [s.flags for s in samples].count(ImuFlag.BRIDGED) == 3
    assert samples[-1].t_ns - samples[0].t_ns == pytest.approx(70 * MS, abs=MS)


def test_frames_with_one_stamp_are_no_reason_to_stop() -> None:
    # an adapter that stamps in steps of 20 ms
    driver = made(ONE_FRAME_IMU)
    samples = feed(driver, *singles([20.0 * (i // 2) for i in range(400)]))
    assert len(samples) == 400
    assert all(0.004 < s.dt < 0.016 for s in samples)
    assert samples[-1].t_ns - samples[0].t_ns == pytest.approx(3980 * MS, abs=20 * MS)


def test_a_restart_of_the_device_is_a_gap() -> None:
    driver = made(ONE_FRAME_IMU + 'time = "Stamp"\n')
    before = list(singles([10.0 * i for i in range(300)]))
    after = [f._replace(rx_ns=f.rx_ns + 8000 * MS) for f in singles([10.0 * i for i in range(300)])]
    samples = feed(driver, *before, *after)
    assert any(s.flags & ImuFlag.GAP for s in samples[300:])
    assert all(b.t_ns > a.t_ns for a, b in pairwise(samples))
    assert all(s.dt == pytest.approx(0.01, rel=0.01) for s in samples[-200:])


def test_increments_are_taken_as_they_are() -> None:
    driver = made(
        ONE_FRAME_IMU.replace('z = "-W" }', 'z = "-W", unit = "mdeg" }')
        .replace('z = "A" }', 'z = "A", unit = "mm/s" }')
        .replace("rate_hz", 'signals = "increments"\nrate_hz')
    )
    samples = feed(driver, *singles([0.0, 10.0]))
    assert samples[1].dtheta == pytest.approx(np.array([1.0, 1.0, -1.0]) * DEG * 1e-3)
    assert samples[1].dv == pytest.approx(np.array([2e-3, -2e-3, 2e-3]))


# --- satellite receiver


def fix_frames(rx_ns: int, **change: float) -> tuple[RawFrame, RawFrame, RawFrame]:
    v: dict[str, float] = {
        "Lat": 48.1234567, "Lon": 11.7654321, "Height": 512.34, "HAcc": 40, "VAcc": 30,
        "VelN": 300, "VelE": -400, "VelD": 50, "Fix": 9, "VelOk": 1, **change,
    }  # fmt: skip
    first = {k: v[k] for k in ("Lat", "Lon")}
    second = {k: v[k] for k in ("Height", "HAcc", "VAcc")}
    third = {k: v[k] for k in ("VelN", "VelE", "VelD", "Fix", "VelOk")}
    return (
        frame("Position", rx_ns, **first),
        frame("Motion", rx_ns + 5 * MS, Page=0, **second),
        frame("Motion", rx_ns + 10 * MS, Page=1, **third),
    )


def test_a_fix_of_three_frames_two_of_them_multiplexed() -> None:
    driver = made(GNSS, latency_ms=50.0)
    (fix,) = feed(driver, *fix_frames(1000 * MS))
    assert isinstance(fix, GnssFix)
    assert fix.t_ns == 950 * MS
    assert (fix.lat, fix.lon) == pytest.approx((48.1234567 * DEG, 11.7654321 * DEG), abs=1e-14)
    assert fix.height == pytest.approx(512.34)
    assert fix.sigma_position == pytest.approx([0.02, 0.02, 0.03])
    assert fix.v_g == pytest.approx([-4.0, 3.0, -0.5])
    assert fix.sigma_velocity == pytest.approx([0.05, 0.05, 0.2])
    assert fix.fix_type == FixType.RTK_FIXED
    assert fix.gps_ns is None


def test_a_multiplexer_value_that_nobody_maps_is_left_alone_and_an_unknown_one_counted() -> None:
    driver = made(GNSS)
    a, b, c = fix_frames(0)
    foreign = c._replace(data=bytes([2]) + c.data[1:])
    assert len(feed(driver, a, b, foreign, c)) == 1
    assert sum(rejects(driver).values()) == 1


def test_invalid_parts_of_a_fix() -> None:
    driver = made(GNSS)
    (fix,) = feed(driver, *fix_frames(0, VelOk=0))
    assert fix.v_g is None
    assert fix.sigma_velocity is None
    assert feed(driver, *fix_frames(1000 * MS, Fix=0), *fix_frames(2000 * MS, Fix=5)) == []
    assert rejects(driver) == {"INVALID": 2}


def test_an_epoch_that_stays_incomplete_is_counted_by_time_and_by_repetition() -> None:
    driver = made(GNSS)
    a, b, _ = fix_frames(0)
    assert feed(driver, a, b) == []
    assert len(feed(driver, *fix_frames(200 * MS))) == 1  # beyond the window of 30 ms
    assert rejects(driver) == {"INCOMPLETE": 1}
    a2, b2, c2 = fix_frames(400 * MS)
    assert len(feed(driver, a2, a2, b2, c2)) == 1  # a second position begins anew
    assert rejects(driver) == {"INCOMPLETE": 2}


def test_a_sigma_of_zero_means_less_than_half_a_step() -> None:
    driver = made(GNSS.replace('sigma_up = "VAcc"', 'sigma_up = { signal = "VAcc", unit = "cm" }'))
    (fix,) = feed(driver, *fix_frames(0, HAcc=0, VAcc=0))
    assert fix.sigma_position == pytest.approx([0.005, 0.005, 0.005])  # the floor, and half of 1 cm


def test_speed_and_course_become_a_velocity() -> None:
    polar = (
        GNSS.replace('vel_east = "VelE"', 'speed = "VelE"')
        .replace('vel_north = "VelN"', 'course = { signal = "VelN", unit = "deg" }')
        .replace('vel_up = "-VelD"', 'sigma_course = { value = 2.0, unit = "deg" }')
    )
    (fix,) = feed(made(polar), *fix_frames(0, VelE=1000, VelN=120))
    assert fix.v_g == pytest.approx([10.0 * math.sin(120 * DEG), 10.0 * math.cos(120 * DEG), 0.0])
    # along the course 5 cm/s; across it 10 m/s times 2 deg and the 5 cm/s
    along, across = 0.05, math.hypot(0.05, 10.0 * 2.0 * DEG)
    s, c = math.sin(120 * DEG), math.cos(120 * DEG)
    expected = [math.hypot(along * s, across * c), math.hypot(along * c, across * s), 0.2]
    assert fix.sigma_velocity == pytest.approx(expected)


# --- odometer and speed


def test_ticks_wrap_and_the_reverse_signal_turns_their_sign() -> None:
    driver = made(
        '[odometer]\nticks = "Ticks"\nm_per_tick = 0.02\n'
        'reverse = { "Wheel.Back" = 1 }\nstandstill = { Stop = 1 }\n'
    )
    samples = feed(
        driver,
        frame("Wheel", 0, Ticks=65_500),
        frame("Wheel", 100 * MS, Ticks=64),
        frame("Wheel", 300 * MS, Ticks=114, Back=1),
        frame("Wheel", 400 * MS, Ticks=114, Stop=1),
    )
    assert all(isinstance(s, OdoSample) for s in samples)
    assert [s.distance for s in samples] == pytest.approx([2.0, -1.0, 0.0])
    assert [s.dt for s in samples] == pytest.approx([0.1, 0.2, 0.1])
    assert [s.standstill for s in samples] == [False, False, True]


def test_a_distance_that_counts_down_goes_back_and_a_jump_is_refused() -> None:
    driver = made('[odometer]\ndistance = "Trip"\nmax_speed_m_s = 50\n')
    samples = feed(
        driver,
        frame("Wheel", 0, Trip=0.3),
        frame("Wheel", 100 * MS, Trip=6553.5),
        frame("Wheel", 200 * MS, Trip=3000.0),
        frame("Wheel", 300 * MS, Trip=3001.0),
    )
    assert [s.distance for s in samples] == pytest.approx([-0.4, 1.0])
    assert rejects(driver) == {"RANGE": 1}


def test_speed_in_its_own_unit_and_direction() -> None:
    driver = made(
        '[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\nreverse = { "Speedo.Back" = 1 }\n'
    )
    samples = feed(driver, frame("Speedo", 0, Kmh=36.0), frame("Speedo", 100 * MS, Kmh=3.6, Back=1))
    assert all(isinstance(s, SpeedSample) for s in samples)
    assert [s.speed for s in samples] == pytest.approx([10.0, -1.0])
    assert samples[0].sigma == pytest.approx(0.3 / 3.6)
    assert feed(driver, frame("Speedo", 200 * MS, Kmh=300.5)) == []
    assert rejects(driver) == {"RANGE": 1}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_float_that_is_no_number_is_refused(value: float) -> None:
    driver = made('[speed]\nspeed = "Fast"\nsigma = { value = 0.1, unit = "m/s" }\n')
    assert feed(driver, frame("Floats", 0, Fast=value)) == []
    assert rejects(driver) == {"RANGE": 1}
    assert feed(driver, frame("Floats", MS, Fast=-2.5))[0].speed == -2.5


def test_what_no_vehicle_does_is_refused_where_the_file_declares_no_range() -> None:
    driver = made('[speed]\nspeed = "Fast"\nsigma = { value = 0.1, unit = "m/s" }\n')
    assert feed(driver, frame("Floats", 0, Fast=3e38)) == []
    assert rejects(driver) == {"RANGE": 1}
    wild = made(
        ONE_FRAME_IMU.replace('z = "-W" }', 'z = "-W", unit = "rpm" }').replace(
            '"W"', '{ signal = "W", scale = 100 }'
        )
    )
    assert feed(wild, frame("Single", 0, W=300.0, Ok=1)) == []
    assert rejects(wild) == {"RANGE": 1}


def test_channels_of_one_device_share_its_frames() -> None:
    text = '[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\n' + (
        '[odometer]\ndistance = { signal = "Kmh", unit = "m" }\nmax_speed_m_s = 1e6\n'
    )
    driver = made(text)
    kinds = [
        type(s).__name__ for s in feed(driver, *(frame("Speedo", i * 100 * MS, Kmh=i) for i in range(3)))
    ]
    assert kinds == ["SpeedSample", "SpeedSample", "OdoSample", "SpeedSample", "OdoSample"]


# --- what devices do wrong


def test_lengths() -> None:
    driver = made('[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\n')
    good = frame("Speedo", 0, Kmh=36.0)
    assert feed(driver, good._replace(data=good.data[:3]), good._replace(data=b"")) == []
    assert rejects(driver) == {"LENGTH": 2}
    # padded to eight bytes, as many devices do
    assert feed(driver, good._replace(data=good.data.ljust(8, b"\xcc")))[0].speed == pytest.approx(10.0)


@settings(deadline=None, max_examples=60)  # every example reads the DBC file anew
@given(
    st.lists(
        st.tuples(
            st.sampled_from([1041 | CAN_EFF, 1042, 1060, 1061, 1070, 1072]),
            st.integers(-10 * MS, 200 * MS),
            st.binary(max_size=64),
        ),
        max_size=40,
    )
)
def test_no_frame_raises_and_time_never_goes_back(parts: list[tuple[int, int, bytes]]) -> None:
    driver = made(
        TWO_FRAME_IMU + GNSS + '[odometer]\ndistance = "Trip"\n'
        '[speed]\nspeed = "Fast"\nsigma = { value = 1, unit = "m/s" }\n'
    )
    rx_ns, last = 0, {}
    for key, step, data in parts:
        rx_ns += step
        for sample in driver.feed(RawFrame(0, rx_ns, 1, key, data)):
            assert sample.t_ns > last.get(type(sample), -(2**62))
            last[type(sample)] = sample.t_ns
            if isinstance(sample, ImuSample):
                assert sample.dt > 0.0
    assert driver.counters.frames == len(parts)


# --- what mappings do wrong


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        ("", "dbc", 'found "vendor.dbc", expected at least one of the tables imu, gnss, speed, odometer'),
        (TWO_FRAME_IMU.replace("RateFwd", "RateForward"), "imu.gyro.y", 'found "RateForward", expected'),
        (
            TWO_FRAME_IMU.replace("AccUp", "Forces.AccDown"),
            "imu.accel.z",
            "one of Forces.AccFwd, Forces.AccLeft, Forces.AccUp",
        ),
        (
            TWO_FRAME_IMU.replace('"Rates.Ok"', '"Ok"'),
            "imu.valid.Ok",
            "there are several: Rates.Ok or Forces.Ok or Single.Ok",
        ),
        (
            TWO_FRAME_IMU.replace('"AccUp" }', '"AccUp", unit = "m/s" }'),
            "imu.accel.x.unit",
            'found "m/s", expected a unit of accel',
        ),
        (
            TWO_FRAME_IMU.replace('"AccUp"', '"RateUp"'),
            "imu.accel.z",
            '(the DBC file says "deg/s"), as unit = one of m/s^2,',
        ),
        (TWO_FRAME_IMU.replace('"Count"', '"Counter"'), "imu.counter", 'found "Rates.Counter", expected'),
        (
            TWO_FRAME_IMU.replace("rate_hz = 100", "rate_hz = 0"),
            "imu.rate_hz",
            "found 0, expected a number > 0",
        ),
        (TWO_FRAME_IMU.replace("rate_hz = 100", ""), "imu.rate_hz", "found nothing"),
        (TWO_FRAME_IMU + 'gravity = "up"\n', "imu.gravity", "found an unknown key"),
        (TWO_FRAME_IMU + 'time = { value = 1, unit = "s" }\n', "imu.time", "expected a signal"),
        (
            GNSS.replace("sigma_horizontal", "sigma_east"),
            "gnss",
            "expected either sigma_horizontal, or sigma_east and",
        ),
        (GNSS.replace('vel_east = "VelE"', ""), "gnss", "expected for a velocity vel_east, vel_north"),
        (GNSS.replace("RTK_FIXED", "RTK"), "gnss.fix_type.values.9", 'found "RTK", expected one of DGPS'),
        (GNSS.replace("9 =", "nine ="), "gnss.fix_type.values", 'found "nine", expected a number as key'),
        (
            GNSS.replace("value = 5,", 'value = 5, signal = "VelE",'),
            "gnss.sigma_speed",
            "both or none of signal and value",
        ),
        (GNSS.replace(', unit = "cm/s"', ""), "gnss.sigma_speed", "a value without unit"),
        ('[speed]\nspeed = "Odd"\nsigma = "Fast"\n', "speed.speed", 'the DBC file says "smoot"'),
        ('[odometer]\nticks = "Ticks"\n', "odometer", "expected either distance, or ticks and m_per_tick"),
        (
            '[odometer]\ndistance = { signal = "Fast", unit = "m" }\n',
            "odometer.distance",
            "an integer signal",
        ),
    ],
)
def test_mistakes_in_a_mapping_are_named(text: str, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made(text)
    assert str(caught.value).startswith(f"test.toml: device.dev.{key}: ")
    assert says in str(caught.value)


def test_a_file_that_is_no_dbc_is_named() -> None:
    options = convert({"driver": "dbc_map", "source": "s", "dbc": "x.dbc"}, DbcMapOptions, "t")
    with pytest.raises(
        ConfigError, match=r'test.toml: device.dev.dbc: found "x.dbc", expected a DBC file \('
    ):
        DbcMap(options, context(files={"x.dbc": b"\x7fELF not a DBC"}))


# --- the log of a real device

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

    def driver(text: str) -> DbcMap:
        table = {
            "driver": "dbc_map",
            "source": "can2",
            "dbc": "canmod-gps.dbc",
            **parse(text.encode(), "t.toml"),
        }
        return DbcMap(convert(table, DbcMapOptions, "t.toml"), context(files={"canmod-gps.dbc": dbc}))

    imu, gnss = driver(REAL_IMU), driver(REAL_GNSS)
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
