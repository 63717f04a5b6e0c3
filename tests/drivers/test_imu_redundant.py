"""Redundant inertial units on the bus: fused increments, sensors that fail, and what cannot be."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.errors import ConfigError
from bridge.frame import RawFrame
from bridge.outputs import UnitHealth
from bridge.strict import convert
from dbc.codec import contract
from nav.types import ImuChange, ImuFlag, ImuSample
from tests.drivers.made import ARCSEC, CALIBRATION, can, context, flipped, rejects

RATE = 100
DT = 1.0 / RATE
G = 9.80665
NONE = -32768
PULSE, PUSH = 0.1 * ARCSEC, 2e-5
WALK = np.radians(0.01 / 60.0)  # 0.01 deg/sqrt(h)
WALK_A = 40e-6 * G

ANGLE = np.arange(6) * np.pi / 3.0
CONE = np.column_stack(
    (np.full(6, np.sqrt(1 / 3)), np.sqrt(2 / 3) * np.cos(ANGLE), np.sqrt(2 / 3) * np.sin(ANGLE))
)
SKEW = np.vstack((np.eye(3), np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]) / np.sqrt(3.0)))
NOISE = {
    "gyro_random_walk_deg_per_sqrt_h": 0.01,
    "gyro_bias_deg_per_h": 0.1,
    "gyro_scale_ppm": 40.0,
    "accel_random_walk_ug_per_sqrt_hz": 40.0,
    "accel_bias_ug": 200.0,
    "accel_scale_ppm": 80.0,
    "false_alarms_per_h": 0.01,
}


def sheet(axes: np.ndarray, gyros: int | None = None) -> bytes:
    rows = [[float(x) for x in row] for row in axes]
    n = len(rows)
    return f"""
[device]
serial = 77
[gyro]
scale_arcsec_per_pulse = {[0.1] * (gyros or n)}
axes = {rows[: gyros or n]}
[accel]
scale_m_s_per_pulse = {[PUSH] * n}
axes = {rows}
""".encode()


def driver(axes: np.ndarray = CONE, **options: object) -> ImuCan:
    table = {
        "driver": "imu_can", "source": "can0", "calibration": "cal.toml", "rate_hz": float(RATE),
        "redundant": NOISE, **options,
    }  # fmt: skip
    made = convert({k: v for k, v in table.items() if v is not None}, ImuCanOptions, "t.toml", "device.imu")
    return ImuCan(made, context("imu", {"cal.toml": sheet(axes)}))


class Unit:
    """Sensors along ``axes`` in a motion of closed form, with the noise of `NOISE`'s random walks."""

    def __init__(self, axes: np.ndarray, seconds: float, seed: int = 3) -> None:
        n = round(seconds * RATE)
        t = (np.arange(n) + 0.5) * DT
        phase = np.array([0.3, 1.1, 2.0])
        self.rate = 0.1 * np.sin(2.0 * np.pi * 0.05 * t[:, None] + phase)
        self.force = 0.5 * np.cos(2.0 * np.pi * 0.03 * t[:, None] + phase) + np.array([0.0, 0.0, G])
        rng = np.random.default_rng(seed)
        white = rng.standard_normal((2, n, len(axes))) * np.sqrt(DT)
        self.gyro = self.rate @ axes.T * DT + WALK * white[0]
        self.accel = self.force @ axes.T * DT + WALK_A * white[1]

    def frames(self) -> list[list[RawFrame]]:
        """Of every sample its five frames."""
        counts = [
            np.diff(np.rint(np.cumsum(of, axis=0) / pulse), axis=0, prepend=0.0).astype(int)
            for of, pulse in ((self.gyro, PULSE), (self.accel, PUSH))
        ]
        return [sample(k, g, a) for k, (g, a) in enumerate(zip(*(c.tolist() for c in counts), strict=True))]


