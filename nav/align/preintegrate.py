"""Inertial increments summed up over an interval, with their dependence on the sensor biases.

A *piece* is a flat row (`SIZE`,) that stands for an interval: the rotation of b over it, the specific
force integrated once and twice in the b of its start, and the first derivatives of these with respect
to gyro and accelerometer bias. Pieces join: two neighbours make a longer one, so a window of motion is
kept as one row per fix and can be gone over again with other biases at bounded cost. The idea is that of
Forster and others, "On-manifold preintegration for real-time visual-inertial odometry", IEEE
Transactions on Robotics 33(1), 2017, section VI.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.jit import in_place, kernel
from nav.types import Vector

R: Final = slice(0, 9)  # rotation from b at the end to b at the start
V: Final = slice(9, 12)  # m/s, integral of f in b at the start
P: Final = slice(12, 15)  # m, double integral
R_GYRO: Final = slice(15, 24)  # s: rotation vector at the end, in b there, per rad/s of gyro bias
V_GYRO: Final = slice(24, 33)
V_ACCEL: Final = slice(33, 42)
P_GYRO: Final = slice(42, 51)
P_ACCEL: Final = slice(51, 60)
DT: Final = 60  # s
SIZE: Final = 61


def empty() -> Vector:
    """The piece of no duration: the neutral element of `extend`."""
    piece = np.zeros(SIZE)
    piece[R] = np.eye(3).ravel()
    return piece


@in_place
def turn_matrix(x: float, y: float, z: float, out: Vector) -> None:
    """Rotation matrix of a rotation vector, row by row into ``out`` (9,)."""
    n2 = x * x + y * y + z * z
    if n2 > 1e-8:
        n = math.sqrt(n2)
        a = math.sin(n) / n
        b = (1.0 - math.cos(n)) / n2
    else:
        a = 1.0 - n2 / 6.0
        b = 0.5 - n2 / 24.0
    out[0] = 1.0 - b * (y * y + z * z)
    out[1] = b * x * y - a * z
    out[2] = b * x * z + a * y
    out[3] = b * x * y + a * z
    out[4] = 1.0 - b * (x * x + z * z)
    out[5] = b * y * z - a * x
    out[6] = b * x * z - a * y
    out[7] = b * y * z + a * x
    out[8] = 1.0 - b * (x * x + y * y)


@kernel
def sample_piece(
    dtheta: Vector, dv: Vector, dt: float, gyro_bias: Vector, accel_bias: Vector, out: Vector
) -> None:
    """The piece of one inertial sample: ``dtheta`` (3,) rad, ``dv`` (3,) m/s over ``dt`` s, into ``out``.

    ``gyro_bias`` (3,) rad/s and ``accel_bias`` (3,) m/s^2 are subtracted. Half the rotation of the interval
    is applied to its velocity increment. Titterton and Weston, 2nd edition, section 11.3.
    """
    out[:] = 0.0
    tx = dtheta[0] - gyro_bias[0] * dt
    ty = dtheta[1] - gyro_bias[1] * dt
    tz = dtheta[2] - gyro_bias[2] * dt
    ux = dv[0] - accel_bias[0] * dt
    uy = dv[1] - accel_bias[1] * dt
    uz = dv[2] - accel_bias[2] * dt
    turn_matrix(tx, ty, tz, out[0:9])
    out[9] = ux + 0.5 * (ty * uz - tz * uy)
    out[10] = uy + 0.5 * (tz * ux - tx * uz)
    out[11] = uz + 0.5 * (tx * uy - ty * ux)
    for i in range(3):
        out[12 + i] = 0.5 * dt * out[9 + i]
        out[15 + 4 * i] = -dt
        out[33 + 4 * i] = -dt
        out[51 + 4 * i] = -0.5 * dt * dt
    # derivative of that half rotation: 0.5 dt [u x]
    out[25], out[26] = -0.5 * dt * uz, 0.5 * dt * uy
    out[27], out[29] = 0.5 * dt * uz, -0.5 * dt * ux
    out[30], out[31] = -0.5 * dt * uy, 0.5 * dt * ux
    out[60] = dt


@kernel
def _add_rotated(r: Vector, m: Vector, out: Vector) -> None:
    """``out += r @ m``, all 3 x 3 row by row."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] += r[3 * i] * m[j] + r[3 * i + 1] * m[3 + j] + r[3 * i + 2] * m[6 + j]


