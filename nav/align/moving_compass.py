"""Gyrocompassing on the move, with an odometer: heading from nothing, and the position meanwhile.

Yan Gongmin 2008, section 2.4. The loops of `nav.align.compass_loop` are told the vehicle's velocity, the
odometer's along the forward axis turned by the attitude that they themselves have (eqs. (2-28) to
(2-30), with the velocity turning with the platform). They level without a heading; a coarse azimuth
follows; they run on to the end of the time given, and back to the beginning. From there a last pass leads
through the stored data to the present, and that one weighs by covariance (`nav.align.moving_weights`),
as the coarse azimuth does: the fixed gains of the printed form lose heading on winding roads. The
position comes from the last pass: that is what section 2.4.3 goes back to the start and ahead again for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from nav.align import still as watch
from nav.align.compass_course import (
    COMPASS,
    LEVEL,
    PRESENT,
    Course,
    Leg,
    attitude,
    compile_loops,
    end_leg,
    first_ns,
    first_state,
    go,
    go_free,
    is_lost,
    is_over,
    next_piece,
    phi_covariance,
    place_course,
    progress,
    turn_about_up,
)
from nav.align.compass_loop import head
from nav.align.handover import hand_over
from nav.align.moving_weights import BLOCK_S, PITCH, POS, TILT, YAWED, Weights
from nav.align.static import limits
from nav.align.store import Piece, Store, Times, Track
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import ecef, position_quat, xyz_to_geodetic
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_rotate
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_V
from nav.types import FixType, GnssFix, ImuSample, OdoSample, Sample, Vector

BLIND: Final = "blind"
WEIGH: Final = "weigh"
RETURN: Final = "return"
SMOOTH_NS: Final = 500_000_000  # on either side: ticks are averaged to a velocity
AHEAD_NS: Final = 1_000_000_000  # of the way for the first velocity
MISSING_NS: Final = 1_000_000_000  # without the odometer
OPENING: Final = 0.2  # of the time, at least, to find a coarse azimuth
LEVELLING: Final = 0.35  # of that to level: 1.2 damped periods, before a coarse azimuth is looked for
PERIOD: Final = 0.75  # damped period per time
LOOSE: Final = 1e-4  # rad of level that the loops lose in turns, to errors of scale and accelerometers
FEELS: Final = 0.1  # of Earth's north rate, by which it may be missed
KNOWN: Final = math.radians(20.0)  # sigma of a coarse azimuth that will do
ASTRAY: Final = math.radians(1.5)  # of heading that the last pass may put right without another one


def plan(config: AlignConfig) -> tuple[Leg, ...]:
    """Level, coarse azimuth, compass ahead and back, and the weighing pass."""
    end = config.coarse_s + config.fine_s
    first = max(config.coarse_s, OPENING * end)
    period = PERIOD * end
    return (
        Leg(LEVEL, True, LEVELLING * first, (LEVELLING * first / 1.2,)),
        Leg(BLIND, True, first, ()),
        Leg(COMPASS, True, end, (period,)),
        Leg(COMPASS, False, 0.0, (period,)),
        Leg(WEIGH, True, PRESENT, ()),
    )


@dataclass(slots=True, eq=False)
class Drive:
    """The course, and the way that the odometer has counted."""

    course: Course
    path: Track = field(default_factory=lambda: Track(1, 3840))  # m since the first sample
    way: float = 0.0
    fix: GnssFix | None = None
    weights: Weights | None = None
    coarse: Vector | None = None  # covariance of phi after the coarse azimuth
    force: Vector = field(default_factory=lambda: np.zeros(3))  # m/s, velocity increments of the first second
    over: bool = False  # the last pass has come to the present, and nothing speaks against it
    seconds: float = 0.0  # since it was last asked whether the odometer is there


# ---- the way -----------------------------------------------------------------------------------


def way_at(path: Track, t_ns: Times) -> Vector:
    """Way (k,) m at ascending times (k,) int64 ns, between those of the odometer by straight lines."""
    place = max(path.first, path.number(int(t_ns[0])) - 1)
    times, ways = [], []
    while place < path.count:
        piece = path.ahead(place, path.count - place)
        stop = min(len(piece.t_ns), int(np.searchsorted(piece.t_ns, t_ns[-1])) + 1)
        times.append(piece.t_ns[:stop])
        ways.append(piece.rows[:stop, 0])
        place += stop
        if piece.t_ns[stop - 1] >= t_ns[-1]:
            break
    zero = int(t_ns[0])
    known = (np.concatenate(times) - zero).astype(np.float64)
    return np.asarray(np.interp((t_ns - zero).astype(np.float64), known, np.concatenate(ways)))


def speeds(path: Track, piece: Piece) -> Vector:
    """Mean speed (k,) m/s around each sample of a piece: the ticks of a second, half of it on either side."""
    low = np.maximum(piece.t_ns - SMOOTH_NS, _first_ns(path))
    high = np.minimum(piece.t_ns + SMOOTH_NS, path.last_ns)
    t_ns = np.concatenate([low, high])
    order = np.argsort(t_ns, kind="stable")
    way = np.empty(len(t_ns))
    way[order] = way_at(path, t_ns[order])
    n = len(low)
    return np.asarray((way[n:] - way[:n]) / np.maximum((high - low) * 1e-9, 1e-3))


def _first_ns(path: Track) -> int:
    return int(path.ahead(path.first, 1).t_ns[0])


def velocities(config: AlignConfig, path: Track, piece: Piece) -> Vector:
    """Velocity (k, 3) m/s of the IMU in b: the odometer's point rolls forward, the arm turns about it."""
    assert config.C_vb is not None
    rates = piece.rows[:, 0:3] / piece.dt[:, None]
    turning = np.cross(rates, config.odometer_lever_arm)
    return np.asarray(speeds(path, piece)[:, None] * config.C_vb[1] - turning)


