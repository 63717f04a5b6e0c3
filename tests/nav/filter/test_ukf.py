"""The unscented filter where it must be the Kalman filter, and where it must be better."""

import math

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints

from nav.filter.ukf import predict, symmetric_points, update


def test_on_a_linear_model_it_is_the_kalman_filter():
    rng = np.random.default_rng(1)
    n, m = 5, 2
    F, H = np.eye(n) + 0.1 * rng.normal(size=(n, n)), rng.normal(size=(m, n))
    g, Q, R = rng.normal(size=(n, 3)), np.diag([0.1, 0.2, 0.3]), 0.5 * np.eye(m)
    points = symmetric_points(n)
    # two of them at once, from different starts
    x, P = rng.normal(size=(2, n)), np.stack([np.eye(n), 3.0 * np.eye(n)])
    x_k, P_k = x.copy(), P.copy()
    for _ in range(20):
        z = rng.normal(size=m)
        x, P = predict(points, x, P, lambda chi: chi @ F.T, g @ Q @ g.T)
        x, P, innovation, S = update(x, P, z, H, R)
        for i in range(2):
            x_i, P_i = F @ x_k[i], F @ P_k[i] @ F.T + g @ Q @ g.T
            S_i = H @ P_i @ H.T + R
            K = P_i @ H.T @ np.linalg.inv(S_i)
            assert np.allclose(innovation[i], z - H @ x_i, atol=1e-9)
            assert np.allclose(S[i], S_i, atol=1e-9)
            x_k[i], P_k[i] = x_i + K @ (z - H @ x_i), P_i - K @ S_i @ K.T
    assert np.allclose(x, x_k, atol=1e-9)
    assert np.allclose(P, P_k, atol=1e-9)


def test_points_and_weights_are_the_printed_ones():
    n, alpha, beta, kappa = 4, 0.5, 2.0, 0.0
    points = symmetric_points(n, alpha, beta, kappa)
    lam = alpha**2 * (n + kappa) - n
    assert points.spread == n + lam
    assert math.isclose(points.for_mean[0], lam / (n + lam))
    assert math.isclose(points.for_covariance[0], points.for_mean[0] + 1.0 - alpha**2 + beta)
    assert np.allclose(points.for_mean[1:], 0.5 / (n + lam))
    rng = np.random.default_rng(2)
    A = rng.normal(size=(n, n))
    x, P = rng.normal(size=n), A @ A.T
    seen = []
    predict(points, x, P, lambda chi: seen.append(chi) or chi, np.zeros((n, n)))
    assert np.allclose(seen[0], MerweScaledSigmaPoints(n, alpha, beta, kappa).sigma_points(x, P))


def test_the_mean_of_a_curved_function_is_right_to_fourth_order():
    sigma = 0.4
    points = symmetric_points(1)
    x, P = predict(points, np.zeros(1), np.array([[sigma**2]]), np.cos, np.zeros((1, 1)))
    # E cos x = exp(-sigma^2/2); points at sqrt(3) sigma have a Gaussian's fourth moment: sigma^6 is left
    assert abs(x[0] - math.exp(-0.5 * sigma**2)) < sigma**6 / 24.0
    assert P[0, 0] > 0.0
