"""Alignment of a driving vehicle by its odometer, in the inertial frame.

Yan Gongmin 2008, section 3.2: specific force without what the odometer says of the motion leaves gravity,
whose drift seen from the frame of the gyros gives north. Eq. (3-16) integrates exactly, no velocity is
differentiated and none has to be smooth:

    int C_b0b f = C_b0b v - v(0) + int C_b0b (w_ie x v) - int C_b0b g

and integrated once more, C_b0b v is distance rolled, as the ticks count it, and v(0) an unknown constant.
What the printed method neglects before eq. (3-19) is known in b0 as soon as it matters: ``w_ie`` is the
filter's own polar axis times a displacement, so the term is linear in the rotation sought; gravity turns with
the displacement over the radius of the Earth. So there is nothing to go over again: what a second pass would
put in is in the first, and the displacement in b0 is the dead reckoning that gives the place at the end,
turned by the attitude found. A second pass with the first one's attitude from the start, over four straight
and four winding roads of 3 km, changed heading by 2.3e-5 deg at most, of sigmas of 0.033 and 0.007 deg.

Scale factor and mounting of the odometer and the errors of gyros and accelerometers are estimated with the
rotation. In a turn the accelerometer bias turns with the vehicle and would look like a drift of gravity, and
what the gyros do not count of it, by their scale and axes, tilts all that is seen since.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant, latitude
from nav.align.apparent import (
    A_P,
    A_T,
    A_V,
    C_i0g,
    Tracker,
    add,
    attitude,
    cross_matrix,
    gravity_integrals,
    polar_axis,
    tracker,
)
from nav.align.apparent_epoch import Mean, Pair, against_gravity, close, fill, pair
from nav.align.apparent_result import attitude_now, contradiction, handed, poor_gyros, velocity_now
from nav.align.apparent_stage import Taken, blank, due, duration, progress, stepping, without_place
from nav.align.constant import WHEEL, Solved
from nav.align.disturbance import Roughness
from nav.align.epochs import Book, bring, take
from nav.align.handover import Place, imu_place
from nav.align.level import level_dcm
from nav.align.rolled import Reckoning, gravity_change, road, transport
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import EARTH_RATE, earth_rate_g, ecef, position_matrix, xyz_to_geodetic
from nav.rotation import quat_from_dcm
from nav.types import GnssFix, ImuSample, OdoSample, Sample, Vector

EPOCH_S: Final = 4.0
START_SPEED: Final = 50.0  # m/s
PLACE: Final = 5.0  # m: what rolled before the first whole interval of the odometer
FLOOR: Final = 0.002  # m, of an epoch
SLIPPED: Final = 0.3  # m
SLOW: Final = 8.0  # ticks of an epoch: fewer do not average out
LOST_S: Final = 0.5  # s without odometer samples
UNMOUNTED: Final = 0.1  # rad, of a mounting that is not given
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)
_DF, _DR, _DU = slice(3, 6), slice(6, 9), slice(9, 12)
_DD: Final = slice(12, 15)


class Ride(NamedTuple):
    """State of the stage."""

    config: AlignConfig
    axes: Vector  # (3, 3) columns: right, forward, up of the vehicle in b
    place: Place | None  # at the beginning
    sigma_p: Vector
    waited: float = 0.0
    track: Tracker | None = None
    reckoning: Reckoning | None = None
    pending: tuple[OdoSample, ...] = ()
    book: Book | None = None
    stiffness: Vector = _EYE  # 1/s^2, change of gravity with displacement
    over: Vector = _ZERO  # displacement at the last epoch's row, and at the next's
    over_next: Vector = _ZERO
    moved: Vector = _ZERO  # rad, east-north-up has turned since by moving over the Earth
    pair: Pair | None = None  # the open epochs
    rolled: float = 0.0  # m since the beginning, to and fro
    marks: tuple[float, ...] = ()  # that, when the last epochs were closed
    lately: tuple[tuple[Vector, Vector], ...] = ()  # of the last epochs, what is told and what the wheels add
    solved: Solved | None = None
    status: AlignStatus | None = None
    now: Place = (0.0, 0.0, 0.0)  # place at the last epoch
    t_ns: int = 0


def init(config: AlignConfig, given: NavInit | None) -> Ride:
    """Begin with nothing known but the mounting."""
    axes = _EYE if config.C_vb is None else config.C_vb.T
    return Ride(config, axes, config.position, np.full(3, config.sigma_position))


def _aid(state: Ride, sample: Sample) -> Taken[Ride]:
    """An odometer sample; a position may come from GNSS."""
    if isinstance(sample, GnssFix) and state.place is None:
        # the attitude is not known: the lever arm is part of the position's error
        sigma = np.hypot(sample.sigma_position, float(np.linalg.norm(state.config.gnss_lever_arm)))
        state = state._replace(place=(sample.lat, sample.lon, sample.height), sigma_p=sigma)
    if isinstance(sample, OdoSample) and state.track is not None:
        return _roll(state._replace(pending=(*state.pending, sample)), state.track)
    return state, None


def _begin(state: Ride, sample: ImuSample) -> Taken[Ride]:
    config, place = state.config, state.place
    if place is None:
        waited = state.waited + sample.dt
        return state._replace(waited=waited), without_place(waited)
    t_ns = sample.t_ns - round(sample.dt * 1e9)
    track = tracker(t_ns)
    sigma = UNMOUNTED if config.C_vb is None else config.sigma_mounting
    wheel = np.array([config.odometer_scale, sigma, sigma])
    estimate = constant.begin(config, START_SPEED, PLACE, wheel, sample.dv / sample.dt)
    zero, row = _ZERO, track.row.copy()
    state = state._replace(
        track=track,
        reckoning=Reckoning(row, t_ns, zero, zero, zero, zero, zero, zero, zero, zero),
        book=Book(estimate, row, Roughness(config.velocity_random_walk)),
        stiffness=gravity_change(place[0], place[2]),
        status=blank(config, place),
        now=imu_place(place, _ZERO),  # there and back: compiled now, not at the first epoch
    )
    return state, poor_gyros(config, place[0], duration(config))


def _take(state: Ride, track: Tracker, sample: ImuSample) -> Taken[Ride]:
    ahead = float(track.row[A_T] + track.waiting[1]) + sample.dt
    end = ahead > duration(state.config) - 1e-6
    add(*track, sample.dtheta, sample.dv, sample.dt, sample.t_ns, end)
    reason = None
    if state.pending:
        state, reason = _roll(state, track)
    assert state.reckoning is not None
    if sample.t_ns - state.reckoning.t_ns > LOST_S * 1e9:
        reason = reason or "no odometer samples"
    if end and reason is None:
        state, reason = _end(state._replace(t_ns=sample.t_ns), track.row)
    return state, reason


def _roll(state: Ride, track: Tracker) -> Taken[Ride]:
    """Work in the odometer samples whose time the inertial ones have reached."""
    reason = None
    found, pending = due(track, state.pending, lambda _: 0)
    while found is not None and reason is None:
        state, reason = _reckon(state, *found)
        found, pending = due(track, pending, lambda _: 0)
    return state._replace(pending=pending), reason


def _reckon(state: Ride, row: Vector, sample: OdoSample) -> Taken[Ride]:
    """Go on by one odometer sample."""
    old, config, book = state.reckoning, state.config, state.book
    assert old is not None
    assert book is not None
    assert state.place is not None
    h = float(row[A_T] - old.row[A_T])
    if h <= 0.0:
        return state, None
    if h > sample.dt + LOST_S:
        return state, f"odometer samples are missing: {h:.1f} s without"
    C = attitude(row)
    C_mid = 0.5 * (attitude(old.row) + C) @ state.axes * sample.distance
    ahead, right, up = old.ahead + C_mid[:, 1], old.right + C_mid[:, 0], old.up + C_mid[:, 2]
    imu = ahead - (C - _EYE) @ config.odometer_lever_arm
    went = imu - old.imu
    axis, level = _frame(state, row)
    over = old.over + went + h * EARTH_RATE * cross_matrix(axis) @ (old.over + 0.5 * went)
    # gravity turns with the place, and falls off with height
    pull = level @ (state.stiffness @ (level.T @ over))
    drop = old.drop + h * pull
    area = old.area + 0.5 * h * (old.imu + imu)
    fall = old.fall + 0.5 * h * (old.drop + drop)
    new = Reckoning(row, sample.t_ns, ahead, right, up, imu, area, over, drop, fall)
    moved = transport(state.now, level.T @ (over - state.over))
    state = state._replace(reckoning=new, moved=moved, rolled=state.rolled + abs(sample.distance))
    open_, t = state.pair, float(row[A_T])
    if open_ is None:
        return state._replace(pair=pair(row, EPOCH_S, 15), over_next=over), None
    fill(open_, t, np.concatenate([row[A_P : A_P + 3] - imu - fall, ahead, right, up, area]))
    if t < open_.newer.middle:
        return state, None
    open_, mean = close(open_, row)
    before, marks = state.over_next, (*state.marks, state.rolled)[-4:]
    state = state._replace(pair=open_, over_next=over, marks=marks)
    return (state, None) if mean is None else _epoch(state._replace(over=before), mean, sample.dt)


def _frame(state: Ride, row: Vector) -> tuple[Vector, Vector]:
    """The Earth's axis (3,) and C_b0g (3, 3) of the start, turned on with it, as far as they are known."""
    assert state.place is not None
    if state.solved is None:
        # nothing but the vertical: the displacement of half a minute asks for no more
        return np.zeros(3), level_dcm(row[A_V : A_V + 3]).T
    lat = state.place[0]
    C_b0i0 = state.solved.C
    return C_b0i0 @ polar_axis(lat), C_b0i0 @ C_i0g(lat, lat, 0.0, float(row[A_T]))


