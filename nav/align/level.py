"""Levelling: the vertical and the gyro bias from a standstill that GNSS confirms, heading not known.

What it says of them, and how well, is what gyros and accelerometers agree about (`nav.align.steady`).
Ends when the vehicle moves. A vehicle that is moving already is levelled by its mean specific force, which
is off by its mean acceleration; the covariance says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from nav.align.match_filter import turned_by
from nav.align.preintegrate import DT, R, empty, extend, sample_piece
from nav.align.steady import Steady, Stood, follow, stood
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import EARTH_RATE, ecef
from nav.rotation import quat_from_dcm, quat_multiply
from nav.types import GnssFix, ImuFlag, ImuSample, Sample, Vector

UNKNOWN_HEADING: Final = math.pi
MOVING_LEVEL: Final = 0.2  # rad: a mean acceleration of 2 m/s^2 over the seconds looked at
REST_SPEED: Final = 0.2  # m/s that GNSS may show at rest
MOVING_SPEED: Final = 0.6  # m/s that GNSS must show before the vehicle is taken to move
TURN_RATE: Final = math.radians(1.5)  # mean rate over a fix interval that is not a standstill
TILT: Final = 0.03  # of g: a change of mean specific force that is not a standstill
REMEMBER_S: Final = 60.0  # a longer standstill forgets: the bias of a warming sensor drifts
MOST_WAITING: Final = 500  # fixes without a verdict
SETTLED_S: Final = (2.0, 5.0)
"""Before the last fix at rest nothing is taken for rest: half of the time so far, within these.

A vehicle that drives off is not seen to at once: one that starts smoothly has crept for three seconds and
more when it has the speed that GNSS may show at rest, and what it gained by then tilts the vertical.
"""
MOVING_S: Final = 3.0  # seconds of motion looked at when there was no standstill
_ZERO: Final = np.zeros(3)


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Inertial samples between two fixes: their sums and their rotation, not yet known to be at rest."""

    end_ns: int
    dtheta: Vector
    dv: Vector
    squares: Vector  # (6,) sums of squared rates and specific forces
    samples: int
    piece: Vector


def _chunk() -> _Chunk:
    return _Chunk(0, np.zeros(3), np.zeros(3), np.zeros(6), 0, empty())


@dataclass(frozen=True, slots=True)
class Level:
    """State of the stage: sums over the standstill, and what came after it."""

    config: AlignConfig
    rate: Vector = field(default_factory=lambda: np.zeros(3))  # mean rate and force at rest, b
    force: Vector = field(default_factory=lambda: np.zeros(3))
    variance: Vector = field(default_factory=lambda: np.zeros(6))  # of single samples within a chunk
    seconds: float = 0.0
    steady: Steady = field(default_factory=Steady)
    stood: Stood | None = None
    q_hb: Vector | None = None  # attitude at the last sample, heading arbitrary, where it has stood
    tilt: float = math.inf  # rad^2, variance of its level, at the last fix
    waiting: tuple[_Chunk, ...] = ()
    open: _Chunk = field(default_factory=_chunk)
    fix: GnssFix | None = None
    anchor: GnssFix | None = None  # an earlier fix, for the speed of a receiver that gives none
    moving: bool = False


def init(config: AlignConfig, given: NavInit | None) -> Level:
    """Begin with nothing known."""
    return Level(config)


def step(state: Level, sample: Sample) -> tuple[Level, AlignStatus]:
    """Take an inertial sample or a fix."""
    if isinstance(sample, ImuSample):
        if sample.flags & ImuFlag.GAP:
            state = Level(state.config, fix=state.fix)
        return _with_imu(state, sample), _status(state)
    if isinstance(sample, GnssFix):
        state = _with_fix(state, sample)
    return state, _status(state)


def _with_imu(state: Level, sample: ImuSample) -> Level:
    piece = np.empty_like(state.open.piece)
    sample_piece(sample.dtheta, sample.dv, sample.dt, _ZERO, _ZERO, piece)
    total = state.open.piece.copy()
    extend(total, piece, _ZERO, _ZERO)
    old = state.open
    squares = old.squares + (np.concatenate([sample.dtheta, sample.dv]) / sample.dt) ** 2
    chunk = _Chunk(
        sample.t_ns, old.dtheta + sample.dtheta, old.dv + sample.dv, squares, old.samples + 1, total
    )
    q_hb = state.q_hb
    if q_hb is not None and state.stood is not None:
        q_hb = turned_by(q_hb, sample.dtheta, state.stood.bias, sample.dt)
    return replace(state, open=chunk, q_hb=q_hb)


