"""Static alignment from any azimuth by unscented filters of large misalignments, then the small-angle filter.

Yan Gongmin 2008, chapter 4, which ends with that advice. The first block gives the level roughly,
`nav.align.large_bank` the azimuth, and a filter of `nav.align.kalman` goes on from there with the drifts that
are known by then.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from nav.align import still as watch
from nav.align.drift import FEWEST
from nav.align.large_bank import ALPHA, DRIFT, SIZE, VEL, Bank, Mean, Noise, levelled, mean, start, step
from nav.align.static import (
    PATIENCE_S,
    SMALL,
    SOMEWHERE,
    UNKNOWN,
    implausible,
    limits,
    lost,
    nav_init,
    not_gravity,
    place_of,
    sensitivities,
    sigma_of_place,
)
from nav.align.still import PUSHED, Block, Lean, Standing, Still, contradiction, standing
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.filter.ukf import Points, symmetric_points
from nav.rotation import quat_from_dcm, rotvec_from_quat
from nav.types import Vector

TILT: Final = math.radians(2.0)  # how far the force of one block may be from the vertical on a swaying base
_ZERO: Final = np.zeros(3)


class Large(NamedTuple):
    """The points of the filters, and the bank of them once there is a place to stand."""

    points: Points
    bank: Bank | None = None
    lean: Lean = Lean()


def _begin(config: AlignConfig, given: NavInit | None) -> Standing[Large]:
    limit = limits(config, *SOMEWHERE, config.coarse_s + config.fine_s)
    nothing = AlignStatus(None, UNKNOWN.copy(), limit, 0.0, False)
    return Standing(config, Still(), nothing, Large(symmetric_points(SIZE)))


def _work(state: Standing[Large], block: Block) -> tuple[Standing[Large], str | None]:
    """Begin, or a step of the bank."""
    config, own, dt = state.config, state.own, block.dt
    place = place_of(config, state.still)
    if place is None:
        return state, lost(config, state.still)
    if own.bank is None:
        reason = not_gravity(config, block.dv, dt, place[0], place[2])
        if reason is not None:
            return state, reason
        C = levelled(np.eye(3), block.dv) @ block.rotation
        noise = Noise(config.gyro_bias, config.angle_random_walk, config.velocity_random_walk, config.sway)
        bank = start(place, C, TILT, noise, own.points)
    else:
        turn = rotvec_from_quat(quat_from_dcm(block.rotation))
        noise = own.bank.noise._replace(angle=math.sqrt(watch.angle_walk(state.still, config)))
        bank, innovation, S = step(own.bank._replace(noise=noise), turn, block.dv, dt)
        leaning, reason = contradiction(own.lean, innovation, S, PUSHED, "m/s")
        own = own._replace(lean=leaning)
    state = state._replace(own=own._replace(bank=bank))
    if reason is not None:
        # a latitude that is far off looks like motion, too
        return state, implausible(config, state.still, place[0]) or reason
    return _judge(state, bank, mean(bank))


def _judge(state: Standing[Large], bank: Bank, found: Mean) -> tuple[Standing[Large], str | None]:
    """Whether the angles are small, and what contradicts a standing IMU on the turning Earth."""
    config, still = state.config, state.still
    lat, _, height = bank.place
    ready = still.seconds >= config.coarse_s - 0.5 * watch.BLOCK_S
    reason = implausible(config, still, lat) if still.line.averages >= FEWEST else None
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


def _finish(state: Standing[Large]) -> NavInit:
    """The members as one, as the fine stage goes on from."""
    config, still, bank = state.config, state.still, state.own.bank
    assert bank is not None
    place = place_of(config, still)
    assert place is not None
    found = mean(bank)
    x = np.concatenate([_ZERO, _ZERO, found.drift, _ZERO])
    P = _covariance(config, bank, found)
    given = nav_init(config, still.t_ns, place, sigma_of_place(config, still), found.C, x, P, True)
    return replace(given, v_g=np.array([*found.velocity, 0.0]), line=still.line)


LARGE: Final = Stage(init=_begin, step=standing(_work), finish=_finish)
