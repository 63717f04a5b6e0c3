"""Latch times and arms: what the driver makes of them, against counts and motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.errors import ConfigError
from bridge.frame import RawFrame
from nav.imu.whole_cycle import METHODS
from nav.types import ImuFlag, ImuSample
from tests.drivers.made import ARCSEC, CALIBRATION, can, context, flipped, rejects

PERIOD_US = 5000
RATES = np.array([370.0, 359.0, 408.0])
PHASES = np.array([0.1, 0.6, 0.3])
TURN = 4e4  # pulses a second


def driver(calibration: bytes = CALIBRATION, **options: object) -> ImuCan:
    table = {"driver": "imu_can", "source": "can0", "calibration": "cal.toml", "rate_hz": 200.0, **options}
    return ImuCan(ImuCanOptions(**table), context("imu", {"cal.toml": calibration}))  # type: ignore[arg-type]


def turned(t: np.ndarray) -> np.ndarray:
    """Whole pulses till ``t`` (3,) s of a rate that swings between nothing and twice `TURN`."""
    return np.rint(TURN * (t + np.cos(12.0 * t) / 12.0)).astype(int)


def latched(k: int) -> np.ndarray:
    t = k * PERIOD_US * 1e-6
    return np.asarray((np.floor(t * RATES + PHASES) - PHASES) / RATES)


def sample(k: int, fd: bool = False, age: float | None = None) -> list[RawFrame]:
    """Sample k >= 1 with its latch frame."""
    rx = 10**9 + k * PERIOD_US * 1000
    counts = (turned(latched(k)) - turned(latched(k - 1))).tolist()
    ages = 1e6 * (k * PERIOD_US * 1e-6 - latched(k)) if age is None else np.full(3, age)
    latch = can("IMU_LATCH", k % 15, k % 16, *ages.tolist(), rx_ns=rx)
    if fd:
        values = (0,) * 6 + (*counts, 1, 2, 490, k % 65536, k * PERIOD_US, 20.0, 0, 0, 77)
        return [latch, can("IMU_FD", k % 256, *values, rx_ns=rx + 1000)]
    return [
        latch,
        can("IMU_GYRO", k % 15, 0, 0, 0, *counts, rx_ns=rx + 1000),
        can("IMU_ACCEL", k % 15, 0, 0, 0, 1, 2, 490, rx_ns=rx + 2000),
        can("IMU_TIME", k % 15, 0, k % 256, 25, k * PERIOD_US, rx_ns=rx + 3000),
    ]


def fed(imu: ImuCan, frames: list[RawFrame]) -> list[ImuSample]:
    return [one for frame in frames for one in imu.feed(frame)]


def angles(samples: list[ImuSample]) -> np.ndarray:
    """Pulses since the first sample, (n, 3)."""
    return np.cumsum([one.dtheta / ARCSEC for one in samples[1:]], axis=0)


def errors(samples: list[ImuSample]) -> np.ndarray:
    """Of the angle at each instant but the first, pulses; their common part is of the first latch."""
    t = PERIOD_US * 1e-6 * np.arange(2, len(samples) + 1)
    true = TURN * (t + np.cos(12.0 * t) / 12.0)
    off = angles(samples) - true[:, None]
    return np.asarray(off - off.mean(axis=0))


@pytest.mark.parametrize("fd", [False, True])
def test_counts_are_moved_to_the_end_of_their_sample(fd: bool) -> None:
    frames = [frame for k in range(1, 201) for frame in sample(k, fd)]
    raw = fed(driver(), frames)
    # a cycle of 2.8 ms at 8e4 pulses a second
    assert np.abs(errors(raw)).max() > 50.0
    for name, most in (("linear", 3.0), ("linear+parabolic", 4.0), ("sextic+septic", 12.0)):
        imu = driver(whole_cycle=name)
        samples = fed(imu, frames)
        assert len(samples) == 200
        assert all(one.flags == ImuFlag.OK for one in samples)
        # half a pulse of each latch, as each method magnifies it, and steps of 0.1 us
        assert np.abs(errors(samples)[20:]).max() < most, name
        assert rejects(imu) == {}
        np.testing.assert_array_equal([one.dv for one in samples], [one.dv for one in raw])


def test_the_usual_path_and_frame_by_frame_agree() -> None:
    frames = [frame for k in range(1, 60) for frame in sample(k)]
    swapped = [frame for k in range(1, 60) for frame in (lambda f: [f[0], f[2], f[1], f[3]])(sample(k))]
    one, other = (fed(driver(whole_cycle="sextic+septic"), some) for some in (frames, swapped))
    np.testing.assert_array_equal([s.dtheta for s in one], [s.dtheta for s in other])


def test_a_latch_frame_that_is_lost_or_spoilt_costs_no_sample() -> None:
    whole = fed(driver(whole_cycle="linear"), [f for k in range(1, 101) for f in sample(k)])
    for spoil, reasons in (
        (lambda frames: frames[1:], {"INCOMPLETE": 1}),
        (lambda frames: [flipped(frames[0]), *frames[1:]], {"CRC": 1, "INCOMPLETE": 1}),
        (
            lambda frames: [frames[0]._replace(data=frames[0].data[:7]), *frames[1:]],
            {"LENGTH": 1, "INCOMPLETE": 1},
        ),
    ):
        imu = driver(whole_cycle="linear")
        frames = [f for k in range(1, 101) for f in (spoil(sample(k)) if k == 50 else sample(k))]
        samples = fed(imu, frames)
        assert len(samples) == 100
        assert rejects(imu) == reasons
        # the rate before goes on for 5 ms; what that misses the next sample makes good
        assert np.abs(angles(samples)[48] - angles(whole)[48]).max() < 60.0
        np.testing.assert_allclose(angles(samples)[60:], angles(whole)[60:], rtol=0, atol=3.0)


def test_the_ages_of_another_sample_are_not_taken() -> None:
    imu = driver(whole_cycle="linear")
    frames = [f for k in range(1, 51) for f in sample(k)]
    late = [*frames[:80], *frames[81:84], frames[80], *frames[84:]]  # the latch of sample 21 behind it
    assert len(fed(imu, late)) == 50
    assert rejects(imu) == {"INCOMPLETE": 1}


def test_a_latch_frame_sent_twice_is_counted_once() -> None:
    imu = driver(whole_cycle="linear")
    frames = [f for k in range(1, 21) for latch, *rest in [sample(k)] for f in (latch, latch, *rest)]
    assert len(fed(imu, frames)) == 20
    assert imu.counters.duplicates == 20
    assert rejects(imu) == {}


def test_a_gyro_that_does_not_dither_is_counted_and_read_as_it_is() -> None:
    imu = driver(whole_cycle="sextic+septic")
    frames = [f for k in range(1, 41) for f in sample(k, age=6553.5)]
    np.testing.assert_allclose(
        [one.dtheta for one in fed(imu, frames)], [one.dtheta for one in fed(driver(), frames)], rtol=1e-14
    )
    assert rejects(imu) == {"RANGE": 40}


def test_after_samples_are_lost_the_correction_begins_anew() -> None:
    kept = [k for k in range(1, 161) if not 60 <= k < 80]
    imu = driver(whole_cycle="linear")
    samples = fed(imu, [f for k in kept for f in sample(k)])
    assert samples[59].flags & ImuFlag.GAP
    after = np.cumsum([one.dtheta / ARCSEC for one in samples[60:]], axis=0)
    t = PERIOD_US * 1e-6 * np.arange(81, 161)
    true = TURN * (t + np.cos(12.0 * t) / 12.0)
    off = after - true[:, None]
    assert np.abs(off - off.mean(axis=0)).max() < 6.0


def test_latch_frames_are_subscribed_to_where_they_are_used() -> None:
    assert driver(id_offset=0x20, whole_cycle="linear").keys[-1] == (1, 0x124)
    assert (1, 0x104) not in driver().keys
    with pytest.raises(ConfigError, match=r"whole_cycle.*linear\+parabolic"):
        driver(whole_cycle="cubic")
    assert set(METHODS) == {"constant", "linear", "parabolic", "linear+parabolic", "sextic+septic"}


ARMS = CALIBRATION + b"lever_arm_mm = [[50.0, 0.0, 0.0], [0.0, 40.0, 0.0], [0.0, 0.0, 30.0]]\n"


def turning(k: int) -> list[RawFrame]:
    """A steady turn of 2000 arcsec a sample about up."""
    a, rx = k % 15, 10**9 + k * PERIOD_US * 1000
    return [
        can("IMU_GYRO", a, 0, 0, 0, 0, 0, 2000, rx_ns=rx),
        can("IMU_ACCEL", a, 0, 0, 0, 1, 2, 490, rx_ns=rx),
        can("IMU_TIME", a, 0, k % 256, 25, k * PERIOD_US, rx_ns=rx),
    ]


def test_arms_in_the_calibration_are_taken_off() -> None:
    """(5-17): what pulls accelerometers inwards is added back; up feels none of a turn about up."""
    frames = [frame for k in range(40) for frame in turning(k)]
    with_arms, without = fed(driver(ARMS), frames), fed(driver(), frames)
    rate = 2000.0 * ARCSEC / 5e-3
    for one, other in zip(with_arms, without, strict=True):
        np.testing.assert_allclose(
            one.dv - other.dv, [0.05 * rate**2 * 5e-3, 0.04 * rate**2 * 5e-3, 0.0], rtol=1e-9, atol=1e-17
        )
        np.testing.assert_array_equal(one.dtheta, other.dtheta)


def test_a_gap_is_no_angular_acceleration() -> None:
    tilted = CALIBRATION + b"lever_arm_mm = [[0.0, 50.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]\n"
    still = [frame._replace(rx_ns=frame.rx_ns) for k in range(20) for frame in turning(k)]
    frames = still + [frame for k in range(60, 90) for frame in turning(k)]
    samples = fed(driver(tilted), frames)
    assert samples[20].flags & ImuFlag.GAP
    for one in samples:
        assert one.dv[0] == pytest.approx(1e-4, abs=1e-15)
