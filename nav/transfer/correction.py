"""What rows of a message are worth, and the correction by them: Schmidt's filter of few estimated states."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import curvature
from nav.jit import kernel
from nav.rotation import exponential, multiply
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V, rotate_columns
from nav.transfer.states import DELAY, MOVED, PHI, POSITION, SIZE, VELOCITY, X_ERRORS

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Numbers = NDArray[np.int64]

_P: Final = POSITION.start
_V: Final = VELOCITY.start
_PHI: Final = PHI.start


class Use(IntEnum):
    """What is done with a row."""

    NOT = 0
    MATCH = 1
    COPY = 2


@kernel
def weigh(
    P: Matrix,
    H: Matrix,
    r: Vector,
    R: Matrix,
    uses: Numbers,
    own: int,
    mask: Vector,
    share: float,
    dx: Vector,
    columns: Numbers,
) -> tuple[Matrix, Matrix, Matrix, Vector, Matrix]:
    """Gain K (m, SIZE), transposed, of the m rows in use, ``P H'`` (SIZE, m), transposed, S (m, m), residual.

    The rows ``H`` (3, SIZE) with residual ``r`` (3,) and noise ``R`` (3, 3) stand for the states from ``own``
    on. By ``uses`` (3,) a row is left out; matched: it corrects the states of ``mask`` (SIZE,) by the
    gain that is best for them, the delay by ``share`` of it; or copied: it sets the state that it stands
    for, as rows are the state itself, misalignment with the other sign. Matched ones are the first of m.
    ``dx`` (SIZE,) is what rows before have found, taken out of the residual (m,). Last come, whitened by S,
    the residual and these ``columns`` of H, (m, 1 + columns); not finite where S is not positive definite.
    """
    rows = np.empty(3, np.int64)
    m = 0
    for kind in (Use.MATCH, Use.COPY):
        for j in range(3):
            if uses[j] == kind:
                rows[m] = j
                m += 1
        if kind == Use.MATCH:
            matched = m
    W, K = np.zeros((m, SIZE)), np.zeros((m, SIZE))
    S, L, e = np.empty((m, m)), np.zeros((m, m)), np.empty(m)
    for a in range(m):
        t = r[rows[a]]
        for k in range(SIZE):
            h = H[rows[a], k]
            if h != 0.0:
                t -= h * dx[k]
                for c in range(SIZE):
                    W[a, c] += h * P[k, c]
        e[a] = t
        for b in range(a + 1):
            t = R[rows[a], rows[b]]
            for k in range(SIZE):
                t += W[a, k] * H[rows[b], k]
            S[a, b] = t
            S[b, a] = t
            # Cholesky, S = L L'
            for k in range(b):
                t -= L[a, k] * L[b, k]
            if b < a:
                L[a, b] = t / L[b, b]
            else:
                L[a, a] = math.sqrt(t) if t > 0.0 else math.nan
    white = np.empty((m, 1 + columns.size))
    for c in range(white.shape[1]):
        for a in range(m):
            t = e[a] if c == 0 else H[rows[a], columns[c - 1]]
            for k in range(a):
                t -= L[a, k] * white[k, c]
            white[a, c] = t / L[a, a]
    # of the matched rows alone L is the corner
    for a in range(matched):
        for c in range(SIZE):
            t = W[a, c]
            for k in range(a):
                t -= L[a, k] * K[k, c]
            K[a, c] = t / L[a, a]
    for a in range(matched - 1, -1, -1):
        for c in range(SIZE):
            t = K[a, c]
            for k in range(a + 1, matched):
                t -= L[k, a] * K[k, c]
            K[a, c] = t / L[a, a]
    for a in range(matched):
        for c in range(SIZE):
            K[a, c] *= mask[c]
        K[a, DELAY] *= share
    for a in range(matched, m):
        c = own + rows[a]
        K[a, c] = H[rows[a], c]
    return K, W, S, e, white


@kernel
def take(P: Matrix, dx: Vector, K: Matrix, W: Matrix, S: Matrix, e: Vector) -> None:
    """Correct covariance ``P`` (SIZE, SIZE) and the errors found ``dx`` (SIZE,), in place; as `weigh` says.

    For any gain; Groves, 2nd ed., eq. (3.58) multiplied out. ``W`` is used up. ``P`` stays symmetric to the
    bit.
    """
    m = K.shape[0]
    for a in range(m):
        for c in range(SIZE):
            dx[c] += K[a, c] * e[a]
        for b in range(m):
            s = 0.5 * S[a, b]
            for c in range(SIZE):
                W[a, c] -= s * K[b, c]
    # whole rows: both halves come out equal, and neighbours are taken at once
    for i in range(SIZE):
        for a in range(m):
            k, w = K[a, i], W[a, i]
            for c in range(SIZE):
                P[i, c] -= k * W[a, c] + w * K[a, c]


@kernel
def correct(x: Vector, dx: Vector) -> None:
    """Take the estimated errors ``dx`` (SIZE,) out of the nominal state ``x`` (X_SIZE,), in place."""
    a, b, c, d = exponential(dx[_PHI], dx[_PHI + 1], dx[_PHI + 2])
    a, b, c, d = multiply(a, b, c, d, x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    size = math.sqrt(a * a + b * b + c * c + d * d)
    x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3] = a / size, b / size, c / size, d / size
    for k in range(3):
        x[X_V + k] -= dx[_V + k]
    east, north = -dx[_P], -dx[_P + 1]
    kxx, kxy, kyy = curvature(x[X_C + 6], x[X_C + 7], x[X_C + 8], x[X_H])
    rotate_columns(x, X_C, -kxy * east - kyy * north, kxx * east + kxy * north, 0.0)
    x[X_H] -= dx[_P + 2]
    for k in range(MOVED, SIZE):
        x[X_ERRORS + k - MOVED] -= dx[k]
