"""The fast twin of `nav.strapdown.mechanize`: scalars in registers, one state vector in place."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, curvature, gravity_north, normal_gravity, radii
from nav.jit import in_place, kernel
from nav.rotation import exponential, multiply
from nav.strapdown.coning import BEND, SLOPE, coefficient_table
from nav.strapdown.control import U_FREE, U_H, U_KH, U_KV, U_NORTH, U_TURN, U_V, U_WC

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


# Places of the navigation state at the head of a state vector.
X_Q: Final = 0  # q_nb, 4
X_V: Final = 4  # v_n, 3
X_C: Final = 7  # C_en by rows, 9
X_H: Final = 16  # height
X_A_H: Final = 17  # correction of the vertical acceleration by a third-order height channel, m/s^2
X_HEAD: Final = 18

# Places in the record of the middle of an interval, which the error model is taken at.
M_C: Final = 0  # C_nb by rows, 9
M_F: Final = 9  # mean specific force in n, 3
M_IE: Final = 12  # w_ie_n, 3
M_EN: Final = 15  # w_en_n, 3
M_K: Final = 18  # curvature xx, xy, yy
M_V: Final = 21  # v_n, 3
M_G: Final = 24  # 2 g / R
M_SIZE: Final = 25

_CONING: Final = coefficient_table()


@in_place
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    """Cross product a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@in_place
def _third_order(
    d: Vector, n: int, sx: float, sy: float, sz: float, vx: float, vy: float, vz: float
) -> tuple[float, float, float]:
    """Twin of `coning._third_order`; (sx, sy, sz) and (vx, vy, vz) are the sums of the samples in ``d``."""
    m, r = _CONING[n, SLOPE], _CONING[n, BEND]
    e, low, high = 3 * (n - 1), 3 * ((n - 1) // 2), 3 * (n // 2)
    ax, ay, az = (d[e] - d[0]) * m, (d[e + 1] - d[1]) * m, (d[e + 2] - d[2]) * m
    bx = (d[0] + d[e] - d[low] - d[high]) * r
    by = (d[1] + d[e + 1] - d[low + 1] - d[high + 1]) * r
    bz = (d[2] + d[e + 2] - d[low + 2] - d[high + 2]) * r
    o = 3 * n
    e, low, high = o + e, o + low, o + high
    ux, uy, uz = (d[e] - d[o]) * m, (d[e + 1] - d[o + 1]) * m, (d[e + 2] - d[o + 2]) * m
    wx = (d[o] + d[e] - d[low] - d[high]) * r
    wy = (d[o + 1] + d[e + 1] - d[low + 1] - d[high + 1]) * r
    wz = (d[o + 2] + d[e + 2] - d[low + 2] - d[high + 2]) * r
    # whole (s, v), slope (a, u), bend (b, w)
    cx, cy, cz = cross(sx, sy, sz, ax, ay, az)
    gx, gy, gz = cross(sx, sy, sz, ux, uy, uz)
    hx, hy, hz = cross(vx, vy, vz, ax, ay, az)
    lx, ly, lz = cross(cx, cy, cz, ux, uy, uz)
    kx, ky, kz = cross(gx + hx, gy + hy, gz + hz, ax, ay, az)
    lx, ly, lz = lx + kx, ly + ky, lz + kz
    cx, cy, cz = cross(sx, sy, sz, bx, by, bz)
    gx, gy, gz = cross(sx, sy, sz, wx, wy, wz)
    hx, hy, hz = cross(vx, vy, vz, bx, by, bz)
    kx, ky, kz = cross(sx, sy, sz, gx + hx, gy + hy, gz + hz)
    hx, hy, hz = cross(vx, vy, vz, cx, cy, cz)
    return lx / 240.0 + (kx + hx) / 360.0, ly / 240.0 + (ky + hy) / 360.0, lz / 240.0 + (kz + hz) / 360.0


@in_place
def increments(d: Vector, n: int, inc: Vector) -> None:
    """Rotation vector and velocity increment, ``inc`` (6,), of ``n`` = 1 to 6 samples.

    ``d`` (6 n,): n angle increments (3 each, rad), then n velocity increments (3 each, m/s). Twin of
    `coning.rotation_vector` and `coning.velocity_increment`.
    """
    e, f = 3 * (n - 1), 6 * n - 3
    bx, by, bz = d[e], d[e + 1], d[e + 2]
    wx, wy, wz = d[f], d[f + 1], d[f + 2]
    sx, sy, sz, vx, vy, vz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    cx, cy, cz, gx, gy, gz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n - 1):
        k = _CONING[n, n - 2 - i]
        o, p = 3 * i, 3 * (n + i)
        ax, ay, az = d[o], d[o + 1], d[o + 2]
        ux, uy, uz = d[p], d[p + 1], d[p + 2]
        sx, sy, sz = sx + ax, sy + ay, sz + az
        vx, vy, vz = vx + ux, vy + uy, vz + uz
        cx += k * (ay * bz - az * by)
        cy += k * (az * bx - ax * bz)
        cz += k * (ax * by - ay * bx)
        gx += k * ((ay * wz - az * wy) + (uy * bz - uz * by))
        gy += k * ((az * wx - ax * wz) + (uz * bx - ux * bz))
        gz += k * ((ax * wy - ay * wx) + (ux * by - uy * bx))
    px, py, pz = sx + bx + cx, sy + by + cy, sz + bz + cz
    vx, vy, vz = vx + wx + gx, vy + wy + gy, vz + wz + gz
    if n > 2:
        gx, gy, gz = _third_order(d, n, sx + bx, sy + by, sz + bz, vx - gx, vy - gy, vz - gz)
        vx, vy, vz = vx + gx, vy + gy, vz + gz
    a2 = px * px + py * py + pz * pz
    if a2 < 0.01:
        # series to the sixth power: truncation below 1e-14
        first = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0))
        second = (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0))) / 6.0
    else:
        a = math.sqrt(a2)
        first = (1.0 - math.cos(a)) / a2
        second = (1.0 - math.sin(a) / a) / a2
    tx, ty, tz = py * vz - pz * vy, pz * vx - px * vz, px * vy - py * vx
    inc[0], inc[1], inc[2] = px, py, pz
    inc[3] = vx + first * tx + second * (py * tz - pz * ty)
    inc[4] = vy + first * ty + second * (pz * tx - px * tz)
    inc[5] = vz + first * tz + second * (px * ty - py * tx)


