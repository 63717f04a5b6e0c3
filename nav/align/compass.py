"""Gyrocompassing at rest: levelling and azimuth loops, from an unknown heading.

Yan Gongmin 2008, section 2.3.3, has four steps, which are the first four legs here: level without a heading;
let go for a while and see the heading in the velocity that Earth's rate makes, eq. (2-26); level again;
close the azimuth loop. `GYROCOMPASS` does that once, with a damped period that grows with the time in
the loop: a short one takes the rough heading away, a long one averages the noise.

The rapid form, section 2.3.4, keeps the data and goes through it again, backwards and forwards, every pass
beginning where the last one ended. The loop runs on the way back too (`nav.align.compass_loop`), so that a
period longer than the data is of use: the passes before the last fill its memory.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align import still as watch
from nav.align.compass_course import (
    AZIMUTH,
    BATCH,
    COMPASS,
    PRESENT,
    Course,
    Leg,
    attitude,
    compile_loops,
    end_leg,
    first_state,
    go,
    is_over,
    next_piece,
    opening,
    phi_covariance,
    place_course,
    progress,
)
from nav.align.compass_theory import P_E, PHI, W_U
from nav.align.static import PATIENCE_S, implausible, limits, nav_init, place_of, standing_at
from nav.align.store import Store
from nav.align.stuck import look
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import position_matrix
from nav.rotation import dcm_from_quat, quat_multiply
from nav.strapdown.kernels import X_C, X_H, X_Q
from nav.types import ImuSample, Sample

SIGMAS: Final = 6.0
GROWTH: Final = 1.2  # of the damped period per second in the azimuth loop
SHORTEST: Final = 0.125  # of the time in the azimuth loop: damped period at first
LONGEST: Final = 3  # further pairs of passes when heading has not converged
SETTLED: Final = 0.1  # of the noise that a rest of the start may be in a converged heading


def once(config: AlignConfig) -> tuple[Leg, ...]:
    """The four steps, once."""
    end = config.coarse_s + config.fine_s
    return (*opening(config.coarse_s), Leg(COMPASS, True, end, SHORTEST * config.fine_s, GROWTH))


def rapid(config: AlignConfig) -> tuple[Leg, ...]:
    """The four steps, and then back and forth: periods as long as the data, then half as long again."""
    end = config.coarse_s + config.fine_s
    return (
        *opening(config.coarse_s),
        Leg(COMPASS, True, end, end),
        Leg(COMPASS, False, 0.0, end),
        Leg(COMPASS, True, end, 1.5 * end),
        Leg(COMPASS, False, 0.0, 1.5 * end),
        Leg(COMPASS, True, PRESENT, 1.5 * end),
    )


def _step(course: Course, sample: Sample) -> tuple[Course, AlignStatus]:
    """Watch that it stands still, keep the sample, and go on."""
    reason = _take(course, sample)
    if reason is None and isinstance(sample, ImuSample) and course.origin is not None:
        reason = _work(course)
    if reason is None and course.status is not None:
        return course, course.status
    return course, _status(course, reason)


def _take(course: Course, sample: Sample) -> str | None:
    config = course.config
    if not isinstance(sample, ImuSample):
        course.still, reason = watch.aid(course.still, sample)
        return reason
    if course.t0_ns is None:
        course.t0_ns = sample.t_ns - round(sample.dt * 1e9)
    reason = watch.fault(sample)
    course.still = watch.add(course.still, sample, np.zeros(3), np.zeros(3))
    course.store.add(sample)
    if reason is None and watch.full(course.still):
        course.still, reason = watch.close(course.still, config)
        course.stuck, stuck = look(course.stuck, course.store, reason is not None)
        reason = stuck or reason
        if course.origin is None and (found := place_of(config, course.still)) is not None:
            place_course(course, found)
            first_state(course, np.zeros(3))
        elif course.origin is None and course.still.seconds > config.coarse_s + PATIENCE_S:
            reason = reason or "no position: no GNSS fix came and the configuration gives none"
    return reason


def _work(course: Course) -> str | None:
    """Go on in the plan, over at most as many samples as one step may work off."""
    left = course.config.replay_samples
    moved = False
    while left > 0 and course.leg < len(course.plan):
        if course.at < course.store.imu.first:
            return f"it took longer than the {course.config.store_s:.0f} s of samples that are kept"
        piece = next_piece(course, left, course.store.imu.count)
        if piece is None:
            break
        if len(piece.dt):
            go(course, piece, np.zeros((len(piece.dt), 3)))
            left -= len(piece.dt)
            moved = True
        if is_over(course):
            reason = _judge(course) or end_leg(course)
            if reason is not None:
                return reason
            _lengthen(course)
            _put_back(course)
        elif not len(piece.dt):
            break
    if moved:
        course.status = _status(course)
    return None


def _put_back(course: Course) -> None:
    """It stands: what the loops' velocity moved it by meanwhile is taken back."""
    assert course.origin is not None
    lat, lon, height = course.origin
    course.x[X_C : X_C + 9] = position_matrix(lat, lon).ravel()
    course.x[X_H] = height


