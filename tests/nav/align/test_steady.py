"""What a standstill says of level and bias where it is none: a boat too slow for GNSS to see it roll."""

import dataclasses
import math

import numpy as np
import pytest

from bridge.studies.alignment_truth import DEG_PER_H, merged
from nav.align.level import LEVEL, MOVING_LEVEL
from nav.align.steady import FEWEST, Steady, follow, stood
from nav.rotation import dcm_from_quat
from nav.types import ImuSample
from tests.nav.align.boats import BARGE, MEMS, MOORED, YACHT, at_anchor

FOG = dataclasses.replace(
    MEMS,
    gyro_bias=0.05 * DEG_PER_H,
    accel_bias=5e-4,
    angle_random_walk=math.radians(0.003) / 60.0,
    velocity_random_walk=2e-4,
)
SEEDS = 5


def levels(boat, config, seed):
    """Once a second while it levels: chi-square of two angles of the vertical, and the sigma (rad) of one."""
    samples, fixes, config, base = at_anchor(boat, seed, config, dt=0.02, every=0.2)
    state, said, last = LEVEL.init(config, None), [], 0
    for sample in merged(samples, fixes):
        state, status = LEVEL.step(state, sample)
        if status.done:
            break
        if isinstance(sample, ImuSample) and sample.t_ns >= last + 1_000_000_000:
            last = sample.t_ns
            if status.estimate is not None and status.covariance[0, 0] < MOVING_LEVEL**2:
                off = np.cross(dcm_from_quat(status.estimate)[2], base.C_gb(last * 1e-9)[2])
                said.append((off @ off / status.covariance[0, 0], math.sqrt(status.covariance[0, 0])))
    return said


@pytest.mark.parametrize("config", [MEMS, FOG], ids=["mems", "fog"])
@pytest.mark.parametrize("boat", [YACHT, BARGE, MOORED], ids=["yacht", "barge", "moored"])
def test_no_level_is_claimed_better_than_it_is(boat, config):
    """Taken for a standstill by its speed, the barge's level was claimed to 0.003 deg and off by 0.7."""
    said = np.array([pair for seed in range(SEEDS) for pair in levels(boat, config, seed)])
    assert len(said) > 50
    # of one seed neighbours are alike: its mean has the spread of two degrees of freedom, 2 +- 2
    assert np.mean(said[:, 0]) < 2.0 + 3.0 * 2.0 / math.sqrt(SEEDS)
    assert np.max(said[:, 0]) < 18.4  # 99.99 % of chi-square
    if boat is MOORED:
        # engine and wind: 20 sway^2 / (g T)^2 of 20 s and more, and the accelerometers' own
        assert np.min(said[:, 1]) < 1.2 * math.hypot(
            config.accel_bias / 9.8, math.sqrt(20.0) * 0.003 / 9.8 / 20.0
        )


def parts(tilt, seconds, dt=0.25, bias=(0.0, 0.0, 0.0)):
    """What gyros of a ``bias`` and accelerometers say of a base that is tilted by ``tilt(t)`` about x."""
    steady = Steady()
    for k in range(round(seconds / dt)):
        a, b = tilt(k * dt), tilt((k + 1) * dt)
        n = np.linspace(a, b, 9)
        force = 9.8 * np.array([0.0, np.mean(np.sin(n)), np.mean(np.cos(n))])
        turn = np.array([b - a, 0.0, 0.0]) + np.asarray(bias) * dt
        steady = follow(steady, dt, turn, force * dt, 60.0)
    return steady


def test_a_steady_roll_is_told_from_a_bias():
    """Two seconds at one deg/s: the gyros alone would call it bias, and the level be that of the middle."""
    rate, bias = math.radians(1.0), np.array([2e-3, -1e-3, 5e-4])
    found = stood(parts(lambda t: rate * (t - 1.0), 2.0, bias=bias), MEMS)
    # of the turning, two variances of what sway looks like over its square are taken for chance
    chance = 2.0 * 72.0 * (MEMS.sway / 9.8) ** 2 / 2.0**4 / rate
    np.testing.assert_allclose(found.bias, bias, atol=1e-5 + chance)
    up = found.force / np.linalg.norm(found.force)
    np.testing.assert_allclose(up, [0.0, math.sin(rate), math.cos(rate)], atol=1e-4)


def test_what_it_was_seen_to_turn_widens_what_it_says():
    config = dataclasses.replace(MEMS, accel_bias=0.0, angle_random_walk=0.0, velocity_random_walk=0.0)
    still = stood(parts(lambda t: 0.0, 10.0), config)
    rolls = stood(parts(lambda t: 0.02 * math.sin(t), 10.0), config)
    # 3 m at 0.014 rad/s are 14 times the sway of a vehicle that stands
    assert 13.0 < math.sqrt(rolls.tilt / still.tilt) < 16.0
    assert np.all(rolls.drift > still.drift)
    assert stood(parts(lambda t: 0.0, 0.25 * (FEWEST - 1)), config) is None
