"""Heading from motion: collects fixes and the motion between them, until the fit is good enough.

For sensors that cannot see Earth rate; the mathematics is in `nav.align.fit`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from nav.align.driven import solve_driven
from nav.align.fit import POSITION_FLOOR, VELOCITY_FLOOR, Epoch, Fit, Window, carried, solve, velocities
from nav.align.level import UNKNOWN_HEADING
from nav.align.match_filter import turned_by
from nav.align.mounting import Mounting, find_mounting, mounting_from_axis
from nav.align.preintegrate import DT, SIZE, P, R, V, empty, extend, sample_piece
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import convergence, earth_rate_g, ecef, gravity_g, position_quat, xyz_to_geodetic
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, quat_rotate
from nav.types import GnssFix, ImuFlag, ImuSample, Sample, SpeedSample, Vector

LONGEST_SILENCE: Final = 10.0  # s without a fix before starting again
SOLVE_EVERY: Final = 0.5  # s
FEWEST_FIXES: Final = 5
LONGEST_WINDOW_FIXES: Final = 400
MOUNTING_LIMIT: Final = math.radians(4.0)
SPEED_EVERY_NS: Final = 90_000_000  # more is not kept
SPEED_BEFORE_NS: Final = 3_000_000_000  # of the window's first fix
AROUND_S: Final = 0.02  # s before and after a fix over which its rate is taken
_ZERO: Final = np.zeros(3)


class Match(NamedTuple):
    """State of the stage."""

    window: Window
    status: AlignStatus
    pending: deque[ImuSample]
    imu_ns: int
    last_ns: int  # the last fix taken, or the hand-over
    rate: Vector  # (3,) rad/s of gyros that do not turn in g
    started: bool = False  # the window has its first fix
    queue: tuple[GnssFix, ...] = ()
    solved_ns: int = 0
    fit: Fit | None = None
    mounting: Mounting | None = None


def init(config: AlignConfig, given: NavInit | None) -> Match:
    """Begin from levelling's result."""
    assert given is not None
    window = Window(config, given, empty())
    return Match(window, _status(window, None, None), deque(), given.t_ns, given.t_ns, given.gyro_bias)


def step(state: Match, sample: Sample) -> tuple[Match, AlignStatus]:
    """Take an inertial sample or a fix."""
    if isinstance(sample, ImuSample):
        if sample.flags & ImuFlag.GAP:
            return _refuse(state, "inertial samples are missing: the motion before them is lost")
        if (sample.t_ns - state.last_ns) * 1e-9 > LONGEST_SILENCE:
            return _refuse(state, f"no GNSS fix for {LONGEST_SILENCE:.0f} s while aligning in motion")
        state.pending.append(sample)
        status = state.status
        if status.estimate is not None:
            now = turned_by(status.estimate, sample.dtheta, state.rate, sample.dt)
            status = status._replace(estimate=now)
        state = state._replace(imu_ns=sample.t_ns, status=status)
    elif isinstance(sample, GnssFix):
        state = state._replace(queue=(*state.queue, sample)[-16:])
    elif isinstance(sample, SpeedSample):
        state = state._replace(window=_with_speed(state.window, sample))
    while state.queue and state.queue[0].t_ns + _around_ns(state.pending) <= state.imu_ns:
        fix, state = state.queue[0], state._replace(queue=state.queue[1:])
        if fix.t_ns > state.last_ns:
            state = _close(state, fix)._replace(last_ns=fix.t_ns)
    return state, state.status


def _with_speed(window: Window, sample: SpeedSample) -> Window:
    since_ns = window.epochs[0].fix.t_ns if window.epochs else sample.t_ns
    if window.speeds and sample.t_ns < window.speeds[-1].t_ns + SPEED_EVERY_NS:
        return window
    kept = tuple(s for s in window.speeds if s.t_ns > since_ns - SPEED_BEFORE_NS)
    return replace(window, speeds=(*kept, sample))


def _refuse(state: Match, reason: str) -> tuple[Match, AlignStatus]:
    return state, state.status._replace(done=False, refusal=reason)


