"""Sensors that are stuck or wild are named; coarse, ideal, swaying and ringing ones are not."""

import math

import numpy as np
import pytest

from nav.align.sensors import STUCK_S, against, sensors
from nav.types import ImuFlag, ImuSample
from tests.nav.align.making import GRADE

DT = 0.01
RATE, FORCE = np.array([0.0, 6e-5, 4e-5]), np.array([0.01, 0.0, 9.8])


def rows(seconds=20.0, seed=1):
    """dtheta and dv (n, 3) with random walks."""
    rng, n = np.random.default_rng(seed), round(seconds / DT)
    noise = math.sqrt(DT) * rng.standard_normal((2, n, 3))
    return (
        RATE * DT + GRADE.angle_random_walk * noise[0],
        FORCE * DT + GRADE.velocity_random_walk * noise[1],
    )


def pulses(rows, size):
    """The same as whole pulses; what is left over goes into the next sample."""
    return np.diff(np.floor(np.cumsum(rows, axis=0, dtype=float) / size), axis=0, prepend=0.0) * size


def said(dtheta, dv, flags=None):
    """Every reason, with the time at which it was given."""
    watched = sensors(GRADE.gyro_bias, GRADE.accel_bias)
    out = []
    for k, (w, f) in enumerate(zip(dtheta, dv, strict=True)):
        reason = against(watched, ImuSample(k, DT, w, f, "imu", 0 if flags is None else flags[k]))
        if reason is not None:
            out.append((k * DT, reason))
    return out


@pytest.mark.parametrize(("gyro", "accel"), [(None, None), (1e-7, 1e-5), (5e-6, 3e-4), (1e-4, 1e-2)])
def test_sound_sensors_are_not_suspected(gyro, accel):
    dtheta, dv = rows()
    dtheta = dtheta if gyro is None else pulses(dtheta, gyro)
    dv = dv if accel is None else pulses(dv, accel)
    assert said(dtheta, dv) == []


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
@pytest.mark.parametrize("pulse", [1e-7, 1e-6, 1e-5])
def test_pulses_that_leak_into_other_axes_are_not_suspected(dt, pulse):
    """Compensation of misalignments makes each axis a mixture of whole pulses of all."""
    dtheta, dv = (x * dt / DT for x in rows(100.0))
    mixed = np.eye(3) + 1e-4 * np.random.default_rng(2).standard_normal((3, 3))
    assert said(pulses(dtheta, pulse) @ mixed, pulses(dv, 100.0 * pulse) @ mixed) == []


def test_ideal_sensors_and_none_at_all_are_not_suspected():
    dtheta, dv = rows()
    assert said(np.tile(RATE * DT, (len(dv), 1)), np.tile(FORCE * DT, (len(dv), 1))) == []
    assert said(0.0 * dtheta, 0.0 * dv) == []


@pytest.mark.parametrize("value", [0.0, None])
@pytest.mark.parametrize("from_s", [0.0, 10.0])
@pytest.mark.parametrize(("sensor", "name"), [(0, "right gyro"), (4, "forward accelerometer")])
def test_a_stuck_sensor_is_named_within_seconds(sensor, name, from_s, value):
    both = np.hstack(rows())
    k = round(from_s / DT)
    both[k:, sensor] = both[k, sensor] if value is None else value
    t, words = said(both[:, :3], both[:, 3:])[0]
    assert f"{name} is stuck" in words
    assert from_s + STUCK_S <= t + DT < from_s + STUCK_S + 0.1


def test_a_coarse_sensor_that_dies_is_named_when_it_is_silent_for_much_longer_than_ever():
    dtheta, dv = pulses(rows(60.0)[0], 1e-6), pulses(rows(60.0)[1], 1e-4)
    dtheta[3000:, 2] = 0.0
    t, words = said(dtheta, dv)[0]
    assert "up gyro is stuck" in words
    # a hundred pulses at a tenth of Earth's rate
    assert 30.0 + 13.6 < t < 30.0 + 13.9


@pytest.mark.parametrize(("sensor", "size"), [(1, 2e-6), (1, 0.3), (5, 0.02), (5, 30.0)])
def test_a_lone_wild_sample_is_named(sensor, size):
    both = np.hstack(rows())
    both[700, sensor] -= size
    ((t, words),) = said(both[:, :3], both[:, 3:])
    assert ("forward gyro" if sensor == 1 else "up accelerometer") in words
    assert "is wild" in words
    assert 7.0 < t < 7.05


def test_what_is_not_alone_is_motion():
    dtheta, dv = rows()
    t = DT * np.arange(len(dv))[:, None]
    # a door: 20 Hz, gone in a fifth of a second, a hundred times the noise
    ring = np.where(t > 7.0, np.exp((7.0 - t) / 0.2) * np.sin(2.0 * math.pi * 20.0 * (t - 7.0)), 0.0)
    assert said(dtheta + 1e-6 * ring, dv + 1e-3 * ring) == []
    # people walking about
    assert said(dtheta + 1e-4 * np.sin(2.0 * math.pi * t), dv + 1e-2 * np.sin(2.0 * math.pi * t)) == []


def test_samples_beside_a_gap_are_not_compared():
    dtheta, dv = rows()
    dv[700:] += 0.05
    flags = np.zeros(len(dv), int)
    flags[700] = int(ImuFlag.GAP)
    assert said(dtheta, dv, flags) == []
