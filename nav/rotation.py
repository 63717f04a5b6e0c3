"""Rotations: quaternions, direction cosine matrices, rotation vectors and Euler angles.

A quaternion q_nb = (w, x, y, z), scalar first, takes b to n as C_nb does. Functions on numbers are
kernels, usable inside other kernels; functions on arrays follow and accept leading axes.

Sources: Groves, 2nd ed., section 2.2 and appendix E.6; Savage, "Strapdown Analytics", section 3.2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav.jit import kernel

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Four = tuple[float, float, float, float]
Three = tuple[float, float, float]


@kernel
def multiply(aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float) -> Four:
    """Quaternion product a b: ``q_nv = q_nb q_bv``. Groves, eq. (E.35)."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@kernel
def exponential(x: float, y: float, z: float) -> Four:
    """Unit quaternion of the rotation vector (x, y, z), rad. Savage, eq. (3.2.4.1-5)."""
    a2 = 0.25 * (x * x + y * y + z * z)
    if a2 < 1e-4:
        # series to the eighth power: truncation below 1e-17
        s = 0.5 * (1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0)))
        c = 1.0 - 0.5 * a2 * (1.0 - a2 / 12.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0)))
    else:
        a = math.sqrt(a2)
        s = 0.5 * math.sin(a) / a
        c = math.cos(a)
    return c, s * x, s * y, s * z


@kernel
def logarithm(w: float, x: float, y: float, z: float) -> Three:
    """Rotation vector (rad, length at most pi) of a unit quaternion. Savage, eq. (3.2.4.5-4)."""
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 * math.atan2(s, w) / s if s > 1e-9 else 2.0 / w
    return k * x, k * y, k * z


@kernel
def rotate(w: float, x: float, y: float, z: float, vx: float, vy: float, vz: float) -> Three:
    """Components in n of a vector given in b, by q_nb = (w, x, y, z)."""
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx


@kernel
def euler(w: float, x: float, y: float, z: float) -> Three:
    """Heading in [0, 2 pi), pitch and roll of q_gb = (w, x, y, z), rad, as `nav.types.Solution` has them."""
    heading = np.arctan2(2.0 * (x * y - w * z), w * w - x * x + y * y - z * z)
    if heading < 0.0:
        heading += 2.0 * np.pi
    if heading >= 2.0 * np.pi:  # a tiny negative angle
        heading = 0.0
    sine = 2.0 * (y * z + w * x)
    if abs(sine) > 1.0:  # by rounding; not asked of NaN, which stays
        sine = np.copysign(1.0, sine)
    return heading, np.arcsin(sine), np.arctan2(-2.0 * (x * z - w * y), w * w - x * x - y * y + z * z)


def cross(a: Vector, b: Vector) -> Vector:
    """Cross products (..., 3) of vectors (..., 3): what NumPy's gives, a few vectors much sooner."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    first = ay * bz - az * by
    c = np.empty((*first.shape, 3))
    c[..., 0] = first
    c[..., 1] = az * bx - ax * bz
    c[..., 2] = ax * by - ay * bx
    return c


def quat_multiply(a: ArrayLike, b: ArrayLike) -> Vector:
    """Product (..., 4) of quaternions ``a`` and ``b`` (..., 4): ``q_nv = q_nb q_bv``."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    w = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + cross(av, bv)], axis=-1)


def quat_conjugate(q: ArrayLike) -> Vector:
    """Inverse rotation (..., 4) of unit quaternions (..., 4): q_bn of q_nb."""
    return np.asarray(np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0]))


def quat_normalize(q: ArrayLike) -> Vector:
    """Quaternions (..., 4) of length one."""
    q = np.asarray(q, dtype=np.float64)
    return np.asarray(q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True)))


def quat_rotate(q_nb: ArrayLike, r_b: ArrayLike) -> Vector:
    """Vectors (..., 3) in n of vectors (..., 3) in b, by ``q_nb`` (..., 4)."""
    q, r = np.asarray(q_nb, dtype=np.float64), np.asarray(r_b, dtype=np.float64)
    t = 2.0 * cross(q[..., 1:], r)
    return np.asarray(r + q[..., :1] * t + cross(q[..., 1:], t))


