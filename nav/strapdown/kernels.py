"""The fast twin of `nav.strapdown.mechanize`: scalars in registers, one state vector in place."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, curvature, gravity_north, normal_gravity, radii
from nav.jit import kernel
from nav.rotation import exponential, multiply
from nav.strapdown.coning import TWO_SAMPLE

Vector = NDArray[np.float64]


# Places of the navigation state at the head of a state vector.
X_Q: Final = 0  # q_nb, 4
X_V: Final = 4  # v_n, 3
X_C: Final = 7  # C_en by rows, 9
X_H: Final = 16  # height

# Places in the record of the middle of an interval, which the error model is taken at.
M_C: Final = 0  # C_nb by rows, 9
M_F: Final = 9  # mean specific force in n, 3
M_IE: Final = 12  # w_ie_n, 3
M_EN: Final = 15  # w_en_n, 3
M_K: Final = 18  # curvature xx, xy, yy
M_V: Final = 21  # v_n, 3
M_G: Final = 24  # 2 g / R
M_SIZE: Final = 25


@kernel
def two_sample(d: Vector) -> tuple[float, float, float, float, float, float]:
    """Rotation vector and velocity increment of ``d`` (12,): dtheta 1, dtheta 2, dv 1, dv 2.

    Twin of `coning.rotation_vector` and `coning.velocity_increment`.
    """
    ax, ay, az, bx, by, bz = d[0], d[1], d[2], d[3], d[4], d[5]
    ux, uy, uz, wx, wy, wz = d[6], d[7], d[8], d[9], d[10], d[11]
    px = ax + bx + TWO_SAMPLE * (ay * bz - az * by)
    py = ay + by + TWO_SAMPLE * (az * bx - ax * bz)
    pz = az + bz + TWO_SAMPLE * (ax * by - ay * bx)
    sx, sy, sz = ax + bx, ay + by, az + bz
    vx, vy, vz = ux + wx, uy + wy, uz + wz
    cx = (ay * wz - az * wy) + (uy * bz - uz * by)
    cy = (az * wx - ax * wz) + (uz * bx - ux * bz)
    cz = (ax * wy - ay * wx) + (ux * by - uy * bx)
    return (
        px,
        py,
        pz,
        vx + 0.5 * (sy * vz - sz * vy) + TWO_SAMPLE * cx,
        vy + 0.5 * (sz * vx - sx * vz) + TWO_SAMPLE * cy,
        vz + 0.5 * (sx * vy - sy * vx) + TWO_SAMPLE * cz,
    )


@kernel
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


@kernel
def strapdown(x: Vector, d: Vector, dt: float, mid: Vector) -> None:
    """One navigation update of the state at the head of ``x`` (places X_), in place.

    ``d`` (12,) as in `two_sample`, ``dt`` seconds over both samples. ``mid`` (M_SIZE,) receives what
    the error model needs. Twin of `mechanize.update`.
    """
    qw, qx, qy, qz = x[0], x[1], x[2], x[3]
    vx, vy, vz = x[4], x[5], x[6]
    px, py, pz, bx, by, bz = two_sample(d)
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

    # middle of the interval
    ex, ey, ez, h = x[13], x[14], x[15], x[16]
    kxx, kxy, kyy = curvature(ex, ey, ez, h)
    north = gravity_north(ez, 1.0, h)
    mx = vx + 0.5 * (sx + north * ex * dt)
    my = vy + 0.5 * (sy + north * ey * dt)
    mz = vz + 0.5 * (sz - normal_gravity(ez, h) * dt)
    tx, ty = -kxy * vx - kyy * vy, kxx * vx + kxy * vy
    half = 0.5 * dt
    gx, gy, gz = ex - ty * ez * half, ey + tx * ez * half, ez - (tx * ey - ty * ex) * half
    h_mid = h + half * mz
    kxx, kxy, kyy = curvature(gx, gy, gz, h_mid)
    tx, ty = -kxy * mx - kyy * my, kxx * mx + kxy * my
    ix, iy, iz = EARTH_RATE * gx, EARTH_RATE * gy, EARTH_RATE * gz
    north = gravity_north(gz, 1.0, h_mid)
    gravity = normal_gravity(gz, h_mid)

    # velocity
    zx, zy, zz = (ix + tx) * dt, (iy + ty) * dt, iz * dt
    ux, uy, uz = 2.0 * ix + tx, 2.0 * iy + ty, 2.0 * iz
    fx = sx - 0.5 * (zy * sz - zz * sy)
    fy = sy - 0.5 * (zz * sx - zx * sz)
    fz = sz - 0.5 * (zx * sy - zy * sx)
    nx = vx + fx + (north * gx - (uy * mz - uz * my)) * dt
    ny = vy + fy + (north * gy - (uz * mx - ux * mz)) * dt
    nz = vz + fz + (-gravity - (ux * my - uy * mx)) * dt

    # position
    ax, ay = 0.5 * (vx + nx), 0.5 * (vy + ny)
    h_new = h + 0.5 * (vz + nz) * dt
    kxx, kxy, kyy = curvature(gx, gy, gz, 0.5 * (h + h_new))
    tx, ty = -kxy * ax - kyy * ay, kxx * ax + kxy * ay
    rotate_columns(x, X_C, tx * dt, ty * dt, 0.0)
    x[4], x[5], x[6], x[16] = nx, ny, nz, h_new

    # attitude
    aw, ai, aj, ak = exponential(-(ix + tx) * dt, -(iy + ty) * dt, -iz * dt)
    rw, ri, rj, rk = multiply(aw, ai, aj, ak, qw, qx, qy, qz)
    aw, ai, aj, ak = exponential(px, py, pz)
    rw, ri, rj, rk = multiply(rw, ri, rj, rk, aw, ai, aj, ak)
    norm = 1.0 / np.sqrt(rw * rw + ri * ri + rj * rj + rk * rk)
    x[0], x[1], x[2], x[3] = rw * norm, ri * norm, rj * norm, rk * norm

    # attitude in the middle: half the rotation vector is small enough for first order
    hx, hy, hz = 0.5 * px, 0.5 * py, 0.5 * pz
    mid[0], mid[1], mid[2] = c00 + c01 * hz - c02 * hy, c01 + c02 * hx - c00 * hz, c02 + c00 * hy - c01 * hx
    mid[3], mid[4], mid[5] = c10 + c11 * hz - c12 * hy, c11 + c12 * hx - c10 * hz, c12 + c10 * hy - c11 * hx
    mid[6], mid[7], mid[8] = c20 + c21 * hz - c22 * hy, c21 + c22 * hx - c20 * hz, c22 + c20 * hy - c21 * hx
    mid[9], mid[10], mid[11] = fx / dt, fy / dt, fz / dt
    mid[12], mid[13], mid[14] = ix, iy, iz
    mid[15], mid[16], mid[17] = tx, ty, 0.0
    mid[18], mid[19], mid[20] = kxx, kxy, kyy
    mid[21], mid[22], mid[23] = ax, ay, 0.5 * (vz + nz)
    r_m, r_n = radii(gz)
    mid[24] = 2.0 * gravity / (np.sqrt(r_m * r_n) + h_mid)
