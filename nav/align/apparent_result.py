"""From the constant rotation to attitude, velocity and their covariance now; what contradicts them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align import constant, handover
from nav.align.apparent import A_T, A_V, C_i0g, attitude
from nav.align.constant import EPS, NAB, START, THETA, VEL, Solved
from nav.align.handover import Place
from nav.align.static import BLIND
from nav.align.types import AlignConfig, NavInit
from nav.earth import EARTH_RATE
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, skew
from nav.types import Vector

IDEAL: Final = 1e-30  # rad/s or m/s^2: no bias at all
LATITUDES: Final = 0.0053  # of gravity, from the equator to a pole
_EYE: Final = np.eye(3)


def _at(part: slice) -> slice:
    """Place of a part of the state in `Solved.P`."""
    return slice(part.start - 6, part.stop - 6)


def attitude_now(
    solved: Solved, row: Vector, start_lat: float, lat: float, lon_since: float
) -> tuple[Vector, Vector]:
    """C_gb (3, 3) and the covariance (3, 3) of phi at a row, ``lon_since`` rad east of the start."""
    C_gb, J = _attitude(solved, row, start_lat, lat, lon_since)
    return C_gb, J @ solved.P @ J.T


def _attitude(
    solved: Solved, row: Vector, start_lat: float, lat: float, lon_since: float
) -> tuple[Vector, Vector]:
    C_gb0 = C_i0g(start_lat, lat, lon_since, float(row[A_T])).T @ solved.C.T
    by_gyros = dcm_from_quat(quat_from_rotvec(solved.x[THETA])) @ attitude(row)
    J = np.zeros((3, len(solved.P)))
    J[:, 0:3], J[:, _at(THETA)] = -C_gb0, C_gb0
    return C_gb0 @ by_gyros, J


def velocity_now(solved: Solved, row: Vector, u: Vector, known: Vector) -> Vector:
    """Velocity over the Earth (3,) in b0: force felt since the start beyond what gravity ``u`` (3,) has it.

    ``known`` (3,) in b0 is what else adds to the integral of force.
    """
    felt = row[A_V : A_V + 3] + solved.x[VEL] + solved.x[START]
    return np.asarray(felt - solved.C @ u - known)


def handed(
    config: AlignConfig,
    solved: Solved,
    row: Vector,
    t_ns: int,
    start: Place,
    place: Place,
    sigma_p: Vector,
    v_b0: Vector,
    u: Vector,
) -> NavInit:
    """State at a row, for an IMU that went from ``start`` to ``place`` (rad, rad, m) at last by ``v_b0``.

    ``v_b0`` (3,) m/s, ``sigma_p`` (3,) m east, north, up; ``u`` as in `velocity_now`.
    """
    since = math.remainder(place[1] - start[1], 2.0 * math.pi)
    C_gb, J_phi = _attitude(solved, row, start[0], place[0], since)
    C_gb0 = -J_phi[:, 0:3]
    J = np.zeros((15, len(solved.P)))
    J[3:6, 0:3] = C_gb0 @ (skew(solved.C @ u) + skew(v_b0))
    J[3:6, _at(VEL)] = J[3:6, _at(START)] = C_gb0
    J[6:9] = J_phi
    J[9:12, _at(EPS)] = J[12:15, _at(NAB)] = _EYE
    P = J @ solved.P @ J.T
    P[0:3, 0:3] = np.diag(sigma_p**2)
    if config.position is None:
        P = handover.under_antenna(P, C_gb @ config.gnss_lever_arm)
    mounting = None if config.C_vb is None else np.full(3, config.sigma_mounting)
    biases = np.concatenate([solved.x[EPS], solved.x[NAB]])
    v_g, q_gb = C_gb0 @ v_b0, quat_from_dcm(C_gb)
    return handover.hand_over(t_ns, place, v_g, q_gb, biases, P, config.C_vb, mounting)


def poor_gyros(config: AlignConfig, lat: float, seconds: float) -> str | None:
    """Why these gyros cannot find heading from the Earth's turning, or None."""
    north = EARTH_RATE * math.cos(lat)
    sigma = math.hypot(config.gyro_bias, config.angle_random_walk / math.sqrt(seconds))
    if sigma <= BLIND * north:
        return None
    return (
        f"gyros good to {math.degrees(sigma) * 3600:.1f} deg/h cannot find heading in an Earth rate of "
        f"{math.degrees(north) * 3600:.1f} deg/h; align in motion"
    )


def contradiction(
    e: constant.Estimate, solved: Solved, config: AlignConfig, lat: float, else_: str = "the base is moved"
) -> str | None:
    """What the nine elements contradict, in words, or None: the latitude, a sensor, or what ``else_`` says.

    They show that one of these is wrong, and not which: a gyro that fails turns gravity as a latitude does.
    Biases far from what they were said to be contradict as well: a wrong latitude is taken for one first.
    """
    biases = (solved.x[EPS] / max(config.gyro_bias, IDEAL), solved.x[NAB] / max(config.accel_bias, IDEAL))
    if solved.misfit + float(np.sum(np.square(biases))) <= constant.MISFIT:
        return None
    M = constant.unshrunk(e, solved.C)[constant.MAT].reshape(3, 3)
    up, east = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    out = []
    for u in (up, east):
        v = M @ u
        H = constant.design(u)
        size = float(np.linalg.norm(v))
        out.append((size, math.sqrt(float(v @ H @ e.P @ H.T @ v)) / size))
    (gravity, sigma_gravity), (turn, sigma_turn) = out
    causes = f"the latitude, a gyro or an accelerometer is wrong, or {else_}"
    if abs(gravity - 1.0) > max(LATITUDES, 5.0 * sigma_gravity):
        return (
            f"specific force is {gravity:.4f} of gravity: an accelerometer is stuck or badly calibrated, "
            f"a gyro failed, or {else_}"
        )
    if abs(turn - 1.0) > 5.0 * sigma_turn or abs(gravity - 1.0) > 5.0 * sigma_gravity:
        return (
            f"gravity is {gravity:.5f} of, and turns {turn:.3f} times as fast as, that at latitude "
            f"{math.degrees(lat):.2f} deg: {causes}"
        )
    return f"gravity does not turn as it does here: {causes}"