def _epoch(state: Ride, mean: Mean, interval: float) -> Taken[Ride]:
    """Mean displacement beyond what was rolled, against gravity's."""
    config, book, place = state.config, state.book, state.place
    assert book is not None
    assert place is not None
    lat, _, height = place
    further = -EARTH_RATE * cross_matrix(mean.values[_DD])
    H, seconds, curved = against_gravity(mean, lat, height, further, polar_axis(lat))
    wheel = np.stack([mean.values[_DF], mean.values[_DR], mean.values[_DU]], axis=1)
    H[:, WHEEL] = wheel
    z = mean.values[0:3]
    # smooth but for ticks and slip: scale and mounting are taken off, from all by what is known of them now
    count = len(book.rough.z)
    lately = (*state.lately[max(0, len(state.lately) - count) :], (z - curved, wheel))
    *others, bare = (told - rolled @ book.estimate.x[WHEEL] for told, rolled in lately)
    book = book._replace(rough=book.rough._replace(z=tuple(others)))
    walk = _slip(state, mean.row) + _phase(state, mean.row)
    # at a steady speed ticks repeat, which looks smooth; a mean by squared sines of independent ones has
    # twice this variance, and what epochs on winding roads show is the half
    rolling = state.marks[-1] > state.marks[-2]
    ticks = config.odometer_quantum * math.sqrt(interval / (16.0 * EPOCH_S)) if rolling else 0.0
    floor = math.hypot(FLOOR, ticks)
    book, moved = take(book, config, mean.row, seconds, bare, H, z, walk, floor, SLIPPED)
    state = state._replace(book=book, lately=lately)
    if moved > 0.0:
        return state, f"wheel slip: the odometer is {moved:.2f} m off what the accelerometers say"
    if not book.settled:
        return _waiting(state), None
    return _solve(state, False)


