"""A delay is told by motion that master and slave have in common, and by no other."""

from __future__ import annotations

import numpy as np
import pytest

from nav.transfer.model import Line
from nav.transfer.states import DELAY, SIZE

SIGMA, SPREAD, OWN = 1e-3, 0.015, 0.1
R = SIGMA**2 * np.eye(3)


def rows(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = Line(slope, np.zeros(3)).rows(np.zeros(3), np.zeros((3, SIZE)), SIGMA, SPREAD, OWN)
    assert found.straight
    return found.H[:, DELAY], found.R


def test_a_slope_that_the_slave_makes_alone_tells_no_delay_and_is_noise() -> None:
    slope = np.array([OWN, -OWN, 0.5 * OWN])
    column, noise = rows(slope)
    assert np.array_equal(column, np.zeros(3))
    # the delay's own sigma is the spread over the root of three
    assert noise == pytest.approx(R + np.outer(slope, slope) * SPREAD**2 / 3.0)


def test_a_turn_of_both_tells_it() -> None:
    slope = np.array([0.0, 30.0 * OWN, 0.0])
    column, noise = rows(slope)
    assert column == pytest.approx(-slope, rel=0.02)
    # what is not told is noise: with it the row has the variance that the delay gives it
    total = noise + np.outer(column, column) * SPREAD**2 / 3.0
    assert total == pytest.approx(R + np.outer(slope, slope) * SPREAD**2 / 3.0)


def test_noise_alone_tells_one_seldom() -> None:
    rng = np.random.default_rng(0)
    told = [np.any(rows(OWN * rng.standard_normal(3))[0] != 0.0) for _ in range(4000)]
    # one of a thousand: 4 +- 2
    assert sum(told) <= 12


def test_without_any_motion_there_is_no_slope() -> None:
    column, noise = rows(np.zeros(3))
    assert np.array_equal(column, np.zeros(3))
    assert noise == pytest.approx(R)
