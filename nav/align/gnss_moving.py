"""Alignment in motion by GNSS: apparent velocity in the inertial frame.

Yan Gongmin 2008, section 3.3: what the accelerometers integrate to in b0 (eq. (3-26a)) against what velocity,
place and gravity ask for in i0 (eq. (3-26b), recursively from fix to fix, integrated by parts so that no
velocity is differentiated). The accuracy is that of the velocity at single epochs, and a stop has an exact
one: zero. Where a receiver gives no velocity its positions are compared instead, once more integrated, their
lasting error estimated.

With stops the sensors limit heading as at rest. Without, the receiver does: velocities of 0.1 m/s leave 0.07
deg after 330 s of a winding road and 0.13 of a straight one, where the sensors alone leave 0.025. The limit
that is told is that of both, on the motion made so far.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import (
    A_P,
    A_T,
    A_V,
    Inertial,
    Tracker,
    add,
    at,
    attitude,
    change,
    felt,
    inertial,
    reach,
    spin,
    tracker,
    turn,
)
from nav.align.apparent_rest import Rest, standing, stopped
from nav.align.apparent_result import attitude_now, contradiction, handed, poor_gyros, velocity_now
from nav.align.apparent_stage import Taken, blank, due, duration, progress, stepping, without_place
from nav.align.constant import MAT, OFFSET, POS, START, THETA, VEL, WHEEL, Estimate, Solved
from nav.align.epochs import SETTLE_S
from nav.align.handover import Place, imu_place
from nav.align.static import PATIENCE_S
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import earth_rate_g, position_matrix, radii, transport_rate_g
from nav.rotation import quat_from_dcm
from nav.types import FixType, GnssFix, ImuSample, OdoSample, Sample, Vector

START_SPEED: Final = 100.0  # m/s
SPACING_S: Final = 0.45  # fixes that come sooner tell little more
LASTS_S: Final = 200.0  # s that the slow error of GNSS positions lasts
FLEETING: Final = 0.3  # of a position's variance differs from fix to fix; the lasting part is a state
ODD: Final = 30.0  # chi-square of three degrees of freedom of an epoch that is left out
MOST_ODD: Final = 5  # such epochs in a row
LEVER_S: Final = 0.04  # s over which the antenna's swing is taken
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)


class Drive(NamedTuple):
    """State of the stage."""

    config: AlignConfig
    fix: GnssFix | None = None  # the last good one
    waited: float = 0.0
    track: Tracker | None = None
    path: Inertial | None = None
    pending: tuple[GnssFix, ...] = ()
    estimate: Estimate | None = None
    row: Vector | None = None  # at the last epoch
    rest: Rest = Rest()
    odd: int = 0
    solved: Solved | None = None
    status: AlignStatus | None = None
    best: Estimate | None = None  # what could be known by now, see `_best`
    w_in_g: Vector = _ZERO  # rad/s, with the velocity of the last epoch
    v_g: Vector = _ZERO
    place: Place = (0.0, 0.0, 0.0)  # of the antenna at the last epoch
    t_ns: int = 0


def init(config: AlignConfig, given: NavInit | None) -> Drive:
    """Begin with nothing known."""
    return Drive(config)


def _begin(state: Drive, sample: ImuSample) -> Taken[Drive]:
    config, fix = state.config, state.fix
    if fix is None:
        waited = state.waited + sample.dt
        return state._replace(waited=waited), without_place(waited)
    track = tracker(sample.t_ns - round(sample.dt * 1e9))
    sigma = float(np.max(fix.sigma_position))
    far = np.full(3, sigma + float(np.linalg.norm(config.gnss_lever_arm)) + PATIENCE_S)
    start = (fix.lat, fix.lon, fix.height)
    path = inertial(*start)
    # the place at the beginning, a constant, takes the states that an odometer would use
    estimate = constant.begin(config, START_SPEED, sigma, far, sample.dv / sample.dt)
    state = state._replace(
        track=track,
        path=path,
        estimate=estimate,
        row=track.row.copy(),
        rest=Rest(since=0.0, place=path.r_0),
        status=blank(config, start),
        best=_best(estimate),
        # there and back: compiled now, not when it ends
        place=imu_place(start, _ZERO),
    )
    return state, poor_gyros(config, fix.lat, duration(config))


def _best(begun: Estimate) -> Estimate:
    """The same, of which the rotation is known but for one small turn, which may be anything.

    That is linear, so its covariance is the least that any method can have (Cramer, Rao) with this receiver,
    these sensors and the motion that was made: what the nine free elements give away is not in it.
    """
    P = begun.P.copy()
    P[MAT, MAT], P[THETA, THETA] = 0.0, math.pi**2 * _EYE
    return begun._replace(P=P)


def _aid(state: Drive, sample: Sample) -> Taken[Drive]:
    """A fix; an odometer, where there is one, tells stops."""
    if isinstance(sample, GnssFix) and sample.fix_type >= FixType.FIX_3D:
        if state.track is None:
            return state._replace(fix=sample), None
        return _fixes(state._replace(pending=(*state.pending, sample)), state.track)
    if isinstance(sample, OdoSample):
        rolled = (state.rest.rolled or 0.0) + abs(sample.distance)
        state = state._replace(rest=state.rest._replace(rolled=rolled))
    return state, None


def _take(state: Drive, track: Tracker, sample: ImuSample) -> Taken[Drive]:
    assert state.row is not None
    ahead = float(track.row[A_T] + track.waiting[1]) + sample.dt
    # from then on the end may come with any sample
    late = ahead > duration(state.config) - 1e-6
    add(*track, sample.dtheta, sample.dv, sample.dt, sample.t_ns, late)
    reason = None
    if state.pending:
        state, reason = _fixes(state, track)
    assert state.row is not None
    if ahead - float(state.row[A_T]) > PATIENCE_S:
        reason = reason or f"no GNSS for {PATIENCE_S:.0f} s"
    found = None if state.status is None else float(state.status.covariance[2, 2])
    if late and reason is None and found is not None and found < state.config.sigma_heading**2:
        state, reason = _end(state._replace(t_ns=sample.t_ns), track.row)
    return state, reason


def _fixes(state: Drive, track: Tracker) -> Taken[Drive]:
    """Work in the fixes whose time the inertial samples have reached."""

    def age_ns(fix: GnssFix) -> int:
        return 0 if fix.v_g is None else round(state.config.gnss_velocity_age * 1e9)

    reason = None
    found, pending = due(track, state.pending, age_ns)
    while found is not None and reason is None:
        row, fix = found
        state, reason = _epoch(state, track, row, fix.t_ns - age_ns(fix), fix)
        found, pending = due(track, pending, age_ns)
    return state._replace(pending=pending), reason


def _epoch(state: Drive, track: Tracker, row: Vector, t_ns: int, fix: GnssFix) -> Taken[Drive]:
    """One fix: where it puts the motion in i0, and what the filter makes of that."""
    config, path, last, old = state.config, state.path, state.fix, state.row
    assert path is not None
    assert last is not None
    assert old is not None
    assert state.estimate is not None
    assert state.best is not None
    seconds = float(row[A_T])
    dt = seconds - float(old[A_T])
    if dt < SPACING_S:
        return state, None
    place = (fix.lat, fix.lon, fix.height)
    if fix.v_g is not None:
        jump = _jump(last, fix)
        if jump is not None:
            return _odd(state, f"GNSS jumped by {jump:.0f} m against its own velocity")
        place = _moved(place, -config.gnss_velocity_age * fix.v_g)
    was = path
    path, r = reach(was, *place, seconds)
    v_i = None
    since = math.remainder(place[1] - path.lon, 2.0 * math.pi)
    if fix.v_g is not None:
        v_i = turn(seconds) @ (position_matrix(place[0], since) @ fix.v_g) + spin(r)
    walk = 2.0 / LASTS_S * float(fix.sigma_position[0]) ** 2 * _EYE
    e = constant.predict(state.estimate, change(old, row), config, walk, LASTS_S)
    best = constant.predict(state.best, change(old, row), config, walk, LASTS_S)
    settled = seconds > SETTLE_S
    rest, quiet = stopped(state.rest, old, row, turn(seconds).T @ r, fix)
    if quiet:
        H, z, R = standing(rest, config, old, row, was, path, r)
        quiet = not settled or constant.innovation(e, H, z, R).chi2 < ODD
        if quiet:
            e = constant.update(e, H, z, R)
            best = constant.update(best, H, z, R)
    lever = config.gnss_lever_arm
    if v_i is not None:
        assert fix.sigma_velocity is not None
        once, _ = felt(path, r, v_i)
        H = constant.design(once)
        H[:, VEL], H[:, START] = -_EYE, -_EYE
        z = row[A_V : A_V + 3] + _swing(track, row, t_ns, lever)
        sigma = fix.sigma_velocity
    else:
        _, twice = felt(path, r, None)
        H = constant.design(twice)
        H[:, POS], H[:, START], H[:, OFFSET], H[:, WHEEL] = -_EYE, -seconds * _EYE, _EYE, _EYE
        z = row[A_P : A_P + 3] + (attitude(row) - _EYE) @ lever
        sigma = fix.sigma_position * math.sqrt(FLEETING)
    R, noise = _round(row, sigma)
    state = state._replace(path=path, estimate=e, best=best, row=row, rest=rest, place=place)
    if settled and constant.innovation(e, H, z, R).chi2 > ODD:
        return _odd(state, "GNSS jumped: fixes contradict the accelerometers")
    best = constant.update(best, H, z, R)
    state = state._replace(estimate=constant.update(e, H, z, R, noise), best=best, fix=fix, odd=0)
    if not settled:
        assert state.status is not None
        return state._replace(status=state.status._replace(limit=_limit(state), progress=_part(state))), None
    return _solve(state, False)


def _odd(state: Drive, reason: str) -> Taken[Drive]:
    """Leave a fix out; too many in a row are no outliers."""
    return state._replace(odd=state.odd + 1), reason if state.odd + 1 >= MOST_ODD else None


def _jump(last: GnssFix, fix: GnssFix) -> float | None:
    """By how much (m) positions went another way than velocities say, or None where that is their noise."""
    if fix.v_g is None or last.v_g is None:
        return None
    dt = (fix.t_ns - last.t_ns) * 1e-9
    r_m, r_n = radii(math.sin(fix.lat))
    d = np.array(
        [
            math.remainder(fix.lon - last.lon, 2.0 * math.pi) * math.cos(fix.lat) * r_n,
            (fix.lat - last.lat) * r_m,
            fix.height - last.height,
        ]
    )
    miss = d - 0.5 * dt * (fix.v_g + last.v_g)
    slack = 6.0 * np.hypot(fix.sigma_position, last.sigma_position) + 2.0 * dt
    return float(np.linalg.norm(miss)) if bool(np.any(np.abs(miss) > slack)) else None


def _moved(place: Place, d: Vector) -> Place:
    """Place (rad, rad, m) a few metres ``d`` (3,) east, north, up of another."""
    r_m, r_n = radii(math.sin(place[0]))
    east = float(d[0]) / ((r_n + place[2]) * math.cos(place[0]))
    return place[0] + float(d[1]) / (r_m + place[2]), place[1] + east, place[2] + float(d[2])


def _round(row: Vector, sigma: Vector) -> tuple[Vector, Vector]:
    """Covariance (3, 3) in b0 and in i0 of an error as large in all level directions."""
    up = row[A_V : A_V + 3] / np.linalg.norm(row[A_V : A_V + 3])
    level, vertical = float(max(sigma[0], sigma[1])) ** 2, float(sigma[2]) ** 2
    return level * _EYE + (vertical - level) * np.outer(up, up), np.diag([level, level, vertical])


def _swing(track: Tracker, row: Vector, t_ns: int, lever: Vector) -> Vector:
    """Velocity (3,) m/s, b0, of the antenna against the IMU."""
    half = round(0.5 * LEVER_S * 1e9)
    before, after = at(track, t_ns - half), at(track, t_ns + half)
    if before is None:
        return _ZERO
    if after is None:
        after = row
    return np.asarray((attitude(after) - attitude(before)) @ lever / (after[A_T] - before[A_T]))


def _part(state: Drive) -> float:
    """Progress; it may have to wait for fixes that are good enough."""
    assert state.row is not None
    return min(0.99, progress(state.config, float(state.row[A_T])))


def _limit(state: Drive) -> Vector:
    """What cannot be beaten: the level by the sensors, heading by the receiver as well."""
    assert state.status is not None
    assert state.best is not None
    assert state.row is not None
    up = state.row[A_V : A_V + 3] / np.linalg.norm(state.row[A_V : A_V + 3])
    heading = math.sqrt(float(up @ state.best.P[THETA, THETA] @ up))
    return np.append(state.status.limit[0:2], min(math.pi, heading))


def _solve(state: Drive, done: bool) -> Taken[Drive]:
    row, e, path, old = state.row, state.estimate, state.path, state.status
    assert row is not None
    assert e is not None
    assert path is not None
    assert old is not None
    solved = constant.attitude_of_all(e)
    part = 1.0 if done else _part(state)
    if solved is None:
        return state._replace(status=old._replace(limit=_limit(state), progress=part)), None
    since = math.remainder(state.place[1] - path.lon, 2.0 * math.pi)
    C_gb, P_phi = attitude_now(solved, row, path.lat, state.place[0], since)
    v_b0, _ = _velocity(state, solved, row)
    status = AlignStatus(quat_from_dcm(C_gb), P_phi, _limit(state), part, done)
    v_g = C_gb @ attitude(row).T @ v_b0
    lat, _, height = state.place
    w_in_g = earth_rate_g(lat) + transport_rate_g(lat, height, v_g)
    state = state._replace(solved=solved, status=status, v_g=v_g, w_in_g=w_in_g)
    return state, contradiction(e, solved, state.config, path.lat, "GNSS is off")


def _velocity(state: Drive, solved: Solved, row: Vector) -> tuple[Vector, Vector]:
    """Velocity in b0 at a row, and what gravity asks for there in i0."""
    assert state.path is not None
    path, r = reach(state.path, *state.place, float(row[A_T]))
    u, _ = felt(path, r, None)
    return velocity_now(solved, row, u, _ZERO), u


def _end(state: Drive, row: Vector) -> Taken[Drive]:
    """Bring the last epoch's estimate and place to the last sample."""
    assert state.row is not None
    assert state.estimate is not None
    dt = float(row[A_T] - state.row[A_T])
    e = constant.predict(state.estimate, change(state.row, row), state.config, np.zeros((3, 3)), LASTS_S)
    place = _moved(state.place, dt * state.v_g)
    return _solve(state._replace(estimate=e, row=row.copy(), place=place), True)


def finish(state: Drive) -> NavInit:
    """Attitude, velocity, biases and place at the last sample."""
    assert state.solved is not None
    assert state.row is not None
    assert state.path is not None
    assert state.fix is not None
    assert state.status is not None
    C_gb = attitude_now(state.solved, state.row, state.path.lat, state.place[0], 0.0)[0]
    v_b0, u = _velocity(state, state.solved, state.row)
    place = imu_place(state.place, C_gb @ state.config.gnss_lever_arm)
    sigma_p = np.asarray(state.fix.sigma_position, dtype=np.float64)
    start = (state.path.lat, state.path.lon, 0.0)
    return handed(state.config, state.solved, state.row, state.t_ns, start, place, sigma_p, v_b0, u)


def _since(state: Drive) -> tuple[Vector, Vector, Vector]:
    assert state.row is not None
    return state.row, state.w_in_g, _ZERO


GNSS: Final = Stage(init, stepping(_aid, _begin, _take, _since), finish)
