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
    COMPASS,
    PRESENT,
    Course,
    Leg,
    attitude,
    compile_loops,
    end_leg,
    first_state,
    go,
    is_lost,
    is_over,
    next_piece,
    opening,
    phi_covariance,
    place_course,
    progress,
    stated,
)
from nav.align.compass_ledger import SWAY_S, Noise
from nav.align.compass_theory import P_E, PHI, W_U
from nav.align.static import implausible, limits, lost, nav_init, place_of, standing_at
from nav.align.store import Store
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import position_matrix
from nav.rotation import dcm_from_quat, quat_multiply
from nav.strapdown.kernels import X_C, X_H, X_Q
from nav.types import ImuSample, Sample

SIGMAS: Final = 6.0
# Damped periods per time: those that leave the least noise in heading by `nav.align.compass_ledger`, of a
# quiet base first and of one that moves by millimetres a second not much more. They grow while heading comes,
# average for most of the time, and are short at the end, when what has been averaged has to be brought in.
ONCE_PERIODS: Final = (0.25, 0.55, 1.1, 1.5, 0.9)
BACK_PERIOD: Final = 0.85
LAST_PERIODS: Final = (1.35, 1.7, 4.5, 0.82)
LONGEST: Final = 3  # further pairs of passes over all data when heading has not converged
FEWEST: Final = 8  # blocks, to see in them how restless the base is
SETTLED: Final = 0.1  # of the noise that a rest of the start may be in a converged heading


def once(config: AlignConfig) -> tuple[Leg, ...]:
    """The four steps; the azimuth loop goes back over those before it, and then ahead to the end."""
    end = config.coarse_s + config.fine_s
    return (
        *opening(config.coarse_s),
        Leg(COMPASS, False, 0.0, (config.coarse_s,)),
        Leg(COMPASS, True, end, tuple(part * end for part in ONCE_PERIODS), end),
    )


def rapid(config: AlignConfig) -> tuple[Leg, ...]:
    """That, and once more back and ahead over all of the data."""
    end = config.coarse_s + config.fine_s
    return (
        *once(config),
        Leg(COMPASS, False, 0.0, (BACK_PERIOD * end,)),
        Leg(COMPASS, True, PRESENT, tuple(part * end for part in LAST_PERIODS), end),
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
    course.still, full = watch.add(course.still, sample)
    course.store.add(sample)
    if reason is None and full:
        before = course.still
        course.still, _, reason = watch.close(before, config, sample.t_ns)
        _feel(course, before)
        if course.origin is None and (found := place_of(config, course.still)) is not None:
            place_course(course, found)
            first_state(course, course.still.force, np.zeros(3))
        elif course.origin is None:
            reason = reason or lost(config, course.still)
        if course.noise is not None:
            course.noise = _noise(course)
    return reason


def _feel(course: Course, before: watch.Still) -> None:
    """By how much the level velocity changed in the block that was closed, beside what it did ``before``."""
    if before.seconds > 0.0:
        push = (course.still.force - before.force) * course.still.seconds
        up = before.force / np.linalg.norm(before.force)
        push = push - up * (up @ push)
        course.pushes += 0.5 * float(push @ push)


def _noise(course: Course) -> Noise:
    """What goes into the loops, by what the blocks so far show: how restless the base is in truth."""
    config, still = course.config, course.still
    stated_ = stated(config)
    if still.blocks <= FEWEST:
        return stated_
    gyro = float(np.trace(watch.rate_covariance(still, config))) / 3.0 * still.seconds
    # the block's change of velocity, by noise and by what comes and goes
    quiet = config.velocity_random_walk**2 * watch.BLOCK_S
    change, free = course.pushes / (still.blocks - 1), 2 * (still.blocks - 1)
    base = 0.0
    if change > quiet * (1.0 + 4.0 * math.sqrt(2.0 / free)):
        base = (change - quiet) / (2.0 * (1.0 - math.exp(-watch.BLOCK_S / SWAY_S)))
    return stated_._replace(gyro=gyro, base=base)


def _work(course: Course) -> str | None:
    """Go on in the plan, over at most as many samples as one step may work off."""
    left = course.config.replay_samples
    moved = False
    while left > 0 and course.leg < len(course.plan):
        if is_lost(course):
            return f"it takes longer than the {course.config.store_s:.0f} s of samples that are kept"
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
        assert course.noise is not None
        P = course.ledger.covariance(course.noise)
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
    if (
        not last
        or course.plan[-1].until != PRESENT
        or len(course.plan) >= len(rapid(course.config)) + 2 * LONGEST
    ):
        return
    assert course.before is not None
    assert course.ledger is not None
    assert course.noise is not None
    noise = math.sqrt(course.ledger.noise(course.noise)[4, 4])
    turned = quat_multiply(course.x[X_Q : X_Q + 4], course.before * np.array([1.0, -1.0, -1.0, -1.0]))
    if course.ledger.kept() * course.found < SETTLED * noise and 2.0 * abs(float(turned[3])) < SIGMAS * noise:
        return
    leg = course.plan[-1]
    course.plan = (*course.plan, course.plan[-2], leg)
    course.before = course.x[X_Q : X_Q + 4].copy()
    course.ledger.turn()


def _status(course: Course, reason: str | None = None) -> AlignStatus:
    config = course.config
    lat, height = (course.origin[0], course.origin[2]) if course.origin is not None else (0.8, 0.0)
    over = course.leg >= len(course.plan)
    return AlignStatus(
        estimate=attitude(course) if course.found < math.pi else None,
        covariance=phi_covariance(course),
        limit=limits(config, lat, height, config.coarse_s + config.fine_s),
        progress=progress(course),
        done=over and course.at == course.store.imu.count and reason is None,
        refusal=reason,
        behind=bool(len(course.x)) and course.store.imu.count - course.at >= course.batch,
    )


def _finish(course: Course) -> NavInit:
    """Attitude at the last sample, with the share that the sensors' constant errors have in its error."""
    config, ledger, origin = course.config, course.ledger, course.origin
    assert ledger is not None
    assert origin is not None
    C = dcm_from_quat(attitude(course))
    P = np.zeros((12, 12))
    P[0:3, 0:3] = np.eye(3) * config.sway**2
    assert course.noise is not None
    P[3:6, 3:6] = ledger.covariance(course.noise)[PHI, PHI]
    weights = ledger.constants()[:, 0:6]
    P[3:6, 6:12] = weights * course.noise.constant[0:6] ** 2
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
