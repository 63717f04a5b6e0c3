"""One navigation update with its covariance, and the solution row: the hot kernels."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, gravity_north, normal_gravity
from nav.filter.covariance import PREDICT_SIZE, feedback, predict
from nav.filter.motion import carry_tick, eb_rate, lose_path, place_beside, take_rate, times, undo_axes
from nav.filter.states import (
    P_GAP_A,
    P_GAP_W,
    P_GNSS,
    P_LO,
    P_LP,
    P_U,
    P_VIB_A,
    P_VIB_G,
    X_A,
    X_BA,
    X_BB,
    X_BG,
    X_F,
    X_F0,
    X_GB,
    X_KO,
    X_MA,
    X_MG,
    X_PATH,
    X_PT,
    X_Q0,
    X_QV,
    X_ROLL,
    X_W,
)
from nav.jit import in_place
from nav.rotation import logarithm, multiply, rotate
from nav.strapdown.coning import MOST_SAMPLES
from nav.strapdown.control import U_H, U_KH, U_SIZE
from nav.strapdown.kernels import (
    M_C,
    M_EN,
    M_IE,
    M_SIZE,
    M_V,
    X_C,
    X_H,
    X_Q,
    X_V,
    increments,
    strapdown,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Places in a row of the increment ring.
ROW_DT: Final = 0  # s, over all samples
ROW_GAP: Final = 1  # s of silence that this interval is part of; 0: it was measured
ROW_NOISE: Final = 2  # factor on the noise densities of velocity and phi
ROW_H: Final = 3  # external height for the height channel, m
ROW_H_AGE: Final = 4  # and how long before the middle of the row it was measured, s
ROW_H_Q: Final = 5  # and the density of its noise, m^2 s; negative: there is none
ROW_N: Final = 6  # samples in this row
ROW_WALK: Final = 7  # further densities of noise in b, (3, 3) of phi, then of velocity
ROW_D: Final = 25  # angle increments of all samples, then velocity increments


def row_size(samples: int) -> int:
    """Length of a row for up to ``samples`` samples an update."""
    return ROW_D + 6 * samples


REST_SIZE: Final = 14

# Places in the scratch, behind that of `predict`.
_D: Final = PREDICT_SIZE  # samples without biases, 6 * MOST_SAMPLES
_U: Final = _D + 6 * MOST_SAMPLES  # control vector
_INC: Final = _U + U_SIZE  # what the samples add up to, 6
_AXES: Final = _INC + 6  # what takes errors of scale and axes out, of gyros and accelerometers, 18
WORK_MID: Final = _AXES + 18  # record of the middle of the update, M_SIZE
WORK_SIZE: Final = WORK_MID + M_SIZE
"""Length of the scratch vector that the kernels share."""


@in_place
def _add_vibration(P: Matrix, mid: Vector, gyro: float, accel: float, row: Vector) -> None:
    """Add to ``P`` what aliased vibration does to attitude and velocity over one row, axis by axis of b.

    Increments made from samples of a rate that shakes faster than half the sampling rate are noise whose
    variance the shaking itself shows: two neighbours with independent errors of variance s^2 differ by
    2 s^2 in the mean square, and the sum of n has n s^2. One sample alone shows nothing.
    """
    n = int(row[ROW_N])
    if n < 2:
        return
    scale = n / (2.0 * (n - 1))
    for k in range(3):
        a, v = 0.0, 0.0
        for i in range(n - 1):
            o = ROW_D + 3 * i + k
            p = o + 3 * n
            a += (row[o + 3] - row[o]) ** 2
            v += (row[p + 3] - row[p]) ** 2
        a, v = gyro * scale * a, accel * scale * v
        for i in range(3):
            ci = mid[M_C + 3 * i + k]
            for j in range(3):
                c = ci * mid[M_C + 3 * j + k]
                P[6 + i, 6 + j] += c * a
                P[3 + i, 3 + j] += c * v


@in_place
def _add_walk(P: Matrix, mid: Vector, row: Vector) -> None:
    """Add to ``P`` what the noise of a row is in b beyond that of the states: C W C^T dt."""
    for kind in range(2):
        w, o = ROW_WALK + 9 * kind, 6 - 3 * kind
        if row[w] + row[w + 4] + row[w + 8] == 0.0:
            continue
        for i in range(3):
            c = M_C + 3 * i
            for k in range(3):
                m = mid[c] * row[w + k] + mid[c + 1] * row[w + 3 + k] + mid[c + 2] * row[w + 6 + k]
                for j in range(3):
                    P[o + i, o + j] += m * mid[M_C + 3 * j + k] * row[ROW_DT]


@in_place
def propagate(x: Vector, P: Matrix, par: Vector, work: Vector, row: Vector) -> None:
    """Nominal state ``x`` and covariance ``P`` through one row of the increment ring, in place.

    A row (see ROW_) holds raw increments of its samples, duration, gap and noise factor. Biases and
    scale factors are taken out here. Over a gap the vehicle is taken to keep velocity and attitude, with the
    uncertainty of the rates and accelerations that may have passed.
    """
    dt = row[ROW_DT]
    n = int(row[ROW_N])
    d = work[_D : _D + 6 * MOST_SAMPLES]
    u = work[_U : _U + U_SIZE]
    inc = work[_INC : _INC + 6]
    mid = work[WORK_MID : WORK_MID + M_SIZE]
    if row[ROW_GAP] != 0.0:
        n = 1
        ex, ey, ez, h = x[X_C + 6], x[X_C + 7], x[X_C + 8], x[X_H]
        north = gravity_north(ez, 1.0, h)
        wx, wy, wz = rotate(x[0], -x[1], -x[2], -x[3], EARTH_RATE * ex, EARTH_RATE * ey, EARTH_RATE * ez)
        ax, ay, az = rotate(x[0], -x[1], -x[2], -x[3], -north * ex, -north * ey, normal_gravity(ez, h))
        extra_v = par[P_GAP_A] * par[P_GAP_A] * row[ROW_GAP]
        extra_phi = par[P_GAP_W] * par[P_GAP_W] * row[ROW_GAP]
        sx, sy, sz = wx * dt, wy * dt, wz * dt
        tx, ty, tz = ax * dt, ay * dt, az * dt
        d[0], d[1], d[2], d[3], d[4], d[5] = sx, sy, sz, tx, ty, tz
    else:
        part = dt / n
        g, f = work[_AXES : _AXES + 9], work[_AXES + 9 : _AXES + 18]
        undo_axes(x, X_MG, g)
        undo_axes(x, X_MA, f)
        wx, wy, wz = x[X_BG] * part, x[X_BG + 1] * part, x[X_BG + 2] * part
        # the bias holds what the axes make of the force at rest
        rx, ry, rz = x[X_F0], x[X_F0 + 1], x[X_F0 + 2]
        ax = (x[X_BA] - x[X_MA] * rx - x[X_MA + 1] * ry - x[X_MA + 2] * rz) * part
        ay = (x[X_BA + 1] - x[X_MA + 3] * rx - x[X_MA + 4] * ry - x[X_MA + 5] * rz) * part
        az = (x[X_BA + 2] - x[X_MA + 6] * rx - x[X_MA + 7] * ry - x[X_MA + 8] * rz) * part
        sx, sy, sz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            o, p = 3 * k, 3 * (n + k)
            bx, by, bz = row[ROW_D + o] - wx, row[ROW_D + o + 1] - wy, row[ROW_D + o + 2] - wz
            bx, by, bz = times(g, bx, by, bz)
            d[o], d[o + 1], d[o + 2] = bx, by, bz
            sx, sy, sz = sx + bx, sy + by, sz + bz
            bx, by, bz = row[ROW_D + p] - ax, row[ROW_D + p + 1] - ay, row[ROW_D + p + 2] - az
            bx, by, bz = times(f, bx, by, bz)
            d[p], d[p + 1], d[p + 2] = bx, by, bz
            tx, ty, tz = tx + bx, ty + by, tz + bz
        extra_v = 0.0
        extra_phi = 0.0
    for i in range(U_SIZE):
        u[i] = par[P_U + i]
    fed = row[ROW_H_Q] >= 0.0
    if fed:
        u[U_H] = row[ROW_H] + row[ROW_H_AGE] * x[X_V + 2] - x[X_BB]
    else:
        for i in range(3):
            u[U_KH + i] = 0.0
    vx, vy, vz = x[X_V], x[X_V + 1], x[X_V + 2]
    increments(d, n, inc)
    strapdown(x, inc, dt, u, mid)
    take_rate(x, sx / dt, sy / dt, sz / dt, dt, row[ROW_GAP] == 0.0)
    x[X_F], x[X_F + 1], x[X_F + 2] = tx / dt, ty / dt, tz / dt
    x[X_A], x[X_A + 1], x[X_A + 2] = (x[X_V] - vx) / dt, (x[X_V + 1] - vy) / dt, (x[X_V + 2] - vz) / dt

    # path of the odometer point in v
    c0, c1, c2, c3, c4 = mid[M_C], mid[M_C + 1], mid[M_C + 2], mid[M_C + 3], mid[M_C + 4]
    c5, c6, c7, c8 = mid[M_C + 5], mid[M_C + 6], mid[M_C + 7], mid[M_C + 8]
    ux, uy, uz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
    ix, iy, iz = mid[M_IE] + mid[M_EN], mid[M_IE + 1] + mid[M_EN + 1], mid[M_IE + 2] + mid[M_EN + 2]
    wx = x[X_W] - (c0 * ix + c3 * iy + c6 * iz)
    wy = x[X_W + 1] - (c1 * ix + c4 * iy + c7 * iz)
    wz = x[X_W + 2] - (c2 * ix + c5 * iy + c8 * iz)
    lx, ly, lz = par[P_LO], par[P_LO + 1], par[P_LO + 2]
    bx = c0 * ux + c3 * uy + c6 * uz + wy * lz - wz * ly
    by = c1 * ux + c4 * uy + c7 * uz + wz * lx - wx * lz
    bz = c2 * ux + c5 * uy + c8 * uz + wx * ly - wy * lx
    bx, by, bz = rotate(x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3], bx, by, bz)
    x[X_PATH] += bx * dt
    x[X_PATH + 1] += by * dt
    x[X_PATH + 2] += bz * dt
    x[X_PT] += dt

    carry_tick(x, mid, dt)
    if row[ROW_GAP] != 0.0:
        lose_path(x)

    # the receiver's error is kept in n, which may turn about the vertical
    keep = 1.0 - par[P_GNSS] * dt
    turn = mid[M_EN + 2] * dt
    gx, gy = x[X_GB], x[X_GB + 1]
    x[X_GB], x[X_GB + 1] = keep * (gx + turn * gy), keep * (gy - turn * gx)
    x[X_GB + 2] *= keep

    predict(P, mid, x, dt, par, row[ROW_NOISE], extra_v, extra_phi, work)
    if fed:
        feedback(P, u[U_KH], u[U_KH + 1], u[U_KH + 2], row[ROW_H_Q], dt)
    _add_walk(P, mid, row)
    if row[ROW_GAP] == 0.0 and (par[P_VIB_G] > 0.0 or par[P_VIB_A] > 0.0):
        _add_vibration(P, mid, par[P_VIB_G], par[P_VIB_A], row)


@in_place
def replay(
    x: Vector,
    P: Matrix,
    par: Vector,
    work: Vector,
    ring: Matrix,
    times: NDArray[np.int64],
    first: int,
    last: int,
    stop_ns: int,
) -> int:
    """Propagate through updates ``first + 1`` to ``last`` of the ring; returns the update reached.

    Stops early at the first update whose time in ``times`` is not before ``stop_ns``.
    """
    capacity = ring.shape[0]
    u = first
    while u < last:
        u += 1
        propagate(x, P, par, work, ring[u % capacity])
        if times[u % capacity] >= stop_ns:
            break
    return u


@in_place
def _sigma(P: Matrix, first: int, a: float, b: float, c: float) -> float:
    """Standard deviation of a combination (a, b, c) of three neighbouring states."""
    i, j, k = first, first + 1, first + 2
    v = a * a * P[i, i] + b * b * P[j, j] + c * c * P[k, k]
    v += 2.0 * (a * b * P[i, j] + a * c * P[i, k] + b * c * P[j, k])
    return float(np.sqrt(max(v, 0.0)))


@in_place
def solution_row(x: Vector, P: Matrix, par: Vector, out: Vector) -> bool:
    """Fill ``out`` (S.SIZE,) with the solution of the output point in vehicle axes, layout `nav.types.S`.

    Returns False when anything in it is not finite.
    """
    qw, qx, qy, qz = x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    ex, ey, ez = x[X_C + 6], x[X_C + 7], x[X_C + 8]
    height = x[X_H]
    vx, vy, vz = x[X_V], x[X_V + 1], x[X_V + 2]
    px, py, pz = par[P_LP], par[P_LP + 1], par[P_LP + 2]
    ax, ay, az = 0.0, 0.0, 0.0
    ux, uy, uz = 0.0, 0.0, 0.0
    if px != 0.0 or py != 0.0 or pz != 0.0:
        ax, ay, az = rotate(qw, qx, qy, qz, px, py, pz)
        wx, wy, wz = eb_rate(x, 0.0)
        ux, uy, uz = rotate(qw, qx, qy, qz, wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px)
        vx, vy, vz = vx + ux, vy + uy, vz + uz
        height += az
    ex, ey, up_x, up_y, up_z = place_beside(x, ax, ay)
    lat = np.arctan2(up_z, np.hypot(up_x, up_y))
    lon = np.arctan2(up_y, up_x)
    # sine and cosine of wander; at a pole any azimuth will do
    cos_lat = np.hypot(ex, ey)
    sa, ca = (ex / cos_lat, ey / cos_lat) if cos_lat > 1e-14 else (0.0, 1.0)
    out[0], out[1], out[2] = lat, lon, height
    out[3], out[4], out[5] = ca * vx - sa * vy, sa * vx + ca * vy, vz

    vw, vi, vj, vk = x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3]
    nw, ni, nj, nk = multiply(qw, qx, qy, qz, vw, -vi, -vj, -vk)
    # q_gn is the turn by wander about up
    half_c = np.sqrt(max(0.0, 0.5 * (1.0 + ca)))
    half_s = 0.5 * sa / half_c if half_c > 1e-8 else 1.0
    gw, gi, gj, gk = multiply(half_c, 0.0, 0.0, half_s, nw, ni, nj, nk)
    norm = 1.0 / np.sqrt(gw * gw + gi * gi + gj * gj + gk * gk)
    if gw < 0.0:
        norm = -norm
    out[6], out[7], out[8], out[9] = gw * norm, gi * norm, gj * norm, gk * norm
    out[10], out[11], out[12] = rotate(vw, vi, vj, vk, x[X_W], x[X_W + 1], x[X_W + 2])
    out[13], out[14], out[15] = rotate(vw, vi, vj, vk, x[X_F], x[X_F + 1], x[X_F + 2])

    # sigmas east, north, up of the output point: position and velocity with the lever arm's share of
    # phi, attitude with the mounting's share
    m0x, m0y, m0z = rotate(nw, ni, nj, nk, 1.0, 0.0, 0.0)
    m1x, m1y, m1z = rotate(nw, ni, nj, nk, 0.0, 0.0, 1.0)
    rx, ry, rz = rotate(nw, ni, nj, nk, 0.0, 1.0, 0.0)
    for axis in range(3):
        ex, ey, ez = 0.0, 0.0, 1.0
        if axis == 0:
            ex, ey, ez = ca, -sa, 0.0
        elif axis == 1:
            ex, ey, ez = sa, ca, 0.0
        for kind in range(2):
            o = 3 * kind
            lx, ly, lz = (ax, ay, az) if kind == 0 else (ux, uy, uz)
            # e . (dp + l x phi) = e . dp + (e x l) . phi
            hx, hy, hz = ey * lz - ez * ly, ez * lx - ex * lz, ex * ly - ey * lx
            s = _sigma(P, o, ex, ey, ez) ** 2
            for i in range(3):
                e, h = (ex, hx) if i == 0 else ((ey, hy) if i == 1 else (ez, hz))
                s += 2.0 * e * hx * P[o + i, 6] + h * hx * P[6 + i, 6]
                s += 2.0 * e * hy * P[o + i, 7] + h * hy * P[6 + i, 7]
                s += 2.0 * e * hz * P[o + i, 8] + h * hz * P[6 + i, 8]
            out[16 + o + axis] = np.sqrt(max(s, 0.0))
        s = _sigma(P, 6, ex, ey, ez) ** 2
        s += (ex * rx + ey * ry + ez * rz) ** 2 * x[X_ROLL]
        a, b = ex * m0x + ey * m0y + ez * m0z, ex * m1x + ey * m1y + ez * m1z
        s += a * a * P[16, 16] + 2.0 * a * b * P[16, 17] + b * b * P[17, 17]
        for i in range(3):
            e = ex if i == 0 else (ey if i == 1 else ez)
            s -= 2.0 * e * (a * P[6 + i, 16] + b * P[6 + i, 17])
        out[22 + axis] = np.sqrt(max(s, 0.0))
    for i in range(3):
        out[25 + i] = x[X_BG + i]
        out[28 + i] = x[X_BA + i]
        out[35 + i] = np.sqrt(max(P[9 + i, 9 + i], 0.0))
        out[38 + i] = np.sqrt(max(P[12 + i, 12 + i], 0.0))
    out[31] = x[X_KO]
    dw, di, dj, dk = multiply(vw, vi, vj, vk, x[X_Q0], -x[X_Q0 + 1], -x[X_Q0 + 2], -x[X_Q0 + 3])
    pitch, _, left = logarithm(dw, di, dj, dk)
    out[32], out[33] = pitch, -left
    out[34] = x[X_BB]
    out[41] = np.sqrt(max(P[15, 15], 0.0))
    out[42] = np.sqrt(max(P[16, 16], 0.0))
    out[43] = np.sqrt(max(P[17, 17], 0.0))
    out[44] = np.sqrt(max(P[18, 18], 0.0))
    total = 0.0
    for i in range(45):
        total += out[i]
    for i in range(P.shape[0]):
        total += P[i, i]
    return bool(np.isfinite(total))


@in_place
def advance(x: Vector, P: Matrix, par: Vector, work: Vector, row: Vector, rest: Vector, out: Vector) -> bool:
    """Propagate through the samples in ``row``, fill ``out``; False when not finite.

    ``rest`` (REST_SIZE,) gathers sums for the detection of standstill: duration, updates, increments of
    angle and velocity (3 + 3), sums of squared rates and specific forces (3 + 3).
    """
    dt = row[ROW_DT]
    n = int(row[ROW_N])
    rest[0] += dt
    rest[1] += 1.0
    for i in range(3):
        a, v = 0.0, 0.0
        for k in range(n):
            a += row[ROW_D + 3 * k + i]
            v += row[ROW_D + 3 * (n + k) + i]
        rest[2 + i] += a
        rest[5 + i] += v
        rest[8 + i] += a * a / (dt * dt)
        rest[11 + i] += v * v / (dt * dt)
    propagate(x, P, par, work, row)
    return solution_row(x, P, par, out)
