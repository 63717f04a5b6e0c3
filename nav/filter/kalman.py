"""The measurement update: gated, joint over the rows of one measurement, symmetric by construction.

Source: Groves, 2nd ed., sections 3.2 and 17.1 (gate), 3.4 (noise correlated with the state); Joseph's form.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import curvature
from nav.filter.states import (
    BASIC,
    FULL,
    RECEIVER,
    X_BA,
    X_BB,
    X_BG,
    X_GB,
    X_KO,
    X_MG,
    X_PATH,
    X_PT,
    X_QV,
)
from nav.jit import kernel
from nav.rotation import exponential, multiply, rotate
from nav.strapdown.kernels import X_A_H, X_C, X_H, X_Q, X_V, rotate_columns

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

GATES: Final = (0.0, 15.1367, 18.4207, 21.1075, 23.5127, 25.7448, 27.8563)
"""Chi-square quantiles at 0.9999 for 1 to 6 degrees of freedom: one good measurement in 10^4 is lost."""


def update_readable(P: Matrix, H: Matrix, r: Vector, R: Matrix, X: Matrix) -> tuple[Vector, Matrix, float]:
    """Textbook update: estimated error (N,), covariance (N, N), normalised innovation squared.

    ``P`` (N, N), ``H`` (m, N), residual ``r`` (m,) computed minus measured, ``R`` (m, m), ``X`` (N, m)
    covariance between the state's error and the residual's noise. Groves, eqs. (3.21) to (3.25), (3.103).
    """
    W = P @ H.T + X
    S = H @ P @ H.T + H @ X + X.T @ H.T + R
    K = W @ np.linalg.inv(S)
    return K @ r, P - K @ S @ K.T, float(r @ np.linalg.solve(S, r))


@kernel
def update_gain(
    P: Matrix, H: Matrix, r: Vector, R: Matrix, X: Matrix, gate: float, dx: Vector, S: Matrix, K: Matrix
) -> float:
    """Update ``P`` in place and write the estimated error to ``dx`` (N,); returns the NIS.

    Arguments as `update_readable`. ``S`` (m, m) receives the innovation covariance, ``K`` (m, N) the
    transposed gain. When the NIS exceeds ``gate``, ``P`` and ``K`` stay and ``dx`` is zero. The covariance is
    ``P - K U' - U K'`` with ``U = W - K S / 2``, which is Joseph's form: errors of K enter in second order
    only.
    """
    n = P.shape[0]
    m = H.shape[0]
    W = np.zeros((m, n))
    for a in range(m):
        for k in range(n):
            h = H[a, k]
            if h != 0.0:
                for c in range(n):
                    W[a, c] += h * P[k, c]
    for a in range(m):
        for b in range(m):
            t = R[a, b]
            for k in range(n):
                t += W[a, k] * H[b, k] + H[a, k] * X[k, b] + X[k, a] * H[b, k]
            S[a, b] = t
    for a in range(m):
        for c in range(n):
            W[a, c] += X[c, a]
    # Cholesky S = L L', then NIS by forward substitution
    L = np.zeros((m, m))
    nis = 0.0
    y = np.zeros(m)
    for a in range(m):
        for b in range(a + 1):
            t = S[a, b]
            for k in range(b):
                t -= L[a, k] * L[b, k]
            if a == b:
                if not t > 0.0:
                    return np.nan
                L[a, a] = np.sqrt(t)
            else:
                L[a, b] = t / L[b, b]
        t = r[a]
        for k in range(a):
            t -= L[a, k] * y[k]
        y[a] = t / L[a, a]
        nis += y[a] * y[a]
    for c in range(n):
        dx[c] = 0.0
    if not nis <= gate:
        return nis
    g = np.zeros(m)
    for c in range(n):
        for a in range(m):
            t = W[a, c]
            for k in range(a):
                t -= L[a, k] * g[k]
            g[a] = t / L[a, a]
        for a in range(m - 1, -1, -1):
            t = g[a]
            for k in range(a + 1, m):
                t -= L[k, a] * K[k, c]
            K[a, c] = t / L[a, a]
        for a in range(m):
            dx[c] += K[a, c] * r[a]
    for a in range(m):
        for c in range(n):
            t = W[a, c]
            for b in range(m):
                t -= 0.5 * S[a, b] * K[b, c]
            W[a, c] = t
    # whole rows: both halves come out equal, and neighbours are taken at once
    for i in range(n):
        for a in range(m):
            k, w = K[a, i], W[a, i]
            for j in range(n):
                P[i, j] -= k * W[a, j] + w * K[a, j]
    return nis


@kernel
def update(
    P: Matrix, H: Matrix, r: Vector, R: Matrix, X: Matrix, gate: float, dx: Vector, S: Matrix
) -> float:
    """`update_gain` for whoever does not want the gain."""
    return update_gain(P, H, r, R, X, gate, dx, S, np.zeros((H.shape[0], P.shape[0])))


@kernel
def correct(x: Vector, dx: Vector) -> None:
    """Take the estimated error ``dx`` (N,) out of the nominal state ``x`` (X_SIZE,), in place."""
    kxx, kxy, kyy = curvature(x[X_C + 6], x[X_C + 7], x[X_C + 8], x[X_H])
    # the integral since the last odometer epoch was made with the velocity error now known
    t = x[X_PT]
    if t > 0.0:
        ux = dx[3] + dx[7] * x[X_V + 2] - dx[8] * x[X_V + 1]
        uy = dx[4] + dx[8] * x[X_V] - dx[6] * x[X_V + 2]
        uz = dx[5] + dx[6] * x[X_V + 1] - dx[7] * x[X_V]
        ux, uy, uz = rotate(x[X_Q], -x[X_Q + 1], -x[X_Q + 2], -x[X_Q + 3], ux, uy, uz)
        ux, uy, uz = rotate(x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3], ux, uy, uz)
        px, py, pz = x[X_PATH], x[X_PATH + 1], x[X_PATH + 2]
        mx, mz = dx[16], dx[17]
        # a change of mounting turns the vector: (I + [mu x])
        x[X_PATH] = px - ux * t - mz * py
        x[X_PATH + 1] = py - uy * t + mz * px - mx * pz
        x[X_PATH + 2] = pz - uz * t + mx * py
    rotate_columns(x, X_C, kxy * dx[0] + kyy * dx[1], -kxx * dx[0] - kxy * dx[1], 0.0)
    x[X_H] -= dx[2]
    for i in range(3):
        x[X_V + i] -= dx[3 + i]
        x[X_BG + i] -= dx[9 + i]
        x[X_BA + i] -= dx[12 + i]
    w, i1, j1, k1 = exponential(dx[6], dx[7], dx[8])
    w, i1, j1, k1 = multiply(w, i1, j1, k1, x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    norm = 1.0 / np.sqrt(w * w + i1 * i1 + j1 * j1 + k1 * k1)
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = w * norm, i1 * norm, j1 * norm, k1 * norm
    x[X_KO] -= dx[15]
    w, i1, j1, k1 = exponential(dx[16], 0.0, dx[17])
    w, i1, j1, k1 = multiply(w, i1, j1, k1, x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3])
    norm = 1.0 / np.sqrt(w * w + i1 * i1 + j1 * j1 + k1 * k1)
    x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3] = w * norm, i1 * norm, j1 * norm, k1 * norm
    x[X_BB] -= dx[18]
    if dx.shape[0] > BASIC:
        for i in range(18):
            x[X_MG + i] -= dx[BASIC + i]
    if dx.shape[0] > RECEIVER:
        x[X_A_H] -= dx[RECEIVER]
    if dx.shape[0] > FULL:
        for i in range(3):
            x[X_GB + i] -= dx[FULL + i]
