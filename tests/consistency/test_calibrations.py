"""What the campaign of calibrations says of the errors' law, for errors of a known one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bridge.studies.calibration_campaign import Round, Rounds, document, lines

RUNS, NAMES = 100, 78


def rounds(errors: np.ndarray) -> Rounds:
    each = tuple(Round(k, row, np.zeros(4), 1.0, 1, 2, None) for k, row in enumerate(errors))
    return Rounds("a plan", "fog", "cone", tuple(f"c{k}" for k in range(NAMES)), each)


def test_normal_errors_are_said_to_be_normal() -> None:
    errors = np.random.default_rng(1).standard_normal((RUNS, NAMES))
    kurtosis, distance = rounds(errors).shape
    # 3.3 sigmas of the kurtosis of so many; 999 of 1000 such distances are below
    assert abs(kurtosis) < 3.3 * np.sqrt(24.0 / errors.size)
    assert distance < stats.kstwo.isf(1e-3, errors.size)


def test_long_tails_and_small_sigmas_are_seen() -> None:
    rng = np.random.default_rng(2)
    kurtosis, _ = rounds(rng.standard_t(8, (RUNS, NAMES))).shape
    assert kurtosis > 0.5  # 1.5 of this law
    _, distance = rounds(1.2 * rng.standard_normal((RUNS, NAMES))).shape
    assert distance > stats.kstwo.isf(1e-3, RUNS * NAMES)


def test_how_often_a_normal_law_has_a_largest_like_this() -> None:
    errors = np.zeros((RUNS, NAMES))
    errors[3, 4] = -4.5
    found = rounds(errors)
    assert found.chance == pytest.approx(1.0 - (1.0 - 2.0 * stats.norm.sf(4.5)) ** errors.size, rel=1e-6)
    assert f"with the chance {found.chance:.2g}" in "\n".join(lines([found]))
    assert document([found])["grades"]["fog"]["chance"] == found.chance
