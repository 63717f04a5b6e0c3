"""Alignment on a swaying base at a fixed place: the drift of gravity seen from an inertial frame.

Angular sway does not matter, since the gyros carry the frame through it; what matters is the
velocity that sway gives to an IMU off its centre (Yan Gongmin 2008, section 3.4). Of one integral of specific
force (eq. (3-38a)) that velocity is noise; of two, only the displacement is, which stays where it is while
the signal grows with the cube of time. Two integrals however drift with the velocity at the start: the
printed method has it zero, here it is estimated, so a sway that runs from the beginning does no harm.

`SINGLE` takes the velocity at instants and the rotation from two vectors (eq. (3-22)); `DOUBLE` the
displacement, averaged over a few seconds, and two vectors; `ALL` the same, and the rotation from all the data
(Wahba's problem). Epochs count by the inverse covariance of what sensors do to them and of the sway, which is
measured as it comes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align import still as watch
from nav.align.apparent import (
    A_P,
    A_T,
    A_V,
    Tracker,
    add,
    gravity_integrals,
    present,
    tracker,
)
from nav.align.apparent_result import (
    attitude_now,
    contradiction,
    hand_over,
    imu_place,
    poor_gyros,
    velocity_now,
)
from nav.align.constant import OFFSET, POS, START, VEL, Solved
from nav.align.disturbance import Held, Window, held, spread, stuck, weigh, window
from nav.align.epochs import Book, bring, take
from nav.align.static import PATIENCE_S, limits
from nav.align.still import Still
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import earth_rate_g
from nav.rotation import dcm_from_quat, quat_from_dcm
from nav.types import ImuSample, Sample, Vector

EPOCH_S: Final = 3.0
GAP_S: Final = (0.4, 0.8)  # mean pause between epochs, and how far pauses are spread
INSTANT_S: Final = (1.0, 0.8)  # the same between instants
PUSHED: Final = 0.05  # m or m/s that is no sway
START_SPEED: Final = 1.0  # m/s, standard deviation of the velocity at the start
PLACE: Final = 0.2  # m, standard deviation of the displacement at the start
SWAY_S: Final = 0.05  # displacement over velocity of a sway that no epoch averages out
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)
_NONE: Final = np.zeros((3, 3))
_SQUARE: Final = 1.0 / 12.0 - 0.5 / math.pi**2  # mean square of the seconds in a window of one second


class Sway(NamedTuple):
    """State of the stage."""

    config: AlignConfig
    still: Still  # what wheels and GNSS say
    hold: Held
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, rad, m, as known at the beginning
    waited: float = 0.0
    track: Tracker | None = None
    book: Book | None = None  # of the epochs
    middle: Vector | None = None  # in the middle of the open one
    window: Window | None = None
    t_ns: int = 0
    solved: Solved | None = None
    status: AlignStatus | None = None  # at the last epoch


def init(config: AlignConfig, given: NavInit | None) -> Sway:
    """Begin with nothing known."""
    return Sway(config, Still(), held())


def _duration(config: AlignConfig) -> float:
    return config.coarse_s + config.fine_s


def _blank(config: AlignConfig, place: tuple[float, float, float] | None) -> AlignStatus:
    lat, height = (place[0], place[2]) if place is not None else (0.8, 0.0)
    limit = limits(config, lat, height, _duration(config))
    return AlignStatus(None, np.diag([1.0, 1.0, math.pi**2]), limit, 0.0, False)


def _wait(state: Sway, sample: ImuSample, reason: str | None) -> tuple[Sway, str | None]:
    """Begin with the first inertial sample that has a place: b0 is where its interval begins."""
    config, still = state.config, state.still
    place = config.position
    if place is None and still.fixes > 0:
        place = imu_place(still.place, _ZERO)  # compiled now, not when it ends
    if place is None:
        waited = state.waited + sample.dt
        if waited > PATIENCE_S:
            reason = reason or "no position: no GNSS fix came and the configuration gives none"
        return state._replace(waited=waited, status=_blank(config, None)), reason
    track = tracker(sample.t_ns - round(sample.dt * 1e9))
    state = state._replace(
        place=place,
        track=track,
        book=Book(constant.begin(config, START_SPEED, PLACE, np.zeros(3)), track.row.copy()),
        status=_blank(config, place),
    )
    return state, reason or poor_gyros(config, place[0], _duration(config))


def _step(state: Sway, sample: Sample, twice: bool, vectors: bool) -> tuple[Sway, AlignStatus]:
    reason = None
    if not isinstance(sample, ImuSample):
        still, reason = watch.aid(state.still, sample)
        state = state._replace(still=still)
    else:
        reason = watch.fault(sample) or stuck(state.hold, sample.dv, sample.dt)
        if state.track is None:
            state, reason = _wait(state, sample, reason)
        if reason is None and state.track is not None:
            state, reason = _add(state, state.track, sample, twice, vectors)
    status = state.status
    if status is None:
        status = _blank(state.config, None)
    if reason is not None:
        return state, status._replace(done=False, refusal=reason)
    if status.estimate is None or status.done or state.track is None or state.book is None:
        return state, status
    # the base moves between epochs
    q_gb = present(state.track, state.book.row, status.estimate, earth_rate_g(state.place[0]), _ZERO)
    return state, AlignStatus(q_gb, status.covariance, status.limit, status.progress, False)


def _add(
    state: Sway, track: Tracker, sample: ImuSample, twice: bool, vectors: bool
) -> tuple[Sway, str | None]:
    row, frame = track.row, state.window
    seconds = float(row[A_T])
    assert state.book is not None
    if frame is None:
        if twice:
            frame = window(seconds + spread(state.book.taken, *GAP_S), EPOCH_S, 3)
        else:
            frame = window(seconds, spread(state.book.taken, *INSTANT_S), 3)
        state = state._replace(window=frame, middle=None)
    ahead = seconds + float(track.waiting[1]) + sample.dt
    end = ahead > _duration(state.config) - 1e-6
    full = ahead > frame.begin + frame.length - 1e-6
    add(*track, sample.dtheta, sample.dv, sample.dt, sample.t_ns, end or full)
    weigh(frame.sums, frame.begin, frame.length, float(row[A_T]), row[A_P : A_P + 3])
    if state.middle is None and row[A_T] >= frame.middle:
        state = state._replace(middle=row.copy())
    reason = None
    if full:
        state, reason = _close(state, row, frame, twice, vectors)
    if end and reason is None:
        state, reason = _end(state._replace(t_ns=sample.t_ns), row, twice, vectors)
    return state, reason


def _close(state: Sway, row: Vector, frame: Window, twice: bool, vectors: bool) -> tuple[Sway, str | None]:
    """An epoch: what was seen, what is expected of it, and the new solution."""
    config, (lat, _, height) = state.config, state.place
    assert state.book is not None
    assert state.status is not None
    if twice:
        assert state.middle is not None
        at = state.middle
        seconds = float(at[A_T])
        once, double = gravity_integrals(lat, height, seconds)
        early, square, z = frame.mean()
        # the row of the middle is a sample off it, and a parabola's mean lies above its middle
        early += frame.middle - seconds
        square += (frame.middle - seconds) * (2.0 * early - (frame.middle - seconds))
        up = (
            gravity_integrals(lat, height, seconds + 0.5)[0]
            - gravity_integrals(lat, height, seconds - 0.5)[0]
        )
        H = constant.design(double + once * early + 0.5 * up * square)
        H[:, POS], H[:, VEL], H[:, OFFSET] = -_EYE, -early * _EYE, _EYE
        H[:, START] = -(seconds + early) * _EYE
        # all epochs are as long: what their curvature differs by is due to where samples fell
        seconds += early
        bare = z - 0.5 * (square - _SQUARE * EPOCH_S**2) / seconds * at[A_V : A_V + 3]
    else:
        at = row.copy()
        seconds = float(at[A_T])
        H = constant.design(gravity_integrals(lat, height, seconds)[0])
        H[:, VEL], H[:, START] = -_EYE, -_EYE
        z = bare = at[A_V : A_V + 3].copy()
    floor = config.sway * (SWAY_S if twice else 1.0)
    book, moved = take(state.book, config, at, seconds, bare, H, z, _NONE, floor)
    status, state = state.status, state._replace(book=book, window=None)
    if moved > PUSHED:
        return state, f"the base was pushed or moves: {moved:.2f} {'m' if twice else 'm/s'}"
    if not book.settled:
        return state._replace(status=status._replace(progress=_progress(config, seconds))), None
    return _solve(state, twice, vectors, False)


def _progress(config: AlignConfig, seconds: float) -> float:
    return min(1.0, seconds / _duration(config))


def _end(state: Sway, row: Vector, twice: bool, vectors: bool) -> tuple[Sway, str | None]:
    """Bring the last epoch's estimate to the last sample."""
    assert state.book is not None
    if not state.book.settled:
        return state, f"{_duration(state.config):.0f} s are too short to tell sway from gravity"
    return _solve(state._replace(book=bring(state.book, state.config, row, _NONE)), twice, vectors, True)


