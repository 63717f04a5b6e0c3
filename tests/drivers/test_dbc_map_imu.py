"""Somebody else's DBC file: inertial samples out of one frame or two, by counter, device time or arrival."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from bridge.frame import CAN_EFF, RawFrame
from nav.types import ImuFlag, ImuSample
from tests.drivers.made import rejects
from tests.drivers.vendor import DEG, MS, ONE_FRAME_IMU, TWO_FRAME_IMU, G, feed, frame, made, pair


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
