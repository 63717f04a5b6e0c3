"""The conventional and the iterative method, by the paper's equations written out for one sensor."""

from __future__ import annotations

import numpy as np
import pytest

from nav.calibrate.plan import planned
from nav.calibrate.sequential import Turned, conventional, iterate, turned
from tests.nav.calibrate.making import FACES_12, TABLE_2_12, G, Unit, place, positions

AXIS = np.array([0.8, -0.36, 0.48])
PLUS, MINUS, BIAS = 50_100.0, 49_900.0, 3e-4 * G


def made(plus=PLUS, minus=MINUS, bias=BIAS, g=G):
    out = np.array([AXIS * g + bias, -AXIS * g + bias])
    up, down = np.where(out >= 0.0, plus, minus) * out
    return Turned(up, down)


def test_without_asymmetry_both_are_exact():
    # the iteration begins without a bias, whose error shrinks by 0.9 a pass: to 1e-16 of it in 350
    for found in (conventional(made(5e4, 5e4), G), iterate(made(5e4, 5e4), G, 350)[-1]):
        assert found.plus == pytest.approx(5e4, rel=1e-12)
        assert found.minus == pytest.approx(5e4, rel=1e-12)
        assert found.bias == pytest.approx(BIAS, rel=1e-9)
        np.testing.assert_allclose(found.axis, AXIS, rtol=0, atol=1e-14)


def test_the_conventional_method_is_wrong_by_its_laws():
    """First order in the asymmetry xi: bias xi S / 6 of gravity, asymmetry short by S / (3 max)."""
    xi, S = 2.0 * (PLUS - MINUS) / (PLUS + MINUS), np.abs(AXIS).sum()
    found = conventional(made(), G)
    assert found.bias - BIAS == pytest.approx(xi * S / 6.0 * G, rel=5e-3)
    assert found.asymmetry == pytest.approx(xi * (1.0 - S / (3.0 * 0.8)), rel=5e-3)


def test_the_iteration_converges_by_its_law_to_the_truth():
    S = np.abs(AXIS).sum()
    passes = iterate(made(), G, 200)
    error = np.array([one.bias - BIAS for one in passes])
    assert error[4] / error[3] == pytest.approx(S * S / 3.0, rel=5e-3)
    # 0.9 to the power of 200 of 1e-3 g is 1e-13 g
    assert abs(error[-1]) < 1e-11 * G
    assert passes[-1].plus == pytest.approx(PLUS, rel=1e-10)
    assert passes[-1].minus == pytest.approx(MINUS, rel=1e-10)
    np.testing.assert_allclose(passes[-1].axis, AXIS, rtol=0, atol=1e-10)


def test_rests_are_sorted_by_the_axis_that_is_up():
    where = place()
    unit = Unit.draw(AXIS[None], np.random.default_rng(1), asymmetry=0.0)
    got = turned(unit.count(positions(FACES_12), where), 1)
    out = np.array(
        [unit.axes[1] * where.gravity + unit.bias[1], -unit.axes[1] * where.gravity + unit.bias[1]]
    )
    np.testing.assert_allclose([got.up, got.down], out / unit.plus[1], rtol=1e-12)


def test_other_positions_are_refused():
    plan = positions(TABLE_2_12)
    counted = Unit.draw(AXIS[None], np.random.default_rng(1)).count(plan[:5], place())
    with pytest.raises(ValueError, match="expected every axis of the unit up and down"):
        turned(counted, 1)
    tilted = planned(plan)[0]
    object.__setattr__(
        tilted, "attitude", tilted.attitude @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    )
    with pytest.raises(ValueError, match="SUW: expected an axis of the unit up or down"):
        turned([tilted], 0)
