"""Static alignment from any azimuth by unscented filters of large misalignments, then the small-angle filter.

Yan Gongmin 2008, chapter 4, which ends with that advice. The first block gives the level roughly,
`nav.align.large_bank` the azimuth, and `nav.align.fine` goes on from there with the drifts that are known by
then.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from nav.align import still as watch
from nav.align.fine import FINE, Fine, fine_init
from nav.align.large_bank import ALPHA, DRIFT, SIZE, VEL, Bank, Mean, Noise, block, levelled, mean, start
from nav.align.static import (
    PATIENCE_S,
    SIGMAS,
    implausible,
    limits,
    nav_init,
    place_of,
    sensitivities,
    sigma_of_place,
)
from nav.align.still import Still
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import normal_gravity
from nav.filter.ukf import Points, symmetric_points
from nav.rotation import quat_from_dcm, rotvec_from_quat
from nav.types import ImuSample, Sample, Vector

TILT: Final = math.radians(2.0)  # how far the force of one block may be from the vertical on a swaying base
SMALL: Final = math.radians(2.0)  # of azimuth, beside what the drifts explain
HEIGHTS: Final = 0.005  # m/s^2, what a height may be wrong by in gravity
_ZERO: Final = np.zeros(3)


class Large(NamedTuple):
    """State of the stage: the watch, and the bank once there is a place to stand."""

    config: AlignConfig
    still: Still
    status: AlignStatus
    points: Points
    bank: Bank | None = None


def _begin(config: AlignConfig, given: NavInit | None) -> Large:
    limit = limits(config, 0.8, 0.0, config.coarse_s + config.fine_s)
    nothing = AlignStatus(None, np.diag([1.0, 1.0, math.pi**2]), limit, 0.0, False)
    return Large(config, Still(), nothing, symmetric_points(SIZE))


def _step(state: Large, sample: Sample) -> tuple[Large, AlignStatus]:
    """Take any sample."""
    config, still, status, points, bank = state
    if isinstance(sample, ImuSample):
        reason = watch.fault(sample)
        still = watch.add(still, sample, _ZERO, _ZERO)
        state = Large(config, still, status, points, bank)
        if reason is None and watch.full(still):
            state, reason = _close(state)
    else:
        still, reason = watch.aid(still, sample)
        state = Large(config, still, status, points, bank)
    if reason is not None:
        return state, state.status._replace(done=False, refusal=reason)
    return state, state.status


def _close(state: Large) -> tuple[Large, str | None]:
    """One block: begin, or a step of the bank."""
    config, bank = state.config, state.bank
    rotation, dv, _, dt = watch.block(state.still)
    still, reason = watch.close(state.still, config)
    place = place_of(config, still)
    if reason is None and place is None and still.seconds > config.coarse_s + PATIENCE_S:
        reason = "no position: no GNSS fix came and the configuration gives none"
    if reason is not None or place is None:
        return state._replace(still=still), reason
    if bank is None:
        reason = _against_gravity(config, place, float(np.linalg.norm(dv)), dt)
        if reason is not None:
            return state._replace(still=still), reason
        C = levelled(np.eye(3), dv) @ rotation
        noise = Noise(config.gyro_bias, config.angle_random_walk, config.velocity_random_walk, config.sway)
        bank = start(place, C, TILT, noise, state.points)
    else:
        bank, innovation, square = block(bank, rotvec_from_quat(quat_from_dcm(rotation)), dv, dt)
        speed = float(np.linalg.norm(innovation))
        if square > SIGMAS**2 and speed > watch.PUSHED:
            reason = f"the vehicle moves: {speed:.2f} m/s against a standstill"
    state = state._replace(still=still, bank=bank)
    return (state, reason) if reason is not None else _judge(state, bank, mean(bank))


def _against_gravity(
    config: AlignConfig, place: tuple[float, float, float], push: float, dt: float
) -> str | None:
    """Why a block of ``dt`` s that adds ``push`` m/s to the velocity is not one of rest, or None."""
    force, gravity = push / dt, normal_gravity(math.sin(place[0]), place[2])
    slack = SIGMAS * math.hypot(config.accel_bias, 2.0 * config.sway / dt) + HEIGHTS
    if abs(force - gravity) <= slack:
        return None
    return (
        f"the specific force is {force:.4f} m/s^2 where gravity is {gravity:.4f}: "
        "an accelerometer is stuck, or calibration or latitude are wrong"
    )


def _judge(state: Large, bank: Bank, found: Mean) -> tuple[Large, str | None]:
    """Whether the angles are small, and what contradicts a standing IMU on the turning Earth."""
    config, still = state.config, state.still
    lat, _, height = bank.place
    ready = still.seconds >= config.coarse_s - 0.5 * watch.BLOCK_S
    reason = implausible(config, still, lat) if ready else None
    sigma = math.sqrt(found.P[2, 2])
    small = sigma < math.hypot(SMALL, 1.5 * limits(config, lat, height, still.seconds)[2])
    if reason is None and not small and still.seconds > config.coarse_s + PATIENCE_S:
        reason = (
            f"azimuth is known to {math.degrees(sigma):.1f} deg only after {still.seconds:.0f} s "
            f"with a sway of {config.sway:.3f} m/s"
        )
    status = AlignStatus(
        estimate=quat_from_dcm(found.C),
        covariance=_covariance(config, bank, found)[3:6, 3:6],
        limit=limits(config, lat, height, config.coarse_s + config.fine_s),
        progress=min(1.0, still.seconds / config.coarse_s),
        done=ready and small and reason is None,
    )
    return state._replace(status=status), reason


def _covariance(config: AlignConfig, bank: Bank, found: Mean) -> Vector:
    """(12, 12) of velocity, phi, gyro bias, accelerometer bias, true minus estimate.

    The filters take for level what is level by the accelerometers.
    """
    lat, _, height = bank.place
    _, by_force = sensitivities(lat, height)
    T = np.zeros((12, SIZE))  # velocity changes its sign
    T[0:2, VEL], T[3:6, ALPHA], T[6:9, DRIFT] = -np.eye(2), np.eye(3), np.eye(3)
    N = np.zeros((12, 3))
    N[3:6], N[9:12] = by_force @ found.C, np.eye(3)
    P = T @ found.P @ T.T + N @ N.T * config.accel_bias**2
    P[2, 2] = config.sway**2
    return P


def _finish(state: Large) -> NavInit:
    """The members as one, as the fine stage goes on from."""
    config, still, bank = state.config, state.still, state.bank
    assert bank is not None
    place = place_of(config, still)
    assert place is not None
    found = mean(bank)
    x = np.concatenate([_ZERO, _ZERO, found.drift, _ZERO])
    P = _covariance(config, bank, found)
    given = nav_init(config, still.t_ns, place, sigma_of_place(config, still), found.C, x, P)
    return replace(given, v_g=np.array([*found.velocity, 0.0]))


def _take_over(config: AlignConfig, given: NavInit | None) -> Fine:
    """The fine stage, from velocity and drifts that are not zero."""
    assert given is not None
    x = np.concatenate([given.v_g, _ZERO, given.gyro_bias, given.accel_bias])
    return fine_init(config, given)._replace(x=x)


LARGE: Final = Stage(init=_begin, step=_step, finish=_finish)
SMALL_ANGLE: Final = replace(FINE, init=_take_over)
