"""The psi-angle error model, how it is tied to the phi-angle model, and what alignment can see of it.

States: position ``dr`` (m), velocity ``dv`` (m/s) and psi (rad), *computed minus true*, all differences of
vectors written in the computed frame c: nothing is compared that stands in two frames. psi is the turn from
c to the frame the computed attitude stands for, ``C_pc = I - [psi x]``. The equations are those of vectors
and hold in any level frame, geographic or wander-azimuth; the source writes them in north, east, down.

With ``dtheta = D dr`` the turn from the true frame to c (`nav.errors.geographic.frame_turn`):
``phi = psi + dtheta`` and ``dv_phi = dv_psi - dtheta x v``. The source has the first relation alone, eq.
(2.2.13); without the second the two models disagree as soon as the vehicle moves.

Source: the excerpt on psi-angle and phi-angle error models, eqs. (2.2.1) to (2.2.19); Groves, 2nd ed., 14.2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav import earth
from nav.errors.geographic import frame_turn, gravity_change, metres_to_angles
from nav.filter.states import PHI, POSITION, VELOCITY
from nav.rotation import skew

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def psi_dynamics(w_ie_n: ArrayLike, w_en_n: ArrayLike, f_n: ArrayLike, gradient_n: ArrayLike) -> Matrix:
    """F (9, 9) of ``d(dx)/dt = F dx + G e``; G is that of the phi form, `geographic.sensor_inputs`.

    ``w_ie_n``, ``w_en_n`` (3,) rad/s Earth and transport rate, ``f_n`` (3,) m/s^2 specific force,
    ``gradient_n`` (3, 3) 1/s^2 change of the gravity vector per metre. Excerpt, eq. (2.2.1).
    """
    w_ie, w_en = np.asarray(w_ie_n, dtype=np.float64), np.asarray(w_en_n, dtype=np.float64)
    F = np.zeros((9, 9))
    F[POSITION, POSITION] = -skew(w_en)
    F[POSITION, VELOCITY] = np.eye(3)
    F[VELOCITY, POSITION] = gradient_n
    F[VELOCITY, VELOCITY] = -skew(2.0 * w_ie + w_en)
    F[VELOCITY, PHI] = skew(f_n)
    F[PHI, PHI] = -skew(w_ie + w_en)
    return F


def gravity_gradient(lat: float, height: float) -> Matrix:
    """Change (3, 3), 1/s^2, of the normal gravity *vector* with a displacement in metres, in g.

    The excerpt's is that of a sphere, diag(-g/R, -g/R, 2 g/R) in east, north, up.
    """
    components = gravity_change(lat, height) @ metres_to_angles(lat, height)
    # a vector of constant components in a frame that turns by D dr
    return components - skew(earth.gravity_g(lat, height)) @ frame_turn(lat, height)


def phi_from_psi(turn: ArrayLike, v_n: ArrayLike) -> Matrix:
    """T (9, 9): states of the psi form to states of the phi form, positions left in metres.

    ``turn`` (3, 3) is D in ``dtheta = D dr`` of the frame in use: `geographic.frame_turn`, or the same
    without its last row where the true frame is defined by the shortest turn, as in `nav.errors.model`.
    ``v_n`` (3,) m/s. Excerpt, eq. (2.2.13), and the velocity's part as the head of this module has it.
    """
    D = np.asarray(turn, dtype=np.float64)
    T = np.eye(9)
    T[VELOCITY, POSITION] = skew(v_n) @ D
    T[PHI, POSITION] = D
    return T


def alignment_dynamics(lat: float, gravity: float, vertical: bool = False) -> Matrix:
    """F of an alignment at rest: velocity and psi, with constant sensor errors as further states.

    In east, north, up: velocity, psi, accelerometer errors (m/s^2), drifts of a platform (rad/s). 12
    states with the ``vertical`` velocity and accelerometer, else 10. Velocity, which comes first, is what is
    measured. ``lat`` rad, ``gravity`` m/s^2. Excerpt, eqs. (2.2.7) and (2.2.9).
    """
    zero = np.zeros(3)
    nav = psi_dynamics(earth.earth_rate_g(lat), zero, np.array([0.0, 0.0, gravity]), np.zeros((3, 3)))[3:, 3:]
    F = np.zeros((12, 12))
    F[:6, :6] = nav
    F[:6, 6:] = np.eye(6)
    keep = [i for i in range(12) if vertical or i not in (2, 8)]
    return F[np.ix_(keep, keep)]


def observability_rank(F: ArrayLike, measured: int, seconds: float) -> int:
    """Rank of the observability matrix of ``F`` (n, n) with its first ``measured`` states measured.

    ``F`` is taken per ``seconds``; with a time in which the states move each other by their own size the
    rank is not hidden by units, so scale the states before (``S F S^-1``).
    """
    A = np.asarray(F, dtype=np.float64) * seconds
    rows = np.eye(len(A))[:measured]
    stack = []
    for _ in range(len(A)):
        stack.append(rows)
        rows = rows @ A
    return int(np.linalg.matrix_rank(np.vstack(stack), tol=1e-9))


def alignment_limit(
    lat: float, gravity: float, accel: tuple[float, float], gyro_east: float
) -> tuple[float, float, float]:
    """Misalignment (rad about east, north, up) that alignment at rest ends with, whatever its filter.

    ``accel`` (east, north) m/s^2 and ``gyro_east`` rad/s are constant errors; the drift is that of a
    platform, so enter a strapdown gyro's output error with the opposite sign. "Inertial navigation", eq.
    (2-104); the signs it prints for the level angles belong to accelerometers that read gravity.
    """
    tilt = accel[0] / gravity
    level = earth.EARTH_RATE * math.cos(lat)
    return -accel[1] / gravity, tilt, gyro_east / level + tilt * math.tan(lat)