def _with_fix(state: Level, fix: GnssFix) -> Level:
    if state.fix is not None and fix.t_ns <= state.fix.t_ns:
        return state
    speed, anchor = gnss_speed(fix, state.anchor)
    waiting = (*state.waiting, state.open) if state.open.end_ns else state.waiting
    if len(waiting) > MOST_WAITING:
        # neither at rest nor driving for very long: begin again
        state, waiting = Level(state.config), ()
    state = replace(state, fix=fix, anchor=anchor, open=_chunk(), waiting=waiting)
    if speed is None:
        return state
    if speed > MOVING_SPEED:
        return replace(state, moving=True)
    if speed > REST_SPEED:
        return state
    # what lies before this fix, with a fix at rest on either side, was at rest
    state = replace(state, moving=False)
    left = list(waiting)
    stood = state.seconds + _seconds(left)
    settled_ns = fix.t_ns - round(min(max(0.5 * stood, SETTLED_S[0]), SETTLED_S[1]) * 1e9)
    while left and left[0].end_ns <= settled_ns:
        if _disturbed(state, left[0]):
            if _seconds(left) < state.config.rest_s:
                # driving off, or a push: what was averaged before holds, and the gyros carry it on
                break
            # it stands again: a new average
            state = Level(state.config, fix=fix, anchor=anchor)
        else:
            state = _commit(state, left[0])
        del left[0]
    return _levelled(replace(state, waiting=tuple(left)))


def _levelled(state: Level) -> Level:
    """Attitude at the last sample by what was seen at rest, and how well it is known."""
    config, seen = state.config, stood(state.steady, state.config)
    if seen is None:
        return replace(state, stood=None, q_hb=None, tilt=math.inf)
    since = _since(state, seen.bias)
    after = float(since[DT])
    tilt = seen.tilt + float(np.max(seen.drift)) * after**2 + config.angle_random_walk**2 * after
    q_hb = quat_from_dcm(level_dcm(seen.force) @ since[R].reshape(3, 3))
    return replace(state, stood=seen, q_hb=q_hb, tilt=tilt)


def _since(state: Level, bias: Vector) -> Vector:
    """The piece since the last chunk that was at rest."""
    total = empty()
    for part in (*state.waiting, state.open):
        # all that was seen at rest, the Earth's turning too: the level stays level
        extend(total, part.piece, bias, _ZERO)
    return total


def _rested(state: Level) -> bool:
    """Whether the level is a standstill's: of a second or more, which shows it better than motion would."""
    return state.seconds >= min(1.0, state.config.rest_s) and state.tilt < MOVING_LEVEL**2


def _disturbed(state: Level, chunk: _Chunk) -> bool:
    """Whether somebody moved the vehicle or the IMU."""
    if state.seconds == 0.0:
        return False
    dt = float(chunk.piece[DT])
    turned = float(np.linalg.norm(chunk.dtheta / dt - state.rate)) > TURN_RATE
    force = chunk.dv / dt
    return turned or float(np.linalg.norm(force - state.force)) > TILT * float(np.linalg.norm(force))


def _commit(state: Level, chunk: _Chunk) -> Level:
    dt = float(chunk.piece[DT])
    rate, force = chunk.dtheta / dt, chunk.dv / dt
    seconds = min(state.seconds, REMEMBER_S) + dt
    variance = np.maximum(chunk.squares / chunk.samples - np.concatenate([rate, force]) ** 2, 0.0)
    return replace(
        state,
        rate=state.rate + (rate - state.rate) * (dt / seconds),
        force=state.force + (force - state.force) * (dt / seconds),
        variance=state.variance + (variance - state.variance) * (dt / seconds),
        seconds=seconds,
        steady=follow(state.steady, dt, chunk.dtheta, chunk.dv, REMEMBER_S),
    )


def gnss_speed(fix: GnssFix, anchor: GnssFix | None) -> tuple[float | None, GnssFix | None]:
    """Horizontal speed (m/s) by the receiver, or by displacement since ``anchor``; and the next anchor.

    None while it is not known: the anchor must be a second or more back.
    """
    if fix.v_g is not None:
        return math.hypot(float(fix.v_g[0]), float(fix.v_g[1])), None
    if anchor is None or (dt := (fix.t_ns - anchor.t_ns) * 1e-9) > 5.0:
        return None, fix
    if dt < 1.0:
        return None, anchor
    apart = ecef(fix.lat, fix.lon, 0.0) - ecef(anchor.lat, anchor.lon, 0.0)
    return float(np.linalg.norm(apart)) / dt, fix


