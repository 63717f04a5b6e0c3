"""Gyrocompassing on the move, with an odometer: heading from nothing, and the position meanwhile.

Yan Gongmin 2008, section 2.4. The loops of `nav.align.compass_loop` are told the vehicle's velocity, the
odometer's along the forward axis turned by the attitude that they themselves have (eqs. (2-28) to
(2-30), with the velocity turning with the platform). They level without a heading; a coarse azimuth follows,
and the azimuth loop leads back to the beginning. From there the last step weighs by covariance
(`nav.align.moving_weights`), as the coarse azimuth does: the fixed gains of the printed form lose heading on
winding roads. It keeps up with the present, and goes back and ahead once more where it had to put right what
is not small. The position comes from that too: section 2.4.3 goes back to the start and ahead again for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from nav.align import moving_north
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
    open_book,
    phi_covariance,
    place_course,
    progress,
    turn_about_up,
)
from nav.align.compass_loop import head
from nav.align.handover import hand_over
from nav.align.moving_block import EPS, NAB, PITCH, POS, TILT, VEL, YAWED
from nav.align.moving_way import ADD, PUT, SMOOTH_NS, TAKE, carried, turn, velocities, way_at
from nav.align.moving_weights import Weights
from nav.align.static import limits
from nav.align.store import Piece, Store, Track
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import EARTH_RATE, ecef, position_quat, xyz_to_geodetic
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_rotate
from nav.strapdown.kernels import X_HEAD, X_V
from nav.types import FixType, GnssFix, ImuSample, OdoSample, Sample, Vector

BLIND: Final = "blind"
WEIGH: Final = "weigh"
RETURN: Final = "return"
AHEAD_NS: Final = 1_000_000_000  # of the way for the first velocity
MISSING_NS: Final = 1_000_000_000  # without the odometer
BEHIND_S: Final = 2.0  # more than it waits for the odometer
OPENING: Final = 0.2  # of the time, at least, to find a coarse azimuth
PERIOD: Final = 0.75  # damped period of the azimuth loop per time
LEVELLING: Final = 0.35  # of that to level: 1.2 damped periods, before a coarse azimuth is looked for
FEELS: Final = 0.1  # of Earth's north rate, by which it may be missed
KNOWN: Final = math.radians(20.0)  # sigma of a coarse azimuth that will do
SMALL: Final = math.radians(0.5)  # of heading that a pass may put right without another one
ASTRAY: Final = math.radians(1.5)  # that the last one may
MOST: Final = 3  # further passes


def plan(config: AlignConfig) -> tuple[Leg, ...]:
    """Level, coarse azimuth, compass ahead and back, and the weighing pass."""
    end = config.coarse_s + config.fine_s
    first = max(config.coarse_s, OPENING * end)
    return (
        Leg(LEVEL, True, LEVELLING * first, (LEVELLING * first / 1.2,)),
        Leg(BLIND, True, first, ()),
        Leg(COMPASS, False, 0.0, (PERIOD * end,)),
        Leg(WEIGH, True, end, ()),
    )


@dataclass(slots=True, eq=False)
class Drive:
    """The course, and the way that the odometer has counted."""

    course: Course
    path: Track = field(default_factory=lambda: Track(1, 3840))  # m since the first sample
    way: float = 0.0
    fix: GnssFix | None = None
    weights: Weights | None = None
    force: Vector = field(default_factory=lambda: np.zeros(3))  # m/s, velocity increments of the first second
    at: Vector = field(default_factory=lambda: np.zeros(4))  # q_gb where the loops are
    P_phi: Vector = field(default_factory=lambda: np.diag([0.05**2, 0.05**2, math.pi**2]))  # rad^2, there
    turned: Vector = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))  # b now to b there
    lag: float = 0.0  # s from there to now
    over: bool = False  # the last pass has come to the present, and nothing speaks against it
    seconds: float = 0.0  # since it was last asked whether the odometer is there


# ---- the stage ---------------------------------------------------------------------------------


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


def _init(config: AlignConfig, given: NavInit | None) -> Drive:
    compile_loops(config)
    if config.C_vb is not None:
        Weights(config, np.zeros(X_HEAD), 0.0, EARTH_RATE).go(np.empty((0, 6)), np.empty(0))
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
    if reason is not None or course.status is None:
        return drive, _status(drive, reason)
    if course.status.estimate is None or not isinstance(sample, ImuSample):
        return drive, course.status
    return drive, course.status._replace(estimate=_present(drive))


def _present(drive: Drive) -> Vector:
    """Attitude of now: the gyros lead there from where the loops are."""
    earth = drive.course.earth
    assert earth is not None
    return carried(drive.at, drive.turned, np.array([0.0, earth.north, earth.up]) * drive.lag)


def _inertial(drive: Drive, sample: ImuSample) -> str | None:
    course, path = drive.course, drive.path
    config = course.config
    if course.t0_ns is None:
        course.t0_ns = sample.t_ns - round(sample.dt * 1e9)
    course.store.add(sample)
    reason = watch.fault(sample)
    if sample.t_ns - course.t0_ns <= AHEAD_NS:
        drive.force += sample.dv
    else:
        turn(drive.turned, sample.dtheta[None, :], ADD)
        drive.lag += sample.dt
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
    course = drive.course
    left = course.config.replay_samples
    moved = False
    while left > 0 and course.leg < len(course.plan):
        if is_lost(course):
            return f"it takes longer than the {course.config.store_s:.0f} s of samples that are kept"
        leg = course.plan[course.leg]
        reach = _reach(drive, leg)
        piece = course.store.imu.ahead(course.at, left) if drive.over else next_piece(course, left, reach)
        if piece is None:
            break
        used = len(piece.dt)
        if used:
            used = _go(drive, leg, piece)
            turn(drive.turned, piece.rows[:used], TAKE if leg.ahead else PUT)
            passed = float(piece.dt[:used].sum())
            drive.lag -= passed if leg.ahead else -passed
            left -= used
            moved = True
        over = course.at >= reach if leg.until == PRESENT else is_over(course)
        if over and not drive.over and (reason := _conclude(drive)) is not None:
            return reason
        if not (used or over) or (drive.over and not used):
            break
    if moved:
        drive.at, drive.P_phi = _said(drive)
        course.status = _status(drive)
    return None


def _reach(drive: Drive, leg: Leg) -> int:
    """Number of the first sample ahead that a leg must wait for: what wheels do around it is not known."""
    imu, path = drive.course.store.imu, drive.path
    if drive.over:
        return imu.count
    return imu.number(path.last_ns - (0 if leg.kind == WEIGH else SMOOTH_NS)) if path.count else 0


def _go(drive: Drive, leg: Leg, piece: Piece) -> int:
    """Through a piece or a part of it; how many samples that was."""
    course = drive.course
    if drive.over:
        # beyond what the odometer has confirmed there is nothing to weigh
        assert drive.weights is not None
        drive.weights.go(piece.rows, piece.dt)
        course.at += len(piece.dt)
    elif leg.kind in (BLIND, WEIGH):
        return _weigh(drive, piece)
    elif leg.kind == RETURN:
        go_free(course, piece)
    else:
        go(course, piece, velocities(course.config, drive.path, piece))
    return len(piece.dt)


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
        north = drive.weights.north()
        sigma, felt = north.sigma, north.felt
        if sigma > KNOWN:
            known = (
                f"known to {math.degrees(sigma):.0f} deg only" if sigma < 0.5 * math.pi else "not known yet"
            )
            reason = f"heading is {known} after the coarse azimuth"
        elif abs(felt / earth.north - 1.0) > FEELS + 6.0 * sigma:
            reason = (
                f"levelled axes felt {felt / earth.north:.2f} of Earth's north rate: "
                "calibration or latitude are wrong"
            )
        turn_about_up(course, north.angle)
        open_book(course, drive.weights.P[VEL, VEL], drive.weights.P[TILT, TILT], min(sigma, math.pi))
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
    assert course.origin is not None
    angle = weights.north().angle
    returns = sum(leg.kind == RETURN for leg in course.plan)
    doubtful = returns == 0 and weights.reason is not None
    if returns < MOST and (abs(angle) > SMALL or doubtful):
        # slip led it astray, or much was to be put right: from what came out of it back, and once more
        course.x = moving_north.turned(weights, course.origin).x
        course.plan = (*course.plan, Leg(RETURN, False, 0.0, ()), Leg(WEIGH, True, PRESENT, ()))
        course.leg += 1
        course.seconds = 0.0
        drive.over = False
        return None
    reason = weights.doubt()
    if reason is None and abs(angle) > ASTRAY:
        reason = f"two passes over the same way differ by {math.degrees(angle):.1f} deg of heading"
    return reason


def _begin_weighing(drive: Drive) -> None:
    """From the loops' attitude at the start, at the place and with the velocity of the start."""
    course, path, config = drive.course, drive.path, drive.course.config
    assert course.origin is not None
    t_ns = np.array([first_ns(course), first_ns(course) + AHEAD_NS])
    way = way_at(path, t_ns)
    lat, lon, height = course.origin
    assert course.earth is not None
    C = dcm_from_quat(attitude(course))
    v_g = C @ velocities(config, path, course.store.imu.ahead(0, 1))[0]
    if drive.fix is not None:
        # the antenna's place, and when it was there
        since = (first_ns(course) - drive.fix.t_ns) * 1e-9
        lat, lon = drive.fix.lat, drive.fix.lon
        moved = v_g * since - C @ config.gnss_lever_arm
        r_e = ecef(lat, lon, drive.fix.height) + quat_rotate(position_quat(lat, lon), moved)
        lat, lon, height = xyz_to_geodetic(*r_e)
    course.origin = lat, lon, height
    course.x = head(quat_from_dcm(C), v_g, lat, lon, height)
    # what the loops found is where it begins and no more: they have seen the same data
    drive.weights = Weights(config, course.x, float(way[0]), course.earth.north)


