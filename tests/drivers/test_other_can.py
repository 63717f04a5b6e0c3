"""Odometer, speed, barometer and GNSS on CAN."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.baro_can import BaroCan, BaroCanOptions, pressure_altitude
from bridge.drivers.gnss_can import WEEK_NS, GnssCan, GnssCanOptions
from bridge.drivers.odometer_can import OdometerCan, OdometerCanOptions
from bridge.drivers.speed_can import SpeedCan, SpeedCanOptions
from bridge.frame import RawFrame
from nav.types import FixType, GnssFix, OdoSample
from tests.drivers.made import can, context, flipped, rejects

MS = 1_000_000
FORWARD, REVERSE, UNKNOWN = 1, 2, 0


def odometer(**options: object) -> OdometerCan:
    table = {"driver": "odometer_can", "source": "can0", "m_per_tick": 0.05, **options}
    return OdometerCan(OdometerCanOptions(**table), context("odo"))  # type: ignore[arg-type]


def odo(k: int, ticks: int, direction: int = FORWARD, still: int = 0, valid: int = 1) -> RawFrame:
    """Frame k of a 50 Hz odometer whose 16-bit time is about to wrap."""
    time_us = (6_500_000 + k * 20_000) // 100 * 100 % 6_553_600
    return can("ODO", k % 15, direction, still, valid, ticks % 2**32, time_us, rx_ns=10**9 + k * 20 * MS)


def test_ticks_and_time_wrap() -> None:
    driver = odometer()
    start = 2**32 - 35
    samples = [s for k in range(20) for s in driver.feed(odo(k, start + 7 * k))]
    assert len(samples) == 19  # the first frame has nothing to be counted from
    for s in samples:
        assert s.distance == pytest.approx(7 * 0.05)
        assert s.dt == pytest.approx(0.02)
        assert not s.standstill


def test_ticks_count_up_in_reverse_too() -> None:
    driver = odometer()
    plan = [(0, FORWARD), (3, FORWARD), (6, REVERSE), (6, UNKNOWN), (8, UNKNOWN), (9, FORWARD)]
    frames = (odo(k, ticks, way) for k, (ticks, way) in enumerate(plan))
    samples = [s for frame in frames for s in driver.feed(frame)]
    assert [s.distance for s in samples] == pytest.approx([0.15, -0.15, 0.0, -0.1, 0.05])


def test_standstill_is_passed_on() -> None:
    driver = odometer()
    driver.feed(odo(0, 5))
    (sample,) = driver.feed(odo(1, 5, UNKNOWN, still=1))
    assert sample.standstill
    assert sample.distance == 0.0


def test_ticks_of_lost_frames_are_in_the_next() -> None:
    driver = odometer()
    driver.feed(odo(0, 0))
    (sample,) = driver.feed(odo(4, 40))
    assert sample.distance == pytest.approx(2.0)
    assert sample.dt == pytest.approx(0.08)
    assert driver.counters.missing == 3


def test_ticks_over_a_silence_longer_than_the_counter_of_time() -> None:
    driver = odometer()
    driver.feed(odo(0, 0))
    (sample,) = driver.feed(odo(500, 50))
    assert sample.dt == pytest.approx(10.0)


def test_a_counter_that_restarts_is_not_a_distance() -> None:
    driver = odometer()
    driver.feed(odo(0, 100_000))
    assert driver.feed(odo(1, 3)) == ()
    assert rejects(driver) == {"RANGE": 1}
    (sample,) = driver.feed(odo(2, 5))
    assert sample.distance == pytest.approx(0.1)


def test_invalid_ticks_are_not_counted_from() -> None:
    driver = odometer()
    driver.feed(odo(0, 100))
    assert driver.feed(odo(1, 110, valid=0)) == ()
    assert driver.feed(odo(2, 120)) == ()
    (sample,) = driver.feed(odo(3, 121))
    assert sample.distance == pytest.approx(0.05)
    assert rejects(driver) == {"INVALID": 1}


def test_alive_counter_of_single_frames() -> None:
    driver = odometer()
    driver.feed(odo(0, 0))
    assert driver.feed(odo(0, 0)) == ()  # the same frame again
    assert driver.feed(odo(15, 1)) == ()  # the same counter, another content
    assert driver.counters.duplicates == 1
    assert rejects(driver) == {"COUNTER": 1}
    assert driver.feed(flipped(odo(1, 1))) == ()
    assert driver.feed(odo(1, 1)._replace(data=b"\x00" * 3)) == ()
    assert rejects(driver) == {"COUNTER": 1, "CRC": 1, "LENGTH": 1}


@given(
    st.lists(st.tuples(st.integers(0, 40), st.booleans()), min_size=2, max_size=60), st.integers(0, 2**32 - 1)
)
@settings(max_examples=40, deadline=None)
def test_no_distance_is_lost_with_frames(steps: list[tuple[int, bool]], start: int) -> None:
    """The sum of the distances is the way from the first frame to the last that arrived."""
    driver = odometer()
    total, ticks, samples, first, last = 0, start, list[OdoSample](), None, 0
    for k, (step, arrives) in enumerate(steps):
        ticks += step
        if arrives or k in (0, len(steps) - 1):
            got = driver.feed(odo(k, ticks))
            if rejects(driver).get("COUNTER"):
                return  # fifteen lost in a row look like a frozen counter
            samples += got
            first = ticks if first is None else first
            last = ticks
    assert first is not None
    total = last - first
    assert sum(s.distance for s in samples) == pytest.approx(0.05 * total)


def test_speed() -> None:
    table = {"driver": "speed_can", "source": "can0"}
    driver = SpeedCan(SpeedCanOptions(**table), context("log"))  # type: ignore[arg-type]
    (sample,) = driver.feed(can("SPEED", 0, 1, -3.25, 0.05, 1000, rx_ns=10**9))
    assert (sample.speed, sample.sigma) == pytest.approx((-3.25, 0.05))
    (sample,) = driver.feed(can("SPEED", 1, 1, 1.0, 0.0, 101_000, rx_ns=10**9 + 100 * MS))
    assert sample.sigma == 0.01  # a device that does not know its accuracy says 0
    assert driver.feed(can("SPEED", 2, 0, 1.0, 0.0, 201_000, rx_ns=10**9 + 200 * MS)) == ()
    assert driver.feed(can("SPEED", 3, 1, 400.0, 0.1, 301_000, rx_ns=10**9 + 300 * MS)) == ()
    assert rejects(driver) == {"INVALID": 1, "RANGE": 1}


@pytest.mark.parametrize(
    ("height_m", "pressure_pa"),
    # ICAO Doc 7488, Table 1: geopotential altitude and pressure
    [
        (-1000, 113_929.0),
        (0, 101_325.0),
        (1000, 89_874.5),
        (5000, 54_019.9),
        (11_000, 22_632.0),
        (15_000, 12_044.5),
    ],
)
def test_pressure_altitude_is_the_standard_atmospheres(height_m: float, pressure_pa: float) -> None:
    """The table has six digits: 0.05 Pa is 4 mm at sea level, 25 mm at 15 km."""
    assert pressure_altitude(pressure_pa) == pytest.approx(height_m, abs=0.06)


def test_barometer() -> None:
    table = {"driver": "baro_can", "source": "can0", "sigma_m": 0.7}
    driver = BaroCan(BaroCanOptions(**table), context("baro"))  # type: ignore[arg-type]
    (sample,) = driver.feed(can("BARO", 0, 1, 89_874.5, 20.0, 1000, rx_ns=10**9))
    assert sample.height == pytest.approx(1000.0, abs=0.1)
    assert sample.sigma == 0.7
    driver.feed(can("BARO", 1, 1, 0.0, 20.0, 41_000, rx_ns=10**9 + 40 * MS))
    driver.feed(can("BARO", 2, 0, 89_874.5, 20.0, 81_000, rx_ns=10**9 + 80 * MS))
    assert rejects(driver) == {"INVALID": 1, "RANGE": 1}


def gnss(**options: object) -> GnssCan:
    table = {"driver": "gnss_can", "source": "can0", "latency_ms": 60.0, **options}
    return GnssCan(GnssCanOptions(**table), context("gnss"))  # type: ignore[arg-type]


WEEK, TOW_S = 2300, 604_799  # the week ends on the way


def epoch(
    k: int, lat: float = 47.123456789, fix: int = FixType.RTK_FIXED, vel_valid: int = 1, sigma: float = 0.25
) -> list[RawFrame]:
    """The six frames of epoch k at 5 Hz, the first arriving 60 ms late."""
    rx = 10**9 + k * 200 * MS + 60 * MS
    gps_us = (WEEK * 604_800 + TOW_S) * 1_000_000 + k * 200_000
    week, tow = divmod(gps_us, 604_800 * 1_000_000)
    a = k % 15
    return [
        can("GNSS_TIME", a, tow, week, rx_ns=rx),
        can("GNSS_LAT", a, lat, sigma, rx_ns=rx + 130_000),
        can("GNSS_LON", a, -122.987654321, 0.5, rx_ns=rx + 260_000),
        can("GNSS_HEIGHT", a, 432.109, 1.0, fix, 17, rx_ns=rx + 390_000),
        can("GNSS_VEL", a, 1.5, -2.5, 0.125, rx_ns=rx + 520_000),
        can("GNSS_ACC", a, 0.05, 0.06, 0.07, vel_valid, 18, rx_ns=rx + 650_000),
    ]


def test_an_epoch_becomes_a_fix() -> None:
    driver = gnss()
    fixes = [fix for k in range(12) for frame in epoch(k) for fix in driver.feed(frame)]
    assert len(fixes) == 12
    for k, fix in enumerate(fixes):
        assert math.degrees(fix.lat) == pytest.approx(47.123456789, abs=1e-12)
        assert math.degrees(fix.lon) == pytest.approx(-122.987654321, abs=1e-12)
        assert fix.height == pytest.approx(432.109)
        np.testing.assert_allclose(fix.sigma_position, [0.5, 0.25, 1.0], rtol=1e-12)
        np.testing.assert_allclose(fix.v_g, [1.5, -2.5, 0.125])  # type: ignore[arg-type]
        np.testing.assert_allclose(fix.sigma_velocity, [0.05, 0.06, 0.07])  # type: ignore[arg-type]
        assert (fix.fix_type, fix.satellites, fix.device) == (FixType.RTK_FIXED, 17, "gnss")
        assert fix.gps_ns == WEEK * WEEK_NS + TOW_S * 10**9 + k * 200 * MS
        assert fix.t_ns == 10**9 + k * 200 * MS
    assert rejects(driver) == {}


def feed(driver: GnssCan, frames: list[RawFrame]) -> list[GnssFix]:
    return [fix for frame in frames for fix in driver.feed(frame)]


@pytest.mark.parametrize("lost", range(6))
def test_an_epoch_with_a_hole_is_counted(lost: int) -> None:
    driver = gnss()
    frames = epoch(0) + [f for place, f in enumerate(epoch(1)) if place != lost] + epoch(2)
    assert len(feed(driver, frames)) == 2
    assert rejects(driver) == {"INCOMPLETE": 1}


def test_epochs_lost_whole_are_missing() -> None:
    driver = gnss()
    assert len(feed(driver, epoch(0) + epoch(4))) == 2
    assert driver.counters.missing == 3


def test_a_repeated_epoch_is_dropped() -> None:
    driver = gnss()
    assert len(feed(driver, epoch(0) + epoch(0) + epoch(1))) == 2
    assert driver.counters.duplicates == 6


def test_what_the_receiver_does_not_vouch_for() -> None:
    driver = gnss()
    assert feed(driver, epoch(0, fix=FixType.NO_FIX)) == []
    (fix,) = feed(driver, epoch(1, vel_valid=0))
    assert fix.v_g is None
    assert fix.sigma_velocity is None
    (fix,) = feed(driver, epoch(2, sigma=0.0))
    assert fix.sigma_position[1] == 0.005
    assert rejects(driver) == {"INVALID": 1}


def test_values_outside_the_declared_range() -> None:
    """A latitude of 91 degrees cannot be encoded, so it is written into the bits and the CRC made good."""
    from dbc import e2e
    from dbc.codec import contract

    driver = gnss()
    frames = epoch(0)
    raw = int.from_bytes(frames[1].data, "little")
    mask = ((1 << 38) - 1) << 12
    data = bytearray(((raw & ~mask) | (91_000_000_000 << 12 & mask)).to_bytes(8, "little"))
    e2e.protect_p01(data, contract()["GNSS_LAT"].data_id)
    frames[1] = frames[1]._replace(data=bytes(data))
    assert feed(driver, frames) == []
    assert rejects(driver) == {"RANGE": 1}


def test_time_that_goes_back_is_stale() -> None:
    driver = gnss()
    frames = epoch(0) + epoch(1) + epoch(2)
    week, tow = WEEK, TOW_S * 1_000_000
    late = epoch(3)
    late[0] = can("GNSS_TIME", 3, tow + 200_000, week, rx_ns=late[0].rx_ns)
    assert len(feed(driver, frames + late)) == 3
    assert rejects(driver) == {"STALE": 1}
