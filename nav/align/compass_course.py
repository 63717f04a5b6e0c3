"""An alignment by gyrocompass loops under way: its plan of passes over stored samples, and what it carries.

A plan is a list of legs. Legs ahead that end later than the last sample wait for more; legs over what is
stored are gone through a bounded number of samples at a time. At rest and on the move differ in
the velocity that the loops are told, and in what watches over them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from nav.align.compass_ledger import Ledger, Noise
from nav.align.compass_loop import L_P, L_SIZE, head, lead, set_free, set_gains
from nav.align.compass_theory import (
    BASE,
    EPS,
    INPUTS,
    NABLA,
    PHI,
    STATES,
    V_E,
    V_N,
    AzimuthGains,
    LevelGains,
    Place,
    azimuth_gains,
    decay,
    level_gains,
    place,
)
from nav.align.level import level_dcm
from nav.align.still import Still
from nav.align.store import Piece, Store
from nav.align.types import AlignConfig, AlignStatus
from nav.earth import position_angles
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, quat_multiply, quat_rotate
from nav.strapdown.kernels import X_C, X_Q, X_V
from nav.types import Vector

LEVEL: Final = "level"
AZIMUTH: Final = "azimuth"
COMPASS: Final = "compass"
PRESENT: Final = math.inf

BATCH: Final = 50  # samples at most, and seconds, that wait for each other while they come in
BATCH_S: Final = 0.25
STRIDE: Final = 4  # times as many have the same gains
FIRST_S: Final = 1.0  # of which the mean specific force is the first vertical
LEVEL_PERIOD: Final = 60.0  # s, damped period of the level loop beside the azimuth loop
FEELS: Final = (0.4, 1.8)  # of Earth's north rate that a coarse azimuth may have felt


class Leg(NamedTuple):
    """A pass or part of one: ``until`` s since the beginning, with damped ``periods`` (s).

    Several of them hold at equal distances over the ``over`` seconds from its start on, and run from one
    to the next by equal ratios; the last one stays.
    """

    kind: str
    ahead: bool
    until: float
    periods: tuple[float, ...]
    over: float = 0.0

    def period(self, seconds: float) -> float:
        """The damped period (s) that holds ``seconds`` after its start."""
        last = len(self.periods) - 1
        if last == 0:
            return self.periods[0]
        place = min(seconds / self.over, 1.0) * last
        k = min(int(place), last - 1)
        return self.periods[k] * math.exp((place - k) * math.log(self.periods[k + 1] / self.periods[k]))


def opening(coarse_s: float) -> tuple[Leg, ...]:
    """Level, coarse azimuth, level again, in ``coarse_s`` seconds."""
    period = 0.3 * coarse_s
    return (
        Leg(LEVEL, True, 0.35 * coarse_s, (period,)),
        Leg(AZIMUTH, True, 0.75 * coarse_s, (period,)),
        Leg(LEVEL, True, coarse_s, (period,)),
    )


@dataclass(slots=True, eq=False)
class Course:
    """Where an alignment is in its plan, and all that it carries."""

    config: AlignConfig
    plan: tuple[Leg, ...]
    store: Store
    still: Still = field(default_factory=Still)
    origin: tuple[float, float, float] | None = None
    earth: Place | None = None
    t0_ns: int | None = None
    leg: int = 0
    at: int = 0  # number of the next sample ahead; on the way back, of the one after it
    seconds: float = 0.0  # in this leg
    batch: int = 1  # samples that wait for each other while they come in
    x: Vector = field(default_factory=lambda: np.zeros(0))
    law: Vector = field(default_factory=lambda: np.zeros(L_SIZE))
    free: Vector = field(default_factory=lambda: np.zeros(0))
    free_law: Vector = field(default_factory=lambda: np.zeros(L_SIZE))
    ledger: Ledger | None = None
    noise: Noise | None = None  # what goes into it
    pushes: float = 0.0  # (m/s)^2, sum over the blocks of a standstill of changes of one level velocity
    found: float = math.pi  # rad, sigma of the coarse azimuth
    before: Vector | None = None  # attitude at the end of the last pass ahead
    status: AlignStatus | None = None


# ---- going through the data --------------------------------------------------------------------


def gains(leg: Leg, earth: Place, seconds: float) -> tuple[LevelGains, AzimuthGains | None]:
    """Gains of a leg ``seconds`` after its start."""
    sign = 1.0 if leg.ahead else -1.0
    if leg.kind != COMPASS:
        return level_gains(sign * decay(leg.periods[0]), earth.gravity), None
    sigma = decay(leg.period(seconds))
    # the level loops are faster than the azimuth loop, but slow enough not to follow the base's motion
    level = max(sigma, decay(LEVEL_PERIOD))
    return level_gains(sign * level, earth.gravity), azimuth_gains(sign * sigma, earth.gravity)


def open_book(course: Course, velocity: Vector, tilt: Vector, heading: float) -> None:
    """Begin the book where heading has been found otherwise.

    Covariances of the velocity (3, 3) and of the tilt (3, 3), sigma of heading (rad).
    """
    assert course.earth is not None
    start = np.zeros(STATES)
    start[[V_E, V_N]] = np.sqrt(np.diag(velocity)[0:2])
    start[PHI] = *np.sqrt(np.diag(tilt)[0:2]), heading
    course.ledger = Ledger(course.earth, start)
    course.found = heading


def compile_loops(config: AlignConfig) -> None:
    """Have everything compiled that a course needs later: not while samples come in."""
    row, second = np.zeros((1, 6)), np.ones(1)
    earth = place(0.5, 0.0)
    level, azimuth = gains(Leg(COMPASS, True, 1.0, (100.0,)), earth, 0.0)
    law = np.zeros(L_SIZE)
    set_gains(law, earth, level, azimuth)
    for ahead in (True, False):
        x = head(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 0.5, 0.0, 0.0)
        lead(x, law, row, second, np.zeros((1, 3)), ahead)
    ledger = Ledger(earth, np.ones(STATES))
    ledger.advance(level, azimuth, 0.0, 1.0, True, np.eye(INPUTS))
    ledger.covariance(stated(config))


def stated(config: AlignConfig) -> Noise:
    """What goes in by the configuration; the vehicle's motion is given one second of correlation."""
    constant = np.zeros(INPUTS)
    constant[0:3], constant[3:6] = config.gyro_bias, config.accel_bias
    constant[6], constant[7] = config.odometer_scale, config.sigma_mounting
    return Noise(config.angle_random_walk**2, config.velocity_random_walk**2, config.sway**2, constant)


