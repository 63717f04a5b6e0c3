"""What can be fed into the strapdown kernel: azimuth law, control rate, and damping by velocity and height.

A control vector ``u`` (U_SIZE,) float64 that is all zero is the undamped wander-azimuth navigator. With
``w_en_n`` the level transport rate and ``up`` the third axis of n:

- azimuth: ``w_en_n += up (U_NORTH v_E tan L/(R_N + h) - U_FREE w_ie sin L + U_TURN)``
- control rate ``w_c`` (in n): attitude turns with ``w_in + w_c`` and velocity carries
  ``-(2 w_ie + w_en + w_c) x v``; the position matrix is not turned by it
- velocity: ``v' += -K (v - U_V)``, K = diag(level, level, vertical)
- height: ``h' = v_U - k1 (h - U_H)``, ``v_U' += -k2 (h - U_H) - a``, ``a' = k3 (h - U_H)``
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

U_NORTH: Final = 0  # 1: n keeps its azimuth to north
U_FREE: Final = 1  # 1: n does not turn about up in inertial space
U_TURN: Final = 2  # further vertical rate of n, rad/s
U_WC: Final = 3  # control rate in n, 3, rad/s
U_V: Final = 6  # external velocity in n, 3, m/s
U_KV: Final = 9  # damping of level and of vertical velocity, 2, 1/s
U_H: Final = 11  # external height, m
U_KH: Final = 12  # height channel k1 1/s, k2 1/s^2, k3 1/s^3
U_SIZE: Final = 15


def control(
    *,
    north: float = 0.0,
    free: float = 0.0,
    turn: float = 0.0,
    w_c: ArrayLike = (0.0, 0.0, 0.0),
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    velocity_gains: tuple[float, float] = (0.0, 0.0),
    height: float = 0.0,
    height_gains: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Vector:
    """Control vector (U_SIZE,); see the module for what each of its places does.

    ``turn`` rad/s, ``w_c`` (3,) rad/s and ``velocity`` (3,) m/s in n, ``velocity_gains`` 1/s (level,
    vertical), ``height`` m, ``height_gains`` (k1 1/s, k2 1/s^2, k3 1/s^3).
    """
    u = np.zeros(U_SIZE)
    u[U_NORTH], u[U_FREE], u[U_TURN] = north, free, turn
    u[U_WC : U_WC + 3] = w_c
    u[U_V : U_V + 3] = velocity
    u[U_KV : U_KV + 2] = velocity_gains
    u[U_H] = height
    u[U_KH : U_KH + 3] = height_gains
    return u
