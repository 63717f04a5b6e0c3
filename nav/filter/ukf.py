"""The unscented Kalman filter for noise that enters linearly, with a linear measurement.

Yan Gongmin 2008, section 4.4: ``x_k = f(x_{k-1}) + g(x_{k-1}) w``, ``z = H x + v``. Points carry the state
through ``f``; all else is the Kalman filter's, eq. (4-47). Functions take leading axes: a bank of filters
is one call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Points(NamedTuple):
    """How points are laid about a mean: weights (2 n + 1,) for mean and covariance, and n + lambda."""

    for_mean: Vector
    for_covariance: Vector
    spread: float


def symmetric_points(n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float | None = None) -> Points:
    """The scaled symmetric points of ``n`` states, eq. (4-41); ``kappa`` is 3 - n where not given."""
    # here and not above: it brings all of SciPy's statistics, 0.7 s that other filters have no use for
    from filterpy.kalman import MerweScaledSigmaPoints

    kappa = 3.0 - n if kappa is None else kappa
    rule = MerweScaledSigmaPoints(n, alpha, beta, kappa)
    return Points(rule.Wm, rule.Wc, alpha**2 * (n + kappa))


def predict(
    points: Points, x: Vector, P: Matrix, f: Callable[[Vector], Vector], noise: Matrix
) -> tuple[Vector, Matrix]:
    """State (..., n) and covariance (..., n, n) after ``f``, which takes points (..., 2 n + 1, n).

    ``noise`` (..., n, n) is g(x) Q g(x)^T. Raises numpy.linalg.LinAlgError where ``P`` is not positive
    definite.
    """
    root = np.swapaxes(np.linalg.cholesky(points.spread * P), -1, -2)
    about = x[..., None, :]
    moved = f(np.concatenate([about, about + root, about - root], axis=-2))
    mean: Vector = np.einsum("k,...ki->...i", points.for_mean, moved)
    off = moved - mean[..., None, :]
    return mean, np.einsum("k,...ki,...kj->...ij", points.for_covariance, off, off) + noise


def update(x: Vector, P: Matrix, z: ArrayLike, H: Matrix, R: Matrix) -> tuple[Vector, Matrix, Vector, Matrix]:
    """State and covariance after ``z`` (..., m), and the innovation (..., m) with its covariance.

    ``H`` (m, n), ``R`` (m, m).
    """
    innovation = np.asarray(z, dtype=np.float64) - x @ H.T
    PHt = P @ H.T
    S = H @ PHt + R
    K = np.swapaxes(np.linalg.solve(S, np.swapaxes(PHt, -1, -2)), -1, -2)
    P = P - K @ np.swapaxes(PHt, -1, -2)
    return x + np.einsum("...ij,...j->...i", K, innovation), 0.5 * (P + np.swapaxes(P, -1, -2)), innovation, S