def _marks(state: Ride) -> tuple[float, ...]:
    """What had rolled at the last four closings; an epoch lies between every other, its row in the middle.

    The one before the first began with it.
    """
    return (*[0.0] * (4 - len(state.marks)), *state.marks)


def _slip(state: Ride, row: Vector) -> Vector:
    """By how much the road takes wheels off their way up to the epoch at ``row``: (3, 3) m^2/s, a walk."""
    assert state.book is not None
    config, before = state.config, state.book.row
    seconds = float(row[A_T] - before[A_T])
    marks = _marks(state)
    up = _frame(state, row)[1][:, 2]
    push = row[A_V : A_V + 3] - before[A_V : A_V + 3]
    level = float(np.linalg.norm(push - up * (up @ push))) / seconds
    across, along = road(config.slip, config.odometer_walk, (marks[2] - marks[1]) / seconds, level)
    axes = attitude(row) @ state.axes
    return np.asarray(axes * [across**2, along**2, across**2] @ axes.T)


def _phase(state: Ride, row: Vector) -> Vector:
    """By how much ticks shift the epoch at ``row`` against the one before: (3, 3) m^2/s of the offset's walk.

    A wheel that stands is anywhere between two ticks, and all epochs of the stand are off by the same. One
    that rolls is off by half a tick in the mean. So a start and a stop change the offset, once.
    """
    assert state.book is not None
    marks = _marks(state)
    slow = min(marks[2] - marks[0], marks[3] - marks[1]) < SLOW * state.config.odometer_quantum
    if not slow or marks[3] == marks[0]:
        return np.zeros((3, 3))
    tick = attitude(row) @ state.axes[:, 1] * state.config.odometer_quantum
    return np.outer(tick, tick) / (12.0 * float(row[A_T] - state.book.row[A_T]))