def _close(state: Match, fix: GnssFix) -> Match:
    """End the open interval at a fix, and solve when it is time."""
    window = state.window
    gyro_bias = window.given.gyro_bias
    rate = rate_at(state.pending, fix.t_ns) - gyro_bias
    piece = _cut(state.pending, fix.t_ns, gyro_bias)
    window = replace(window, epochs=(*window.epochs, Epoch(fix, piece, rate)))
    if not state.started:
        # bring the level attitude from the hand-over to the first fix
        return state._replace(started=True, window=_shift(window))
    while len(window.epochs) > LONGEST_WINDOW_FIXES or _seconds(window.epochs) > window.config.window_s:
        window = _shift(replace(window, epochs=window.epochs[1:]))
    state = state._replace(window=window)
    if len(window.epochs) < FEWEST_FIXES or (fix.t_ns - state.solved_ns) * 1e-9 < SOLVE_EVERY:
        return state
    # a receiver's velocity shows more than a speed; without it speeds are far better than positions alone
    driven = window.speeds and any(e.fix.v_g is None for e in window.epochs)
    fit = solve_driven(window) if driven else solve(window)
    mounting = None if fit is None else _mounting(window, fit)
    status, rate = _status(window, fit, mounting), state.rate
    if fit is not None and status.estimate is not None:
        # what it says holds for the last sample
        rate = window.given.gyro_bias + fit.x[0:3] + fit.C_end.T @ earth_rate_g(fix.lat)
        now = status.estimate
        for sample in state.pending:
            now = turned_by(now, sample.dtheta, rate, sample.dt)
        status = status._replace(estimate=now)
    return state._replace(solved_ns=fix.t_ns, fit=fit, mounting=mounting, status=status, rate=rate)


def _seconds(epochs: tuple[Epoch, ...]) -> float:
    return (epochs[-1].fix.t_ns - epochs[0].fix.t_ns) * 1e-9


def _shift(window: Window) -> Window:
    """Carry what was given over the first epoch's piece, whose end becomes the window's start."""
    before = window.before.copy()
    extend(before, window.epochs[0].piece, _ZERO, _ZERO)
    return replace(window, before=before)


def _around_ns(samples: Sequence[ImuSample]) -> int:
    """Half of the time (ns) that a rate is the mean of: of one sample at least, in whose middle it holds."""
    return round(max(AROUND_S, 0.5 * samples[-1].dt if samples else 0.0) * 1e9)


def rate_at(samples: Sequence[ImuSample], t_ns: int) -> Vector:
    """w_ib_b (3,) rad/s at ``t_ns`` by the ``samples`` around it: their mean over as long on either side.

    A mean of what came before alone is late by half of its time, and an antenna that swings is then off by
    how fast its velocity changes.
    """
    turned, seconds = np.zeros(3), 0.0
    if samples:
        half = min(_around_ns(samples), t_ns - _begin_ns(samples[0]), samples[-1].t_ns - t_ns)
        for sample in samples:
            begin_ns = _begin_ns(sample)
            part = min(sample.t_ns, t_ns + half) - max(begin_ns, t_ns - half)
            if part > 0:
                share = part / (sample.t_ns - begin_ns)
                turned, seconds = turned + share * sample.dtheta, seconds + share * sample.dt
    return turned / seconds if seconds > 0.0 else turned


def _begin_ns(sample: ImuSample) -> int:
    return sample.t_ns - round(sample.dt * 1e9)


def _cut(pending: deque[ImuSample], t_ns: int, gyro_bias: Vector) -> Vector:
    """Take the samples up to ``t_ns`` out of ``pending``: their piece.

    A sample that straddles ``t_ns`` is divided in proportion.
    """
    total, piece = empty(), np.empty(SIZE)
    while pending:
        sample = pending[0]
        begin_ns = _begin_ns(sample)
        if begin_ns >= t_ns:
            break
        pending.popleft()
        part = 1.0
        if sample.t_ns > t_ns:
            part = (t_ns - begin_ns) / (sample.t_ns - begin_ns)
            rest = 1.0 - part
            pending.appendleft(
                sample._replace(dt=rest * sample.dt, dtheta=rest * sample.dtheta, dv=rest * sample.dv)
            )
        sample_piece(part * sample.dtheta, part * sample.dv, part * sample.dt, gyro_bias, _ZERO, piece)
        extend(total, piece, _ZERO, _ZERO)
        if part < 1.0:
            break
    return total


def _mounting(window: Window, fit: Fit) -> Mounting | None:
    C_gb = fit.C @ fit.rows[:, R].reshape(-1, 3, 3)
    rates = np.array([e.rate for e in window.epochs])
    fixes = [e.fix for e in window.epochs]
    if all(f.v_g is not None for f in fixes):
        v = velocities(fixes)
    else:
        v = (
            fit.x[6:9]
            + (fit.C @ fit.rows[:, V].T).T
            + fit.rows[:, DT, None] * gravity_g(fixes[0].lat, fixes[0].height)
        )
    given = window.given
    if given.C_vb is not None and given.sigma_mounting is not None:
        up_b, sigma_up = given.C_vb[2], float(given.sigma_mounting[1])
    else:
        # never seen at rest: the mean vertical of the drive so far, as good as roads and suspension are level
        up_b = np.mean(C_gb[:, 2, :], axis=0)
        up_b, sigma_up = up_b / np.linalg.norm(up_b), math.hypot(0.05, window.config.slope)
    if fit.forward is not None and fit.forward_cov is not None:
        return mounting_from_axis(fit.forward, fit.forward_cov, up_b, sigma_up)
    rate_up = np.einsum("kj,kj->k", C_gb[:, 2, :], rates)
    return find_mounting(C_gb, v, rate_up, up_b, sigma_up, VELOCITY_FLOOR, math.sqrt(float(fit.cov[2, 2])))


