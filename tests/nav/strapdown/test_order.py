"""Coning with sculling through the whole kernel: drifts of attitude and velocity and their order in the step.

The body cones about the vertical with half angle alpha at angular frequency W and is shaken level at the same
frequency, in phase, at a place on the turning Earth; what it should end with is known in closed form, and
increments are Gauss-Legendre integrals of the exact rates.
"""

import math

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.strapdown import coning
from nav.strapdown.control import control
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_V, integrate

LAT, HEIGHT = 0.8, 300.0
SECONDS = 12.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def exact_samples(alpha, W, shake, count, h):
    """Samples (count, 6) of ``h`` s; ``shake`` m/s^2 is the amplitude along north of ``shake cos W t``."""
    t = h * (np.arange(count)[:, None] + 0.5 * (NODES + 1.0))
    s, zero = math.sin(alpha / 2.0), np.zeros_like(t)
    cos, sin = np.cos(W * t), np.sin(W * t)
    C_nb = rot.dcm_from_quat(np.stack([zero + math.cos(alpha / 2.0), s * cos, s * sin, zero], axis=-1))
    w_nb_b = W * np.stack([-math.sin(alpha) * sin, math.sin(alpha) * cos, zero - 2.0 * s * s], axis=-1)
    v = np.stack([zero, shake / W * sin, zero], axis=-1)
    # the place moves by millimetres: its rates are those of the middle
    w_ie = earth.earth_rate_g(LAT)
    r_m, _ = earth.radii(math.sin(LAT))
    w_en = np.stack([-v[..., 1] / (r_m + HEIGHT), zero, zero], axis=-1)
    a = np.stack([zero, shake * cos, zero], axis=-1)
    f_n = a + np.cross(2.0 * w_ie + w_en, v) - earth.gravity_g(LAT, HEIGHT)
    rate = w_nb_b + np.einsum("...ji,...j", C_nb, w_ie + w_en)
    force = np.einsum("...ji,...j", C_nb, f_n)
    return np.hstack([np.einsum("k,ikj->ij", 0.5 * h * WEIGHTS, x) for x in (rate, force)])


def drifts(alpha_deg, hz, shake, h, n):
    """Drift of attitude about the cone's axis, rad/s, and of the vertical velocity, m/s^2."""
    alpha, W = math.radians(alpha_deg), 2.0 * math.pi * hz
    count = round(SECONDS / h / n) * n
    x = np.zeros(X_HEAD)
    x[:2] = math.cos(alpha / 2.0), math.sin(alpha / 2.0)
    x[X_C : X_C + 9], x[X_H] = earth.position_matrix(LAT, 0.1).ravel(), HEIGHT
    samples = exact_samples(alpha, W, shake, count, h)
    integrate(x, samples, h, n, control(), 1, np.zeros((0, X_HEAD)))
    end = count * h
    true = [
        math.cos(alpha / 2.0),
        *(math.sin(alpha / 2.0) * np.array([math.cos(W * end), math.sin(W * end), 0.0])),
    ]
    error = rot.rotvec_from_quat(rot.quat_multiply(x[:4], rot.quat_conjugate(true)))
    return error[2] / end, x[X_V + 2] / end


def coefficient(n):
    """Of a_1 a_2 lambda^(2n+1) in the drift of one update: Yan Gongmin 2008, eq. (7-21)."""
    return n * math.factorial(n) / (2.0 ** (n + 1) * math.prod(2 * k - 1 for k in range(1, n + 2)))


def closed_forms(alpha_deg, hz, shake, h, n):
    """Drifts by order of the algorithm: two angles, or an angle and a velocity, that swing in quadrature."""
    alpha, W = math.radians(alpha_deg), 2.0 * math.pi * hz
    per_second = coefficient(n) * (W * h) ** (2 * n + 1) / (n * h)
    return -(alpha**2) * per_second, -alpha * shake / W * per_second


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_degree_at_ten_hertz_drifts_as_the_algorithms_order_says(n):
    """Half angle 1 deg at 10 Hz, shaken with 1 g, 200 Hz: within twice the closed form, both of them."""
    attitude, velocity = drifts(1.0, 10.0, 9.8, 0.005, n)
    by_attitude, by_velocity = closed_forms(1.0, 10.0, 9.8, 0.005, n)
    assert 0.5 < attitude / by_attitude < 2.0
    assert 0.5 < velocity / by_velocity < 2.0


@pytest.mark.parametrize("n", range(1, 7))
def test_attitude_drift_is_the_exact_one(n):
    """From one interval in closed form: with four samples and more alpha to the fourth rules at 1 deg."""
    alpha, lam = math.radians(1.0), 2.0 * math.pi * 10.0 * 0.005
    i = np.arange(1, n + 1)
    across = 2.0 * math.sin(alpha) * math.sin(lam / 2.0)
    phase = (i - 0.5) * lam
    along = np.full(n, -2.0 * lam * math.sin(alpha / 2.0) ** 2)
    cone = np.stack([along, -across * np.sin(phase), across * np.cos(phase)], axis=-1)
    q = rot.quat_from_rotvec(coning.rotation_vector(cone))
    turned = rot.quat_multiply(q, [math.cos(n * lam / 2.0), math.sin(n * lam / 2.0), 0.0, 0.0])
    expected = (2.0 * math.atan2(np.linalg.norm(turned[1:]), turned[0]) - n * lam) / (n * 0.005)
    # Earth rate tilts the cone a little from update to update
    assert drifts(1.0, 10.0, 0.0, 0.005, n)[0] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_order_in_the_step(n):
    """Half the step, and the drift of one update falls by 2^(2n+1); small angles, nothing else is left."""
    steps = (0.01, 0.005) if n == 4 else (0.005, 0.0025)
    found = np.array([drifts(0.1, 10.0, 30.0, h, n) for h in steps])
    # per second it is one less; the next power of the phase is lam^2 = 0.1 (0.4) of it, times 0.2 or so
    order = math.log2(found[0, 0] / found[1, 0]) + 1.0
    assert order == pytest.approx(2 * n + 1, abs=0.1 if n < 4 else 0.4)
    if n < 3:
        order = math.log2(found[0, 1] / found[1, 1]) + 1.0
        assert order == pytest.approx(2 * n + 1, abs=0.1)
    # with three samples and more gravity, seen from a cone, leaves as much as sculling does
    assert abs(found[1, 1]) < 3.0 * abs(closed_forms(0.1, 10.0, 30.0, steps[1], n)[1]) + 1e-7


@pytest.mark.parametrize("n", [3, 4, 5, 6])
def test_gravity_on_a_cone_is_not_lifted(n):
    """Products of two increments alone would lift it by 1.2e-5, 4e-5, 1e-4 and 1.9e-4 m/s^2."""
    without = {3: 1.2e-5, 4: 4.0e-5, 5: 9.7e-5, 6: 1.9e-4}[n]
    lifted = abs(drifts(1.0, 10.0, 0.0, 0.005, n)[1])
    assert lifted < without / 7.0
    # what is left is of seventh order in the interval at least: a fast vanishing drift
    assert abs(drifts(1.0, 10.0, 0.0, 0.0025, n)[1]) < lifted / 10.0
