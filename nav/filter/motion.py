"""How points of the vehicle move, from the filter's state: the kernels that measurements share."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, curvature
from nav.filter.states import P_LO, X_A, X_F, X_PATH, X_PT, X_QV, X_TICK_COV, X_TICK_VAR, X_W, X_WD, X_WT
from nav.jit import in_place, kernel
from nav.rotation import exponential, multiply, rotate
from nav.strapdown.kernels import M_C, X_C, X_H, X_Q, X_V

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_NEVER: Final = 1e9  # s


@kernel
def matrix(q: Vector) -> Matrix:
    """Direction cosine matrix of the quaternion at ``q[0:4]``."""
    C = np.empty((3, 3))
    for j in range(3):
        C[0, j], C[1, j], C[2, j] = rotate(
            q[0], q[1], q[2], q[3], 1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0
        )
    return C


@in_place
def place_beside(x: Vector, ax: float, ay: float) -> tuple[float, float, float, float, float]:
    """Level part of the polar axis in n, and the vertical in e, ``ax``, ``ay`` m along the level axes of n.

    By direction vectors, so that it holds at a pole: the vertical turns by the curvature times the way.
    """
    ex, ey, ez = x[X_C + 6], x[X_C + 7], x[X_C + 8]
    kxx, kxy, kyy = curvature(ex, ey, ez, x[X_H])
    tx, ty = kxx * ax + kxy * ay, kxy * ax + kyy * ay
    ux = x[X_C + 2] + x[X_C] * tx + x[X_C + 1] * ty
    uy = x[X_C + 5] + x[X_C + 3] * tx + x[X_C + 4] * ty
    return ex - ez * tx, ey - ez * ty, ux, uy, ez + ex * tx + ey * ty


@in_place
def undo_axes(x: Vector, place: int, out: Vector) -> None:
    """Put the inverse of ``I + M`` into ``out`` (9,), M (9,) standing at ``place`` in ``x``."""
    a, b, c = 1.0 + x[place], x[place + 1], x[place + 2]
    d, e, f = x[place + 3], 1.0 + x[place + 4], x[place + 5]
    g, h, i = x[place + 6], x[place + 7], 1.0 + x[place + 8]
    u, v, w = e * i - f * h, f * g - d * i, d * h - e * g
    s = 1.0 / (a * u + b * v + c * w)
    out[0], out[1], out[2] = s * u, s * (c * h - b * i), s * (b * f - c * e)
    out[3], out[4], out[5] = s * v, s * (a * i - c * g), s * (c * d - a * f)
    out[6], out[7], out[8] = s * w, s * (b * g - a * h), s * (a * e - b * d)


@in_place
def times(m: Vector, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Matrix ``m`` (9,), row by row, times a vector."""
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[3] * x + m[4] * y + m[5] * z,
        m[6] * x + m[7] * y + m[8] * z,
    )


@in_place
def eb_rate(x: Vector, tau: float) -> tuple[float, float, float]:
    """w_eb_b: rate of b with respect to the Earth, ``tau`` seconds before the state's time.

    The mean over an update is the rate in its middle. On a base that rolls at one hertz the rate at its end,
    5 ms later, is another by so much that an antenna on a mast is off by 5 cm/s, always as it accelerates.
    """
    ix, iy, iz = rotate(
        x[X_Q],
        -x[X_Q + 1],
        -x[X_Q + 2],
        -x[X_Q + 3],
        EARTH_RATE * x[X_C + 6],
        EARTH_RATE * x[X_C + 7],
        EARTH_RATE * x[X_C + 8],
    )
    ahead = x[X_WT] - tau
    return (
        x[X_W] + ahead * x[X_WD] - ix,
        x[X_W + 1] + ahead * x[X_WD + 1] - iy,
        x[X_W + 2] + ahead * x[X_WD + 2] - iz,
    )


@in_place
def take_rate(x: Vector, wx: float, wy: float, wz: float, dt: float, measured: bool) -> None:
    """Take w_ib_b, the mean over an update of ``dt`` s, and how it changes where the last two say it."""
    half = 0.5 * dt
    per_s = 1.0 / (x[X_WT] + half) if measured and x[X_WT] > 0.0 else 0.0
    x[X_WD] = per_s * (wx - x[X_W])
    x[X_WD + 1] = per_s * (wy - x[X_W + 1])
    x[X_WD + 2] = per_s * (wz - x[X_W + 2])
    x[X_WT] = half if measured else 0.0
    x[X_W], x[X_W + 1], x[X_W + 2] = wx, wy, wz


@in_place
def attitude_ago(x: Vector, tau: float) -> tuple[float, float, float, float]:
    """q_nb ``tau`` seconds before the state's time.

    What turns to and fro is not where its rate was a moment ago: the two out of step make a mean velocity of
    an antenna that only swings.
    """
    wx, wy, wz = eb_rate(x, 0.5 * tau)
    w, i, j, k = exponential(-wx * tau, -wy * tau, -wz * tau)
    return multiply(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3], w, i, j, k)


