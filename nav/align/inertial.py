"""Alignment on a swaying base at a fixed place: the drift of gravity seen from an inertial frame.

Angular sway does not matter, since the gyros carry the frame through it; what matters is the
velocity that sway gives to an IMU off the point it turns about (Yan Gongmin 2008, section 3.4). The gyros see
that as well: it is the lever arm, a constant in b, times what b0 sees b turn. So the lever arm is estimated,
and only what it does not explain (a centre that moves itself) is noise. Of one integral of specific force
(eq. (3-38a)) that is a velocity; of two, a displacement, which stays where it is while the signal grows with
the cube of time. Two integrals however drift with the velocity at the start: the printed method has it
zero, here it is estimated, so a sway that runs from the beginning does no harm.

`SINGLE` takes the velocity at instants, from a pair of samples to the next, and the rotation from two
vectors (eq. (3-22)); `DOUBLE` the displacement, averaged over two seconds, and two vectors; `ALL` that,
and the rotation from all the data (Wahba's problem). Epochs count by the inverse covariance of what sensors
do to them and of the sway that is left, which is measured as it comes.
"""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align import still as watch
from nav.align.apparent import A_T, Tracker, add, before, change, gravity_integrals, swung, tracker
from nav.align.apparent_epoch import Mean, Pair, against_gravity, close, fill, pair
from nav.align.apparent_result import (
    attitude_now,
    contradiction,
    handed,
    poor_gyros,
    velocity_now,
)
from nav.align.apparent_stage import Taken, blank, duration, progress, stepping, without_place
from nav.align.constant import LEVER, START, Solved
from nav.align.disturbance import Roughness, spread
from nav.align.epochs import Book, bring, take
from nav.align.handover import Place, imu_place
from nav.align.still import Still
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import earth_rate_g
from nav.rotation import dcm_from_quat, quat_from_dcm
from nav.types import ImuSample, Sample, Vector

EPOCH_S: Final = 2.0
INSTANT_S: Final = (1.0, 0.8)  # mean pause between instants, and how far pauses are spread
PUSHED: Final = 0.05  # m or m/s that is no sway
START_SPEED: Final = 1.0  # m/s, standard deviation of the velocity at the start
PLACE: Final = 0.2  # m, standard deviation of the displacement at the start
SWAY_S: Final = 0.02  # displacement over velocity of a sway that no epoch averages out
ARM: Final = 10.0  # m, standard deviation of what the base turns about is away
STEADY: Final = 0.05  # of a sway's velocity, at least left at an instant
RIVAL_EPOCHS: Final = 24  # that a rival goes along
WHITE: Final = 30.0  # chi-square by which it is better by chance in no sway that the lever arm explains
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)
_NONE: Final = np.zeros((3, 3))


class Sway(NamedTuple):
    """State of the stage."""

    config: AlignConfig
    still: Still  # what wheels and GNSS say
    place: Place = (0.0, 0.0, 0.0)  # rad, rad, m, as known at the beginning
    waited: float = 0.0
    track: Tracker | None = None
    book: Book | None = None  # of the epochs
    pair: Pair | None = None  # the open ones
    instant: float = 0.0  # s, the next
    t_ns: int = 0
    solved: Solved | None = None
    status: AlignStatus | None = None  # at the last epoch


def init(config: AlignConfig, given: NavInit | None) -> Sway:
    """Begin with nothing known."""
    return Sway(config, Still())


def _aid(state: Sway, sample: Sample) -> Taken[Sway]:
    """Wheels and GNSS may contradict the rest."""
    still, reason = watch.aid(state.still, sample)
    return state._replace(still=still), reason


def _begin(state: Sway, sample: ImuSample, twice: bool) -> Taken[Sway]:
    """Begin with the first inertial sample that has a place: b0 is where its interval begins."""
    config, still = state.config, state.still
    place = config.position
    if place is None and still.fixes > 0:
        place = imu_place(_antenna(still), _ZERO)  # compiled now, not when it ends
    if place is None:
        waited = state.waited + sample.dt
        return state._replace(waited=waited), without_place(waited)
    track = tracker(sample.t_ns - round(sample.dt * 1e9))
    estimate = constant.begin(config, START_SPEED, PLACE, np.full(3, ARM))
    state = state._replace(
        place=place,
        track=track,
        book=Book(
            estimate,
            track.row.copy(),
            Roughness(config.velocity_random_walk, twice),
            lasts=RIVAL_EPOCHS,
            white=WHITE,
        ),
        pair=pair(track.row, EPOCH_S, 12),
        instant=spread(0, *INSTANT_S),
        status=blank(config, place),
    )
    return state, poor_gyros(config, place[0], duration(config))


def _antenna(still: Still) -> Place:
    lat, lon, height = still.place.tolist()
    return lat, lon, height


def _take(state: Sway, track: Tracker, sample: ImuSample, twice: bool, vectors: bool) -> Taken[Sway]:
    row, open_ = track.row, state.pair
    assert open_ is not None
    ahead = float(row[A_T] + track.waiting[1]) + sample.dt
    end = ahead > duration(state.config) - 1e-6
    full = ahead > (open_.newer.middle if twice else state.instant) - 1e-6
    add(*track, sample.dtheta, sample.dv, sample.dt, sample.t_ns, end or full)
    reason = None
    if twice:
        fill(open_, float(row[A_T]), swung(row))
        if full:
            open_, mean = close(open_, row)
            state = state._replace(pair=open_)
            if mean is not None:
                state, reason = _epoch(state, mean, vectors)
    elif full:
        state, reason = _instant(state, before(track), row.copy())
    if end and reason is None:
        state, reason = _end(state._replace(t_ns=sample.t_ns), row, twice, vectors)
    return state, reason