def _judge(course: Course) -> str | None:
    """What speaks against a standing IMU on the turning Earth at this latitude, or None."""
    config, leg, earth = course.config, course.plan[course.leg], course.earth
    assert earth is not None
    assert course.origin is not None
    if course.leg == 0:
        force = float(np.linalg.norm(course.still.force))
        slack = SIGMAS * config.accel_bias + 0.005
        if abs(force - earth.gravity) > slack:
            return (
                f"the specific force is {force:.4f} m/s^2 where gravity is {earth.gravity:.4f}: "
                "an accelerometer is stuck, or calibration or latitude are wrong"
            )
    if leg.kind == AZIMUTH:
        return implausible(config, course.still, course.origin[0])
    if leg.kind == COMPASS and leg.ahead and course.ledger is not None:
        P = course.ledger.covariance(config)
        for name, k, rate in (("north", P_E, course.law[9]), ("vertical", W_U, course.law[11])):
            sigma = math.sqrt(P[k, k])
            if abs(rate) > SIGMAS * sigma:
                return (
                    f"the loops turn by {math.degrees(rate) * 3600:.3f} deg/h about the {name} axis where "
                    f"gyros explain {math.degrees(sigma) * 3600:.3f}: calibration or latitude are wrong"
                )
    return None


def _lengthen(course: Course) -> None:
    """One more pair of passes while two passes over the same data do not agree."""
    last = course.leg == len(course.plan)
    pairs = sum(not leg.ahead for leg in course.plan)
    if not last or course.before is None or course.ledger is None or pairs == 0 or pairs >= 2 + LONGEST:
        return
    noise = math.sqrt(course.ledger.noise(course.config)[4, 4])
    turned = quat_multiply(course.x[X_Q : X_Q + 4], course.before * np.array([1.0, -1.0, -1.0, -1.0]))
    if course.ledger.from_start() < SETTLED * noise and 2.0 * abs(float(turned[3])) < SIGMAS * noise:
        return
    leg = course.plan[-1]
    course.plan = (*course.plan, Leg(COMPASS, False, 0.0, leg.period), leg)
    course.before = course.x[X_Q : X_Q + 4].copy()
    course.ledger.turn()


def _status(course: Course, reason: str | None = None) -> AlignStatus:
    config = course.config
    lat, height = (course.origin[0], course.origin[2]) if course.origin is not None else (0.8, 0.0)
    over = course.leg >= len(course.plan)
    return AlignStatus(
        estimate=attitude(course) if len(course.x) else None,
        covariance=phi_covariance(course),
        limit=limits(config, lat, height, config.coarse_s + config.fine_s),
        progress=progress(course),
        done=over and course.at == course.store.imu.count and reason is None,
        refusal=reason,
        behind=bool(len(course.x)) and course.store.imu.count - course.at >= BATCH,
    )


def _finish(course: Course) -> NavInit:
    """Attitude at the last sample, with the share that the sensors' constant errors have in its error."""
    config, ledger, origin = course.config, course.ledger, course.origin
    assert ledger is not None
    assert origin is not None
    C = dcm_from_quat(attitude(course))
    P = np.zeros((12, 12))
    P[0:3, 0:3] = np.eye(3) * config.sway**2
    P[3:6, 3:6] = ledger.covariance(config)[PHI, PHI]
    by_gyros, by_accelerometers = ledger.constants()
    P[3:6, 6:9] = by_gyros @ C * config.gyro_bias**2
    P[3:6, 9:12] = by_accelerometers @ C * config.accel_bias**2
    P[6:12, 3:6] = P[3:6, 6:12].T
    P[6:9, 6:9] = np.eye(3) * config.gyro_bias**2
    P[9:12, 9:12] = np.eye(3) * config.accel_bias**2
    sigma_p = np.full(3, config.sigma_position) if config.position is not None else course.still.sigma_place
    given = nav_init(config, course.store.imu.last_ns, origin, sigma_p, C, np.zeros(12), P)
    stands, sigma_p = standing_at(config, given, course.still, C)
    return nav_init(config, course.store.imu.last_ns, stands, sigma_p, C, np.zeros(12), P)


def _begin_once(config: AlignConfig, given: NavInit | None) -> Course:
    compile_loops(config)
    return Course(config, once(config), Store(config.store_s))


def _begin_rapid(config: AlignConfig, given: NavInit | None) -> Course:
    compile_loops(config)
    return Course(config, rapid(config), Store(config.store_s))


ONCE: Final = Stage(init=_begin_once, step=_step, finish=_finish)
RAPID: Final = Stage(init=_begin_rapid, step=_step, finish=_finish)
