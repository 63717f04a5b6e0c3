"""The navigation that a calibration of redundant accelerometers is judged by, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bridge.studies.figures.redundant_flights import RATE_HZ, TURN_S, Flips, distance, read
from nav.calibrate.sequential import Sequential
from nav.imu.geometry import with_skew

LAT_DEG, HEIGHT = 39.9, 50.0
PULSES = 5e4
AXES = with_skew()
PERFECT = [Sequential(PULSES, PULSES, 0.0, axis) for axis in AXES]
OVER = np.diag([-1.0, 1.0, -1.0])  # upside down, forward stays north
ROUND = np.diag([-1.0, -1.0, 1.0])


def unit(bias: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All sensors ideal but x, which has a bias in m/s^2."""
    return AXES, np.full(5, PULSES), np.full(5, PULSES), np.array([bias, 0.0, 0.0, 0.0, 0.0])


def test_perfect_sensors_stay_where_they_are() -> None:
    """Nine flips by 180 degrees cost the kernel's own error at 100 samples a second, next to 50 m nothing."""
    flips = Flips(LAT_DEG, HEIGHT, [np.eye(3), OVER] * 5, 60.0)
    assert distance(flips, list(flips), PERFECT, unit(), np.zeros(3)) < 0.2


def test_a_flip_turns_the_body_and_takes_its_time() -> None:
    sensed = list(Flips(LAT_DEG, HEIGHT, [np.eye(3), OVER], 60.0))
    assert sum(len(samples) * times for samples, times in sensed) == 120 * RATE_HZ
    way = np.vstack([samples for samples, times in sensed if times == 1])
    assert len(way) == TURN_S * RATE_HZ
    # about the second axis by half a turn, and what the Earth turns meanwhile
    assert way[:, :3].sum(axis=0) == pytest.approx([0.0, math.pi, 0.0], abs=2.0 * 7.3e-5 * TURN_S)


def test_a_calibration_that_is_right_gives_the_increments_back() -> None:
    """Two scales, a bias and skewed axes: exact where no sample changes its sign."""
    rng = np.random.default_rng(1)
    axes, bias = AXES + 1e-3 * rng.standard_normal((5, 3)), 1e-2 * rng.standard_normal(5)
    plus, minus = PULSES * (1.0 + 1e-3 * rng.standard_normal((2, 5)))
    said = [Sequential(*each) for each in zip(plus, minus, bias, axes, strict=True)]
    dv = np.array([[0.01, -0.02, 0.098], [-0.05, 0.06, -0.03]])
    np.testing.assert_allclose(read(said, (axes, plus, minus, bias), dv, 0.01), dv, rtol=1e-12)


def test_a_bias_that_is_turned_round_swings_with_schuler() -> None:
    """Levelled by itself nothing is seen of it; turned round twice as much: 2 b (1 - cos w t) R / g."""
    flips = Flips(LAT_DEG, HEIGHT, [np.eye(3), ROUND, ROUND, ROUND], 300.0)
    bias = 1e-4 * 9.8
    found = distance(flips, list(flips), PERFECT, unit(bias), np.zeros(3))
    # of the fused force: the least-squares weight of x, whose column has the others beside
    weight = np.linalg.pinv(AXES)[:, 0]
    level = np.array([weight[0], weight[1]]) * bias
    # the middle of the turn is where it changes
    t, rate = 900.0 - 0.5 * TURN_S, math.sqrt(9.8 / 6.37e6)
    expected = 2.0 * np.linalg.norm(level) / rate**2 * (1.0 - math.cos(rate * t))
    # the Earth turns the swing by w_ie sin L t = 0.04 rad and bends it by its square; the radius is to 0.5 %
    assert found == pytest.approx(expected, rel=0.02)


def test_what_asymmetry_brings_in_is_in_proportion_to_it() -> None:
    """To first order in it, the scale of one sign."""
    flips = Flips(LAT_DEG, HEIGHT, [np.eye(3), OVER], 300.0)
    sensed = list(flips)
    skewed = np.arange(5) == 3  # positive while the unit is upright, negative when it is not
    small, large = (
        distance(flips, sensed, PERFECT, (AXES, PULSES * (1.0 + e * skewed), *unit()[2:]), np.zeros(3))
        for e in (1e-4, 3e-4)
    )
    assert large / small == pytest.approx(3.0, rel=1e-2)
    assert small > 10.0