def _epoch(state: Sway, mean: Mean, vectors: bool) -> Taken[Sway]:
    """A mean displacement, and the new solution."""
    config, (lat, _, height), book = state.config, state.place, state.book
    assert book is not None
    H, seconds, curved = against_gravity(mean, lat, height)
    z, arm = mean.values[0:3], mean.values[3:12].reshape(3, 3) - _EYE
    H[:, LEVER] = arm
    bare = np.column_stack([z - curved, arm])
    book, moved = take(book, config, mean.row, seconds, bare, H, z, _NONE, config.sway * SWAY_S, PUSHED)
    return _taken(state._replace(book=book), moved, "m", True, vectors)


def _instant(state: Sway, before: Vector, row: Vector) -> Taken[Sway]:
    """A velocity, from one row to the next, and the new solution."""
    config, (lat, _, height), book = state.config, state.place, state.book
    assert book is not None
    seconds, dt = float(row[A_T]), float(row[A_T] - before[A_T])
    u = gravity_integrals(lat, height, seconds)[1] - gravity_integrals(lat, height, seconds - dt)[1]
    H = constant.design(u / dt)
    went = (swung(row) - swung(before)) / dt
    z, arm = went[0:3], went[3:12].reshape(3, 3)
    H -= constant.meanwhile(change(before, row))
    H[:, START], H[:, LEVER] = -_EYE, arm
    bare = np.column_stack([z, arm])
    book, moved = take(book, config, row, seconds - 0.5 * dt, bare, H, z, _NONE, STEADY * config.sway, PUSHED)
    state = state._replace(book=book, instant=seconds + spread(book.taken, *INSTANT_S))
    return _taken(state, moved, "m/s", False, True)


def _taken(state: Sway, moved: float, unit: str, twice: bool, vectors: bool) -> Taken[Sway]:
    assert state.book is not None
    if moved > 0.0:
        failed = "the base was pushed or moves, or a gyro or accelerometer failed"
        return state, f"{failed}: {1e3 * moved:.1f} m{unit} in an epoch"
    if not state.book.settled:
        return _waiting(state), None
    return _solve(state, twice, vectors, False)


def _waiting(state: Sway) -> Sway:
    assert state.book is not None
    assert state.status is not None
    part = progress(state.config, float(state.book.row[A_T]))
    return state._replace(status=state.status._replace(progress=part))


def _end(state: Sway, row: Vector, twice: bool, vectors: bool) -> Taken[Sway]:
    """Bring the last epoch's estimate to the last sample."""
    assert state.book is not None
    if not state.book.settled:
        return state, f"{duration(state.config):.0f} s are too short to tell sway from gravity"
    return _solve(state._replace(book=bring(state.book, state.config, row, _NONE)), twice, vectors, True)


def _solve(state: Sway, twice: bool, vectors: bool, done: bool) -> Taken[Sway]:
    lat, _, height = state.place
    assert state.book is not None
    assert state.status is not None
    estimate, row = state.book.estimate, state.book.row
    seconds = float(row[A_T])
    if vectors:
        # of the middle and of the end, as fitted to all epochs between
        which = 1 if twice else 0
        u_l, u_m = (gravity_integrals(lat, height, x * seconds)[which] for x in (0.5, 1.0))
        solved = constant.two_vectors(estimate, u_l, u_m)
    else:
        solved = constant.attitude_of_all(estimate)
    if solved is None:
        reason = f"{seconds:.0f} s do not tell north in this sway" if done else None
        return _waiting(state), reason
    solved = solved._replace(P=state.book.doubt * solved.P)
    C_gb, P_phi = attitude_now(solved, row, lat, lat, 0.0)
    part = progress(state.config, seconds)
    status = AlignStatus(quat_from_dcm(C_gb), P_phi, state.status.limit, part, done)
    reason = contradiction(estimate, solved, state.config, lat)
    return state._replace(solved=solved, status=status), reason


def finish(state: Sway) -> NavInit:
    """Attitude, velocity of the sway and biases at the last sample."""
    assert state.solved is not None
    assert state.book is not None
    assert state.status is not None
    assert state.status.estimate is not None
    config, (lat, _, height) = state.config, state.place
    once, _ = gravity_integrals(lat, height, float(state.book.row[A_T]))
    v_b0 = velocity_now(state.solved, state.book.row, once, np.zeros(3))
    place, sigma_p = state.place, np.full(3, config.sigma_position)
    if config.position is None:
        C_gb = dcm_from_quat(state.status.estimate)
        place, sigma_p = (
            imu_place(_antenna(state.still), C_gb @ config.gnss_lever_arm),
            state.still.sigma_place,
        )
    return handed(config, state.solved, state.book.row, state.t_ns, state.place, place, sigma_p, v_b0, once)


def _since(state: Sway) -> tuple[Vector, Vector, Vector]:
    assert state.book is not None
    return state.book.row, earth_rate_g(state.place[0]), _ZERO


def _stage(twice: bool, vectors: bool) -> Stage[Sway]:
    begin, take_ = partial(_begin, twice=twice), partial(_take, twice=twice, vectors=vectors)
    return Stage(init, stepping(_aid, begin, take_, _since), finish)


SINGLE: Final = _stage(twice=False, vectors=True)
DOUBLE: Final = _stage(twice=True, vectors=True)
ALL: Final = _stage(twice=True, vectors=False)
