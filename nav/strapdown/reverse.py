"""Running backwards in time through the same kernels.

Time itself is what changes sign: intervals are negative, the increments over them are those of the way
forward undone, in reverse order, and every rate in the kernel (of the Earth, of transport, of the control
vector) turns back by itself. That is the same as negating gyro samples, Earth rate, velocity and control
rates and letting time run on (Yan Gongmin 2008, eqs. (2-4), (2-6) and (2-8)), but state and control vector
keep their meaning.

An update back takes the attitude to exactly where the update forward came from, given the same rate of n.
Velocity and position come back but for terms of third order in the interval and for the growth of rounding
in the unstable height: forward and back again over 3 km of driving ends within 1 mm of the start. A damped
channel does not invert: errors that it takes away on the way forward would grow on the way back, so it is
refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nav.jit import kernel
from nav.rotation import exponential, rotate
from nav.strapdown.control import U_KH, U_KV
from nav.strapdown.kernels import M_SIZE, X_HEAD, increments, strapdown, take

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@kernel
def invert(inc: Vector) -> None:
    """Make of ``inc`` (6,) of `nav.strapdown.kernels.increments` that of the same motion backwards, in place.

    The second half is an integral in the axes at the start of the interval; those are now the ones at its
    end.
    """
    w, i, j, k = exponential(-inc[0], -inc[1], -inc[2])
    x, y, z = rotate(w, i, j, k, inc[3], inc[4], inc[5])
    inc[0], inc[1], inc[2] = -inc[0], -inc[1], -inc[2]
    inc[3], inc[4], inc[5] = -x, -y, -z


@kernel
def _integrate_back(
    x: Vector, samples: Matrix, dt_sample: float, n: int, u: Vector, every: int, out: Matrix
) -> int:
    d = np.empty(6 * n)
    inc = np.empty(6)
    mid = np.empty(M_SIZE)
    rows = 0
    updates = samples.shape[0] // n
    for k in range(updates):
        take(samples, (updates - 1 - k) * n, n, d)
        increments(d, n, inc)
        invert(inc)
        strapdown(x, inc, -n * dt_sample, u, mid)
        if (k + 1) % every == 0 and rows < out.shape[0]:
            for j in range(X_HEAD):
                out[rows, j] = x[j]
            rows += 1
    return rows


def integrate_back(
    x: Vector, samples: Matrix, dt_sample: float, n: int, u: Vector, every: int, out: Matrix
) -> int:
    """Undo `nav.strapdown.kernels.integrate`: from the state after ``samples`` to the one before them.

    Arguments as there, samples (M, 6) in the order of time; ``x`` is changed in place, rows of ``out`` come
    in the order in which they are reached. Raises ValueError when ``u`` damps velocity or height.
    """
    if np.any(u[U_KV : U_KV + 2]) or np.any(u[U_KH : U_KH + 3]):
        raise ValueError("a damped channel does not run backwards: velocity and height gains must be zero")
    return int(_integrate_back(x, samples, dt_sample, n, u, every, out))
