"""Covariance through one navigation update: the sparse twin of ``Phi P Phi' + Q``.

Only position, velocity and misalignment move others, so only nine rows change by products; the rest
grows on the diagonal.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.filter.states import ALL, BASIC, FULL, P_GNSS, P_Q, RECEIVER, X_F, X_F0, X_W
from nav.jit import in_place
from nav.strapdown.kernels import M_C, M_EN, M_F, M_G, M_IE, M_K, M_V

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_WIDTH: Final = 48
"""Length of a row of scratch: a multiple of what a processor takes at once, ALL or more."""
"""Length of a row of scratch: a multiple of what a processor takes at once, ALL or more."""
_PHI: Final = 9 * _WIDTH
"""Where ``F dt`` of position, velocity and phi lies in scratch, 9 rows of 9, behind the products."""
PREDICT_SIZE: Final = _PHI + 81


def predict_readable(P: Matrix, F: Matrix, q: Vector, dt: float) -> Matrix:
    """Covariance (N, N) after ``dt`` seconds: ``Phi = I + F dt``, ``Q = diag(q) dt``.

    ``F`` (N, N) of `nav.errors.model`, ``q`` (N,) noise densities. Groves, eq. (3.46).
    """
    Phi = np.eye(len(P)) + F * dt
    return np.asarray(Phi @ P @ Phi.T + np.diag(q) * dt)


@in_place
def nav_block(w: Vector, place: int, mid: Vector, dt: float) -> None:
    """Put F dt of position, velocity and phi, 9 rows of 9, at ``place`` into ``w``, but for its zeros.

    ``mid`` is the strapdown kernel's record; see `nav.errors.model`.
    """
    kxx, kxy, kyy = mid[M_K] * dt, mid[M_K + 1] * dt, mid[M_K + 2] * dt
    mean = 0.5 * (kxx + kyy)
    ix, iy, iz = mid[M_IE], mid[M_IE + 1], mid[M_IE + 2]
    tx, ty, tz = mid[M_EN], mid[M_EN + 1], mid[M_EN + 2]
    vx, vy, vz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
    turn = tz * dt
    fx, fy, fz = mid[M_F] * dt, mid[M_F + 1] * dt, mid[M_F + 2] * dt
    x, y, z = place, place + 9, place + 18  # rows of position
    w[x], w[x + 1], w[x + 2], w[x + 3] = mean * vz, turn, -mean * vx, dt
    w[y], w[y + 1], w[y + 2], w[y + 4] = -turn, mean * vz, -mean * vy, dt
    w[z + 5] = dt

    # rows of dw_ie (i) over level position, then dw_in (a) with the transport part
    i00, i01 = -iz * kxx, -iz * kxy
    i10, i11 = -iz * kxy, -iz * kyy
    i20, i21 = ix * kxx + iy * kxy, ix * kxy + iy * kyy
    a02, a12 = -mean * tx, -mean * ty
    a20, a21 = i20 + tx * kxx + ty * kxy, i21 + tx * kxy + ty * kyy
    wx, wy, wz = (ix + tx) * dt, (iy + ty) * dt, (iz + tz) * dt
    x, y, z = place + 54, place + 63, place + 72  # rows of phi
    w[x], w[x + 1], w[x + 2], w[x + 3], w[x + 4] = i00, i01, a02, -kxy, -kyy
    w[y], w[y + 1], w[y + 2], w[y + 3], w[y + 4] = i10, i11, a12, kxx, kxy
    w[z], w[z + 1] = a20, a21
    w[x + 7], w[x + 8] = wz, -wy
    w[y + 6], w[y + 8] = -wz, wx
    w[z + 6], w[z + 7] = wy, -wx

    # velocity: v x (2 dw_ie + dw_en)
    g00, g01 = 2.0 * i00, 2.0 * i01
    g10, g11 = 2.0 * i10, 2.0 * i11
    g20, g21 = i20 + a20, i21 + a21
    x, y, z = place + 27, place + 36, place + 45  # rows of velocity
    w[x], w[x + 1], w[x + 2] = vy * g20 - vz * g10, vy * g21 - vz * g11, -vz * a12
    w[y], w[y + 1], w[y + 2] = vz * g00 - vx * g20, vz * g01 - vx * g21, vz * a02
    w[z], w[z + 1] = vx * g10 - vy * g00, vx * g11 - vy * g01
    w[z + 2] = vx * a12 - vy * a02 + mid[M_G] * dt
    cx, cy, cz = (2.0 * ix + tx) * dt, (2.0 * iy + ty) * dt, (2.0 * iz + tz) * dt
    w[x + 3], w[x + 4], w[x + 5] = -vz * kxx, cz - vz * kxy, -cy
    w[y + 3], w[y + 4], w[y + 5] = -cz - vz * kxy, -vz * kyy, cx
    w[z + 3], w[z + 4] = cy + vx * kxx + vy * kxy, -cx + vx * kxy + vy * kyy
    w[x + 7], w[x + 8] = -fz, fy
    w[y + 6], w[y + 8] = fz, -fx
    w[z + 6], w[z + 7] = -fy, fx


@in_place
def _carry(P: Matrix, x: Vector, mid: Vector, dt: float, w: Vector, n: int, columns: int) -> None:
    """Rows at the head of ``w`` become the first nine of Phi times ``P`` (n, n), over ``columns``.

    The elements of Phi that are always zero are left out. Everything a column needs is one expression over
    rows of equal length, so that the compiler takes several columns at once; behind the last column of a row
    it may take the first ones of the next.
    """
    if P.shape[1] != n:  # never; but now the compiler knows how far apart the rows are
        return
    o = _PHI
    a00, a01, a02, a10, a11, a12 = w[o], w[o + 1], w[o + 2], w[o + 9], w[o + 10], w[o + 11]
    o = _PHI + 27
    a30, a31, a32, a33, a34 = w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4]
    a35, a37, a38 = w[o + 5], w[o + 7], w[o + 8]
    o = _PHI + 36
    a40, a41, a42, a43, a44 = w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4]
    a45, a46, a48 = w[o + 5], w[o + 6], w[o + 8]
    o = _PHI + 45
    a50, a51, a52, a53, a54, a56, a57 = w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 6], w[o + 7]
    o = _PHI + 54
    a60, a61, a62, a63, a64, a67, a68 = w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 7], w[o + 8]
    o = _PHI + 63
    a70, a71, a72, a73, a74, a76, a78 = w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 6], w[o + 8]
    o = _PHI + 72
    a80, a81, a86, a87 = w[o], w[o + 1], w[o + 6], w[o + 7]
    c00, c01, c02 = mid[M_C] * dt, mid[M_C + 1] * dt, mid[M_C + 2] * dt
    c10, c11, c12 = mid[M_C + 3] * dt, mid[M_C + 4] * dt, mid[M_C + 5] * dt
    c20, c21, c22 = mid[M_C + 6] * dt, mid[M_C + 7] * dt, mid[M_C + 8] * dt
    w0, w1, w2 = x[X_W], x[X_W + 1], x[X_W + 2]
    b0, b1, b2 = x[X_F] - x[X_F0], x[X_F + 1] - x[X_F0 + 1], x[X_F + 2] - x[X_F0 + 2]
    for c in range(columns):
        p, q, r = P[0, c], P[1, c], P[2, c]
        u, v, s = P[3, c], P[4, c], P[5, c]
        e, m, h = P[6, c], P[7, c], P[8, c]
        g0, g1, g2 = P[9, c], P[10, c], P[11, c]
        f0, f1, f2 = P[12, c], P[13, c], P[14, c]
        if n > BASIC:
            # an error of scale or axes acts as a bias of its size at this rate or force
            g0 = g0 + w0 * P[19, c] + w1 * P[20, c] + w2 * P[21, c]
            g1 = g1 + w0 * P[22, c] + w1 * P[23, c] + w2 * P[24, c]
            g2 = g2 + w0 * P[25, c] + w1 * P[26, c] + w2 * P[27, c]
            f0 = f0 + b0 * P[28, c] + b1 * P[29, c] + b2 * P[30, c]
            f1 = f1 + b0 * P[31, c] + b1 * P[32, c] + b2 * P[33, c]
            f2 = f2 + b0 * P[34, c] + b1 * P[35, c] + b2 * P[36, c]
        w[c] = p + (a00 * p + a01 * q + a02 * r + dt * u)
        w[_WIDTH + c] = q + (a10 * p + a11 * q + a12 * r + dt * v)
        w[2 * _WIDTH + c] = r + dt * s
        w[3 * _WIDTH + c] = u + (
            (a30 * p + a31 * q + a32 * r)
            + (a33 * u + a34 * v + a35 * s)
            + (a37 * m + a38 * h)
            - (c00 * f0 + c01 * f1 + c02 * f2)
        )
        w[4 * _WIDTH + c] = v + (
            (a40 * p + a41 * q + a42 * r)
            + (a43 * u + a44 * v + a45 * s)
            + (a46 * e + a48 * h)
            - (c10 * f0 + c11 * f1 + c12 * f2)
        )
        w[5 * _WIDTH + c] = s + (
            (a50 * p + a51 * q + a52 * r)
            + (a53 * u + a54 * v)
            + (a56 * e + a57 * m)
            - (c20 * f0 + c21 * f1 + c22 * f2)
        )
        w[6 * _WIDTH + c] = e + (
            (a60 * p + a61 * q + a62 * r)
            + (a63 * u + a64 * v)
            + (a67 * m + a68 * h)
            + (c00 * g0 + c01 * g1 + c02 * g2)
        )
        w[7 * _WIDTH + c] = m + (
            (a70 * p + a71 * q + a72 * r)
            + (a73 * u + a74 * v)
            + (a76 * e + a78 * h)
            + (c10 * g0 + c11 * g1 + c12 * g2)
        )
        w[8 * _WIDTH + c] = h + ((a80 * p + a81 * q) + (a86 * e + a87 * m) + (c20 * g0 + c21 * g1 + c22 * g2))


@in_place
def _through(P: Matrix, x: Vector, mid: Vector, dt: float, w: Vector, n: int) -> None:
    """``Phi P Phi'`` in place, for an ``n`` that the compiler knows."""
    last = 14 if n == BASIC else 36  # row that is read
    _carry(P, x, mid, dt, w, n, min((n + 7) // 8 * 8, (n - last) * n))
    for i in range(9):
        for c in range(9, n):
            P[i, c] = w[_WIDTH * i + c]
    for c in range(n):
        for i in range(9):
            P[c, i] = w[_WIDTH * i + c]
    # the columns hold the transpose of Phi P now, and the corner wants Phi once more
    _carry(P, x, mid, dt, w, n, 16)
    for i in range(9):
        for j in range(i + 1):
            value = w[_WIDTH * i + j]
            P[i, j] = value
            P[j, i] = value


@in_place
def predict(
    P: Matrix,
    mid: Vector,
    x: Vector,
    dt: float,
    par: Vector,
    factor: float,
    extra_v: float,
    extra_phi: float,
    w: Vector,
) -> None:
    """Covariance ``P`` (N, N) through ``dt`` seconds, in place; N is BASIC, FULL, RECEIVER or ALL.

    ``mid`` is the strapdown kernel's record of the interval, ``x`` (X_SIZE,) holds what errors of the axes
    act on: the corrected rate, and the specific force less that at rest. ``par`` holds noise densities
    (from place P_Q). ``factor`` multiplies the noise of velocity and phi, ``extra_v`` and ``extra_phi`` are
    added to it ((m/s)^2/s and rad^2/s). ``w`` is scratch of PREDICT_SIZE numbers or more. Twin of
    `predict_readable`.
    """
    n = P.shape[0]
    nav_block(w, _PHI, mid, dt)
    # one compiled form for each size
    if n == BASIC:
        _through(P, x, mid, dt, w, BASIC)
    elif n == FULL:
        _through(P, x, mid, dt, w, FULL)
    elif n == RECEIVER:
        _through(P, x, mid, dt, w, RECEIVER)
    else:
        _through(P, x, mid, dt, w, ALL)

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


@in_place
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
