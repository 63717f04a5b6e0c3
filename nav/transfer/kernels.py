"""The slave's own strapdown arithmetic through kept samples, and what its errors are moved by meanwhile."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.filter.motion import times, undo_axes
from nav.jit import kernel
from nav.strapdown.control import U_SIZE
from nav.strapdown.kernels import M_SIZE, increments, strapdown
from nav.transfer.states import X_ERRORS, X_REST

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# What `run` adds up, each times its interval.
S_MID: Final = 0  # the strapdown kernel's record of it
S_WB: Final = M_SIZE  # rate of b, corrected, 3
S_FB: Final = S_WB + 3  # specific force in b, corrected, 3
S_DT: Final = S_FB + 3  # s
S_SIZE: Final = S_DT + 1

_GYRO: Final = X_ERRORS + 6
_ACCEL: Final = X_ERRORS + 15


@kernel
def run(x: Vector, rows: Matrix, first: int, begin: float, last: int, end: float, sums: Vector) -> None:
    """Navigate ``x`` (X_SIZE,) from within sample ``first`` to within sample ``last``, in place.

    ``rows`` (M, 7): s, angle (rad) and velocity increments (m/s) of a sample. Of the first the share
    ``begin`` is done already, of the last the share ``end`` is taken: a sample is split evenly. ``sums``
    (S_SIZE,) is added to. Each (part of a) sample is an update of its own.
    """
    u = np.zeros(U_SIZE)
    d, inc, mid = np.empty(6), np.empty(6), np.empty(M_SIZE)
    G, A = np.empty(9), np.empty(9)
    undo_axes(x, _GYRO, G)
    undo_axes(x, _ACCEL, A)
    e, r = X_ERRORS, X_REST
    for i in range(first, last + 1):
        share = (end if i == last else 1.0) - (begin if i == first else 0.0)
        if share <= 0.0:
            continue
        dt = share * rows[i, 0]
        d[0], d[1], d[2] = times(
            G,
            share * rows[i, 1] - x[e] * dt,
            share * rows[i, 2] - x[e + 1] * dt,
            share * rows[i, 3] - x[e + 2] * dt,
        )
        rx, ry, rz = x[r] * dt, x[r + 1] * dt, x[r + 2] * dt
        fx, fy, fz = times(
            A,
            share * rows[i, 4] - x[e + 3] * dt - rx,
            share * rows[i, 5] - x[e + 4] * dt - ry,
            share * rows[i, 6] - x[e + 5] * dt - rz,
        )
        d[3], d[4], d[5] = fx + rx, fy + ry, fz + rz
        increments(d, 1, inc)
        strapdown(x, inc, dt, u, mid)
        sums[S_DT] += dt
        for k in range(M_SIZE):
            sums[S_MID + k] += mid[k] * dt
        for k in range(3):
            sums[S_WB + k] += d[k]
            sums[S_FB + k] += d[3 + k]