def _roll(drive: Drive, sample: OdoSample) -> str | None:
    """Lengthen the way by a sample."""
    path, begin_ns = drive.path, sample.t_ns - round(sample.dt * 1e9)
    if path.count == 0:
        path.row(begin_ns, 0.0)[0] = 0.0
    elif sample.t_ns <= path.last_ns:
        return None
    elif begin_ns - path.last_ns > MISSING_NS:
        return f"odometer samples are missing for {(begin_ns - path.last_ns) * 1e-9:.1f} s"
    drive.way += sample.distance
    path.row(sample.t_ns, sample.dt)[0] = drive.way
    return None


# ---- the stage ---------------------------------------------------------------------------------


def _init(config: AlignConfig, given: NavInit | None) -> Drive:
    compile_loops(config)
    if config.C_vb is not None:
        Weights(config, np.zeros(X_HEAD), 0.0).go(np.empty((0, 6)), np.empty(0))
    return Drive(Course(config, plan(config), Store(config.store_s)))


def _step(drive: Drive, sample: Sample) -> tuple[Drive, AlignStatus]:
    course = drive.course
    reason = None
    if isinstance(sample, OdoSample):
        reason = _roll(drive, sample)
    elif isinstance(sample, GnssFix):
        if course.origin is None and sample.fix_type >= FixType.FIX_3D:
            drive.fix = sample
            place_course(course, (sample.lat, sample.lon, sample.height))
    elif isinstance(sample, ImuSample):
        if course.origin is None and course.config.position is not None:
            place_course(course, course.config.position)
        if course.origin is not None:
            reason = _inertial(drive, sample)
    if reason is None and course.status is not None:
        return drive, course.status
    return drive, _status(drive, reason)


def _inertial(drive: Drive, sample: ImuSample) -> str | None:
    course, path = drive.course, drive.path
    config = course.config
    if course.t0_ns is None:
        course.t0_ns = sample.t_ns - round(sample.dt * 1e9)
    course.store.add(sample)
    reason = watch.fault(sample)
    if sample.t_ns - course.t0_ns <= AHEAD_NS:
        drive.force += sample.dv
    drive.seconds += sample.dt
    if drive.seconds >= 1.0:
        drive.seconds = 0.0
        if config.C_vb is None:
            return "how the IMU is mounted in the vehicle must be known"
        silent = sample.t_ns - max(path.last_ns, course.t0_ns)
        if reason is None and silent > 3 * MISSING_NS:
            reason = f"no odometer for {silent * 1e-9:.1f} s"
    if reason is None and path.count and path.last_ns - course.t0_ns > AHEAD_NS + SMOOTH_NS:
        if not len(course.x):
            first = course.store.imu.ahead(0, 1)
            t_ns = np.array([course.t0_ns, course.t0_ns + AHEAD_NS])
            speed = float(np.diff(way_at(path, t_ns))[0]) / (AHEAD_NS * 1e-9)
            turning = np.cross(first.rows[0, 0:3] / first.dt[0], config.odometer_lever_arm)
            assert config.C_vb is not None
            first_state(course, drive.force, speed * config.C_vb[1] - turning)
        reason = _work(drive)
    return reason