def place_course(course: Course, origin: tuple[float, float, float]) -> None:
    """Say where it is."""
    course.origin = origin
    course.earth = place(origin[0], origin[2])


def first_state(course: Course, force: Vector, velocity: Vector) -> None:
    """Begin after the first second, with ``force`` (3,) in b for the vertical and heading zero.

    ``velocity`` (3,) m/s in b.
    """
    config, earth = course.config, course.earth
    assert course.origin is not None
    assert earth is not None
    q = quat_from_dcm(level_dcm(force))
    course.x = head(q, quat_rotate(q, velocity), *course.origin)
    course.at = course.store.imu.number(first_ns(course) + round(FIRST_S * 1e9))
    course.batch = max(1, min(BATCH, config.replay_samples, round(course.at * BATCH_S / FIRST_S)))
    start = np.zeros(STATES)
    start[[V_E, V_N]] = config.sway + config.velocity_random_walk
    start[PHI] = *(2 * [2.0 * start[V_E] / FIRST_S / earth.gravity]), 0.0
    course.ledger = Ledger(earth, start)
    course.noise = stated(config)


def first_ns(course: Course) -> int:
    """When the first sample began."""
    assert course.t0_ns is not None
    return course.t0_ns


def bound(course: Course, leg: Leg) -> tuple[int, bool]:
    """Number of the first sample that a leg ahead does not take, and whether that sample is not there yet."""
    imu = course.store.imu
    if leg.until == PRESENT:
        return imu.count, False
    end_ns = first_ns(course) + round(leg.until * 1e9) + 1_000_000
    if imu.last_ns < end_ns - 2_000_000:
        return imu.count, True
    return imu.number(end_ns), False


def next_piece(course: Course, most: int, limit: int) -> Piece | None:
    """The next samples of the leg, at most ``most`` and none from number ``limit`` on; None: it must wait."""
    leg, imu = course.plan[course.leg], course.store.imu
    most = min(most, STRIDE * course.batch)
    if not leg.ahead:
        return imu.back(course.at, most)
    end, more = bound(course, leg)
    end = min(end, limit)
    if more and end - course.at < course.batch:
        return None
    return imu.ahead(course.at, min(most, end - course.at))


def is_lost(course: Course) -> bool:
    """Whether samples that it still needs have been dropped: passes on the way back go to the first one."""
    back = any(not leg.ahead for leg in course.plan[course.leg :])
    return course.store.imu.first > (0 if back else course.at)


def is_over(course: Course) -> bool:
    """Whether the leg has come to its end."""
    leg = course.plan[course.leg]
    if not leg.ahead:
        return course.at == 0
    end, more = bound(course, leg)
    return not more and course.at >= end


def go(course: Course, piece: Piece, velocity: Vector) -> None:
    """Lead the loops through a piece; ``velocity`` (k, 3) m/s in b is what the vehicle does."""
    leg, earth = course.plan[course.leg], course.earth
    assert earth is not None
    level, azimuth = gains(leg, earth, course.seconds)
    set_gains(course.law, earth, level, azimuth)
    lead(course.x, course.law, piece.rows, piece.dt, velocity, leg.ahead)
    seconds = float(piece.dt.sum())
    if leg.kind == AZIMUTH:
        set_free(course.free_law, decay(leg.periods[0]))
        lead(course.free, course.free_law, piece.rows, piece.dt, velocity, leg.ahead)
    if course.ledger is not None:
        begin = (int(piece.t_ns[0]) - first_ns(course)) * 1e-9 - float(piece.dt[0])
        mix = mixing(course, velocity.mean(axis=0))
        course.ledger.advance(level, azimuth, begin, seconds, leg.ahead, mix)
    course.seconds += seconds
    course.at += len(piece.dt) if leg.ahead else -len(piece.dt)