@in_place
def rotate_columns(x: Vector, c: int, rx: float, ry: float, rz: float) -> None:
    """Multiply the matrix at ``x[c:c+9]`` (by rows) from the right by the rotation of a vector, rad."""
    w, i, j, k = exponential(rx, ry, rz)
    r00, r01, r02 = w * w + i * i - j * j - k * k, 2.0 * (i * j - w * k), 2.0 * (i * k + w * j)
    r10, r11, r12 = 2.0 * (i * j + w * k), w * w - i * i + j * j - k * k, 2.0 * (j * k - w * i)
    r20, r21, r22 = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i), w * w - i * i - j * j + k * k
    for row in range(3):
        o = c + 3 * row
        a0, a1, a2 = x[o], x[o + 1], x[o + 2]
        x[o] = a0 * r00 + a1 * r10 + a2 * r20
        x[o + 1] = a0 * r01 + a1 * r11 + a2 * r21
        x[o + 2] = a0 * r02 + a1 * r12 + a2 * r22
    # one step of C (3 I - C'C)/2 removes what rounding adds to the scale and the skew of the axes
    s00 = x[c] * x[c] + x[c + 3] * x[c + 3] + x[c + 6] * x[c + 6]
    s11 = x[c + 1] * x[c + 1] + x[c + 4] * x[c + 4] + x[c + 7] * x[c + 7]
    s22 = x[c + 2] * x[c + 2] + x[c + 5] * x[c + 5] + x[c + 8] * x[c + 8]
    s01 = x[c] * x[c + 1] + x[c + 3] * x[c + 4] + x[c + 6] * x[c + 7]
    s02 = x[c] * x[c + 2] + x[c + 3] * x[c + 5] + x[c + 6] * x[c + 8]
    s12 = x[c + 1] * x[c + 2] + x[c + 4] * x[c + 5] + x[c + 7] * x[c + 8]
    for row in range(3):
        o = c + 3 * row
        a0, a1, a2 = x[o], x[o + 1], x[o + 2]
        x[o] = 0.5 * (a0 * (3.0 - s00) - a1 * s01 - a2 * s02)
        x[o + 1] = 0.5 * (a1 * (3.0 - s11) - a0 * s01 - a2 * s12)
        x[o + 2] = 0.5 * (a2 * (3.0 - s22) - a0 * s02 - a1 * s12)


