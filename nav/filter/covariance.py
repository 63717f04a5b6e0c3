"""Covariance through one navigation update: the sparse twin of ``Phi P Phi' + Q``.

Only position, velocity and misalignment move others, so only nine rows change by products; the rest
grows on the diagonal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nav.filter.states import P_GNSS, P_Q
from nav.jit import kernel
from nav.strapdown.kernels import M_C, M_EN, M_F, M_G, M_IE, M_K, M_V

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def predict_readable(P: Matrix, F: Matrix, q: Vector, dt: float) -> Matrix:
    """Covariance (N, N) after ``dt`` seconds: ``Phi = I + F dt``, ``Q = diag(q) dt``.

    ``F`` (N, N) of `nav.errors.model`, ``q`` (N,) noise densities. Groves, eq. (3.46).
    """
    Phi = np.eye(len(P)) + F * dt
    return np.asarray(Phi @ P @ Phi.T + np.diag(q) * dt)


@kernel
def _nav_block(A: Matrix, mid: Vector, dt: float) -> None:
    """Fill A (9, 9) with F dt of position, velocity and phi; see `nav.errors.model`."""
    kxx, kxy, kyy = mid[M_K] * dt, mid[M_K + 1] * dt, mid[M_K + 2] * dt
    mean = 0.5 * (kxx + kyy)
    ix, iy, iz = mid[M_IE], mid[M_IE + 1], mid[M_IE + 2]
    tx, ty, tz = mid[M_EN], mid[M_EN + 1], mid[M_EN + 2]
    vx, vy, vz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
    fx, fy, fz = mid[M_F] * dt, mid[M_F + 1] * dt, mid[M_F + 2] * dt
    for i in range(9):
        for j in range(9):
            A[i, j] = 0.0
    A[0, 0] = mean * vz
    A[0, 2] = -mean * vx
    A[1, 1] = mean * vz
    A[1, 2] = -mean * vy
    A[0, 3] = dt
    A[1, 4] = dt
    A[2, 5] = dt

    # rows of dw_ie (i) over level position, then dw_in (a) with the transport part
    i00, i01 = -iz * kxx, -iz * kxy
    i10, i11 = -iz * kxy, -iz * kyy
    i20, i21 = ix * kxx + iy * kxy, ix * kxy + iy * kyy
    a02, a12, a22 = -mean * tx, -mean * ty, -mean * tz
    a20, a21 = i20 + tx * kxx + ty * kxy, i21 + tx * kxy + ty * kyy
    A[6, 0], A[6, 1], A[6, 2] = i00, i01, a02
    A[7, 0], A[7, 1], A[7, 2] = i10, i11, a12
    A[8, 0], A[8, 1], A[8, 2] = a20, a21, a22
    A[6, 3], A[6, 4] = -kxy, -kyy
    A[7, 3], A[7, 4] = kxx, kxy
    wx, wy, wz = (ix + tx) * dt, (iy + ty) * dt, (iz + tz) * dt
    A[6, 7], A[6, 8] = wz, -wy
    A[7, 6], A[7, 8] = -wz, wx
    A[8, 6], A[8, 7] = wy, -wx

    # velocity: v x (2 dw_ie + dw_en)
    g00, g01 = 2.0 * i00, 2.0 * i01
    g10, g11 = 2.0 * i10, 2.0 * i11
    g20, g21 = i20 + a20, i21 + a21
    A[3, 0], A[3, 1], A[3, 2] = vy * g20 - vz * g10, vy * g21 - vz * g11, vy * a22 - vz * a12
    A[4, 0], A[4, 1], A[4, 2] = vz * g00 - vx * g20, vz * g01 - vx * g21, vz * a02 - vx * a22
    A[5, 0], A[5, 1] = vx * g10 - vy * g00, vx * g11 - vy * g01
    A[5, 2] = vx * a12 - vy * a02 + mid[M_G] * dt
    cx, cy, cz = (2.0 * ix + tx) * dt, (2.0 * iy + ty) * dt, (2.0 * iz + tz) * dt
    A[3, 3], A[3, 4], A[3, 5] = -vz * kxx, cz - vz * kxy, -cy
    A[4, 3], A[4, 4], A[4, 5] = -cz - vz * kxy, -vz * kyy, cx
    A[5, 3], A[5, 4] = cy + vx * kxx + vy * kxy, -cx + vx * kxy + vy * kyy
    A[3, 7], A[3, 8] = -fz, fy
    A[4, 6], A[4, 8] = fz, -fx
    A[5, 6], A[5, 7] = -fy, fx


@kernel
def predict(
    P: Matrix,
    mid: Vector,
    w_b: Vector,
    f_b: Vector,
    dt: float,
    par: Vector,
    factor: float,
    extra_v: float,
    extra_phi: float,
    work: Matrix,
) -> None:
    """Covariance ``P`` (N, N) through ``dt`` seconds, in place.

    ``mid`` is the strapdown kernel's record of the interval, ``w_b`` and ``f_b`` (3,) the corrected rate
    and specific force, ``par`` holds noise densities (from place P_Q). ``factor``
    multiplies the noise of velocity and phi, ``extra_v`` and ``extra_phi`` are added to it ((m/s)^2/s and
    rad^2/s). ``work`` (18, ALL) is scratch. Twin of `predict_readable`.
    """
    n = P.shape[0]
    # the transpose is what both products below walk along
    B = work[9:18]
    _nav_block(B[:, 0:9].T, mid, dt)
    # Y = (I + A) P, rows of the nine, all columns
    for i in range(9):
        for c in range(n):
            work[i, c] = P[i, c]
        for k in range(9):
            a = B[k, i]
            if a != 0.0:
                for c in range(n):
                    work[i, c] += a * P[k, c]
    for i in range(3):
        for k in range(3):
            a = mid[M_C + 3 * i + k] * dt
            for c in range(n):
                work[6 + i, c] += a * P[9 + k, c]
                work[3 + i, c] -= a * P[12 + k, c]
            if n > 19:
                s = a * w_b[k]
                u = a * f_b[k]
                for c in range(n):
                    work[6 + i, c] += s * P[19 + k, c]
                    work[3 + i, c] -= u * P[22 + k, c]
    # the nine by nine corner: Y (I + A)' and Y's own columns of the sensor states
    for i in range(9):
        for j in range(9):
            P[i, j] = work[i, j]
        for k in range(9):
            a = work[i, k]
            for j in range(9):
                P[i, j] += a * B[k, j]
        for k in range(3):
            a, u = work[i, 9 + k] * dt, work[i, 12 + k] * dt
            if n > 19:
                a += work[i, 19 + k] * w_b[k] * dt
                u += work[i, 22 + k] * f_b[k] * dt
            for j in range(3):
                P[i, 6 + j] += a * mid[M_C + 3 * j + k]
                P[i, 3 + j] -= u * mid[M_C + 3 * j + k]
    for i in range(9):
        for j in range(i):
            P[i, j] = P[j, i]
    for c in range(9, n):
        for i in range(9):
            P[i, c] = work[i, c]
            P[c, i] = work[i, c]
        P[c, c] += par[P_Q + c] * dt
    if n > 25:
        keep = 1.0 - par[P_GNSS] * dt
        for i in range(25, n):
            P[i, i] -= par[P_Q + i] * dt
            for c in range(n):
                P[i, c] *= keep
                P[c, i] *= keep
            P[i, i] += par[P_Q + i] * dt
    for i in range(3):
        P[i, i] += par[P_Q + i] * dt
        P[3 + i, 3 + i] += (par[P_Q + 3 + i] * factor + extra_v) * dt
        P[6 + i, 6 + i] += (par[P_Q + 6 + i] * factor + extra_phi) * dt
