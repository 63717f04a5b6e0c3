"""Stops on the way: how they are told, and what a standstill from one fix to the next says of velocity."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import A_P, A_T, A_V, Inertial, attitude, change, felt, turn
from nav.align.constant import START
from nav.align.types import AlignConfig
from nav.rotation import quat_from_dcm, rotvec_from_quat
from nav.types import GnssFix, Vector

QUIET_RATE: Final = math.radians(0.1)  # rad/s
QUIET_FORCE: Final = 0.03  # m/s^2, change from epoch to epoch
QUIET_S: Final = 2.5  # s of both before it may be a stop
CREEP: Final = 0.1  # m/s that a velocity may show at rest
CREPT: Final = 1.0  # m that positions may go in a stop
SWAY_S: Final = 0.05  # displacement over velocity of a vehicle that stands
REST: Final = 0.003  # m/s, of a stop whose sway is not known
FEWEST: Final = 3  # differences that tell it
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)


class Rest(NamedTuple):
    """What tells a stop: since when inertial sensors are quiet, and where that was."""

    force: Vector = _ZERO  # of the last epoch, m/s^2, b
    since: float = math.inf  # s
    place: Vector = _ZERO  # m, Earth-fixed axes of the start
    rolled: float | None = None  # m since the last epoch, where there is an odometer
    means: tuple[tuple[float, Vector], ...] = ()  # times and mean apparent velocities of the last intervals
    squares: tuple[float, ...] = ()  # m^2/s^2, of what a mean differs from a straight line


def stopped(rest: Rest, old: Vector, row: Vector, r_e: Vector, fix: GnssFix) -> tuple[Rest, bool]:
    """Whether the vehicle has stood since the last epoch ``old``, and what is to be remembered for the next.

    ``r_e`` (3,) m where ``fix`` puts it, in Earth-fixed axes.
    """
    seconds = float(row[A_T])
    C_old, C = attitude(old), attitude(row)
    dt = seconds - float(old[A_T])
    force = C.T @ (row[A_V : A_V + 3] - old[A_V : A_V + 3]) / dt
    rate = float(np.linalg.norm(rotvec_from_quat(quat_from_dcm(C_old.T @ C)))) / dt
    steady = seconds < 2.0 * dt or float(np.linalg.norm(force - rest.force)) < QUIET_FORCE
    rolled = None if rest.rolled is None else 0.0
    if rate >= QUIET_RATE or not steady:
        return Rest(force, rolled=rolled), False
    begin, place = (rest.since, rest.place) if math.isfinite(rest.since) else (seconds, r_e)
    new = _swaying(rest._replace(force=force, since=begin, place=place, rolled=rolled), old, row)
    if rest.rolled is not None:
        return new, rest.rolled == 0.0
    if fix.v_g is not None and fix.sigma_velocity is not None:
        speed = float(np.linalg.norm(fix.v_g[0:2]))
        return new, speed < CREEP + 3.0 * float(np.max(fix.sigma_velocity[0:2]))
    gone = float(np.linalg.norm(r_e - place))
    limit = CREPT + 0.5 * float(np.max(fix.sigma_position[0:2]))
    return new, seconds - begin > QUIET_S and gone < limit


def _mean(old: Vector, row: Vector) -> Vector:
    return np.asarray((row[A_P : A_P + 3] - old[A_P : A_P + 3]) / (row[A_T] - old[A_T]))


def _swaying(rest: Rest, old: Vector, row: Vector) -> Rest:
    """See how far the mean velocities of three intervals are off a straight line, which gravity gives."""
    means = (*rest.means, (0.5 * float(old[A_T] + row[A_T]), _mean(old, row)))[-3:]
    if len(means) < 3:
        return rest._replace(means=means)
    (t_0, v_0), (t_1, v_1), (t_2, v_2) = means
    part = (t_1 - t_0) / (t_2 - t_0)
    off = v_1 - (1.0 - part) * v_0 - part * v_2
    square = float(off @ off) / (3.0 * (1.0 + part**2 + (1.0 - part) ** 2))
    return rest._replace(means=means, squares=(*rest.squares, square))


def standing(
    rest: Rest, config: AlignConfig, old: Vector, row: Vector, was: Inertial, path: Inertial, r: Vector
) -> tuple[Vector, Vector, Vector]:
    """H (3, SIZE), z (3,) and R (3, 3) of H x = z + noise, for a vehicle that stood from ``old`` to ``row``.

    A sway goes to and fro, so its mean velocity over the interval is much nearer to zero than that at an
    instant. ``was`` and ``path`` are at the two epochs, ``r`` (3,) m the place at the second.
    """
    dt, velocity = float(row[A_T] - old[A_T]), _mean(old, row)
    r_old = turn(was.seconds) @ (turn(path.seconds).T @ r)
    u = (felt(path, r, None)[1] - felt(was, r_old, None)[1]) / dt
    H = constant.design(u)
    H -= constant.meanwhile(change(old, row))
    H[:, START] -= _EYE
    least = 2.0 * (config.sway * SWAY_S / dt) ** 2 + config.velocity_random_walk**2 * dt / 3.0
    if len(rest.squares) < FEWEST:
        return H, velocity, max(config.sway, REST) ** 2 * _EYE
    return H, velocity, max(least, sum(rest.squares) / len(rest.squares)) * _EYE