def _weigh(drive: Drive, piece: Piece) -> int:
    """Go to the end of the block, where the odometer said something, or of the piece; how many samples."""
    course, path, weights = drive.course, drive.path, drive.weights
    assert weights is not None
    rest = weights.length - weights.seconds - float(piece.dt[0])
    said = path.ahead(path.number(int(piece.t_ns[0]) + round(rest * 1e9) - 1), 1).t_ns
    used = len(piece.t_ns)
    closes = False
    if len(said):
        end_ns = int(said[0]) - round(0.5e9 * float(piece.dt[0]))
        closes = bool(piece.t_ns[-1] >= end_ns)
        used = min(used, int(np.searchsorted(piece.t_ns, end_ns)) + 1)
    weights.go(piece.rows[:used], piece.dt[:used])
    course.at += used
    course.seconds += float(piece.dt[:used].sum())
    if closes:
        weights.close(float(way_at(path, piece.t_ns[used - 1 : used])[0]))
    return used


def _said(drive: Drive) -> tuple[Vector, Vector]:
    """q_gb (4,) at the sample at which it is, and the covariance (3, 3) of its phi, rad^2."""
    course, weights = drive.course, drive.weights
    if weights is None or course.plan[min(course.leg, len(course.plan) - 1)].kind != WEIGH:
        return attitude(course), phi_covariance(course)
    assert course.origin is not None
    found = moving_north.turned(weights, course.origin)
    return found.q_gb, moving_north.phi_covariance(weights, found.C_gn)


