"""Alignment in motion on a boat that rolls, with the antenna on a mast: its swing at the instant of a fix."""

import math

import numpy as np
import pytest

from bridge.studies.alignment_truth import merged, misalignment
from nav.align import ALIGNMENTS, advance, begin
from nav.align.match import rate_at
from nav.types import ImuSample
from tests.nav.align.boats import LAUNCH, at_anchor

SEEDS = 4


def last_word(samples, config):
    """Attitude and covariance that it says last, and when (s)."""
    run = begin(ALIGNMENTS["motion"], config)
    said = None
    for sample in samples:
        run, status = advance(run, sample)
        assert status.refusal is None
        if isinstance(sample, ImuSample) and status.estimate is not None:
            said = status.estimate, status.covariance, sample.t_ns * 1e-9
    return said


@pytest.mark.parametrize("late", [True, False], ids=["as they come", "at once"])
def test_heading_from_a_roll_is_as_good_as_it_says(late):
    found, sigmas = [], []
    for seed in range(SEEDS):
        samples, fixes, config, base = at_anchor(LAUNCH, seed)
        # fixes come 60 ms after their time, or before anything that is later than they are
        mixed = merged(samples, fixes) if late else sorted([*samples, *fixes], key=lambda s: s.t_ns)
        q_gb, P, t = last_word(mixed, config)
        phi = misalignment(base.C_gb(t), q_gb)
        found.append(phi @ np.linalg.solve(P, phi))
        sigmas.append(math.sqrt(P[2, 2]))
    # with rates 50 ms late: 14 a seed, and sigmas of 1 deg. Bounds: 99.9 % of chi-square; swings of 0.5 m/s
    # seen to 0.03 m/s, four times a second for half of the time, leave 0.4 deg and less
    assert sum(found) < 32.9, found
    assert max(sigmas) < math.radians(0.6)


@pytest.mark.parametrize("dt", [0.005, 0.01, 0.05])
@pytest.mark.parametrize("after", [0.0, 0.3, 0.8])
def test_a_rate_is_that_of_its_instant(dt, after):
    """``after`` of a sample past its beginning: off by (w h)^2/2 of the rate at most, h the longer of half
    of a sample and 20 ms, and by what a long sample hides; late by 50 ms it would be off by w h = 0.3."""
    size, omega = np.array([0.1, -0.05, 0.02]), 2.0 * math.pi

    def angle(t):
        return size * math.sin(omega * t)

    samples = [
        ImuSample(round((k + 1) * dt * 1e9), dt, angle((k + 1) * dt) - angle(k * dt), np.zeros(3), "imu")
        for k in range(round(1.0 / dt))
    ]
    for k in np.arange(round(0.2 / dt), round(0.8 / dt)):
        t = (k + after) * dt
        off = rate_at(samples, round(t * 1e9)) - size * omega * math.cos(omega * t)
        assert np.max(np.abs(off)) < 0.5 * (omega * max(dt, 0.02)) ** 2 * 0.1 * omega


def test_a_rate_at_either_end_of_what_there_is():
    none = np.zeros(3)
    turns = [np.array([0.01, 0.0, 0.0]), np.array([0.03, 0.0, 0.0])]
    samples = [ImuSample((k + 1) * 100_000_000, 0.1, turns[k], none, "imu") for k in range(2)]
    np.testing.assert_allclose(rate_at(samples, 100_000_000), [0.2, 0.0, 0.0], rtol=1e-12)
    np.testing.assert_allclose(rate_at(samples, 170_000_000), [0.3, 0.0, 0.0], rtol=1e-12)
    np.testing.assert_array_equal(rate_at(samples, 200_000_000), none)
    np.testing.assert_array_equal(rate_at([], 0), none)


def test_a_swing_does_not_depend_on_how_long_fixes_take():
    samples, fixes, config, _ = at_anchor(LAUNCH, 7, seconds=12.0)
    late = last_word(merged(samples, fixes), config)
    at_once = last_word(sorted([*samples, *fixes], key=lambda s: s.t_ns), config)
    np.testing.assert_allclose(late[1], at_once[1], rtol=1e-9, atol=1e-12)