def level_dcm(f_b: Vector) -> Vector:
    """C_hb (3, 3) that puts the specific force ``f_b`` (3,) upwards, at an arbitrary heading.

    Works for any attitude: the axis of b that is nearest to level becomes the north of h, projected.
    """
    up = f_b / np.linalg.norm(f_b)
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(up)))] = 1.0
    north = axis - up * (up @ axis)
    north /= np.linalg.norm(north)
    return np.stack([np.cross(north, up), north, up])


def _seconds(chunks: Sequence[_Chunk]) -> float:
    return sum(float(chunk.piece[DT]) for chunk in chunks)


def _motion_seconds(state: Level) -> float:
    return _seconds((*state.waiting, state.open))


def _status(state: Level) -> AlignStatus:
    rested = _rested(state)
    done = state.moving and (rested or _motion_seconds(state) >= MOVING_S)
    level = state.config.accel_bias / 9.8
    tilt = state.tilt if rested else MOVING_LEVEL**2
    return AlignStatus(
        estimate=state.q_hb if rested else None,
        covariance=np.diag([tilt, tilt, UNKNOWN_HEADING**2]),
        limit=np.array([level, level, UNKNOWN_HEADING]),
        progress=min(1.0, state.seconds / state.config.rest_s),
        done=done,
    )


def finish(state: Level) -> NavInit:
    """Attitude at the last inertial sample, heading arbitrary with a sigma that says so."""
    config, fix = state.config, state.fix
    assert fix is not None
    parts = (*state.waiting, state.open)
    rested, seen = _rested(state), state.stood
    if rested and seen is not None:
        C = level_dcm(seen.force)
        since = _since(state, seen.bias)
        after = float(since[DT])
        # the level part of Earth rate points nobody knows where
        unseen = 0.5 * (EARTH_RATE * math.cos(fix.lat)) ** 2
        var = seen.drift + unseen + config.gyro_walk**2 * (state.seconds / 3.0 + after)
        # a sensor better than that unseen part is believed more than the standstill
        weight = config.gyro_bias**2 / (config.gyro_bias**2 + var)
        level_var = state.tilt
        bias = weight * (seen.bias - EARTH_RATE * math.sin(fix.lat) * C[2])
        sigma_bias = np.sqrt(weight * var)
        mounting: Vector | None = C if config.C_vb is None else config.C_vb
    else:
        C = level_dcm(np.sum([part.dv for part in parts], axis=0))
        since = _since(state, _ZERO)
        bias, sigma_bias = np.zeros(3), np.full(3, config.gyro_bias)
        level_var = MOVING_LEVEL**2
        mounting = config.C_vb
    q_hb = quat_from_dcm(C @ since[R].reshape(3, 3))
    known = config.C_vb is not None
    slope = 0.0 if known else config.slope
    return NavInit(
        t_ns=max(part.end_ns for part in parts),
        lat=fix.lat,
        lon=fix.lon,
        height=fix.height,
        v_g=np.zeros(3),
        q_gb=q_hb,
        P_phi=np.diag([level_var, level_var, UNKNOWN_HEADING**2]),
        sigma_v=np.full(3, MOVING_SPEED if rested else 100.0),
        sigma_p=np.asarray(fix.sigma_position),
        gyro_bias=bias,
        accel_bias=np.zeros(3),
        sigma_gyro_bias=sigma_bias,
        sigma_accel_bias=np.full(3, config.accel_bias),
        C_vb=mounting,
        sigma_mounting=None if mounting is None else np.array([slope, slope, 0.0 if known else np.pi]),
        rest_rate=np.sqrt(state.variance[0:3]) if rested else None,
        rest_force=np.sqrt(state.variance[3:6]) if rested else None,
    )


def rotate_heading(q_hb: Vector, psi: float) -> Vector:
    """``q_gb`` of an attitude with arbitrary heading: turned counter-clockwise by ``psi`` (rad) about up."""
    return quat_multiply(np.array([math.cos(0.5 * psi), 0.0, 0.0, math.sin(0.5 * psi)]), q_hb)


LEVEL: Final = Stage(init=init, step=step, finish=finish)
