"""The CAN inertial driver: assembly, gaps, duplicates, faults."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.frame import RawFrame
from dbc.codec import Contract
from nav.types import ImuFlag, ImuSample
from tests.drivers.made import ARCSEC, CALIBRATION, can, context, flipped, rejects

PERIOD_US = 5000
FIRST_US = 2**32 - 12 * PERIOD_US  # wraps on the way


def driver(messages: Contract | None = None, **options: object) -> ImuCan:
    table = {
        "driver": "imu_can",
        "source": "can0",
        "calibration": "cal.toml",
        "rate_hz": 200.0,
        "latency_ms": 0.26,
        **options,
    }
    made = context("imu", {"cal.toml": CALIBRATION}, messages=messages)
    return ImuCan(ImuCanOptions(**table), made)  # type: ignore[arg-type]


def three(k: int, gyro: int = 10, status: int = 0, sat: int = 0) -> list[RawFrame]:
    """Sample k, counted from 0, arriving 0.3 ms after its end."""
    rx = 10**9 + k * PERIOD_US * 1000 + 300_000
    time_us = (FIRST_US + k * PERIOD_US) % 2**32
    a = k % 15
    return [
        can("IMU_GYRO", a, sat, 0, 0, gyro, -gyro, 2 * gyro, rx_ns=rx),
        can("IMU_ACCEL", a, 0, 0, 0, 1, 2, 490, rx_ns=rx + 130_000),
        can("IMU_TIME", a, status, k % 256, 25, time_us, rx_ns=rx + 260_000),
    ]


def one_fd(k: int, gyro: int = 10) -> list[RawFrame]:
    rx = 10**9 + k * PERIOD_US * 1000 + 560_000
    values = (0,) * 6 + (
        gyro,
        -gyro,
        2 * gyro,
        1,
        2,
        490,
        k % 65536,
        2**48 - 10_000 + k * PERIOD_US,
        20.0,
        0,
        0,
        77,
    )
    values = (*values[:13], values[13] % 2**48, *values[14:])
    return [can("IMU_FD", k % 256, *values, rx_ns=rx)]


def fed(imu: ImuCan, frames: Iterable[RawFrame]) -> list[ImuSample]:
    return [sample for frame in frames for sample in imu.feed(frame)]


@pytest.mark.parametrize("frames", [three, one_fd])
def test_pulses_become_increments(frames: object) -> None:
    imu = driver()
    samples = fed(imu, (f for k in range(50) for f in frames(k)))  # type: ignore[operator]
    assert len(samples) == 50
    for k, s in enumerate(samples):
        assert s.device == "imu"
        assert s.flags == ImuFlag.OK
        assert s.dt == pytest.approx(0.005, abs=1e-12)
        np.testing.assert_allclose(s.dtheta, [10 * ARCSEC, -10 * ARCSEC, 20 * ARCSEC], rtol=1e-14)
        np.testing.assert_allclose(s.dv, [1e-4, 2e-4, 0.049], rtol=1e-14)
        # every frame is equally late: the stamp is that of the frame with the time, less the latency
        assert s.t_ns == 10**9 + k * PERIOD_US * 1000 + 300_000
    health = imu.counters.health(samples[-1].t_ns)
    assert (health.samples, health.missing, health.duplicates, health.rejects) == (50, 0, 0, {})
    assert health.frames == 50 * len(frames(0))  # type: ignore[operator]


def test_the_interval_is_the_devices_not_the_nominal() -> None:
    imu = driver(rate_hz=100.0)  # the device runs at 200 Hz
    samples = fed(imu, (f for k in range(20) for f in three(k)))
    assert len(samples) == 20
    assert all(s.dt == pytest.approx(0.005) for s in samples[1:])
    assert imu.counters.missing == 0


@pytest.mark.parametrize("lost", [1, 3, 5])
def test_a_short_gap_is_bridged_on_a_straight_line(lost: int) -> None:
    imu = driver(bridge_samples=5)
    # a ramp in rate: the straight line is exact
    kept = [k for k in range(40) if not 20 <= k < 20 + lost]
    samples = fed(imu, (f for k in kept for f in three(k, gyro=100 + 7 * k)))
    assert len(samples) == 40
    for k, s in enumerate(samples):
        assert s.flags == (ImuFlag.BRIDGED if 20 <= k < 20 + lost else ImuFlag.OK)
        assert s.dtheta[0] == pytest.approx((100 + 7 * k) * ARCSEC, rel=1e-12)
        assert s.dt == pytest.approx(0.005)
        assert s.t_ns == pytest.approx(10**9 + k * PERIOD_US * 1000 + 300_000, abs=2)
    health = imu.counters.health(0)
    assert (health.missing, health.bridged) == (lost, lost)


@pytest.mark.parametrize("lost", [6, 14, 40, 255, 256, 600])
def test_a_long_gap_is_flagged_and_counted(lost: int) -> None:
    """Also where the sample counter of 8 bits has come round, and where ALIVE (of 15) has."""
    imu = driver(bridge_samples=5)
    frames = [f for k in (*range(20), *range(20 + lost, 60 + lost)) for f in three(k)]
    samples = fed(imu, frames)
    first = samples[20]
    # after a whole number of ALIVE rounds the first sample cannot be told from a repeated counter
    hidden = 1 if (lost + 1) % 15 == 0 else 0
    assert first.flags == ImuFlag.GAP
    assert first.dt == pytest.approx(0.005, rel=1e-3)
    assert all(s.flags == ImuFlag.OK for s in samples[21:])
    assert imu.counters.missing == lost + hidden
    assert imu.counters.bridged == 0


def test_a_lost_frame_loses_its_sample() -> None:
    for which in range(3):
        imu = driver()
        frames = [f for k in range(10) for place, f in enumerate(three(k)) if (k, place) != (5, which)]
        samples = fed(imu, frames)
        assert len(samples) == 10
        assert [s.flags for s in samples].index(ImuFlag.BRIDGED) == 5
        assert rejects(imu) == {"INCOMPLETE": 1}
        assert imu.counters.missing == 1


def test_bad_frames_are_counted_by_reason() -> None:
    for which in range(3):
        for spoil, reason in ((flipped, "CRC"), (lambda f: f._replace(data=f.data[:5]), "LENGTH")):
            imu = driver()
            frames = [f for k in range(4) for f in three(k)]
            frames[6 + which] = spoil(frames[6 + which])
            assert len(fed(imu, frames)) == 4  # the one lost is bridged
            assert rejects(imu).pop(reason) == 1


def test_duplicates_are_dropped() -> None:
    imu = driver()
    frames = [f for k in range(10) for f in three(k) for _ in range(2)]
    samples = fed(imu, frames)
    assert len(samples) == 10
    assert all(s.flags == 0 for s in samples)
    # the second accelerometer frame of a pair is the same in place and cannot hurt
    assert imu.counters.duplicates >= 20


def test_whole_samples_sent_twice_are_dropped() -> None:
    imu = driver()
    samples = fed(imu, (f for k in range(10) for _ in range(2) for f in three(k)))
    assert len(samples) == 10
    assert imu.counters.duplicates == 30
    assert rejects(imu) == {}


def test_a_frozen_alive_counter_is_refused() -> None:
    imu = driver()
    frames = [f for k in range(5) for f in three(k)]
    for k in range(5, 10):
        rx = 10**9 + k * PERIOD_US * 1000
        frames += [
            can("IMU_GYRO", 4, 0, 0, 0, k, 0, 0, rx_ns=rx),
            can("IMU_ACCEL", 4, 0, 0, 0, k, 0, 0, rx_ns=rx),
            can("IMU_TIME", 4, 0, k, 25, (FIRST_US + k * PERIOD_US) % 2**32, rx_ns=rx),
        ]
    assert len(fed(imu, frames)) == 5
    assert rejects(imu) == {"COUNTER": 15}


def test_a_frozen_sample_counter_is_refused() -> None:
    imu = driver()
    frames = []
    for k in range(10):
        gyro, accel, _ = three(k)
        frames += [
            gyro,
            accel,
            can("IMU_TIME", k % 15, 0, min(k, 4), 25, 1000 + k * PERIOD_US, rx_ns=gyro.rx_ns),
        ]
    assert len(fed(imu, frames)) == 5
    assert rejects(imu) == {"COUNTER": 5}


def test_a_device_that_restarts_goes_on_after_a_flag() -> None:
    imu = driver()
    samples = fed(imu, (f for k in range(100) for f in three(k)))
    rx = 10**9 + 100 * PERIOD_US * 1000
    for k in range(400):
        a = k % 15
        now = rx + k * PERIOD_US * 1000
        samples += fed(
            imu,
            [
                can("IMU_GYRO", a, 0, 0, 0, 10, 0, 0, rx_ns=now),
                can("IMU_ACCEL", a, 0, 0, 0, 0, 0, 490, rx_ns=now),
                can("IMU_TIME", a, 0, k % 256, 25, k * PERIOD_US, rx_ns=now),
            ],
        )
    flagged = [s for s in samples if s.flags & ImuFlag.GAP]
    assert len(flagged) == 1
    assert len(samples) >= 495
    assert all(s.dt == pytest.approx(0.005, rel=1e-3) for s in samples)
    assert abs(samples[-1].t_ns - (rx + 399 * PERIOD_US * 1000)) < 1_000_000
    stamps = [s.t_ns for s in samples]
    assert stamps == sorted(set(stamps))


def test_device_time_that_goes_back_is_stale() -> None:
    imu = driver()
    frames = [f for k in range(10) for f in three(k)]
    old = three(9)
    late = can("IMU_TIME", 10, 0, 10, 25, (FIRST_US + 5 * PERIOD_US) % 2**32, rx_ns=old[2].rx_ns + 5_000_000)
    odd = [old[0]._replace(data=three(10)[0].data), old[1]._replace(data=three(10)[1].data), late]
    assert len(fed(imu, [*frames, *odd])) == 10
    assert rejects(imu) == {"STALE": 1}
    (after,) = fed(imu, three(11))[-1:]
    assert after.flags & ImuFlag.GAP


def test_saturation_and_faults_are_flagged() -> None:
    imu = driver()
    plain, saturated, faulty, test_mode, synchronised = (
        fed(imu, three(k, status=status, sat=sat))[0]
        for k, (status, sat) in enumerate([(0, 0), (0, 1), (1, 0), (2, 0), (4, 0)])
    )
    assert plain.flags == synchronised.flags == ImuFlag.OK
    assert saturated.flags == ImuFlag.SATURATED
    assert faulty.flags == test_mode.flags == ImuFlag.DEVICE_FAULT
    assert rejects(imu) == {"SATURATED": 1}


def test_another_unit_than_the_calibration_is_for_is_said_once_and_not_heard() -> None:
    imu = driver()
    assert len(fed(imu, three(0))) == 1
    for k in range(4):
        imu.feed(can("IMU_STATUS", k, 20.0, 0, 78))
    assert imu.counters.notes == ["serial number 78, but the calibration is for 77: no sample is used"]
    assert fed(imu, [*three(1), *three(2)]) == []
    assert rejects(imu) == {"FOREIGN": 2}


def test_one_status_alone_with_another_serial_number_is_not_believed() -> None:
    imu = driver()
    for k, serial in enumerate((77, 78, 77, 78, 77)):
        imu.feed(can("IMU_STATUS", k, 20.0, 0, serial))
    assert imu.counters.notes == []
    assert len(fed(imu, three(0))) == 1


def test_shifted_identifiers() -> None:
    imu = driver(id_offset=0x20)
    assert imu.keys == [(1, key) for key in (0x120, 0x121, 0x122, 0x130, 0x123)]


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_any_mixture_of_frames_keeps_the_promises(data: st.DataObject) -> None:
    """Frames lost, doubled, spoilt and exchanged: no exception, stamps grow, intervals are plausible."""
    imu = driver()
    frames = [f for k in range(data.draw(st.integers(1, 40))) for f in three(k)]
    for _ in range(data.draw(st.integers(0, 10))):
        place = data.draw(st.integers(0, len(frames) - 1))
        what = data.draw(st.integers(0, 4))
        if what == 0 and len(frames) > 1:
            del frames[place]
        elif what == 1:
            frames.insert(place, frames[place])
        elif what == 2:
            frames[place] = frames[place]._replace(data=data.draw(st.binary(max_size=16)))
        elif what == 3:
            frames[place], frames[-1] = frames[-1], frames[place]
        else:
            frames[place] = frames[place]._replace(rx_ns=data.draw(st.integers(0, 2**62)))
    last = -1
    for sample in fed(imu, frames):
        assert sample.t_ns > last or last == -1
        last = sample.t_ns
        assert 0.0 < sample.dt < 0.2
        assert np.all(np.isfinite(sample.dtheta))
        assert np.all(np.isfinite(sample.dv))