def _status(window: Window, fit: Fit | None, mounting: Mounting | None) -> AlignStatus:
    config = window.config
    level = config.accel_bias / 9.8
    if fit is None:
        unknown = np.diag([level**2, level**2, UNKNOWN_HEADING**2])
        return AlignStatus(None, unknown, np.array([level, level, UNKNOWN_HEADING]), 0.0, False)
    sigma = math.sqrt(float(fit.cov[2, 2]))
    # the heading of b in v enters the vehicle's heading like the alignment's own error
    mounted = config.C_vb is not None or (
        mounting is not None and float(mounting.sigma[2]) < max(MOUNTING_LIMIT, 1.5 * config.sigma_heading)
    )
    first, last = window.epochs[0].fix, window.epochs[-1].fix
    turned = _about_up(float(convergence(first.lat, first.lon, last.lat, last.lon)))
    return AlignStatus(
        estimate=quat_from_dcm(turned @ fit.C_end) if fit.trusted else None,
        covariance=turned @ fit.cov[0:3, 0:3] @ turned.T,
        limit=np.array([level, level, fit.formal]),
        progress=min(1.0, config.sigma_heading / sigma) * (1.0 if mounted else 0.9),
        done=fit.trusted and sigma < config.sigma_heading and mounted,
    )


def finish(state: Match) -> NavInit:
    """Carry the fit to the last inertial sample."""
    fit, window = state.fit, state.window
    config, given = window.config, window.given
    assert fit is not None
    first, last = window.epochs[0].fix, window.epochs[-1].fix
    after, piece = empty(), np.empty(SIZE)
    for sample in state.pending:
        sample_piece(sample.dtheta, sample.dv, sample.dt, given.gyro_bias + fit.x[0:3], fit.x[3:6], piece)
        extend(after, piece, _ZERO, _ZERO)
    g, w_ie, dt = gravity_g(last.lat, last.height), earth_rate_g(last.lat), float(after[DT])
    C = dcm_from_quat(quat_from_rotvec(-dt * w_ie)) @ fit.C_end @ after[R].reshape(3, 3)
    v = fit.v_end + fit.C_end @ after[V] + dt * (g - 2.0 * np.cross(w_ie, fit.v_end))
    step_g = fit.v_end * dt + fit.C_end @ after[P] + 0.5 * dt**2 * g - fit.C_end @ config.gnss_lever_arm
    # all of this is along east and north as they were at the window's first fix
    step_g = _about_up(float(convergence(first.lat, first.lon, last.lat, last.lon))) @ step_g
    q_eg = position_quat(last.lat, last.lon)
    place = xyz_to_geodetic(*(ecef(last.lat, last.lon, last.height) + quat_rotate(q_eg, step_g)))
    turned = _about_up(float(convergence(first.lat, first.lon, place[0], place[1])))
    if config.C_vb is not None:
        C_vb, sigma_mounting = config.C_vb, np.zeros(3)
    else:
        assert state.mounting is not None
        C_vb, sigma_mounting = state.mounting.C_vb, state.mounting.sigma
    cov = _covariance(fit, after, turned, last)
    sigma = np.sqrt(np.diag(cov))
    return NavInit(
        t_ns=state.imu_ns,
        lat=place[0],
        lon=place[1],
        height=place[2],
        v_g=turned @ v,
        q_gb=quat_from_dcm(turned @ C),
        P_phi=cov[6:9, 6:9].copy(),
        sigma_v=sigma[3:6],
        sigma_p=sigma[0:3],
        gyro_bias=given.gyro_bias + fit.x[0:3],
        accel_bias=given.accel_bias + fit.x[3:6],
        sigma_gyro_bias=sigma[9:12],
        sigma_accel_bias=sigma[12:15],
        C_vb=C_vb,
        sigma_mounting=sigma_mounting,
        P=cov,
        rest_rate=given.rest_rate,
        rest_force=given.rest_force,
    )


def _about_up(angle: float) -> Vector:
    """Components (3, 3) along axes whose bearings are larger by ``angle`` rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _covariance(fit: Fit, after: Vector, turned: Vector, last: GnssFix) -> Vector:
    """(15, 15) as `NavInit` has it, of the last fix's position, ``after`` it.

    ``turned`` (3, 3) takes axes of ``fit`` to those there.
    """
    J = np.zeros((15, 12))
    J[[*range(6, 15), *range(3, 6)]] = carried(fit.C_end, after)
    for part in (slice(3, 6), slice(6, 9)):
        J[part] = turned @ J[part]
    cov: Vector = J @ fit.cov @ J.T
    cov[0:3, 0:3] = np.diag(np.hypot(np.asarray(last.sigma_position), POSITION_FLOOR) ** 2)
    return cov


MATCH: Final = Stage(init=init, step=step, finish=finish)
