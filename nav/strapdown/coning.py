"""Coning and sculling: what a vector sum of increments misses when the axis of rotation moves.

Source: Yan Gongmin, "On SINS In-movement Initial Alignment and Some Other Problems", 2008, chapter 7;
Savage, "Strapdown Inertial Navigation Integration Algorithm Design", Journal of Guidance, Control, and
Dynamics 21, 1998, part 1 eq. (47), part 2 eq. (56).
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

TWO_SAMPLE: Final = 2.0 / 3.0
"""The coefficient of the two-sample algorithm, for coning and for sculling alike."""


def coning_coefficients(samples: int) -> list[Fraction]:
    """Coefficients k_1 ... k_(N-1) of the N-sample coning correction; k_j belongs to separation j.

    Exact solution of Yan Gongmin 2008, eq. (7-20), with the matrix of eq. (7-18). Raises ValueError
    for fewer than two samples.
    """
    if samples < 2:
        raise ValueError(f"a coning correction needs at least 2 samples, not {samples}")
    n = samples - 1
    rows = []
    for i in range(1, n + 1):
        p = 2 * i + 1
        sign, factorial = (-1) ** (i + 1), math.factorial(p)
        row = [Fraction(sign * ((j + 1) ** p + (j - 1) ** p - 2 * j**p), factorial) for j in range(1, n + 1)]
        rows.append([*row, Fraction(sign * samples**p, 2 * factorial)])
    # Gauss and Jordan over the rationals; the matrix is regular, pivots are found by exchange
    for c in range(n):
        pivot = next(r for r in range(c, n) if rows[r][c] != 0)
        rows[c], rows[pivot] = rows[pivot], rows[c]
        rows[c] = [a / rows[c][c] for a in rows[c]]
        for r in range(n):
            if r != c and rows[r][c] != 0:
                rows[r] = [a - rows[r][c] * b for a, b in zip(rows[r], rows[c], strict=True)]
    return [row[-1] for row in rows]


def rotation_vector(dtheta: ArrayLike) -> Vector:
    """Rotation vector (3,), rad, over an interval of N >= 1 equal samples ``dtheta`` (N, 3), rad.

    Yan Gongmin 2008, eq. (7-16).
    """
    d = np.asarray(dtheta, dtype=np.float64)
    phi = d.sum(axis=0)
    if len(d) > 1:
        k = coning_coefficients(len(d))
        for i in range(len(d) - 1):
            phi = phi + float(k[len(d) - 2 - i]) * np.cross(d[i], d[-1])
    return np.asarray(phi)


def velocity_increment(dtheta: ArrayLike, dv: ArrayLike) -> Vector:
    """Integral of the specific force (3,), m/s, in the body axes at the start of the interval.

    ``dtheta`` (2, 3) rad and ``dv`` (2, 3) m/s are two equal samples. Rotation (half the product of the
    sums) and sculling: Savage 1998, part 2, eqs. (33) and (56).
    """
    a, u = np.asarray(dtheta, dtype=np.float64), np.asarray(dv, dtype=np.float64)
    angle, velocity = a[0] + a[1], u[0] + u[1]
    sculling = TWO_SAMPLE * (np.cross(a[0], u[1]) + np.cross(u[0], a[1]))
    return np.asarray(velocity + 0.5 * np.cross(angle, velocity) + sculling)
