"""The filter through a window of fixes, against all of its fixes at once."""

import numpy as np

from nav.align.match_filter import through


def test_the_filter_is_the_conditional_mean_of_all_fixes_at_once():
    rng = np.random.default_rng(3)
    fixes, d, n = 5, 6, 9
    F = 0.3 * rng.standard_normal((fixes, d, n))
    F[:, np.arange(d), np.arange(d)] += 1.0
    root = 0.2 * rng.standard_normal((fixes, d, d))
    Q, H = root @ np.swapaxes(root, 1, 2), rng.standard_normal((fixes, 3, n))
    walk = np.zeros((fixes, n))
    walk[:, d:] = 0.01
    x0, P0 = rng.standard_normal(n), np.diag(rng.uniform(0.5, 2.0, n))
    var, z = rng.uniform(0.1, 1.0, (fixes, 3)), rng.standard_normal((fixes, 3))

    # x_k = A_k (x_0, noises): mean and covariance of the last state and of all measurements together
    size = n * fixes
    mean, cov = np.zeros(size), np.zeros((size, size))
    mean[:n], cov[:n, :n] = x0, P0
    A, at, carried = np.zeros((n, size)), [], np.eye(n)
    A[:, :n] = np.eye(n)
    for k in range(fixes):
        if k > 0:
            whole = np.eye(n)
            whole[:d] = F[k]
            A, carried = whole @ A, whole @ carried
            own = slice(n * k, n * k + n)
            A[:, own] = np.eye(n)
            cov[own, own] = np.diag(walk[k])
            cov[n * k : n * k + d, n * k : n * k + d] += Q[k]
        at.append(H[k] @ A)
    every = np.concatenate(at)
    S = every @ cov @ every.T + np.diag(var.ravel())
    gain = A @ cov @ every.T @ np.linalg.inv(S)

    x, P, normed, total = x0.copy(), P0.copy(), np.empty((fixes, 3)), np.empty((d, n))
    through(x, P, F, Q, H, walk, z, var, normed, total)
    innovation = z.ravel() - every @ mean
    np.testing.assert_allclose(x, A @ mean + gain @ innovation, rtol=1e-9)
    np.testing.assert_allclose(P, (A - gain @ every) @ cov @ A.T, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(total, carried[:d], rtol=1e-12)
    # whitened innovations have the square of all of them together
    assert np.isclose(np.sum(normed**2), innovation @ np.linalg.solve(S, innovation))