def _solve(state: Sway, twice: bool, vectors: bool, done: bool) -> tuple[Sway, str | None]:
    (lat, _, height), config = state.place, state.config
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
        status = state.status._replace(progress=_progress(config, seconds))
        return state._replace(status=status), reason
    C_gb, P_phi = attitude_now(solved, row, lat, lat, 0.0)
    limit, progress = state.status.limit, _progress(config, seconds)
    status = AlignStatus(quat_from_dcm(C_gb), P_phi, limit, progress, done)
    reason = contradiction(estimate, solved, lat)
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
        place, sigma_p = imu_place(state.still.place, C_gb @ config.gnss_lever_arm), state.still.sigma_place
    return hand_over(
        config, state.solved, state.book.row, state.t_ns, state.place, place, sigma_p, v_b0, once
    )


def _stepping(twice: bool, vectors: bool) -> Callable[[Sway, Sample], tuple[Sway, AlignStatus]]:
    def step(state: Sway, sample: Sample) -> tuple[Sway, AlignStatus]:
        """Work in inertial samples; wheels and GNSS may contradict the rest."""
        return _step(state, sample, twice, vectors)

    return step


SINGLE: Final = Stage(init=init, step=_stepping(False, True), finish=finish)
DOUBLE: Final = Stage(init=init, step=_stepping(True, True), finish=finish)
ALL: Final = Stage(init=init, step=_stepping(True, False), finish=finish)