def _waiting(state: Ride) -> Ride:
    assert state.book is not None
    assert state.status is not None
    part = progress(state.config, float(state.book.row[A_T]))
    return state._replace(status=state.status._replace(progress=part))


def _end(state: Ride, row: Vector) -> Taken[Ride]:
    """Bring the last epoch's estimate to the last sample."""
    assert state.book is not None
    if not state.book.settled:
        return state, f"{duration(state.config):.0f} s are too short to tell ticks from gravity"
    book = bring(state.book, state.config, row, np.zeros((3, 3)))
    return _solve(state._replace(book=book), True)


def _solve(state: Ride, done: bool) -> Taken[Ride]:
    book, place, old = state.book, state.place, state.status
    assert book is not None
    assert place is not None
    assert old is not None
    row = book.row
    seconds = float(row[A_T])
    once, _ = gravity_integrals(place[0], place[2], seconds)
    since = math.remainder(state.now[1] - place[1], 2.0 * math.pi)
    found = latitude.solve(book.estimate, place[0], C_i0g(place[0], state.now[0], since, seconds), once)
    if found is None:
        reason = f"{seconds:.0f} s do not tell north on this road" if done else None
        return _waiting(state), reason
    solved, seen = found
    solved = solved._replace(P=book.doubt * solved.P)
    state = state._replace(solved=solved)
    now = _place(state, row)
    since = math.remainder(now[1] - place[1], 2.0 * math.pi)
    C_gb, P_phi = attitude_now(solved, row, place[0], now[0], since)
    status = AlignStatus(quat_from_dcm(C_gb), P_phi, old.limit, progress(state.config, seconds), done)
    reason = contradiction(book.estimate, solved, state.config, place[0], else_="the odometer slips")
    reason = reason or latitude.contradiction(seen, else_="the odometer slips")
    return state._replace(status=status, now=now), reason


def _went(state: Ride, row: Vector) -> Vector:
    """Displacement (3,) m over the Earth since the beginning, east, north, up of the start, up to a row."""
    assert state.solved is not None
    assert state.reckoning is not None
    assert state.place is not None
    lat, seconds = state.place[0], float(row[A_T])
    reckoning, solved = state.reckoning, state.solved
    scale, heading, pitch = solved.x[WHEEL]
    _, level = _frame(state, row)
    over = reckoning.over * (1.0 + scale)
    # sideways by the mounting in heading, upwards by that in pitch
    over = over + heading * cross_matrix(reckoning.over) @ level[:, 2] + pitch * reckoning.up
    over = over + _velocity(state, row) * (seconds - float(reckoning.row[A_T]))
    return np.asarray((solved.C @ C_i0g(lat, lat, 0.0, seconds)).T @ over)


def _place(state: Ride, row: Vector) -> Place:
    assert state.place is not None
    lat, lon, height = state.place
    r_e = ecef(lat, lon, height) + position_matrix(lat, lon) @ _went(state, row)
    return xyz_to_geodetic(float(r_e[0]), float(r_e[1]), float(r_e[2]))


def _velocity(state: Ride, row: Vector) -> Vector:
    assert state.solved is not None
    assert state.reckoning is not None
    assert state.place is not None
    once, _ = gravity_integrals(state.place[0], state.place[2], float(row[A_T]))
    axis, _ = _frame(state, row)
    known = EARTH_RATE * cross_matrix(axis) @ state.reckoning.imu + state.reckoning.drop
    return velocity_now(state.solved, row, once, known)


def finish(state: Ride) -> NavInit:
    """Attitude, velocity, biases and the place reached, at the last sample."""
    assert state.solved is not None
    assert state.book is not None
    assert state.place is not None
    assert state.reckoning is not None
    assert state.status is not None
    row, config, solved = state.book.row, state.config, state.solved
    v_b0 = _velocity(state, row)
    once, _ = gravity_integrals(state.place[0], state.place[2], float(row[A_T]))
    gone = float(np.linalg.norm(state.reckoning.over))
    # scale, mounting and heading turn or stretch all that was rolled
    spread2 = np.diag(solved.P)[WHEEL.start - 6 : WHEEL.stop - 6].sum() + state.status.covariance[2, 2]
    sigma_p = np.hypot(state.sigma_p, gone * math.sqrt(float(spread2)))
    return handed(config, solved, row, state.t_ns, state.place, state.now, sigma_p, v_b0, once)


def _since(state: Ride) -> tuple[Vector, Vector, Vector]:
    assert state.book is not None
    return state.book.row, earth_rate_g(state.now[0]), state.moved


ODOMETER: Final = Stage(init, stepping(_aid, _begin, _take, _since), finish)