@kernel
def _turned(x: float, y: float, z: float, m: Vector, add: Vector, out: Vector) -> None:
    """``out = add - [(x, y, z) x] @ m``."""
    for j in range(3):
        out[j] = add[j] - (y * m[6 + j] - z * m[3 + j])
        out[3 + j] = add[3 + j] - (z * m[j] - x * m[6 + j])
        out[6 + j] = add[6 + j] - (x * m[3 + j] - y * m[j])


@kernel
def extend(total: Vector, piece: Vector, gyro_bias: Vector, accel_bias: Vector) -> None:
    """Join ``piece`` to the end of ``total``, in place, with its biases changed by the two (3,) given."""
    turn = np.empty(9)
    rotation = np.empty(9)
    work = np.empty(9)
    v = np.empty(3)
    p = np.empty(3)
    g0, g1, g2 = gyro_bias[0], gyro_bias[1], gyro_bias[2]
    a0, a1, a2 = accel_bias[0], accel_bias[1], accel_bias[2]
    turn_matrix(
        piece[15] * g0 + piece[16] * g1 + piece[17] * g2,
        piece[18] * g0 + piece[19] * g1 + piece[20] * g2,
        piece[21] * g0 + piece[22] * g1 + piece[23] * g2,
        turn,
    )
    rotation[:] = 0.0
    _add_rotated(piece[0:9], turn, rotation)
    for i in range(3):
        j = 3 * i
        v[i] = (
            piece[9 + i]
            + (piece[24 + j] * g0 + piece[25 + j] * g1 + piece[26 + j] * g2)
            + (piece[33 + j] * a0 + piece[34 + j] * a1 + piece[35 + j] * a2)
        )
        p[i] = (
            piece[12 + i]
            + (piece[42 + j] * g0 + piece[43 + j] * g1 + piece[44 + j] * g2)
            + (piece[51 + j] * a0 + piece[52 + j] * a1 + piece[53 + j] * a2)
        )
    dt = piece[60]
    # position and velocity first: they need the rotation and its derivative at the joint
    for i in range(3):
        total[12 + i] += total[9 + i] * dt
    for i in range(9):
        total[42 + i] += total[24 + i] * dt
        total[51 + i] += total[33 + i] * dt
    r = total[0:9]
    for i in range(3):
        total[12 + i] += r[3 * i] * p[0] + r[3 * i + 1] * p[1] + r[3 * i + 2] * p[2]
        total[9 + i] += r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2]
    _turned(p[0], p[1], p[2], total[15:24], piece[42:51], work)
    _add_rotated(r, work, total[42:51])
    _add_rotated(r, piece[51:60], total[51:60])
    _turned(v[0], v[1], v[2], total[15:24], piece[24:33], work)
    _add_rotated(r, work, total[24:33])
    _add_rotated(r, piece[33:42], total[33:42])
    # derivative of the rotation: carried through the transpose of the new part
    for i in range(3):
        for j in range(3):
            work[3 * i + j] = (
                rotation[i] * total[15 + j]
                + rotation[3 + i] * total[18 + j]
                + rotation[6 + i] * total[21 + j]
            )
    for i in range(9):
        total[15 + i] = work[i] + piece[15 + i]
    work[:] = 0.0
    _add_rotated(r, rotation, work)
    for i in range(9):
        total[i] = work[i]
    total[60] += dt


@kernel
def running(pieces: Vector, gyro_bias: Vector, accel_bias: Vector, out: Vector) -> None:
    """Row k of ``out`` is the join of ``pieces`` (K, SIZE) 0 to k, with the biases changed as in `extend`."""
    total = np.zeros(61)
    total[0] = 1.0
    total[4] = 1.0
    total[8] = 1.0
    for k in range(pieces.shape[0]):
        extend(total, pieces[k], gyro_bias, accel_bias)
        for i in range(61):
            out[k, i] = total[i]