def _work(drive: Drive) -> str | None:
    """Go on in the plan, over at most as many samples as one step may work off."""
    course, path = drive.course, drive.path
    imu = course.store.imu
    left = course.config.replay_samples
    moved = False
    while left > 0 and course.leg < len(course.plan):
        if drive.over:
            return _coast(drive, left)
        if is_lost(course):
            return f"it takes longer than the {course.config.store_s:.0f} s of samples that are kept"
        weighs = course.plan[course.leg].kind in (BLIND, WEIGH)
        piece = next_piece(course, left, imu.number(path.last_ns - (0 if weighs else SMOOTH_NS)))
        if piece is None:
            break
        used, reason = 0, None
        if len(piece.dt):
            if weighs:
                used = _weigh(drive, piece)
            else:
                if course.plan[course.leg].kind == RETURN:
                    go_free(course, piece)
                else:
                    go(course, piece, velocities(course.config, path, piece))
                used = len(piece.dt)
            left -= used
            moved = True
        present = course.plan[course.leg].until == PRESENT
        over = course.at >= imu.number(path.last_ns) if present else is_over(course)
        if reason is None and over:
            reason = _conclude(drive)
        if reason is not None:
            return reason
        if not (used or over):
            break
    if moved:
        course.status = _status(drive)
    return None


def _coast(drive: Drive, most: int) -> str | None:
    """From where the odometer leaves it to the present."""
    course, weights = drive.course, drive.weights
    assert weights is not None
    piece = course.store.imu.ahead(course.at, most)
    weights.go(piece.rows, piece.dt)
    course.at += len(piece.dt)
    course.status = _status(drive)
    return None


def _conclude(drive: Drive) -> str | None:
    """End a leg and begin the next; what speaks against it, or None."""
    course = drive.course
    earth = course.earth
    assert earth is not None
    reason = None
    drive.over = course.leg + 1 == len(course.plan)
    if drive.over:
        return _judge(drive)
    if course.plan[course.leg].kind == BLIND:
        assert drive.weights is not None
        angle, sigma, felt = drive.weights.north(earth.north)
        if sigma > KNOWN:
            reason = f"heading is known to {math.degrees(sigma):.0f} deg only after the coarse azimuth"
        elif abs(felt / earth.north - 1.0) > FEELS + 6.0 * sigma:
            reason = (
                f"levelled axes felt {felt / earth.north:.2f} of Earth's north rate: "
                "calibration or latitude are wrong"
            )
        tilts = np.diag(drive.weights.P[TILT, TILT])
        drive.coarse = np.diag(tilts + np.array([LOOSE**2, LOOSE**2, sigma**2]))
        turn_about_up(course, angle)
        drive.weights = None
    end_leg(course)
    kind = course.plan[course.leg].kind
    if kind == BLIND:
        way = way_at(drive.path, np.full(1, course.store.imu.back(course.at, 1).t_ns[-1]))
        drive.weights = Weights(course.config, course.x, float(way[0]), earth.north)
    elif kind == WEIGH:
        _begin_weighing(drive)
    return reason


def _judge(drive: Drive) -> str | None:
    """Whether the last pass may be believed; one more where it had to put right what is not small."""
    course, weights = drive.course, drive.weights
    assert weights is not None
    again = any(leg.kind == RETURN for leg in course.plan)
    if not again and (abs(weights.turned) > ASTRAY or weights.reason is not None):
        # slip led the loops astray: from what came out of it back to the start, and once more
        course.plan = (*course.plan, Leg(RETURN, False, 0.0, ()), course.plan[-1])
        course.leg += 1
        course.seconds = 0.0
        drive.over = False
        return None
    reason = weights.doubt()
    if reason is None and abs(weights.turned) > ASTRAY:
        reason = f"two passes over the same way differ by {math.degrees(weights.turned):.1f} deg of heading"
    return reason


