"""The gyrocompass loops on paper: gains, poles, the error model, what constant and drifting sensors leave.

Yan Gongmin 2008, section 2.3. Errors are those of `nav.align.types`: true C_gb = (I + [phi x]) computed; the
sensors' errors are output minus truth, and a strapdown gyro's turns the computed attitude with the opposite
sign of a platform's. The report's loops are drawn for a platform; its signs of gyro errors are changed here.

A loop runs backwards in time when its ``sigma`` is negative: odd gains change their sign, even ones stay, and
the poles -sigma have the loop decay on the way back.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav.earth import EARTH_RATE, curvature, normal_gravity

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DAMPING: Final = math.sqrt(0.5)

# States of the linear model: velocity east, north (m/s), phi (rad), integrator of the east loop (rad/s), and
# that of the north loop, or in its place the azimuth loop's control rate (rad/s).
V_E: Final = 0
V_N: Final = 1
PHI: Final = slice(2, 5)
P_E: Final = 5
P_N: Final = 6
W_U: Final = 7
STATES: Final = 8
# Inputs: errors of gyros (rad/s) and accelerometers (m/s^2), east, north, up; a motion of the base that the
# loop takes for an error of its velocity (m/s east, north).
EPS: Final = slice(0, 3)
NABLA: Final = slice(3, 6)
BASE: Final = slice(6, 8)
INPUTS: Final = 8


class Place(NamedTuple):
    """What the loops feel of the Earth: rates north and up (rad/s), gravity (m/s^2), curvatures (1/m)."""

    north: float
    up: float
    gravity: float
    along_east: float
    along_north: float


def place(lat: float, height: float) -> Place:
    """The Earth at ``lat`` (rad) and ``height`` (m)."""
    s, c = math.sin(lat), math.cos(lat)
    east, _, north = curvature(0.0, c, s, height)
    return Place(EARTH_RATE * c, EARTH_RATE * s, normal_gravity(s, height), east, north)


def decay(period: float, damping: float = DAMPING) -> float:
    """sigma (1/s) of a damped period T_d (s): eq. (2-11)."""
    return 2.0 * math.pi / period * damping / math.sqrt(1.0 - damping * damping)


class LevelGains(NamedTuple):
    """K_1 (1/s), (1 + K_2)/R (1/m) and K_3 (1/(m s)) of a third-order levelling loop."""

    k1: float
    k2: float
    k3: float


def level_gains(sigma: float, gravity: float, damping: float = DAMPING) -> LevelGains:
    """Gains for poles -sigma and those of s^2 + 2 sigma s + sigma^2/xi^2: eq. (2-10a).

    (1 + K_2)/R is given whole: in it the radius cancels.
    """
    inverse = 1.0 / (damping * damping)
    return LevelGains(3.0 * sigma, sigma**2 * (2.0 + inverse) / gravity, sigma**3 * inverse / gravity)


class AzimuthGains(NamedTuple):
    """K_U1 (1/s), (1 + K_U2)/R (1/m), K_U3 (1/(m s^2)) and K_U4 (1/s) of the azimuth loop.

    K(s) = K_U3/(w_N (s + K_U4)): eq. (2-9).
    """

    k1: float
    k2: float
    k3: float
    k4: float


def azimuth_gains(sigma: float, gravity: float) -> AzimuthGains:
    """Gains for two pairs of poles of s^2 + 2 sigma s + 2 sigma^2: eq. (2-10b)."""
    return AzimuthGains(2.0 * sigma, 4.0 * sigma**2 / gravity, 4.0 * sigma**4 / gravity, 2.0 * sigma)


def dynamics(
    at: Place, level: LevelGains, azimuth: AzimuthGains | None, coupled: bool = True
) -> tuple[Matrix, Matrix]:
    """F (8, 8) and G (8, 8) of ``dx/dt = F x + G e`` for the states and inputs named above.

    With ``azimuth`` None both level channels are of third order and azimuth is left alone: figs. 2-1 and
    2-2; else the north channel is that of fig. 2-3. Without ``coupled`` the channels are those drawn there;
    with it the Earth's rate couples them as it does in the loops that run.
    """
    g = at.gravity
    F, G = np.zeros((STATES, STATES)), np.zeros((STATES, INPUTS))
    e, n, u = range(2, 5)
    F[V_E, n], F[V_N, e] = -g, g
    F[e, u] = -at.north
    if coupled:
        F[e, n], F[n, e], F[u, e] = at.up, -at.up, at.north
    G[V_E, 3], G[V_N, 4] = 1.0, 1.0
    G[PHI, EPS] = -np.eye(3)
    F[V_E, V_E] = -level.k1
    F[n, V_E], F[n, P_E], F[P_E, V_E] = level.k2, 1.0, level.k3
    if azimuth is None:
        F[V_N, V_N] = -level.k1
        F[e, V_N], F[e, P_N], F[P_N, V_N] = -level.k2, -1.0, level.k3
        if not coupled:
            F[e, u] = 0.0
    else:
        F[V_N, V_N] = -azimuth.k1
        F[e, V_N] = -azimuth.k2
        F[u, W_U], F[W_U, V_N], F[W_U, W_U] = 1.0, azimuth.k3 / at.north, -azimuth.k4
    # what the loop knows of its velocity is wrong by that of the base
    G[:, BASE] = F[:, [V_E, V_N]]
    return F, G


def states_of(azimuth: bool) -> list[int]:
    """The states that are in use: with the azimuth loop, or with level channels alone (azimuth is free)."""
    return [V_E, V_N, 2, 3, 4, P_E, W_U] if azimuth else [V_E, V_N, 2, 3, P_E, P_N]


def poles(at: Place, level: LevelGains, azimuth: AzimuthGains | None, coupled: bool = False) -> Vector:
    """Eigenvalues (7,), or (6,) without azimuth, of the loops as drawn, complex, 1/s."""
    F, _ = dynamics(at, level, azimuth, coupled)
    used = states_of(azimuth is not None)
    return np.asarray(np.linalg.eigvals(F[np.ix_(used, used)]))


def steady(F: Matrix, G: Matrix, e: ArrayLike, azimuth: bool = True) -> Vector:
    """The state (8,) in which the loops come to rest under constant inputs ``e`` (8,)."""
    used = states_of(azimuth)
    x = np.zeros(STATES)
    x[used] = np.linalg.solve(F[np.ix_(used, used)], -G[used] @ np.asarray(e, dtype=np.float64))
    return x


def following(F: Matrix, G: Matrix, slope: ArrayLike, azimuth: bool = True) -> tuple[Vector, Vector]:
    """Under inputs ``slope`` (8,) times t the state ends as the first (8,) returned plus t the second."""
    rate = steady(F, G, slope, azimuth)
    used = states_of(azimuth)
    x = np.zeros(STATES)
    x[used] = np.linalg.solve(F[np.ix_(used, used)], rate[used])
    return x, rate


def constant_errors(at: Place, sigma: float, eps: ArrayLike, nabla: ArrayLike) -> Vector:
    """phi (3,), rad, that constant errors of gyros (3,) and accelerometers (3,) leave: eq. (2-12).

    The strapdown form: the signs of the gyros' are opposite to those printed. The channels as drawn.
    """
    eps, nabla = np.asarray(eps, dtype=np.float64), np.asarray(nabla, dtype=np.float64)
    g = at.gravity
    return np.array([-nabla[1] / g, nabla[0] / g, -eps[0] / at.north - 2.0 / sigma * eps[2]])


def ramp_errors(
    at: Place, period: float, level_period: float, eps_slope: ArrayLike, nabla_slope: ArrayLike, eps_up: float
) -> Vector:
    """phi (3,), rad, beyond the constant parts: eqs. (2-14), (2-15') and (2-17), strapdown signs.

    ``eps_slope`` (3,) rad/s^2 and ``nabla_slope`` (3,) m/s^3 of errors that grow, ``eps_up`` rad/s a constant
    error of the vertical gyro; ``period`` and ``level_period`` s of the azimuth and the level loops. Azimuth
    follows the slope of the north accelerometer with a plus, where (2-17) prints a minus.
    """
    eps_slope = np.asarray(eps_slope, dtype=np.float64)
    square = (period / (2.0 * math.pi)) ** 2
    phi_e = -square * eps_slope[0] + square * at.north * eps_up
    phi_n = -1.5 * (level_period / (2.0 * math.pi)) ** 2 * eps_slope[1]
    return np.array([phi_e, phi_n, float(np.asarray(nabla_slope)[1]) / (at.gravity * at.north)])


def speed_error(at: Place, v_n: float) -> float:
    """phi_U (rad) that an error ``v_n`` (m/s) of the reference velocity's north part makes: eq. (2-47)."""
    return -v_n * at.along_north / at.north
