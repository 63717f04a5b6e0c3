"""Closed forms at rest against integration, characteristic roots, and what noise adds up to."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from nav import earth
from nav.errors.geographic import phi_dynamics
from nav.errors.response import (
    SOURCES,
    STATES,
    Sphere,
    frequencies,
    responses,
    static_dynamics,
    velocity_variance,
)

SPHERE = Sphere(9.8, 6371000.0)
DAY = 86400.0
# the states in units of like size: Schuler speed, Earth radii, radians
UNITS = np.array([SPHERE.radius * SPHERE.schuler] * 2 + [1.0] * 5)


@pytest.mark.parametrize("lat", [-1.2, 0.0, 0.6, 1.3])
def test_closed_forms_are_the_integral_without_coriolis(lat):
    """24 h, each state to 1e-9 of its largest value; where terms cancel to nothing, rounding of the terms."""
    F, G = static_dynamics(lat, SPHERE, coriolis=False)
    A = SPHERE.schuler**-1 * F * UNITS / UNITS[:, None]
    t = np.linspace(0.0, DAY, 97)
    closed = responses(t, lat, SPHERE)
    for i in range(len(SOURCES)):
        unit = 1.0 if i < 3 else SPHERE.gravity
        b = G[:, i] * unit / UNITS / SPHERE.schuler
        solved = solve_ivp(
            lambda _, x, b=b: A @ x + b,
            (0.0, DAY * SPHERE.schuler),
            np.zeros(7),
            method="DOP853",
            t_eval=t * SPHERE.schuler,
            rtol=1e-13,
            atol=1e-14 * np.max(np.abs(b)),
        )
        integral = solved.y * UNITS[:, None] / unit
        size = np.max(np.abs(closed[i]), axis=1)
        rounding = 1e-12 * np.max(size / UNITS) * UNITS
        assert np.all(np.max(np.abs(integral - closed[i]), axis=1) <= 1e-9 * size + rounding)


def test_times_may_have_any_shape():
    t = np.linspace(0.0, 100.0, 6).reshape(2, 3)
    x = responses(t, 0.5, SPHERE)
    assert x.shape == (len(SOURCES), len(STATES), 2, 3)
    np.testing.assert_array_equal(x[:, :, 1, 2], responses(t[1, 2], 0.5, SPHERE))
    np.testing.assert_allclose(responses(0.0, 0.5, SPHERE), 0.0, atol=1e-9)


def test_dynamics_at_rest_are_those_of_the_moving_model():
    """Equation (2-90) is the phi form at rest without height, but for the flattening of the Earth."""
    lat, h = 0.8, 0.0
    s = math.sin(lat)
    g, (r_m, r_n) = earth.normal_gravity(s, h), earth.radii(s)
    F = phi_dynamics(lat, h, np.zeros(3), np.array([0.0, 0.0, g]))
    place = [3, 4, 0, 1, 6, 7, 8]
    ours, _ = static_dynamics(lat, Sphere(g, r_n), coriolis=True)
    whole = F[np.ix_(place, place)]
    np.testing.assert_allclose(ours, whole, rtol=abs(r_n / r_m - 1.0), atol=1e-20)
    ours, _ = static_dynamics(lat, Sphere(g, r_m), coriolis=True)
    np.testing.assert_allclose(ours[[2, 4]], whole[[2, 4]], rtol=1e-12, atol=1e-20)


@pytest.mark.parametrize("lat", [-1.4, -0.5, 0.0, 0.7, 1.5])
def test_roots_are_exact(lat):
    """Equation (2-93): the roots are those of the matrix; (2-95) is their first order."""
    F, _ = static_dynamics(lat, SPHERE, coriolis=True)
    A = np.delete(np.delete(F * UNITS / UNITS[:, None], 3, 0), 3, 1)
    roots = np.linalg.eigvals(A)
    found = np.sort(roots.imag[roots.imag > 0])
    # two pairs meet at the equator, where rounding of a double root is its square root
    rel = 1e-9 if lat else 1e-7
    np.testing.assert_allclose(found, np.sort(frequencies(lat, SPHERE)), rtol=rel)
    assert np.max(np.abs(roots.real)) < rel * SPHERE.schuler
    for s in 1j * np.array(frequencies(lat, SPHERE)):
        w, f = SPHERE.rate, SPHERE.rate * math.sin(lat)
        value = (s**2 + w**2) * ((s**2 + SPHERE.schuler**2) ** 2 + 4 * s**2 * f**2)
        assert abs(value) < 1e-14 * SPHERE.schuler**6
    _, fast, slow = frequencies(lat, SPHERE)
    f = SPHERE.rate * abs(math.sin(lat))
    assert fast - (SPHERE.schuler + f) == pytest.approx(f * f / (2 * SPHERE.schuler), rel=1e-2, abs=1e-18)
    assert fast * slow == pytest.approx(SPHERE.schuler**2, rel=1e-14)


def test_variance_is_the_integral():
    """Equation (2-98) against the covariance of the two-state channel, by Van Loan's exponential."""
    w, q = SPHERE.schuler, 2e-8
    A = np.array([[0.0, -SPHERE.gravity], [1.0 / SPHERE.radius, 0.0]])
    for t in (10.0, 1000.0, 5000.0, DAY):
        M = expm(np.block([[-A, np.diag([q, 0.0])], [np.zeros((2, 2)), A.T]]) * t)
        P = M[2:, 2:].T @ M[:2, 2:]
        assert velocity_variance(t, q, w) == pytest.approx(P[0, 0], rel=1e-9)
    # a short time: q t; a long one: half of it, because the other half is in the tilt
    assert velocity_variance(1.0, q, w) == pytest.approx(q, rel=1e-5)
    assert velocity_variance(100 * DAY, q, w) == pytest.approx(50 * DAY * q, rel=1e-3)
