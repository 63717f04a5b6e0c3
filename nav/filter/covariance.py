"""Covariance through one navigation update: the sparse twin of ``Phi P Phi' + Q``.

Only position, velocity and misalignment move others, so only nine rows change by products; the rest
grows on the diagonal.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.filter.states import BASIC, FULL, P_GNSS, P_Q, RECEIVER
from nav.jit import kernel
from nav.strapdown.kernels import M_C, M_EN, M_F, M_G, M_IE, M_K, M_V

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

WIDTH: Final = 48
"""Length of a row of scratch: a multiple of what a processor takes at once, ALL or more."""
OUT: Final = 15 * WIDTH
"""Where the results begin in scratch, behind the rows of navigation and sensor errors."""
PREDICT_SIZE: Final = OUT + 9 * WIDTH + 81


def predict_readable(P: Matrix, F: Matrix, q: Vector, dt: float) -> Matrix:
    """Covariance (N, N) after ``dt`` seconds: ``Phi = I + F dt``, ``Q = diag(q) dt``.

    ``F`` (N, N) of `nav.errors.model`, ``q`` (N,) noise densities. Groves, eq. (3.46).
    """
    Phi = np.eye(len(P)) + F * dt
    return np.asarray(Phi @ P @ Phi.T + np.diag(q) * dt)


@kernel
def _nav_block(A: Matrix, mid: Vector, dt: float) -> None:
    """Put F dt of position, velocity and phi into A (9, 9), but for its zeros; see `nav.errors.model`."""
    kxx, kxy, kyy = mid[M_K] * dt, mid[M_K + 1] * dt, mid[M_K + 2] * dt
    mean = 0.5 * (kxx + kyy)
    ix, iy, iz = mid[M_IE], mid[M_IE + 1], mid[M_IE + 2]
    tx, ty, tz = mid[M_EN], mid[M_EN + 1], mid[M_EN + 2]
    vx, vy, vz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
    turn = tz * dt
    fx, fy, fz = mid[M_F] * dt, mid[M_F + 1] * dt, mid[M_F + 2] * dt
    A[0, 0] = mean * vz
    A[0, 1] = turn
    A[0, 2] = -mean * vx
    A[1, 0] = -turn
    A[1, 1] = mean * vz
    A[1, 2] = -mean * vy
    A[0, 3] = dt
    A[1, 4] = dt
    A[2, 5] = dt

    # rows of dw_ie (i) over level position, then dw_in (a) with the transport part
    i00, i01 = -iz * kxx, -iz * kxy
    i10, i11 = -iz * kxy, -iz * kyy
    i20, i21 = ix * kxx + iy * kxy, ix * kxy + iy * kyy
    a02, a12 = -mean * tx, -mean * ty
    a20, a21 = i20 + tx * kxx + ty * kxy, i21 + tx * kxy + ty * kyy
    A[6, 0], A[6, 1], A[6, 2] = i00, i01, a02
    A[7, 0], A[7, 1], A[7, 2] = i10, i11, a12
    A[8, 0], A[8, 1] = a20, a21
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
    A[3, 0], A[3, 1], A[3, 2] = vy * g20 - vz * g10, vy * g21 - vz * g11, -vz * a12
    A[4, 0], A[4, 1], A[4, 2] = vz * g00 - vx * g20, vz * g01 - vx * g21, vz * a02
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
def _carry(w: Vector, A: Matrix, mid: Vector, dt: float, columns: int) -> None:
    """Rows from OUT of ``w`` become the first nine of Phi times the rows at its head, over ``columns``.

    The elements of Phi that are always zero are left out. Everything a column needs is one expression over
    rows of equal length, so that the compiler takes several columns at once.
    """
    a00, a01, a02, a10, a11, a12 = A[0, 0], A[0, 1], A[0, 2], A[1, 0], A[1, 1], A[1, 2]
    a30, a31, a32, a33, a34, a35 = A[3, 0], A[3, 1], A[3, 2], A[3, 3], A[3, 4], A[3, 5]
    a40, a41, a42, a43, a44, a45 = A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4], A[4, 5]
    a50, a51, a52, a53, a54 = A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4]
    a37, a38, a46, a48, a56, a57 = A[3, 7], A[3, 8], A[4, 6], A[4, 8], A[5, 6], A[5, 7]
    a60, a61, a62, a63, a64, a67, a68 = A[6, 0], A[6, 1], A[6, 2], A[6, 3], A[6, 4], A[6, 7], A[6, 8]
    a70, a71, a72, a73, a74, a76, a78 = A[7, 0], A[7, 1], A[7, 2], A[7, 3], A[7, 4], A[7, 6], A[7, 8]
    a80, a81, a86, a87 = A[8, 0], A[8, 1], A[8, 6], A[8, 7]
    c00, c01, c02 = mid[M_C] * dt, mid[M_C + 1] * dt, mid[M_C + 2] * dt
    c10, c11, c12 = mid[M_C + 3] * dt, mid[M_C + 4] * dt, mid[M_C + 5] * dt
    c20, c21, c22 = mid[M_C + 6] * dt, mid[M_C + 7] * dt, mid[M_C + 8] * dt
    for c in range(columns):
        x, y, z = w[c], w[WIDTH + c], w[2 * WIDTH + c]
        u, v, s = w[3 * WIDTH + c], w[4 * WIDTH + c], w[5 * WIDTH + c]
        e, n, h = w[6 * WIDTH + c], w[7 * WIDTH + c], w[8 * WIDTH + c]
        g0, g1, g2 = w[9 * WIDTH + c], w[10 * WIDTH + c], w[11 * WIDTH + c]
        f0, f1, f2 = w[12 * WIDTH + c], w[13 * WIDTH + c], w[14 * WIDTH + c]
        o = OUT + c
        w[o] = x + (a00 * x + a01 * y + a02 * z + dt * u)
        w[o + WIDTH] = y + (a10 * x + a11 * y + a12 * z + dt * v)
        w[o + 2 * WIDTH] = z + dt * s
        w[o + 3 * WIDTH] = u + (
            (a30 * x + a31 * y + a32 * z)
            + (a33 * u + a34 * v + a35 * s)
            + (a37 * n + a38 * h)
            - (c00 * f0 + c01 * f1 + c02 * f2)
        )
        w[o + 4 * WIDTH] = v + (
            (a40 * x + a41 * y + a42 * z)
            + (a43 * u + a44 * v + a45 * s)
            + (a46 * e + a48 * h)
            - (c10 * f0 + c11 * f1 + c12 * f2)
        )
        w[o + 5 * WIDTH] = s + (
            (a50 * x + a51 * y + a52 * z)
            + (a53 * u + a54 * v)
            + (a56 * e + a57 * n)
            - (c20 * f0 + c21 * f1 + c22 * f2)
        )
        w[o + 6 * WIDTH] = e + (
            (a60 * x + a61 * y + a62 * z)
            + (a63 * u + a64 * v)
            + (a67 * n + a68 * h)
            + (c00 * g0 + c01 * g1 + c02 * g2)
        )
        w[o + 7 * WIDTH] = n + (
            (a70 * x + a71 * y + a72 * z)
            + (a73 * u + a74 * v)
            + (a76 * e + a78 * h)
            + (c10 * g0 + c11 * g1 + c12 * g2)
        )
        w[o + 8 * WIDTH] = h + ((a80 * x + a81 * y) + (a86 * e + a87 * n) + (c20 * g0 + c21 * g1 + c22 * g2))


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
    w: Vector,
) -> None:
    """Covariance ``P`` (N, N) through ``dt`` seconds, in place.

    ``mid`` is the strapdown kernel's record of the interval, ``w_b`` and ``f_b`` (3,) what errors of the axes
    act on: the corrected rate, and the specific force less that at rest. ``par`` holds noise densities (from
    place P_Q). ``factor``
    multiplies the noise of velocity and phi, ``extra_v`` and ``extra_phi`` are added to it ((m/s)^2/s and
    rad^2/s). ``w`` is scratch of PREDICT_SIZE numbers or more. Twin of `predict_readable`.
    """
    n = P.shape[0]
    A = w[OUT + 9 * WIDTH : PREDICT_SIZE].reshape(9, 9)
    _nav_block(A, mid, dt)
    # Phi P
    for i in range(15):
        for c in range(n):
            w[WIDTH * i + c] = P[i, c]
    if n > BASIC:
        # an error of scale or axes acts as a bias of its size at this rate or force
        for k in range(3):
            g, f = WIDTH * (9 + k), WIDTH * (12 + k)
            for j in range(3):
                rate, force = w_b[j], f_b[j]
                a = BASIC + 3 * k + j
                for c in range(n):
                    w[g + c] += rate * P[a, c]
                    w[f + c] += force * P[a + 9, c]
    _carry(w, A, mid, dt, (n + 7) // 8 * 8)
    for c in range(9, n):
        for i in range(9):
            value = w[OUT + WIDTH * i + c]
            P[i, c] = value
            P[c, i] = value
    # (Phi P) Phi' in the corner: Phi once more, to the transpose
    for i in range(9):
        for k in range(15):
            w[WIDTH * k + i] = w[OUT + WIDTH * i + k]
    if n > BASIC:
        for i in range(9):
            for k in range(3):
                o = OUT + WIDTH * i + BASIC + 3 * k
                g, f = WIDTH * (9 + k) + i, WIDTH * (12 + k) + i
                for j in range(3):
                    w[g] += w_b[j] * w[o + j]
                    w[f] += f_b[j] * w[o + 9 + j]
    _carry(w, A, mid, dt, 16)
    for i in range(9):
        for j in range(i + 1):
            value = w[OUT + WIDTH * i + j]
            P[i, j] = value
            P[j, i] = value

    for c in range(9, n):
        P[c, c] += par[P_Q + c] * dt
    if n > FULL:
        keep = 1.0 - par[P_GNSS] * dt
        for i in range(FULL, RECEIVER):
            P[i, i] -= par[P_Q + i] * dt
        turn = mid[M_EN + 2] * dt
        if turn != 0.0:
            for c in range(n):
                a, b = P[FULL, c], P[FULL + 1, c]
                P[FULL, c], P[FULL + 1, c] = a + turn * b, b - turn * a
            for c in range(n):
                a, b = P[c, FULL], P[c, FULL + 1]
                P[c, FULL], P[c, FULL + 1] = a + turn * b, b - turn * a
        for i in range(FULL, RECEIVER):
            for c in range(n):
                P[i, c] *= keep
                P[c, i] *= keep
            P[i, i] += par[P_Q + i] * dt
    for i in range(3):
        P[i, i] += par[P_Q + i] * dt
        P[3 + i, 3 + i] += (par[P_Q + 3 + i] * factor + extra_v) * dt
        P[6 + i, 6 + i] += (par[P_Q + 6 + i] * factor + extra_phi) * dt


def feedback_readable(P: Matrix, gains: tuple[float, float, float], q: float, dt: float) -> Matrix:
    """Covariance (N, N) after ``dt`` seconds of feedback from an external height, N = 19 or more.

    ``gains`` k1, k2, k3 of `nav.strapdown.height`; ``q`` (m^2 s) is the density of the external height's
    white noise. Its slow error is the barometer bias: the difference fed back is in error by that of the
    height and that of the bias together.
    """
    k1, k2, k3 = gains
    feed = np.zeros(len(P))
    feed[2], feed[5] = -k1, -k2
    F = np.zeros_like(P)
    if len(P) > RECEIVER:
        feed[RECEIVER] = k3
        F[5, RECEIVER] = -1.0
    F[:, 2] += feed
    F[:, 18] += feed
    Phi = np.eye(len(P)) + F * dt
    return np.asarray(Phi @ P @ Phi.T + np.outer(feed, feed) * q * dt)


@kernel
def feedback(P: Matrix, k1: float, k2: float, k3: float, q: float, dt: float) -> None:
    """Covariance ``P`` through the feedback of a height channel, in place. Twin of `feedback_readable`."""
    n = P.shape[0]
    a, b, c = k1 * dt, k2 * dt, k3 * dt
    third = n > RECEIVER
    for k in range(n):
        s = P[2, k] + P[18, k]
        P[2, k] -= a * s
        P[5, k] -= b * s
        if third:
            P[5, k] -= dt * P[RECEIVER, k]
            P[RECEIVER, k] += c * s
    for k in range(n):
        s = P[k, 2] + P[k, 18]
        P[k, 2] -= a * s
        P[k, 5] -= b * s
        if third:
            P[k, 5] -= dt * P[k, RECEIVER]
            P[k, RECEIVER] += c * s
    # both triangles by sums in the same order but for rounding; one is enough
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
    r = q / dt
    P[2, 2] += a * a * r
    P[5, 5] += b * b * r
    P[2, 5] += a * b * r
    P[5, 2] += a * b * r
    if third:
        P[RECEIVER, RECEIVER] += c * c * r
        P[2, RECEIVER] -= a * c * r
        P[RECEIVER, 2] -= a * c * r
        P[5, RECEIVER] -= b * c * r
        P[RECEIVER, 5] -= b * c * r
