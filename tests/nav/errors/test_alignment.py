"""What an alignment at rest sees of its own errors, in the psi form: ranks, limits, and a filter's sigma."""

import math

import numpy as np
import pytest
from scipy.linalg import null_space

from nav import earth
from nav.errors import psi
from nav.filter.covariance import predict_readable
from nav.filter.kalman import update

G = 9.80665
UG = 1e-6 * G
DEG_PER_H = math.radians(1.0) / 3600.0
ARCMIN = math.radians(1.0) / 60.0
DAY = 1.0 / earth.EARTH_RATE


def scaled(lat, vertical):
    """Dynamics with velocity in g / w_e, accelerometers in g, drifts in w_e: all of order one per 1 / w_e."""
    F = psi.alignment_dynamics(lat, G, vertical)
    k = 3 if vertical else 2
    size = np.array([G * DAY] * k + [1.0] * 3 + [G] * k + [1.0 / DAY] * 3)
    return F * size / size[:, None]


@pytest.mark.parametrize("lat", [-1.2, 0.0, 0.5, 1.4])
@pytest.mark.parametrize(("vertical", "rank"), [(False, 7), (True, 9)])
def test_ranks(lat, vertical, rank):
    """7 of 10 states and 9 of 12 are observable: excerpt on psi-angle models, eqs. (2.2.7), (2.2.9)."""
    F = scaled(lat, vertical)
    k = 3 if vertical else 2
    assert psi.observability_rank(F, k, DAY) == rank
    # of the three that are not seen, each tilt hides an accelerometer error and azimuth the east drift
    hidden = null_space(
        np.vstack([np.eye(len(F))[:k] @ np.linalg.matrix_power(F * DAY, i) for i in range(12)])
    )
    assert hidden.shape[1] == 3
    for x in hidden.T:
        angle, accel, drift = x[k : k + 3], G * x[k + 3 : 2 * k + 3], x[2 * k + 3 :] / DAY
        limit = psi.alignment_limit(lat, G, (accel[0], accel[1]), drift[0])
        np.testing.assert_allclose(angle, limit, atol=1e-9)
        assert np.max(np.abs(x[:k])) < 1e-9


def test_limit_is_an_equilibrium():
    """With constant errors and the misalignments of (2-104), velocity and psi rest but for the other drifts.

    Those are what a filter sees: the north and vertical drift turn the platform, and velocity shows it.
    """
    lat, accel, drift = 0.6, (80 * UG, -120 * UG), 0.03 * DEG_PER_H
    angle = psi.alignment_limit(lat, G, accel, drift)
    rate = psi.alignment_dynamics(lat, G) @ np.array([0, 0, *angle, *accel, drift, 0, 0])
    np.testing.assert_allclose(rate[:3], 0.0, atol=1e-18)
    # the north and vertical drift that the tilt feigns
    north, up = earth.EARTH_RATE * math.cos(lat), earth.EARTH_RATE * math.sin(lat)
    np.testing.assert_allclose(rate[3:5], [-up * angle[0], north * angle[0]], rtol=1e-12)


def test_limit_in_numbers():
    """0.9402 mrad for 0.01 deg/h at 45 deg, where the text rounds to 1 mrad; 1 mrad of tilt for 1 mg."""
    _, _, azimuth = psi.alignment_limit(math.pi / 4, G, (0.0, 0.0), 0.01 * DEG_PER_H)
    assert azimuth == pytest.approx(0.9402e-3, rel=1e-4)
    east, north, _ = psi.alignment_limit(0.3, G, (1000 * UG, 1000 * UG), 0.0)
    assert (east, north) == pytest.approx((-1e-3, 1e-3), rel=1e-12)


@pytest.mark.parametrize("vertical", [False, True])
def test_filter_reaches_the_limit(vertical):
    """100 ug and 0.02 deg/h at 45 deg: after 900 s the sigma of a filter is the limit's, 0.344, 0.344, 6.47'.

    Velocity of rest to 0.1 m/s at 1 Hz, 10 ug/sqrt(Hz), 0.002 deg/sqrt(h), from 1 deg and 0.1 m/s. The random
    walk adds its n / (w_N sqrt(t)), 1.3', and a little for the drift that must be told from it.
    """
    lat, u, drift = math.pi / 4, 100 * UG, 0.02 * DEG_PER_H
    walk, noise = 0.002 * math.radians(1.0) / 60.0, 10 * UG
    F = psi.alignment_dynamics(lat, G, vertical)
    k, n = (3, 12) if vertical else (2, 10)
    P = np.diag(np.square([0.1] * k + [math.radians(1.0)] * 3 + [u] * k + [drift] * 3))
    q = np.square([noise] * k + [walk] * 3 + [0.0] * (k + 3))
    H, R, dx, S = np.eye(n)[:k], 0.01 * np.eye(k), np.empty(n), np.empty((k, k))
    for _ in range(900):
        P = predict_readable(P, F, q, 1.0)
        update(P, H, np.zeros(k), R, np.zeros((n, k)), np.inf, dx, S)
    sigma = np.sqrt(np.diag(P))[k : k + 3]
    east, north, _ = psi.alignment_limit(lat, G, (u, u), drift)
    azimuth = math.hypot(psi.alignment_limit(lat, G, (0.0, 0.0), drift)[2], u / G)
    np.testing.assert_allclose(np.array([east, north, azimuth]) / ARCMIN, [-0.344, 0.344, 6.47], atol=5e-3)
    np.testing.assert_allclose(sigma[:2], u / G, rtol=6e-3)
    assert azimuth < sigma[2] < math.hypot(azimuth, 1.4 * walk / (earth.EARTH_RATE * math.cos(lat) * 30.0))
    np.testing.assert_allclose(sigma / ARCMIN, [0.345, 0.345, 6.66], rtol=5e-3)