@in_place
def turn_attitude(x: Vector, px: float, py: float, pz: float, zx: float, zy: float, zz: float) -> None:
    """Turn the quaternion at the head of ``x`` by the rotation vectors of b, (px, py, pz), and of n, rad."""
    qw, qx, qy, qz = exponential(-zx, -zy, -zz)
    qw, qx, qy, qz = multiply(qw, qx, qy, qz, x[0], x[1], x[2], x[3])
    bw, bx, by, bz = exponential(px, py, pz)
    qw, qx, qy, qz = multiply(qw, qx, qy, qz, bw, bx, by, bz)
    norm = 1.0 / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    x[0], x[1], x[2], x[3] = qw * norm, qx * norm, qy * norm, qz * norm


@in_place
def vertical_rate(u: Vector, ex: float, ey: float, ez: float, tx: float, ty: float) -> float:
    """Vertical transport rate (rad/s) at polar axis (ex, ey, ez) in n with the level one (tx, ty).

    v_E/(R_N + h) is the part of the level rate about north. Twin of `mechanize.vertical_rate`.
    """
    rate = u[U_TURN] - u[U_FREE] * (EARTH_RATE * ez)
    if u[U_NORTH] != 0.0:
        rate += u[U_NORTH] * ez * (tx * ex + ty * ey) / (ex * ex + ey * ey)
    return float(rate)


@in_place
def strapdown(x: Vector, inc: Vector, dt: float, u: Vector, mid: Vector) -> None:
    """One navigation update of the state at the head of ``x`` (places X_), in place.

    ``inc`` (6,) of `increments` over ``dt`` seconds; ``u`` (U_SIZE,) the control vector. ``mid`` (M_SIZE,)
    receives what the error model needs. Twin of `mechanize.update`.
    """
    qw, qx, qy, qz = x[0], x[1], x[2], x[3]
    vx, vy, vz = x[4], x[5], x[6]
    px, py, pz, bx, by, bz = inc[0], inc[1], inc[2], inc[3], inc[4], inc[5]
    c00, c01, c02 = (
        qw * qw + qx * qx - qy * qy - qz * qz,
        2.0 * (qx * qy - qw * qz),
        2.0 * (qx * qz + qw * qy),
    )
    c10, c11, c12 = (
        2.0 * (qx * qy + qw * qz),
        qw * qw - qx * qx + qy * qy - qz * qz,
        2.0 * (qy * qz - qw * qx),
    )
    c20, c21, c22 = (
        2.0 * (qx * qz - qw * qy),
        2.0 * (qy * qz + qw * qx),
        qw * qw - qx * qx - qy * qy + qz * qz,
    )
    sx = c00 * bx + c01 * by + c02 * bz
    sy = c10 * bx + c11 * by + c12 * bz
    sz = c20 * bx + c21 * by + c22 * bz
    wcx, wcy, wcz = u[U_WC], u[U_WC + 1], u[U_WC + 2]
    ox, oy, oz, level, vertical = u[U_V], u[U_V + 1], u[U_V + 2], u[U_KV], u[U_KV + 1]
    h_ext, k1, k2, k3 = u[U_H], u[U_KH], u[U_KH + 1], u[U_KH + 2]

    # middle of the interval
    half = 0.5 * dt
    ex, ey, ez, h, a_h = x[13], x[14], x[15], x[16], x[17]
    kxx, kxy, kyy = curvature(ex, ey, ez, h)
    north = gravity_north(ez, 1.0, h)
    tx, ty = -kxy * vx - kyy * vy, kxx * vx + kxy * vy
    tz = vertical_rate(u, ex, ey, ez, tx, ty)
    ux = 2.0 * EARTH_RATE * ex + tx + wcx
    uy = 2.0 * EARTH_RATE * ey + ty + wcy
    uz = 2.0 * EARTH_RATE * ez + tz + wcz
    miss = h - h_ext
    fall = normal_gravity(ez, h) + vertical * (vz - oz) + k2 * miss + a_h
    mx = vx + 0.5 * (sx + (north * ex - (uy * vz - uz * vy) - level * (vx - ox)) * dt)
    my = vy + 0.5 * (sy + (north * ey - (uz * vx - ux * vz) - level * (vy - oy)) * dt)
    mz = vz + 0.5 * (sz - (fall + (ux * vy - uy * vx)) * dt)
    gx = ex - (ty * ez - tz * ey) * half
    gy = ey - (tz * ex - tx * ez) * half
    gz = ez - (tx * ey - ty * ex) * half
    h_mid = h + half * (mz - k1 * miss)
    a_mid = a_h + half * k3 * miss
    kxx, kxy, kyy = curvature(gx, gy, gz, h_mid)
    tx, ty = -kxy * mx - kyy * my, kxx * mx + kxy * my
    tz = vertical_rate(u, gx, gy, gz, tx, ty)
    ix, iy, iz = EARTH_RATE * gx, EARTH_RATE * gy, EARTH_RATE * gz
    north = gravity_north(gz, 1.0, h_mid)
    gravity = normal_gravity(gz, h_mid)
    miss = h_mid - h_ext

    # velocity
    zx, zy, zz = (ix + tx + wcx) * dt, (iy + ty + wcy) * dt, (iz + tz + wcz) * dt
    ux, uy, uz = 2.0 * ix + tx + wcx, 2.0 * iy + ty + wcy, 2.0 * iz + tz + wcz
    fx = sx - 0.5 * (zy * sz - zz * sy)
    fy = sy - 0.5 * (zz * sx - zx * sz)
    fz = sz - 0.5 * (zx * sy - zy * sx)
    fall = gravity + vertical * (mz - oz) + k2 * miss + a_mid
    nx = vx + fx + (north * gx - (uy * mz - uz * my) - level * (mx - ox)) * dt
    ny = vy + fy + (north * gy - (uz * mx - ux * mz) - level * (my - oy)) * dt
    nz = vz + fz + (-fall - (ux * my - uy * mx)) * dt

    # position
    ax, ay = 0.5 * (vx + nx), 0.5 * (vy + ny)
    h_new = h + (0.5 * (vz + nz) - k1 * miss) * dt
    h_mean = 0.5 * (h + h_new)
    kxx, kxy, kyy = curvature(gx, gy, gz, h_mean)
    tx, ty = -kxy * ax - kyy * ay, kxx * ax + kxy * ay
    tz = vertical_rate(u, gx, gy, gz, tx, ty)
    rotate_columns(x, X_C, tx * dt, ty * dt, tz * dt)
    x[4], x[5], x[6], x[16], x[17] = nx, ny, nz, h_new, a_h + k3 * miss * dt

    # attitude
    turn_attitude(x, px, py, pz, (ix + tx + wcx) * dt, (iy + ty + wcy) * dt, (iz + tz + wcz) * dt)

    # attitude in the middle: half the rotation vector is small enough for first order
    hx, hy, hz = 0.5 * px, 0.5 * py, 0.5 * pz
    mid[0], mid[1], mid[2] = c00 + c01 * hz - c02 * hy, c01 + c02 * hx - c00 * hz, c02 + c00 * hy - c01 * hx
    mid[3], mid[4], mid[5] = c10 + c11 * hz - c12 * hy, c11 + c12 * hx - c10 * hz, c12 + c10 * hy - c11 * hx
    mid[6], mid[7], mid[8] = c20 + c21 * hz - c22 * hy, c21 + c22 * hx - c20 * hz, c22 + c20 * hy - c21 * hx
    mid[9], mid[10], mid[11] = fx / dt, fy / dt, fz / dt
    mid[12], mid[13], mid[14] = ix, iy, iz
    mid[15], mid[16], mid[17] = tx, ty, tz
    mid[18], mid[19], mid[20] = kxx, kxy, kyy
    mid[21], mid[22], mid[23] = ax, ay, 0.5 * (vz + nz)
    r_m, r_n = radii(gz)
    mid[24] = 2.0 * gravity / (np.sqrt(r_m * r_n) + h_mid)