def _status(drive: Drive, reason: str | None = None) -> AlignStatus:
    course = drive.course
    config = course.config
    lat, height = (course.origin[0], course.origin[2]) if course.origin is not None else (0.8, 0.0)
    leg = course.plan[min(course.leg, len(course.plan) - 1)]
    return AlignStatus(
        estimate=_present(drive) if course.found < math.pi else None,
        covariance=drive.P_phi,
        limit=limits(config, lat, height, config.coarse_s + config.fine_s),
        progress=progress(course),
        done=drive.over and course.at == course.store.imu.count and reason is None,
        refusal=reason,
        behind=bool(len(course.x)) and (not leg.ahead or drive.lag > BEHIND_S),
    )


def _finish(drive: Drive) -> NavInit:
    """State at the last inertial sample, which the odometer has not confirmed yet."""
    course, weights, config = drive.course, drive.weights, drive.course.config
    assert weights is not None
    assert course.origin is not None
    weights.close(None)
    found = moving_north.turned(weights, course.origin)
    at, way_g = moving_north.place(weights, found, course.origin)
    P = moving_north.covariance(weights, found, way_g)
    sigma_p = np.full(3, config.sigma_position)
    if drive.fix is not None:
        sigma_p = np.asarray(drive.fix.sigma_position, dtype=np.float64)
    P[POS, POS] += np.diag(sigma_p**2)
    north = weights.north()
    mounting = np.sqrt(np.diag(north.P)[[PITCH, YAWED]])
    return hand_over(
        course.store.imu.last_ns,
        at,
        found.C_gn @ found.x[X_V : X_V + 3],
        found.q_gb,
        weights.bias + north.error[EPS.start : NAB.stop],
        P,
        config.C_vb,
        np.array([mounting[0], config.sigma_mounting, mounting[1]]),
    )


MOVING: Final = Stage(init=_init, step=_step, finish=_finish)
