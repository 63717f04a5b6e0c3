"""The line through averaged angles: exact of a constant rate, and as good as it says of what else turns."""

import math

import numpy as np
import pytest

from nav.align import drift

ARW = 1.5e-7  # rad/sqrt(s)


def lines(rate, seconds=60, blocks=3):
    """Of rates (n, 3) rad/s, n samples of 0.1 s, in blocks of a second."""
    line, dt = drift.Line(), 0.1
    for turns in (np.asarray(rate) * dt).reshape(seconds, 10, 3):
        before = np.cumsum(turns, axis=0) - turns
        t = dt * np.arange(10)[:, None]
        area = np.sum((before + 0.5 * turns) * dt, axis=0)
        # integral of t theta over a sample in which theta grows evenly
        late = np.sum((before * (t + 0.5 * dt) + turns * (0.5 * t + dt / 3.0)) * dt, axis=0)
        line = drift.follow(line, drift.Turn(1.0, turns.sum(axis=0), area, late), blocks)
    return drift.fitted(line, ARW)


def test_a_constant_rate_is_found_and_nothing_about_it():
    rate = np.array([3e-5, -5e-5, 4e-5])
    found = lines(np.tile(rate, (600, 1)))
    np.testing.assert_allclose(found.rate, rate, rtol=1e-12)
    np.testing.assert_allclose(found.now, 0.0, atol=1e-15)
    np.testing.assert_allclose(found.walk, np.eye(3) * ARW**2)


def test_a_random_walk_scatters_the_slope_as_it_says():
    rng, errors, walks = np.random.default_rng(1), [], []
    for _ in range(200):
        found = lines(10.0 * ARW / math.sqrt(0.1) * rng.standard_normal((600, 3)))
        errors.append(found.rate)
        walks.append(np.trace(found.walk) / 3.0)
    # ten times what was configured; 600 components to 3 sigma of a variance: 18 %, the walks scatter more
    assert np.mean(walks) == pytest.approx((10.0 * ARW) ** 2, rel=0.2)
    assert np.mean(np.square(errors)) == pytest.approx(1.2 * (10.0 * ARW) ** 2 / 60.0, rel=0.2)


@pytest.mark.parametrize("at", [60, 200, 300, 500])
def test_one_turn_is_in_the_covariance(at):
    rate = np.zeros((600, 3))
    rate[at : at + 10, 0] = 1e-4
    found = lines(rate)
    sigma = math.sqrt(1.2 * found.walk[0, 0] / 60.0)
    assert 0.0 < found.rate[0] < 1.5 * sigma
    # at the end it is where it was turned to: a part of the step is in the slope
    assert abs(found.now[0] + 0.5 * 60.0 * found.rate[0] - (1e-4 * (1.0 - (1.0 - at / 600.0)))) < 2e-5


def test_shaking_averages_out():
    """An engine of 1.4 Hz: the difference of two angles holds 2e-5 rad of it, 0.07 deg/h in a minute."""
    t = 0.1 * (np.arange(600) + 0.5)
    wave = 3e-5 * 2.0 * math.pi * 1.4 * np.cos(2.0 * math.pi * 1.4 * t + 1.0)
    found = lines(np.stack([wave, 0.0 * t, 0.0 * t], axis=1))
    assert abs(found.rate[0]) < 0.003 * math.radians(1.0) / 3600.0