@in_place
def take(samples: Matrix, first: int, n: int, d: Vector) -> None:
    """Put ``n`` rows of ``samples`` (M, 6) into ``d`` (6 n,): angle increments, then velocity increments."""
    for i in range(n):
        for j in range(3):
            d[3 * i + j] = samples[first + i, j]
            d[3 * (n + i) + j] = samples[first + i, 3 + j]


@kernel
def integrate(
    x: Vector, samples: Matrix, dt_sample: float, n: int, u: Vector, every: int, out: Matrix
) -> int:
    """Navigate through ``samples`` (M, 6), ``n`` of them an update; returns the number of rows stored.

    A sample is an angle increment (rad) and a velocity increment (m/s) over ``dt_sample`` seconds; samples
    that do not fill an update are left. ``u`` (U_SIZE,) holds for all of them. After every ``every``-th
    update the head of ``x`` is stored in the next row of ``out`` (rows, X_HEAD), while there is one.
    """
    d = np.empty(6 * n)
    inc = np.empty(6)
    mid = np.empty(M_SIZE)
    rows = 0
    for k in range(samples.shape[0] // n):
        take(samples, k * n, n, d)
        increments(d, n, inc)
        strapdown(x, inc, n * dt_sample, u, mid)
        if (k + 1) % every == 0 and rows < out.shape[0]:
            for j in range(X_HEAD):
                out[rows, j] = x[j]
            rows += 1
    return rows