def quat_from_rotvec(rotvec: ArrayLike) -> Vector:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad."""
    r = np.asarray(rotvec, dtype=np.float64)
    a2 = 0.25 * np.sum(r * r, axis=-1, keepdims=True)
    a = np.sqrt(a2)
    # np.sinc is sin(pi x)/(pi x) and exact at zero
    return np.concatenate([np.cos(a), 0.5 * np.sinc(a / np.pi) * r], axis=-1)


def rotvec_from_quat(q: ArrayLike) -> Vector:
    """Rotation vectors (..., 3), rad, length at most pi, of unit quaternions (..., 4)."""
    q = np.asarray(q, dtype=np.float64)
    q = np.where(q[..., :1] < 0.0, -q, q)
    s = np.sqrt(np.sum(q[..., 1:] ** 2, axis=-1, keepdims=True))
    small = s < 1e-9
    k = np.where(small, 2.0, 2.0 * np.arctan2(s, q[..., :1]) / np.where(small, 1.0, s))
    return np.asarray(k * q[..., 1:])


def dcm_from_quat(q: ArrayLike) -> Matrix:
    """Direction cosine matrices C_nb (..., 3, 3) of unit quaternions q_nb (..., 4). Groves, eq. (2.34)."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    # element by element: stacking them takes four times as long as computing them
    C = np.empty((*q.shape[:-1], 3, 3))
    C[..., 0, 0] = w * w + x * x - y * y - z * z
    C[..., 0, 1] = 2.0 * (x * y - w * z)
    C[..., 0, 2] = 2.0 * (x * z + w * y)
    C[..., 1, 0] = 2.0 * (x * y + w * z)
    C[..., 1, 1] = w * w - x * x + y * y - z * z
    C[..., 1, 2] = 2.0 * (y * z - w * x)
    C[..., 2, 0] = 2.0 * (x * z - w * y)
    C[..., 2, 1] = 2.0 * (y * z + w * x)
    C[..., 2, 2] = w * w - x * x - y * y + z * z
    return C


def quat_from_dcm(C: ArrayLike) -> Vector:
    """Unit quaternion (4,) with w >= 0 of a direction cosine matrix (3, 3).

    The largest element is found first, so no rotation angle is special (Shepperd, Journal of
    Guidance and Control 1(3), 1978, 223-224).
    """
    C = np.asarray(C, dtype=np.float64)
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    squares = np.array([trace, C[0, 0], C[1, 1], C[2, 2]])
    i = int(np.argmax(squares))
    q = np.empty(4)
    if i == 0:
        q[:] = [1.0 + trace, C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]
    else:
        j, k, m = i - 1, i % 3, (i + 1) % 3
        q[0] = C[m, k] - C[k, m]
        q[1 + j] = 1.0 + 2.0 * C[j, j] - trace
        q[1 + k] = C[k, j] + C[j, k]
        q[1 + m] = C[m, j] + C[j, m]
    q = quat_normalize(q)
    return -q if q[0] < 0.0 else q


def dcm_from_euler(heading: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> Matrix:
    """C_gb (..., 3, 3) of heading (clockwise from north), pitch (nose up), roll (right side down), rad.

    From level and north: turn by heading about down, then pitch about right, then roll about forward.
    """
    h, p, r = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (heading, pitch, roll)))
    sh, ch, sp, cp, sr, cr = np.sin(h), np.cos(h), np.sin(p), np.cos(p), np.sin(r), np.cos(r)
    rows = [
        [ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr],
        [-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr],
        [-cp * sr, sp, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_euler(heading: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> Vector:
    """q_gb (..., 4) of heading, pitch, roll (rad), as `dcm_from_euler`."""
    h, p, r = np.broadcast_arrays(*(0.5 * np.asarray(a, dtype=np.float64) for a in (heading, pitch, roll)))
    zero = np.zeros_like(h)
    q_h = np.stack([np.cos(h), zero, zero, -np.sin(h)], axis=-1)
    q_p = np.stack([np.cos(p), np.sin(p), zero, zero], axis=-1)
    q_r = np.stack([np.cos(r), zero, np.sin(r), zero], axis=-1)
    return quat_multiply(quat_multiply(q_h, q_p), q_r)


def euler_from_dcm(C_gb: ArrayLike) -> tuple[Vector, Vector, Vector]:
    """Heading in [0, 2 pi), pitch and roll, rad, each (...), of C_gb (..., 3, 3).

    With the nose straight up or down heading and roll are not separate; roll is then zero.
    """
    C = np.asarray(C_gb, dtype=np.float64)
    cos_pitch = np.hypot(C[..., 0, 1], C[..., 1, 1])
    vertical = cos_pitch < 1e-9
    heading = np.where(
        vertical, np.arctan2(-C[..., 1, 0], C[..., 0, 0]), np.arctan2(C[..., 0, 1], C[..., 1, 1])
    )
    roll = np.where(vertical, 0.0, np.arctan2(-C[..., 2, 0], C[..., 2, 2]))
    heading = np.mod(heading, 2.0 * np.pi)
    # the remainder of a tiny negative angle rounds up to a whole turn
    heading = np.where(heading >= 2.0 * np.pi, 0.0, heading)
    return heading, np.arctan2(C[..., 2, 1], cos_pitch), roll


def euler_from_quat(q_gb: ArrayLike) -> tuple[Vector, Vector, Vector]:
    """Heading in [0, 2 pi), pitch and roll, rad, each (...), of q_gb (..., 4)."""
    return euler_from_dcm(dcm_from_quat(q_gb))


def skew(r: ArrayLike) -> Matrix:
    """[r x] (..., 3, 3): the matrix with ``skew(r) @ u == cross(r, u)``."""
    r = np.asarray(r, dtype=np.float64)
    C = np.zeros((*r.shape[:-1], 3, 3))
    C[..., 2, 1], C[..., 0, 2], C[..., 1, 0] = r[..., 0], r[..., 1], r[..., 2]
    C[..., 1, 2], C[..., 2, 0], C[..., 0, 1] = -r[..., 0], -r[..., 1], -r[..., 2]
    return C