@kernel
def vehicle_velocity(x: Vector, par: Vector, tau: float) -> Vector:
    """Velocity (3,) of the odometer point in v, ``tau`` seconds before the state's time."""
    wx, wy, wz = eb_rate(x, tau)
    lx, ly, lz = par[P_LO], par[P_LO + 1], par[P_LO + 2]
    w, i, j, k = attitude_ago(x, tau)
    bx, by, bz = rotate(
        w,
        -i,
        -j,
        -k,
        x[X_V] - x[X_A] * tau,
        x[X_V + 1] - x[X_A + 1] * tau,
        x[X_V + 2] - x[X_A + 2] * tau,
    )
    u = np.empty(3)
    u[0], u[1], u[2] = rotate(
        x[X_QV],
        x[X_QV + 1],
        x[X_QV + 2],
        x[X_QV + 3],
        bx + wy * lz - wz * ly,
        by + wz * lx - wx * lz,
        bz + wx * ly - wy * lx,
    )
    return u


@kernel
def mean_velocity(x: Vector, par: Vector, tau: float) -> Vector:
    """Mean velocity (3,) of the odometer point in v since the last odometer epoch, up to tau ago."""
    u = vehicle_velocity(x, par, 0.5 * tau)
    t = x[X_PT] - tau
    for k in range(3):
        u[k] = (x[X_PATH + k] - u[k] * tau) / t
    return u


@kernel
def vehicle_row(x: Vector, par: Vector, axis: int, u: Vector, age: float, H: Matrix, row: int) -> None:
    """Row of H for the odometer point's velocity along one axis of v, ``age`` seconds ago.

    ``u`` (3,) is that velocity in v. ``du = C_vn (dv + phi x v) + C_vb (l x db) + u x mu`` with dv and v of
    then. Written with those of now, what the vehicle accelerated by drops out, and gravity's part is left: a
    wrong azimuth turns velocity and acceleration alike.
    """
    Cv = matrix(x[X_QV : X_QV + 4])
    Cb = matrix(x[X_Q : X_Q + 4])
    vx, vy, vz = x[X_V], x[X_V + 1], x[X_V + 2]
    fx, fy, fz = rotate(x[0], x[1], x[2], x[3], x[X_F], x[X_F + 1], x[X_F + 2])
    fx, fy, fz = fx - x[X_A], fy - x[X_A + 1], fz - x[X_A + 2]
    lx, ly, lz = par[P_LO], par[P_LO + 1], par[P_LO + 2]
    c0 = Cv[axis, 0] * Cb[0, 0] + Cv[axis, 1] * Cb[0, 1] + Cv[axis, 2] * Cb[0, 2]
    c1 = Cv[axis, 0] * Cb[1, 0] + Cv[axis, 1] * Cb[1, 1] + Cv[axis, 2] * Cb[1, 2]
    c2 = Cv[axis, 0] * Cb[2, 0] + Cv[axis, 1] * Cb[2, 1] + Cv[axis, 2] * Cb[2, 2]
    H[row, 3], H[row, 4], H[row, 5] = c0, c1, c2
    # dv was smaller by (f x phi - C dba) age, phi x v by (phi x a) age; and c . (phi x v) = phi . (v x c)
    H[row, 6] = vy * c2 - vz * c1 - age * (c1 * fz - c2 * fy)
    H[row, 7] = vz * c0 - vx * c2 - age * (c2 * fx - c0 * fz)
    H[row, 8] = vx * c1 - vy * c0 - age * (c0 * fy - c1 * fx)
    H[row, 9] = Cv[axis, 1] * lz - Cv[axis, 2] * ly
    H[row, 10] = Cv[axis, 2] * lx - Cv[axis, 0] * lz
    H[row, 11] = Cv[axis, 0] * ly - Cv[axis, 1] * lx
    for k in range(3):
        H[row, 12 + k] = age * Cv[axis, k]
    if axis == 0:
        H[row, 17] = u[1]
    elif axis == 1:
        H[row, 16] = u[2]
        H[row, 17] = -u[0]
    else:
        H[row, 16] = -u[1]


@kernel
def restart_path(x: Vector, par: Vector, tau: float) -> None:
    """Begin the path of the odometer point anew ``tau`` seconds before the state's time."""
    u = vehicle_velocity(x, par, 0.5 * tau)
    for k in range(3):
        x[X_PATH + k] = u[k] * tau
    x[X_PT] = tau


@in_place
def lose_path(x: Vector) -> None:
    """The path since the last odometer epoch is not known: nothing is compared with it before the next."""
    x[X_PT] = -_NEVER
    x[X_TICK_VAR] = -1.0


@in_place
def carry_tick(x: Vector, mid: Vector, dt: float) -> None:
    """Carry what the errors have to do with the odometer's last tick on by ``dt`` s.

    As the errors move, but for biases, in the fraction of a second to the next epoch. ``mid`` is the
    strapdown kernel's record of the interval.
    """
    f0, f1, f2 = x[X_F], x[X_F + 1], x[X_F + 2]
    fx = mid[M_C] * f0 + mid[M_C + 1] * f1 + mid[M_C + 2] * f2
    fy = mid[M_C + 3] * f0 + mid[M_C + 4] * f1 + mid[M_C + 5] * f2
    fz = mid[M_C + 6] * f0 + mid[M_C + 7] * f1 + mid[M_C + 8] * f2
    v, phi = X_TICK_COV + 3, X_TICK_COV + 6
    for i in range(3):
        x[X_TICK_COV + i] += x[v + i] * dt
    x[v] += (fy * x[phi + 2] - fz * x[phi + 1]) * dt
    x[v + 1] += (fz * x[phi] - fx * x[phi + 2]) * dt
    x[v + 2] += (fx * x[phi + 1] - fy * x[phi]) * dt
