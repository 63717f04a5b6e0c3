"""Coning and sculling against closed forms."""

import math
from fractions import Fraction as F

import numpy as np
import pytest

from nav import rotation as rot
from nav.strapdown import coning
from nav.strapdown.kernels import increments

# Yan Gongmin 2008, section 7.2
TABLE = {
    2: [F(2, 3)],
    3: [F(27, 20), F(9, 20)],
    4: [F(214, 105), F(92, 105), F(54, 105)],
    5: [F(1375, 504), F(650, 504), F(525, 504), F(250, 504)],
    6: [F(15797, 4620), F(3917, 2310), F(608, 385), F(2279, 2310), F(463, 924)],
}


@pytest.mark.parametrize("n", TABLE)
def test_coefficients_are_the_published_ones(n):
    assert coning.coning_coefficients(n) == TABLE[n]


def test_one_sample_has_no_coefficients():
    with pytest.raises(ValueError, match="at least 2"):
        coning.coning_coefficients(1)
    np.testing.assert_array_equal(coning.rotation_vector([[1.0, 2.0, 3.0]]), [1, 2, 3])


def cone(alpha, lam, n):
    """Increments of one update of a coning motion about x, Yan Gongmin 2008, eq. (7-10), from phase 0."""
    i = np.arange(1, n + 1)
    phase = (i - 0.5) * lam
    along = np.full(n, -2.0 * lam * math.sin(alpha / 2) ** 2)
    across = 2.0 * math.sin(alpha) * math.sin(lam / 2)
    return np.stack([along, -across * np.sin(phase), across * np.cos(phase)], axis=-1)


# Drift per update in powers of the angle lam of one sample: Yan Gongmin 2008, eq. (7-21), and the next
# term in alpha, which is of fifth order in lam whatever the number of samples.
SERIES = {2: (1 / 30, -1 / 30), 3: (3 / 280, 0.0), 4: (1 / 315, 89 / 630), 5: (5 / 5544, 575 / 672)}


def drift(q, total):
    """Computed minus true turn about the cone's axis of one update."""
    c, s = math.cos(total / 2), math.sin(total / 2)
    # quaternion of the computed update followed by the turn of the phase; its scalar and axial parts
    product = rot.quat_multiply(q, [c, s, 0.0, 0.0])
    return 2.0 * math.atan2(np.linalg.norm(product[1:]), product[0]) - total


@pytest.mark.parametrize("n", SERIES)
def test_drift_is_that_of_the_closed_form(n):
    alpha, lam = 1e-3, 0.3 if n < 4 else 0.5
    q = rot.quat_from_rotvec(coning.rotation_vector(cone(alpha, lam, n)))
    first, second = SERIES[n]
    expected = -first * alpha**2 * lam ** (2 * n + 1) - second * alpha**4 * lam**5
    # the next term in lam is below lam^2 of the first; angles of order one round at 4e-16
    assert drift(q, n * lam) == pytest.approx(expected, rel=lam**2, abs=1e-15)


def test_exact_update_has_no_drift():
    alpha, total = 0.02, 0.5
    s, c = math.sin(alpha / 2), math.cos(alpha / 2)
    exact = np.array(
        [
            c * c + s * s * math.cos(total),
            -s * s * math.sin(total),
            -math.sin(alpha) * math.sin(total / 2) * math.sin(total / 2),
            math.sin(alpha) * math.sin(total / 2) * math.cos(total / 2),
        ]
    )
    assert drift(exact, total) == pytest.approx(0.0, abs=1e-15)
    # and the two-sample rotation vector approaches it
    q = rot.quat_from_rotvec(coning.rotation_vector(cone(alpha, total / 2, 2)))
    assert np.linalg.norm(q - exact) < alpha**2 * total**5


def test_sculling_rectifies_in_phase_vibration():
    """Rotation a sin(w t) about x with force b sin(w t) along y: mean acceleration a b / 2 along z."""
    a, b, w, dt = 2e-3, 30.0, 2 * math.pi * 5, 0.02
    total, angle = np.zeros(3), 0.0
    for k in range(500):
        t = k * dt
        edges = np.array([t, t + dt / 2, t + dt])
        dtheta = np.zeros((2, 3))
        dv = np.zeros((2, 3))
        dtheta[:, 0] = a * np.diff(np.sin(w * edges))
        dv[:, 1] = b / w * -np.diff(np.cos(w * edges))
        u = coning.velocity_increment(dtheta, dv)
        total += rot.quat_rotate(rot.quat_from_rotvec([angle, 0, 0]), u)
        angle += dtheta[:, 0].sum()
    # the error of the two-sample form is of the order (w dt)^4 / 100 of the effect, 1.6e-3
    assert total[2] / (500 * dt) == pytest.approx(a * b / 2, rel=2e-3)


@pytest.mark.parametrize("n", range(1, 7))
@pytest.mark.parametrize("size", [1e-4, 0.02, 0.3])
def test_kernel_is_the_twin(n, size):
    rng = np.random.default_rng(n)
    inc = np.zeros(6)
    for _ in range(20):
        a, u = rng.normal(size=(n, 3)) * size, rng.normal(size=(n, 3))
        increments(np.concatenate([a.ravel(), u.ravel()]), n, inc)
        np.testing.assert_allclose(inc[:3], coning.rotation_vector(a), rtol=1e-12, atol=1e-14)
        # coefficients of six samples reach 3.4, products of a dozen terms cancel
        np.testing.assert_allclose(inc[3:], coning.velocity_increment(a, u), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n", range(1, 7))
def test_constant_rate_and_force_in_the_body_are_exact(n):
    """Rotation vector of a turn about a fixed axis is the turn; force fixed in the body turns with it."""
    w, f, dt = np.array([0.3, -1.0, 0.5]), np.array([1.0, 2.0, -9.0]), 0.4
    a, u = np.tile(w * dt / n, (n, 1)), np.tile(f * dt / n, (n, 1))
    np.testing.assert_allclose(coning.rotation_vector(a), w * dt, rtol=1e-14)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    turned = rot.quat_rotate(rot.quat_from_rotvec(0.5 * (nodes[:, None] + 1) * w * dt), f)
    np.testing.assert_allclose(coning.velocity_increment(a, u), 0.5 * dt * weights @ turned, rtol=1e-12)
