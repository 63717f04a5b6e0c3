"""Rotations of the bench, on stacks of matrices and vectors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def attitude(heading: Array, pitch: Array, roll: Array) -> Array:
    """C_gv (n, 3, 3) from vehicle axes to east-north-up: heading, then pitch, then roll."""
    sh, ch, sp, cp = np.sin(heading), np.cos(heading), np.sin(pitch), np.cos(pitch)
    sr, cr = np.sin(roll), np.cos(roll)
    return np.stack(
        (
            np.stack((ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr), axis=-1),
            np.stack((-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr), axis=-1),
            np.stack((-cp * sr, sp, cp * cr), axis=-1),
        ),
        axis=-2,
    )


def euler(C: Array) -> tuple[Array, Array, Array]:
    """Heading in [0, 2 pi), pitch and roll (n,) rad of `attitude` matrices (n, 3, 3)."""
    heading = np.arctan2(C[:, 0, 1], C[:, 1, 1]) % (2.0 * math.pi)
    pitch = np.arcsin(np.clip(C[:, 2, 1], -1.0, 1.0))
    return heading, pitch, np.arctan2(-C[:, 2, 0], C[:, 2, 2])


def quaternion(C: Array) -> Array:
    """Quaternion (4,) of a rotation matrix, scalar part not negative."""
    # largest of the four squares first: never a division by something small
    trace = float(np.trace(C))
    squares = np.array([trace, C[0, 0], C[1, 1], C[2, 2]])
    k = int(np.argmax(squares))
    q = np.empty(4)
    if k == 0:
        q[:] = 1.0 + trace, C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q[0] = C[m, j] - C[j, m]
        q[1 + i] = 1.0 + C[i, i] - C[j, j] - C[m, m]
        q[1 + j] = C[j, i] + C[i, j]
        q[1 + m] = C[m, i] + C[i, m]
    q /= math.sqrt(float(q @ q))
    return -q if q[0] < 0.0 else q


def cross(a: Array, b: Array) -> Array:
    """Vector products of stacks (..., 3)."""
    return np.stack(
        (
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ),
        axis=-1,
    )


def down(C: Array, v: Array) -> Array:
    """C^T v for stacks: a vector from the axes C maps to into the axes C maps from."""
    return np.asarray((C * v[..., :, None]).sum(axis=-2))


def up(C: Array, v: Array) -> Array:
    """C v for stacks."""
    return np.asarray((C * v[..., None, :]).sum(axis=-1))
