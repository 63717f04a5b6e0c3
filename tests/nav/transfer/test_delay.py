"""A delay is told by motion that master and slave have in common, and by no other."""

from __future__ import annotations

import numpy as np
import pytest

from nav.transfer.model import dated
from nav.transfer.states import DELAY, SIZE

SIGMA, SPREAD, OWN = 1e-3, 0.015, 0.1
R = SIGMA**2 * np.eye(3)


def rows(slope: np.ndarray, lasts: bool = True) -> tuple[np.ndarray, np.ndarray, float]:
    r, H, noise = np.zeros(3), np.zeros((3, SIZE)), np.empty((3, 3))
    straight, share = dated(tuple(slope.tolist()), (0.0, 0.0, 0.0), SIGMA, SPREAD, OWN, lasts, r, H, noise)
    assert straight
    return H[:, DELAY], noise, share


def test_a_slope_that_the_slave_makes_alone_tells_no_delay_and_is_no_noise() -> None:
    """What the delay may do is in the row, whole: noise would fade, and it is the same in every message."""
    slope = np.array([OWN, -OWN, 0.5 * OWN])
    column, noise, share = rows(slope)
    assert share == 0.0
    assert np.array_equal(column, -slope)
    assert noise == pytest.approx(R)


def test_a_change_that_does_not_last_is_nothing_unless_it_tells() -> None:
    """What vibrates is in every message, and would be taken for what a delay does."""
    column, noise, share = rows(np.array([OWN, -OWN, 0.5 * OWN]), False)
    assert share == 0.0
    assert np.array_equal(column, np.zeros(3))
    assert noise == pytest.approx(R)


@pytest.mark.parametrize("lasts", [True, False])
def test_a_turn_of_both_tells_it(lasts: bool) -> None:
    slope = np.array([0.0, 30.0 * OWN, 0.0])
    column, noise, share = rows(slope, lasts)
    assert share == pytest.approx(1.0, abs=0.02)
    assert np.array_equal(column, -slope)
    assert noise == pytest.approx(R)


def test_noise_alone_tells_one_seldom() -> None:
    rng = np.random.default_rng(0)
    told = [rows(OWN * rng.standard_normal(3))[2] > 0.0 for _ in range(4000)]
    # one of a thousand: 4 +- 2
    assert sum(told) <= 12


def test_without_any_motion_there_is_no_slope() -> None:
    column, noise, _ = rows(np.zeros(3))
    assert np.array_equal(column, np.zeros(3))
    assert noise == pytest.approx(R)
