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

MOST_SAMPLES: Final = 6
"""Most samples in one update; the coefficients of more than that grow and amplify what sensors round."""


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


SLOPE: Final = MOST_SAMPLES - 1
BEND: Final = MOST_SAMPLES
# by number of samples: first + last - the middle two, over (half the second derivative times the cube of one
# sample's interval); the middle two are one and the same where the number is odd
_BEND: Final = {3: 2.0, 4: 4.0, 5: 8.0, 6: 12.0}


def _third_order(a: Vector, u: Vector) -> Vector:
    """What products of two leave of the velocity, to fifth order in the interval, from 3 samples or more.

    Coning and sculling stop at products of two increments. Those of three, two angles and a velocity, do
    matter, since gravity is always there: with four samples at 200 Hz a cone of 1 deg at 10 Hz would lift it
    by 4e-5 m/s^2, twenty times what is left so. ``a``, ``u`` (N, 3). Brackets of the sixth-order method of
    Blanes, Casas, Oteo and Ros, "The Magnus expansion and some of its applications", Physics Reports 470,
    2009, applied to rigid motions.
    """

    def bracket(p: tuple[Vector, Vector], q: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        return np.cross(p[0], q[0]), np.cross(p[0], q[1]) + np.cross(p[1], q[0])

    n = len(a)
    whole = a.sum(axis=0), u.sum(axis=0)
    slope = (a[-1] - a[0]) * (n * n / (n - 1)), (u[-1] - u[0]) * (n * n / (n - 1))
    low, high, scale = (n - 1) // 2, n // 2, n**3 / _BEND[n]
    bend = (a[0] + a[-1] - a[low] - a[high]) * scale, (u[0] + u[-1] - u[low] - u[high]) * scale
    left = bracket(bracket(whole, slope), slope)
    right = bracket(whole, bracket(whole, bend))
    return np.asarray(left[1] / 240.0 + right[1] / 360.0)


def velocity_increment(dtheta: ArrayLike, dv: ArrayLike) -> Vector:
    """Integral of the specific force (3,), m/s, in the body axes at the start of the interval.

    ``dtheta`` (N, 3) rad and ``dv`` (N, 3) m/s are N >= 1 equal samples. Sculling is coning's counterpart:
    with one of the two vectors of each product replaced by the velocity increment, and the same
    coefficients (Savage 1998, part 2, eq. (56) for two samples). The sum so corrected turns with the
    body as if rate and force were constant in it: Savage 1998, part 2, eq. (37).
    """
    a, u = np.asarray(dtheta, dtype=np.float64), np.asarray(dv, dtype=np.float64)
    phi, eta = rotation_vector(a), u.sum(axis=0)
    if len(a) > 1:
        k = coning_coefficients(len(a))
        for i in range(len(a) - 1):
            eta = eta + float(k[len(a) - 2 - i]) * (np.cross(a[i], u[-1]) + np.cross(u[i], a[-1]))
    if len(a) > 2:
        eta = eta + _third_order(a, u)
    angle = float(np.linalg.norm(phi))
    # (1 - cos)/x^2 and (1 - sin/x)/x^2; the first is half the square of sinc(x/2)
    first = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    second = 1.0 / 6.0 - angle**2 / 120.0 + angle**4 / 5040.0
    if angle > 0.05:
        second = (1.0 - math.sin(angle) / angle) / angle**2
    turned = np.cross(phi, eta)
    return np.asarray(eta + first * turned + second * np.cross(phi, turned))


def coefficient_table() -> Vector:
    """What the kernel needs (MOST_SAMPLES + 1, MOST_SAMPLES + 1): row N belongs to N samples.

    The coning coefficients by separation; in the last two places the factors of slope and bend.
    """
    table = np.zeros((MOST_SAMPLES + 1, MOST_SAMPLES + 1))
    for n in range(2, MOST_SAMPLES + 1):
        table[n, : n - 1] = [float(k) for k in coning_coefficients(n)]
    for n, bend in _BEND.items():
        table[n, SLOPE], table[n, BEND] = n * n / (n - 1), n**3 / bend
    return table