def _begin_weighing(drive: Drive) -> None:
    """From the loops' attitude at the start, at the place and with the velocity of the start."""
    course, path, config = drive.course, drive.path, drive.course.config
    assert course.origin is not None
    t_ns = np.array([first_ns(course), first_ns(course) + AHEAD_NS])
    way = way_at(path, t_ns)
    lat, lon, height = course.origin
    C = dcm_from_quat(attitude(course))
    v_g = C @ velocities(config, path, course.store.imu.ahead(0, 1))[0]
    if drive.fix is not None:
        # the antenna's place, and when it was there
        since = (first_ns(course) - drive.fix.t_ns) * 1e-9
        moved = v_g * since - C @ config.gnss_lever_arm
        r_e = ecef(lat, lon, height) + quat_rotate(position_quat(lat, lon), moved)
        lat, lon, height = xyz_to_geodetic(*r_e)
    course.origin = lat, lon, height
    course.x = head(quat_from_dcm(C), v_g, lat, lon, height)
    drive.weights = Weights(config, course.x, float(way[0]))


def _weigh(drive: Drive, piece: Piece) -> int:
    """Go to the end of the block or of the piece; how many samples that took."""
    course, weights = drive.course, drive.weights
    assert weights is not None
    seconds = weights.seconds + np.cumsum(piece.dt)
    used = min(len(seconds), int(np.searchsorted(seconds, BLOCK_S - 1e-6)) + 1)
    weights.go(piece.rows[:used], piece.dt[:used])
    course.at += used
    course.seconds += float(piece.dt[:used].sum())
    if weights.seconds >= BLOCK_S - 1e-6:
        weights.close(float(way_at(drive.path, piece.t_ns[used - 1 : used])[0]))
    return used


def _status(drive: Drive, reason: str | None = None) -> AlignStatus:
    course, weights = drive.course, drive.weights
    config = course.config
    lat, height = (course.origin[0], course.origin[2]) if course.origin is not None else (0.8, 0.0)
    last = course.leg == len(course.plan) - 1
    covariance = phi_covariance(course) if drive.coarse is None else drive.coarse
    if weights is not None and last:
        covariance = weights.P[TILT, TILT]
    waiting = course.store.imu.number(drive.path.last_ns) if drive.path.count else 0
    return AlignStatus(
        estimate=attitude(course) if len(course.x) else None,
        covariance=covariance,
        limit=limits(config, lat, height, config.coarse_s + config.fine_s),
        progress=progress(course),
        done=drive.over and course.at == course.store.imu.count and reason is None,
        refusal=reason,
        behind=bool(len(course.x)) and waiting - course.at >= config.replay_samples,
    )


def _finish(drive: Drive) -> NavInit:
    """State at the last inertial sample, which the odometer has not confirmed yet."""
    course, weights, config = drive.course, drive.weights, drive.course.config
    assert weights is not None
    weights.close(None)
    x, P = weights.x, weights.P[0:15, 0:15].copy()
    sigma_p = np.full(3, config.sigma_position)
    if drive.fix is not None:
        sigma_p = np.asarray(drive.fix.sigma_position, dtype=np.float64)
    P[POS, POS] += np.diag(sigma_p**2)
    C_eg = x[X_C : X_C + 9].reshape(3, 3)
    lat = math.asin(max(-1.0, min(1.0, C_eg[2, 2])))
    lon = math.atan2(C_eg[1, 2], C_eg[0, 2])
    r_e = ecef(lat, lon, float(x[X_H])) + C_eg @ weights.shift
    mounting = np.sqrt(np.diag(weights.P)[[PITCH, YAWED]])
    return hand_over(
        course.store.imu.last_ns,
        xyz_to_geodetic(*r_e),
        x[X_V : X_V + 3].copy(),
        attitude(course),
        weights.bias,
        P,
        config.C_vb,
        np.array([mounting[0], config.sigma_mounting, mounting[1]]),
    )


MOVING: Final = Stage(init=_init, step=_step, finish=_finish)
