"""A block of the moving gyrocompass: navigated freely, with what errors do over it.

Errors, true minus estimate: position (m) and velocity (m/s) in n, phi (rad), gyro and accelerometer bias in
b, odometer scale (1), mounting about right and up of the vehicle (rad), way (m), level part of Earth's rate
in n (rad/s). Behind these are the errors of scale and axes, as many as there are: entries of two matrices, by
which what a rate says is off by M_g w, and what a force says by M_a a, of which a has no gravity in it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.match_filter import Indices
from nav.jit import kernel
from nav.rotation import skew
from nav.strapdown.control import U_SIZE, U_WC
from nav.strapdown.kernels import (
    M_C,
    M_EN,
    M_F,
    M_IE,
    M_K,
    M_SIZE,
    M_V,
    X_V,
    increments,
    strapdown,
    take,
)
from nav.types import Vector

POS, VEL, TILT, EPS, NAB = (slice(k, k + 3) for k in range(0, 15, 3))
SCALE: Final = 15
PITCH: Final = 16
YAWED: Final = 17  # mounting about up
WAY: Final = 18
RATE: Final = slice(19, 21)
SIZE: Final = 21
OWN: Final = slice(SIZE, None)

# Sums over a block: C_nb dt, velocity of the odometer's point in v times dt, C_vn [v x] dt, f_n dt, w_in dt,
# transport tensor dt, seconds, w_ib_b dt.
_S_C: Final = 0
_S_WAY: Final = 9
_S_TURN: Final = 12
_S_F: Final = 21
_S_IN: Final = 24
_S_CORIOLIS: Final = 27
_S_K: Final = 30
_S_DT: Final = 33
_S_W: Final = 34
S_SIZE: Final = 37


@kernel
def track(
    x: Vector,
    rows: Vector,
    dt: Vector,
    bias: Vector,
    rate: Vector,
    C_vb: Vector,
    arm: Vector,
    n: int,
    sums: Vector,
) -> None:
    """Navigate freely through samples and add to the ``sums`` (S_SIZE,) of a block; ``x`` is the kernel's.

    ``rows`` (k, 6) and ``dt`` (k,) as in `nav.align.compass_loop.run`; ``bias`` (6,) of gyros and
    accelerometers is taken off, n turns by ``rate`` (2,) rad/s about its level axes beside; ``C_vb`` (3, 3),
    ``arm`` (3,) m from IMU to the odometer's point in b.
    """
    d = np.empty(6 * n)
    inc = np.empty(6)
    mid = np.empty(M_SIZE)
    u = np.zeros(U_SIZE)
    u[U_WC], u[U_WC + 1] = rate[0], rate[1]
    i = 0
    while i < rows.shape[0]:
        m = n if i + n <= rows.shape[0] else 1
        take(rows, i, m, d)
        step = 0.0
        for j in range(m):
            for k in range(3):
                d[3 * j + k] -= bias[k] * dt[i + j]
                d[3 * (m + j) + k] -= bias[3 + k] * dt[i + j]
            step += dt[i + j]
        i += m
        increments(d, m, inc)
        strapdown(x, inc, step, u, mid)
        vx, vy, vz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
        # of twice Earth's rate the kernel has had a control rate once
        x[X_V] -= rate[1] * vz * step
        x[X_V + 1] += rate[0] * vz * step
        x[X_V + 2] -= (rate[0] * vy - rate[1] * vx) * step
        # velocity of the odometer's point in b: of the IMU, and what turning adds
        px = (inc[1] * arm[2] - inc[2] * arm[1]) / step
        py = (inc[2] * arm[0] - inc[0] * arm[2]) / step
        pz = (inc[0] * arm[1] - inc[1] * arm[0]) / step
        px += mid[M_C] * vx + mid[M_C + 3] * vy + mid[M_C + 6] * vz
        py += mid[M_C + 1] * vx + mid[M_C + 4] * vy + mid[M_C + 7] * vz
        pz += mid[M_C + 2] * vx + mid[M_C + 5] * vy + mid[M_C + 8] * vz
        for r in range(3):
            cx, cy, cz = C_vb[r, 0], C_vb[r, 1], C_vb[r, 2]
            sums[_S_WAY + r] += (cx * px + cy * py + cz * pz) * step
            # row of C_vn
            ex = cx * mid[M_C] + cy * mid[M_C + 1] + cz * mid[M_C + 2]
            ey = cx * mid[M_C + 3] + cy * mid[M_C + 4] + cz * mid[M_C + 5]
            ez = cx * mid[M_C + 6] + cy * mid[M_C + 7] + cz * mid[M_C + 8]
            sums[_S_TURN + 3 * r] += (ey * vz - ez * vy) * step
            sums[_S_TURN + 3 * r + 1] += (ez * vx - ex * vz) * step
            sums[_S_TURN + 3 * r + 2] += (ex * vy - ey * vx) * step
        for k in range(9):
            sums[_S_C + k] += mid[M_C + k] * step
        for k in range(3):
            sums[_S_F + k] += mid[M_F + k] * step
            sums[_S_IN + k] += (mid[M_IE + k] + mid[M_EN + k]) * step
            sums[_S_CORIOLIS + k] += (2.0 * mid[M_IE + k] + mid[M_EN + k]) * step
            sums[_S_K + k] += mid[M_K + k] * step
            sums[_S_W + k] += inc[k]
        sums[_S_DT] += step


class Block(NamedTuple):
    """What a block of ``tau`` s does to the errors: ``F`` (n, n), their change over it, to first order.

    ``J``, ``M`` (3, 3) are the means of C_vn and C_vn [v x], by which they show in the velocity of the
    odometer's point in v; ``rolled`` (3,) m is the way of that, ``level`` m/s^2 the level specific force.
    """

    tau: float
    F: Vector
    J: Vector
    M: Vector
    rolled: Vector
    level: float


def block(sums: Vector, C_vb: Vector, v_n: Vector, gained: Vector, own_g: Indices, own_a: Indices) -> Block:
    """The block of ``sums``, at the end of which the velocity is ``v_n``, by ``gained`` more than before.

    (3,) m/s both. ``own_g``, ``own_a``: which entries of M_g and of M_a, row by row, are errors.
    """
    tau = seconds(sums)
    C = sums[_S_C : _S_C + 9].reshape(3, 3)
    J, M = C_vb @ C.T, sums[_S_TURN : _S_TURN + 9].reshape(3, 3)
    w_b, a_b = sums[_S_W : _S_W + 3] / tau, C.T @ gained / tau**2
    accel = SIZE + len(own_g)
    n = accel + len(own_a)
    F = np.zeros((n, n))
    F[POS, VEL] = np.eye(3) * tau
    F[VEL, VEL] = -skew(sums[_S_CORIOLIS : _S_CORIOLIS + 3])
    F[VEL, TILT] = -skew(sums[_S_F : _S_F + 3])
    F[VEL, NAB] = -C
    F[VEL, RATE] = 2.0 * tau * skew(v_n)[:, 0:2]
    F[VEL, accel:] = -C[:, own_a // 3] * a_b[own_a % 3]
    kxx, kxy, kyy = sums[_S_K : _S_K + 3]
    # an error of velocity, true minus estimate, turns n by less than it should
    F[TILT.start : TILT.start + 2, VEL.start : VEL.start + 2] = [[kxy, kyy], [-kxx, -kxy]]
    F[TILT, TILT] = -skew(sums[_S_IN : _S_IN + 3])
    F[TILT, EPS] = -C
    F[TILT.start, RATE.start] = F[TILT.start + 1, RATE.start + 1] = -tau
    F[TILT, SIZE:accel] = -C[:, own_g // 3] * w_b[own_g % 3]
    F[WAY, VEL], F[WAY, TILT] = J[1], M[1]
    level = math.hypot(sums[_S_F], sums[_S_F + 1]) / tau
    return Block(tau, F, J / tau, M / tau, sums[_S_WAY : _S_WAY + 3], level)


def seconds(sums: Vector) -> float:
    """Length of the block of ``sums``."""
    return float(sums[_S_DT])
