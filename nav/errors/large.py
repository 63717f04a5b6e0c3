"""Misalignments of any size: the Euler angles of the platform, and what they do to a damped navigator.

``alpha`` (..., 3) rad are the angles about x, y, z that take the true navigation frame n to the one that the
computed attitude stands for, p, turned about z, then x, then y: "Yan Gongmin 2008", section 4.2. For
small ones they are phi of `nav.errors.geographic`. Errors are computed minus true, of sensors output
minus truth. Frames are east, north, up. Nothing here holds where alpha_x is 90 deg.

A *damped* navigator, section 4.3.3, takes velocity and position from outside for everything but specific
force, so that its attitude knows nothing of its velocity. All functions take leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def misalignment(alpha: ArrayLike) -> Matrix:
    """C_pn (..., 3, 3), which takes n to p; Yan Gongmin 2008, eq. (4-4)."""
    a = np.asarray(alpha, dtype=np.float64)
    (sx, sy, sz), (cx, cy, cz) = np.moveaxis(np.sin(a), -1, 0), np.moveaxis(np.cos(a), -1, 0)
    C = np.empty((*a.shape, 3))
    C[..., 0, 0], C[..., 0, 1], C[..., 0, 2] = cy * cz - sy * sx * sz, cy * sz + sy * sx * cz, -sy * cx
    C[..., 1, 0], C[..., 1, 1], C[..., 1, 2] = -cx * sz, cx * cz, sx
    C[..., 2, 0], C[..., 2, 1], C[..., 2, 2] = sy * cz + cy * sx * sz, sy * sz - cy * sx * cz, cy * cx
    return C


def angles(C_pn: ArrayLike) -> Vector:
    """``alpha`` (..., 3) of `misalignment`, alpha_x within a right angle."""
    C = np.asarray(C_pn, dtype=np.float64)
    x = np.arctan2(C[..., 1, 2], np.hypot(C[..., 0, 2], C[..., 2, 2]))
    return np.stack([x, np.arctan2(-C[..., 0, 2], C[..., 2, 2]), np.arctan2(-C[..., 1, 0], C[..., 1, 1])], -1)


def euler_rates(alpha: ArrayLike) -> Matrix:
    """(..., 3, 3) from the turn rate of p against n, in p, to that of ``alpha``; eq. (4-7)."""
    a = np.asarray(alpha, dtype=np.float64)
    (sx, sy, _), (cx, cy, _) = np.moveaxis(np.sin(a), -1, 0), np.moveaxis(np.cos(a), -1, 0)
    W = np.zeros((*a.shape, 3))
    W[..., 0, 0], W[..., 0, 2] = cy, sy
    W[..., 1, 0], W[..., 1, 1], W[..., 1, 2] = sy * sx / cx, 1.0, -cy * sx / cx
    W[..., 2, 0], W[..., 2, 2] = -sy / cx, cy / cx
    return W


def attitude_rate(alpha: ArrayLike, w_in: ArrayLike, dw_in: ArrayLike, drift: ArrayLike) -> Vector:
    """Rate (..., 3) of ``alpha``, rad/s; eq. (4-17), and with ``dw_in`` zero eq. (4-26a).

    ``w_in`` (3,) rad/s is the computed rate of n, ``dw_in`` (3,) its error, ``drift`` (..., 3) the gyros'
    error as it comes into p, C_pb eps.
    """
    C = misalignment(alpha)
    w, dw = np.asarray(w_in, dtype=np.float64), np.asarray(dw_in, dtype=np.float64)
    return _apply(euler_rates(alpha), w - _apply(C, w - dw) - np.asarray(drift, dtype=np.float64))


def velocity_rate(alpha: ArrayLike, f_p: ArrayLike, offset: ArrayLike) -> Vector:
    """Rate (..., 3) of the velocity error of a damped navigator, m/s^2; eq. (4-26b).

    ``f_p`` (3,) m/s^2 is the specific force that it computes, C_pb f, and ``offset`` (3,) the
    accelerometers' error in it, C_pb nabla.
    """
    f = np.asarray(f_p, dtype=np.float64)
    back = np.swapaxes(misalignment(alpha), -1, -2)
    return np.asarray(f - _apply(back, f - np.asarray(offset, dtype=np.float64)), dtype=np.float64)


def standing_velocity_rate(alpha: ArrayLike, gravity: float, offset: ArrayLike) -> Vector:
    """The same (..., 3) of one that stands, by gravity (m/s^2) alone; eq. (4-26b') before it is shortened.

    The azimuth has no part in it. (4-27') is what is left of it where alpha_x and alpha_y are small.
    """
    up = np.array([0.0, 0.0, gravity])
    return np.asarray(_apply(misalignment(alpha), up) - up + offset, dtype=np.float64)


def nearly_level_rate(alpha: ArrayLike, north: float, up: float, drift: ArrayLike) -> Vector:
    """Rate (..., 3) of ``alpha`` of a standing navigator where only alpha_z is large; eq. (4-27).

    ``north`` and ``up`` (rad/s) are the parts of Earth rate, ``drift`` (..., 3) as in `attitude_rate`.
    """
    a = np.asarray(alpha, dtype=np.float64)
    x, y, z = np.moveaxis(a, -1, 0)
    level = -np.sin(z) * north + y * up, (1.0 - np.cos(z)) * north - x * up
    return np.stack([*level, x * np.cos(z) * north], -1) - np.asarray(drift, dtype=np.float64)


def _apply(M: Matrix, v: Vector) -> Vector:
    return np.asarray(np.einsum("...ij,...j->...i", M, v), dtype=np.float64)