def sample(k: int, gyro: list[int], accel: list[int], sat: int = 0) -> list[RawFrame]:
    rx = 10**9 + k * 10**9 // RATE
    a, none = k % 15, [NONE] * 6
    g, f = ([*gyro, *none][:6], [*accel, *none][:6])
    return [
        can("IMU_GYRO", a, sat, 0, 0, *g[:3], rx_ns=rx),
        can("IMU_GYRO_2", a, 0, 0, 0, *g[3:], rx_ns=rx),
        can("IMU_ACCEL", a, 0, 0, 0, *f[:3], rx_ns=rx),
        can("IMU_ACCEL_2", a, 0, 0, 0, *f[3:], rx_ns=rx),
        can("IMU_TIME", a, 0, k % 256, 25, k * 1_000_000 // RATE, rx_ns=rx),
    ]


def fed(imu: ImuCan, frames: Iterable[list[RawFrame]]) -> tuple[list[ImuSample], list[ImuChange]]:
    made = [one for each in frames for frame in each for one in imu.feed(frame)]
    return [s for s in made if isinstance(s, ImuSample)], [s for s in made if isinstance(s, ImuChange)]


@pytest.mark.parametrize("axes", [CONE, SKEW], ids=["cone", "skew"])
def test_the_fused_increments_are_the_motion(axes: np.ndarray) -> None:
    unit, imu = Unit(axes, 40.0), driver(axes)
    samples, changes = fed(imu, unit.frames())
    assert changes == []
    assert len(samples) == 4000
    assert {s.flags for s in samples} == {0}
    assert imu.counters.sensors is not None
    assert imu.counters.sensors.masks == (0, 0, 0, 0)
    # covariance of least squares, of the sum over 40 s; and half a pulse at its end
    spread = np.sqrt(np.diag(np.linalg.inv(axes.T @ axes)))
    turned = np.sum([s.dtheta for s in samples], axis=0) - unit.rate.sum(axis=0) * DT
    pushed = np.sum([s.dv for s in samples], axis=0) - unit.force.sum(axis=0) * DT
    assert np.all(np.abs(turned) < 4.0 * spread * np.hypot(WALK * np.sqrt(40.0), 0.3 * PULSE))
    assert np.all(np.abs(pushed) < 4.0 * spread * np.hypot(WALK_A * np.sqrt(40.0), 0.3 * PUSH))
    # sample by sample: random walk, and the difference of two roundings
    off = np.array([s.dtheta for s in samples]) - unit.rate * DT
    one = spread * np.hypot(WALK * np.sqrt(DT), PULSE / np.sqrt(6.0))
    # 12000 squares of normal deviates, neighbours a quarter correlated: 5 sigma are 0.07
    assert np.mean((off / one) ** 2) == pytest.approx(1.0, abs=0.07)


def test_a_step_is_found_at_once_and_named() -> None:
    unit, imu = Unit(CONE, 40.0), driver()
    unit.gyro[2000:, 3] += np.radians(0.1) * DT  # 360 deg/h
    samples, changes = fed(imu, unit.frames())
    (change,) = changes
    assert (change.gyros_out, change.gyros_suspect, change.accels_out) == (8, 0, 0)
    # 0.1 deg/s over a sample is 20 sigmas of it: no sample with it is used
    assert change.t_ns == samples[2000].t_ns
    assert imu.counters.sensors == UnitHealth(change.t_ns, 8, 0, 0, 0)
    assert [bool(s.flags & ImuFlag.EXCLUDED) for s in samples] == [False] * 2000 + [True] * 2000
    spread = np.sqrt(np.diag(np.linalg.inv(CONE.T @ CONE - np.outer(CONE[3], CONE[3]))))
    turned = np.sum([s.dtheta for s in samples[2000:]], axis=0) - unit.rate[2000:].sum(axis=0) * DT
    assert np.all(np.abs(turned) < 4.0 * spread * np.hypot(WALK * np.sqrt(20.0), 0.4 * PULSE))
    # of six sensors 1/2 along each axis; what is added without the fourth is c c' / (4 (1 - 1/2))
    more = 0.1 * ARCSEC * np.sqrt(0.5) * np.abs(CONE[3])
    np.testing.assert_allclose(change.bias, [more, np.zeros(3)], rtol=1e-6, atol=1e-12)


def test_what_a_small_fault_did_before_it_was_found_is_owed() -> None:
    unit, imu = Unit(CONE, 60.0), driver()
    plain, _ = fed(driver(), unit.frames())
    unit.accel[2500:, 1] += 0.02 * DT  # 2 mg: seen over a second or ten
    samples, changes = fed(imu, unit.frames())
    (change,) = changes
    assert (change.gyros_out, change.accels_out, change.accels_suspect) == (0, 2, 0)
    assert 0.0 < change.t_ns - samples[2500].t_ns <= 10.5e9
    total = np.sum([s.dv for s in samples], axis=0) + change.owed[1]
    off = total - np.sum([s.dv for s in plain], axis=0)
    # without the correction a half of 0.02 m/s^2 along the axis stays for as long as it took
    wrong = 0.5 * 0.02 * (change.t_ns - samples[2500].t_ns) * 1e-9
    assert np.linalg.norm(off - change.owed[1]) == pytest.approx(wrong, rel=0.2)
    # and with it the noise of one sensor, whose share it is, over the rest of the run
    assert np.linalg.norm(off) < 4.0 * WALK_A * np.sqrt(60.0)
    np.testing.assert_array_equal(change.owed[0], np.zeros(3))


def test_a_sensor_that_gives_nothing_is_out_and_comes_back() -> None:
    unit, imu = Unit(CONE, 100.0), driver()
    frames = unit.frames()
    for k in range(1000, 1500):
        gone = [*frames[k]]
        four, _, six = contract()["IMU_ACCEL_2"].decode(gone[3].data)[3:]
        gone[3] = can("IMU_ACCEL_2", k % 15, 0, 0, 0, four, NONE, six, rx_ns=gone[3].rx_ns)
        frames[k] = gone
    samples, changes = fed(imu, frames)
    out, back = changes
    assert (out.accels_out, out.t_ns) == (0b010000, samples[1000].t_ns)
    assert back.accels_out == 0
    # it has to agree for two windows of thirty seconds
    assert 60e9 <= back.t_ns - samples[1500].t_ns <= 91e9
    assert len(samples) == 10000
    pushed = np.sum([s.dv for s in samples], axis=0) - unit.force.sum(axis=0) * DT
    assert np.all(np.abs(pushed + out.owed[1]) < 4.0 * WALK_A * np.sqrt(100.0))


@pytest.mark.parametrize("pair", [(0, 1), (0, 3), (2, 4)])
def test_two_dead_sensors_of_a_cone(pair: tuple[int, int]) -> None:
    unit, imu = Unit(CONE, 40.0, seed=5), driver()
    unit.gyro[1000:, pair[0]] = 0.0
    unit.gyro[2000:, pair[1]] = 0.0
    samples, changes = fed(imu, unit.frames())
    assert changes[-1].gyros_out == 1 << pair[0] | 1 << pair[1]
    assert changes[-1].accels_out == 0
    left = np.delete(CONE, pair, axis=0)
    noise = WALK**2 * np.linalg.inv(left.T @ left), WALK_A**2 * np.linalg.inv(CONE.T @ CONE)
    np.testing.assert_allclose(changes[-1].walk, noise, rtol=1e-6, atol=1e-9 * WALK**2)
    spread = np.sqrt(np.diag(np.linalg.inv(left.T @ left)))
    first = next(k for k, s in enumerate(samples) if s.t_ns >= changes[-1].t_ns)
    turned = np.sum([s.dtheta for s in samples[first:]], axis=0) - unit.rate[first:].sum(axis=0) * DT
    assert np.all(np.abs(turned) < 4.0 * spread * (WALK * np.sqrt(20.0) + PULSE))


def test_with_too_few_left_there_is_no_sample() -> None:
    imu = driver()
    frames = Unit(CONE, 2.0).frames()
    frames[100:150] = [
        [*f[:1], can("IMU_GYRO_2", k % 15, 0, 0, 0, NONE, NONE, NONE), f[2], f[3], f[4]]
        if k < 120
        else [
            can("IMU_GYRO", k % 15, 0, 0, 0, NONE, NONE, 0),
            can("IMU_GYRO_2", k % 15, 0, 0, 0, NONE, NONE, NONE),
            *f[2:],
        ]
        for k, f in enumerate(frames[100:150], start=100)
    ]
    samples, changes = fed(imu, frames)
    assert [c.gyros_out for c in changes[:2]] == [0b111000, 0b111011]
    assert rejects(imu)["INVALID"] >= 30
    assert all(np.isfinite(s.dtheta).all() and np.isfinite(s.dv).all() for s in samples)


def test_saturation_counts_while_the_sensor_is_used() -> None:
    imu = driver()
    frames = Unit(CONE, 1.0).frames()
    bad = [sample(100 + k, [32767, 0, 0, 0, 0, 0], [0] * 6, sat=1) for k in range(3)]
    samples, changes = fed(imu, [*frames, *bad])
    assert changes[0].gyros_out & 1
    assert not any(s.flags & ImuFlag.SATURATED for s in samples)
    good = driver()
    full = Unit(CONE, 1.0).frames()
    full[50][0] = can("IMU_GYRO", 50 % 15, 1, 0, 0, *contract()["IMU_GYRO"].decode(full[50][0].data)[3:])
    samples, _ = fed(good, full)
    assert [k for k, s in enumerate(samples) if s.flags & ImuFlag.SATURATED] == [50]
    assert rejects(good) == {"SATURATED": 1}


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_lost_doubled_and_spoilt_frames_cost_their_sample_alone(data: st.DataObject) -> None:
    frames = Unit(SKEW, 0.4).frames()
    imu = driver(SKEW)
    hurt = data.draw(st.sets(st.integers(1, 38), max_size=5))
    for k in hurt:
        place, what = data.draw(st.integers(0, 4)), data.draw(st.integers(0, 1))
        frames[k] = (
            [f for i, f in enumerate(frames[k]) if i != place]
            if what
            else [flipped(f) if i == place else f for i, f in enumerate(frames[k])]
        )
    samples, changes = fed(imu, frames)
    assert changes == []
    assert len(samples) == 40  # the gaps are bridged
    assert {k for k, s in enumerate(samples) if s.flags & ImuFlag.BRIDGED} == hurt
    assert imu.counters.missing == len(hurt)


def test_the_order_of_the_frames_before_the_time_does_not_matter() -> None:
    frames = Unit(CONE, 1.0).frames()
    one, _ = fed(driver(), frames)
    other, _ = fed(driver(), [[f[3], f[1], f[0], f[2], f[4]] for f in frames])
    assert [(s.dtheta.tobytes(), s.dv.tobytes()) for s in one] == [
        (s.dtheta.tobytes(), s.dv.tobytes()) for s in other
    ]


def test_more_sensors_than_the_calibration_is_for_are_refused() -> None:
    imu = driver(SKEW)
    samples, _ = fed(imu, Unit(CONE, 0.2).frames())
    assert len(samples) == 1  # said once is not believed
    assert rejects(imu) == {"FOREIGN": 19}
    assert "more than the 5 gyros" in imu.counters.notes[0]


def test_fewer_sensors_than_the_calibration_has_are_told() -> None:
    imu = driver(CONE)
    _, changes = fed(imu, Unit(CONE[:5], 0.2).frames())
    assert (changes[0].gyros_out, changes[0].accels_out) == (0b100000, 0b100000)


def test_another_units_serial_number_is_refused() -> None:
    imu = driver()
    frames = Unit(CONE, 0.3).frames()
    for k in (5, 15):
        frames[k].append(can("IMU_STATUS", k // 10, 25.0, 0, 78))
    samples, _ = fed(imu, frames)
    assert len(samples) == 16
    assert rejects(imu) == {"FOREIGN": 14}


def test_what_cannot_be_configured_says_so() -> None:
    with pytest.raises(ConfigError, match=r"device.imu.redundant: .*expected it for 6 gyros"):
        driver(redundant=None)
    with pytest.raises(ConfigError, match=r"device.imu.whole_cycle: found .linear., .*three gyros alone"):
        driver(whole_cycle="linear")
    with pytest.raises(ConfigError, match=r"false_alarms_per_h: found 1000.0, expected a number <= 60"):
        driver(redundant={**NOISE, "false_alarms_per_h": 1000.0})
    with pytest.raises(ConfigError, match=r"t.toml: device.imu.redundant.gyro_bias_deg_per_h"):
        driver(redundant={**NOISE, "gyro_bias_deg_per_h": 0.0})
    flat = np.column_stack((CONE[:, :2], np.zeros(6)))
    with pytest.raises(ConfigError, match="do not span"):
        driver(flat)
    options = convert(
        {"driver": "imu_can", "source": "can0", "calibration": "c", "rate_hz": 100.0, "redundant": NOISE},
        ImuCanOptions,
        "t.toml",
        "device.imu",
    )
    with pytest.raises(ConfigError, match=r"redundant: .*more than three gyros and accelerometers"):
        ImuCan(options, context("imu", {"c": CALIBRATION}))
    with pytest.raises(ConfigError, match=r"axes: found .*, expected five rows"):
        ImuCan(
            options,
            context(
                "imu",
                {"c": sheet(CONE).replace(b"[0.1, 0.1, 0.1, 0.1, 0.1, 0.1]", b"[0.1, 0.1, 0.1, 0.1, 0.1]")},
            ),
        )


def test_keys_and_offsets() -> None:
    imu = driver(id_offset=0x10)
    assert {key for _, key in imu.keys} == {0x110, 0x115, 0x111, 0x116, 0x112, 0x113}
