"""How master and slave moved between two messages, each by its own sensors."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import gravity_north, normal_gravity
from nav.jit import kernel
from nav.rotation import logarithm, multiply, rotate
from nav.strapdown.kernels import X_Q, cross
from nav.transfer.instant import I_DW
from nav.transfer.model import A_PLACE, A_Q, A_V, E_ARM, E_W, T_Q

Vector = NDArray[np.float64]

CALM: Final = 1.0
"""m/s^2 of the arm's swing up to which master and slave feel the same force."""


@kernel
def moved(
    x: Vector, before: Vector, last: Vector, m: Vector, seconds: float, now: Vector, s: Vector, t: Vector
) -> tuple[Vector, Vector, Vector]:
    """Angles (3,), rad, by the master and by the slave, specific force (3,) by the master, in b as built.

    The slave turned from ``before`` (4,), q_nb, to the nominal state ``x`` in ``seconds``, its master from
    ``last`` to ``m`` (A_SIZE,), which both tell attitude; the rest as `nav.transfer.model.scene`. The force
    is zero where the slave swings too much at the end of its arm to feel the same.
    """
    turn, own, force = np.empty(3), np.empty(3), np.zeros(3)
    i = A_Q
    a, b, c, d = multiply(
        last[i], -last[i + 1], -last[i + 2], -last[i + 3], m[i], m[i + 1], m[i + 2], m[i + 3]
    )
    px, py, pz = logarithm(a, b, c, d)
    turn[0], turn[1], turn[2] = rotate(t[T_Q], t[T_Q + 1], t[T_Q + 2], t[T_Q + 3], px, py, pz)
    a, b, c, d = multiply(
        before[0], -before[1], -before[2], -before[3], x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3]
    )
    own[0], own[1], own[2] = logarithm(a, b, c, d)
    bx, by, bz = s[E_ARM], s[E_ARM + 1], s[E_ARM + 2]
    wx, wy, wz = s[E_W], s[E_W + 1], s[E_W + 2]
    ux, uy, uz = cross(wx, wy, wz, bx, by, bz)
    ux, uy, uz = cross(wx, wy, wz, ux, uy, uz)
    px, py, pz = cross(now[I_DW], now[I_DW + 1], now[I_DW + 2], bx, by, bz)
    ux, uy, uz = ux + px, uy + py, uz + pz
    # how it swings is told by gyros that may be the wrong ones
    if math.sqrt(ux * ux + uy * uy + uz * uz) < CALM:
        sine, cosine, height = math.sin(m[A_PLACE]), math.cos(m[A_PLACE]), m[A_PLACE + 2]
        px, py = (m[A_V] - last[A_V]) / seconds, (m[A_V + 1] - last[A_V + 1]) / seconds
        pz = (m[A_V + 2] - last[A_V + 2]) / seconds
        py, pz = py - gravity_north(sine, cosine, height), pz + normal_gravity(sine, height)
        px, py, pz = rotate(m[i], -m[i + 1], -m[i + 2], -m[i + 3], px, py, pz)
        force[0], force[1], force[2] = rotate(t[T_Q], t[T_Q + 1], t[T_Q + 2], t[T_Q + 3], px, py, pz)
    return turn, own, force