def mixing(course: Course, velocity: Vector) -> Vector:
    """How constant errors, in b, and of ``velocity`` (3,) m/s in b along and across, come into the loops."""
    C = dcm_from_quat(course.x[X_Q : X_Q + 4])
    v = C @ velocity
    mix = np.zeros((INPUTS, INPUTS))
    mix[EPS, 0:3] = mix[NABLA, 3:6] = C
    mix[BASE, 6], mix[BASE, 7] = v[0:2], (-v[1], v[0])
    return mix


def go_free(course: Course, piece: Piece) -> None:
    """Lead the state through a piece without any control; on the way back that undoes the way ahead."""
    leg = course.plan[course.leg]
    set_free(course.law, 0.0)
    lead(course.x, course.law, piece.rows, piece.dt, np.zeros((len(piece.dt), 3)), leg.ahead)
    course.seconds += float(piece.dt.sum())
    course.at += len(piece.dt) if leg.ahead else -len(piece.dt)


def end_leg(course: Course) -> str | None:
    """Draw the conclusion of a leg; what speaks against it, or None."""
    leg, earth = course.plan[course.leg], course.earth
    assert earth is not None
    reason = None
    if leg.kind == AZIMUTH:
        reason = turn_to_north(course)
    if leg.kind == COMPASS and leg.ahead and course.leg + 1 < len(course.plan):
        course.before = course.x[X_Q : X_Q + 4].copy()
    course.leg += 1
    course.seconds = 0.0
    if course.ledger is not None:
        course.ledger.turn()
    if course.leg < len(course.plan) and course.plan[course.leg].kind == AZIMUTH:
        # what the loop had not levelled yet would grow with the square of time: begin from a smooth start
        course.free = course.x.copy()
        assert course.ledger is not None
        course.ledger.let_go()
    return reason


def turn_to_north(course: Course) -> str | None:
    """Coarse azimuth, eqs. (2-26) and (2-27); or why there is none.

    The velocity of the platform that was let go, less that of the one that was kept level, has grown with
    the square of time.
    """
    earth = course.earth
    assert earth is not None
    if course.seconds == 0.0:
        return f"{course.config.coarse_s:g} s of coarse alignment are too short to tell north"
    grown = course.free[X_V : X_V + 2] - course.x[X_V : X_V + 2]
    unit = 0.5 * earth.gravity * earth.north * course.seconds**2
    cosine, sine = 1.0 + grown[0] / unit, -grown[1] / unit
    felt = math.hypot(cosine, sine)
    if not FEELS[0] < felt < FEELS[1]:
        return (
            f"levelled axes felt {felt:.2f} of Earth's north rate: "
            "the vehicle turns or is shaken, or calibration or latitude are wrong"
        )
    angle = math.atan2(sine, cosine)
    turn_about_up(course, angle)
    assert course.ledger is not None
    assert course.noise is not None
    course.ledger.find_north(angle, unit)
    course.found = math.sqrt(course.ledger.covariance(course.noise)[4, 4])
    return None


def turn_about_up(course: Course, angle: float) -> None:
    """Turn what the loops take for east and north by ``angle`` rad."""
    turn = quat_from_rotvec([0.0, 0.0, angle])
    course.x[X_Q : X_Q + 4] = quat_multiply(turn, course.x[X_Q : X_Q + 4])
    course.x[X_V : X_V + 3] = quat_rotate(turn, course.x[X_V : X_V + 3])
    # the integrators hold the level part of Earth's rate, which is in the kernel from now on
    course.law[L_P] = 0.0


# ---- what it says ------------------------------------------------------------------------------


def attitude(course: Course) -> Vector:
    """q_gb (4,) of the loops' state."""
    _, _, wander = position_angles(course.x[X_C : X_C + 9].reshape(3, 3))
    return quat_multiply(quat_from_rotvec([0.0, 0.0, wander]), course.x[X_Q : X_Q + 4])


def phi_covariance(course: Course) -> Vector:
    """Covariance (3, 3) of phi, rad^2."""
    if course.ledger is None or course.noise is None:
        return np.diag([0.05**2, 0.05**2, math.pi**2])
    P = course.ledger.covariance(course.noise)[PHI, PHI].copy()
    if course.found == math.pi:
        P[2, 2] = math.pi**2
    return P


def progress(course: Course) -> float:
    """From 0 to 1, by legs."""
    if course.leg >= len(course.plan):
        return 1.0
    leg, before = course.plan[course.leg], course.plan[course.leg - 1].until if course.leg else 0.0
    span = abs(leg.until - before) if leg.until != PRESENT else course.config.coarse_s + course.config.fine_s
    return (course.leg + min(1.0, course.seconds / max(span, 1e-3))) / len(course.plan)
