"""Coning figures against numbers typed from the table and against a plain simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from bridge.studies.figures.coning import ANGLES, LAMBDA, SAMPLE_S, TABLE_7_1, kernel_drift, residual
from bridge.studies.figures.coning_exact import PI, Cone, sine_cosine
from bridge.studies.figures.result import Result
from nav.rotation import quat_conjugate, quat_from_rotvec, quat_multiply, rotvec_from_quat
from nav.strapdown.coning import rotation_vector


@pytest.mark.parametrize("x", ["0.3", "-2.5", "40", "1e-9"])
def test_series_of_sine_and_cosine(x: str) -> None:
    s, c = sine_cosine(Decimal(x))
    assert float(s) == pytest.approx(math.sin(float(x)), rel=1e-15)
    assert float(c) == pytest.approx(math.cos(float(x)), rel=1e-15)


def test_increments_are_integrals_of_the_rate() -> None:
    """Yan Gongmin 2008, eq. (7-4), by Gauss's rule of eight points."""
    alpha, lam = 0.3, 0.2
    nodes, weights = np.polynomial.legendre.leggauss(8)
    phase = lam * (3.5 + 0.5 * nodes)
    rate = np.stack(
        [
            np.full(8, -2 * math.sin(alpha / 2) ** 2),
            -math.sin(alpha) * np.sin(phase),
            math.sin(alpha) * np.cos(phase),
        ]
    )
    found = [float(x) for x in Cone(Decimal(alpha), Decimal(lam)).increment(3)]
    assert found == pytest.approx(0.5 * lam * rate @ weights, rel=1e-13)


def test_the_true_rotation_vector_has_no_drift() -> None:
    """Eqs. (7-6) and (7-8): the rotation from one phase of the cone to another."""
    alpha, lam_n = Decimal("0.2"), Decimal("0.5")
    s, c = sine_cosine(alpha / 2)
    s_n, c_n = sine_cosine(lam_n)
    sh, _ = sine_cosine(lam_n / 2)
    w = c * c + s * s * c_n
    axis = [-s * s * s_n, Decimal(0), 2 * s * c * sh]
    length = sum(x * x for x in axis).sqrt()
    angle = 2 * Decimal(math.atan2(float(length), float(w)))
    phi = [angle * x / length for x in axis]
    # the angle is only known to double precision here
    assert abs(float(Cone(alpha, lam_n).drift(phi, 1))) < 1e-16


@pytest.mark.parametrize(
    ("samples", "series"),
    [
        (1, lambda a, x: -(a**2) / 12 * x**3 + a**4 / 36 * x**3),
        (2, lambda a, x: -(a**2) / 30 * x**5 + a**4 / 30 * x**5),
        (3, lambda a, x: -3 * a**2 / 280 * x**7 + 3 * a**4 / 160 * x**5),
        (4, lambda a, x: -(a**2) / 315 * x**9 - 89 * a**4 / 630 * x**5),
        (5, lambda a, x: -5 * a**2 / 5544 * x**11 - 575 * a**4 / 672 * x**5),
    ],
)
def test_exact_drift_has_the_series_of_small_angles(
    samples: int, series: Callable[[float, float], float]
) -> None:
    coefficients = [Fraction(k) for k in TABLE_7_1[samples][0]]
    alpha, lam = 0.02, 0.03
    drift = float(Cone(Decimal(alpha), Decimal(lam)).algorithm_drift(coefficients))
    # next terms: alpha^6 lambda^5 over alpha^4 lambda^5, and lambda^2 times a factor that grows with N^2
    assert drift == pytest.approx(series(alpha, lam), rel=0.02)


def test_the_drift_is_that_of_an_attitude_integrated_in_double_precision() -> None:
    """10 deg, where a quaternion can hold it: 60 s of quaternion products against the angle per update."""
    alpha, samples = float(ANGLES["10 deg"]), 2
    cone = Cone(ANGLES["10 deg"], LAMBDA)
    turn = 2.0 * math.pi * 0.01

    def truth(sample: int) -> np.ndarray:
        s, phase = math.sin(alpha / 2), turn * sample
        return np.array([math.cos(alpha / 2), 0.0, s * math.cos(phase), s * math.sin(phase)])

    d = np.array([[float(x) for x in cone.increment(sample)] for sample in range(100)])
    steps = [quat_from_rotvec(rotation_vector(d[k : k + samples])) for k in range(0, 100, samples)]
    q = truth(0)
    for _ in range(60):
        for step in steps:
            q = quat_multiply(q, step)
    drift = rotvec_from_quat(quat_multiply(q, quat_conjugate(truth(6000))))[0]
    arcsec = -drift * 648_000 / math.pi
    # printed 0.596, cut after three digits; the periodic part returns to zero after whole seconds
    assert 0.596 <= arcsec < 0.597


@pytest.mark.parametrize(
    ("angle", "samples", "low", "high"),
    [
        ("1'", 1, 2.164e-3, 2.165e-3),
        ("1'", 2, 1.708e-6, 1.709e-6),
        ("1 deg", 1, 7.790, 7.791),
        ("1 deg", 4, 4.480e-6, 4.481e-6),
        ("1 deg", 5, 2.103e-5, 2.104e-5),
        ("10 deg", 1, 771.242, 771.243),
        ("10 deg", 3, -5.456e-3, -5.455e-3),
        ("10 deg", 4, 4.416e-2, 4.417e-2),
        ("10 deg", 5, 2.075e-1, 2.076e-1),  # printed with another exponent
    ],
)
def test_table_7_2(angle: str, samples: int, low: float, high: float) -> None:
    """Printed numbers are cut: ours lie between them and one more of their last digit."""
    per_minute = float(-60 / (samples * SAMPLE_S) * 648_000 / PI)
    assert low <= float(kernel_drift(ANGLES[angle], LAMBDA, samples)) * per_minute < high


def test_residuals_are_those_of_the_general_formula() -> None:
    """Yan Gongmin 2008, eq. (7-21), in the turn of a sample."""
    for samples in range(1, 7):
        product = math.prod(2 * k - 1 for k in range(1, samples + 2))
        printed = Fraction(samples * math.factorial(samples), 2 ** (samples + 1) * product)
        assert residual(samples) * samples ** (2 * samples + 1) == printed


def test_cells_that_differ_say_why(computed: Callable[[str], Result]) -> None:
    why = {row.name: row.why for row in computed("coning").rows if row.why}
    assert set(why) == {'1" N=1', '1" N=3', '1" N=4', '1" N=5', "1' N=5", "10 deg N=5"}
    assert "exponent" in why["10 deg N=5"]


def test_sculling_is_rectified_as_the_closed_form_says(computed: Callable[[str], Result]) -> None:
    """1 deg, 10 Hz, 1 g, samples of 5 ms, by hand: alpha (a + alpha g) x^5 / (480 Omega T), x = 0.2 pi."""
    rows = {row.name: row for row in computed("coning").rows}
    alpha, omega, update, g = math.radians(1.0), 20.0 * math.pi, 0.01, 9.80665
    x = omega * update
    classical = alpha * (g + alpha * 9.806) * x**5 / (480.0 * omega * update) / g * 1e6
    assert 0.5 < rows["shaken N=2 sculling"].ours / classical < 2.0
    classical = alpha**2 * x**5 / 960.0 / update * 60.0 * 648_000.0 / math.pi
    assert rows["shaken N=2 coning"].ours == pytest.approx(classical, rel=0.02)
