"""Open-loop fine alignment: straight lines through the drift of the level, by least squares.

"Inertial navigation", eqs. (2-121) to (2-135). The coarse attitude is held; what specific force and rate, put
into g with it, differ from gravity and Earth rate by, eq. (2-125), is due to its error phi (true C_gb = (I +
[phi x]) C_gb) and to motion of the vehicle. With v and theta the integrals of these differences,

    phi_E' = theta_E' - kappa_E,   kappa_E = phi_U w_N - phi_N w_U,   v_N' =  g phi_E,
    phi_N' = theta_N' - kappa_N,   kappa_N = phi_E w_U,               v_E' = -g phi_N.

The source fits tilt (2-130) and angle (2-131) apart, so a vehicle that settles in the meantime looks like
Earth rate. Here what the gyros saw of its motion is taken off the tilt first: phi - theta is the line a t + b
however it moved, so v/g less the integral of theta is a parabola; a least-squares fit to that, rather than
to its derivative, lets sway average out. The slope is -kappa: azimuth, eq. (2-135). The tilt of the last
moment is the line's plus theta's, eqs. (2-133) and (2-134). The coarse attitude counts by its noise beside:
the constant errors of the two are the same, eq. (2-104).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from nav.align.drift import CHANCE
from nav.align.static import SIGMAS, fine_status, go_on, nav_init, standing_at, with_constants
from nav.align.still import Block, Standing, standing
from nav.align.types import AlignConfig, NavInit, Stage
from nav.earth import earth_rate_g, gravity_g, normal_gravity
from nav.rotation import dcm_from_quat, quat_from_rotvec
from nav.types import Vector

FEWEST: Final = 4  # blocks that a parabola is laid through
TILTED: Final = 5e-4  # rad that the level may differ by before anything is said
MOVED: Final = 0.01  # m/s off the parabola, likewise
WEIGHED: Final = 512  # blocks whose weights are computed one by one; of more, the same at coarser steps
_UNIT: Final = 60.0  # s
_ZERO: Final = np.zeros(3)


class Lines(NamedTuple):
    """Integrals up to now, and the sums of the fit."""

    given: NavInit
    C: Vector  # C_gb (3, 3), held
    noise: Vector  # (3, 3) rad^2, of phi beside what constant errors make of it
    v: Vector  # (3,) m/s
    theta: Vector  # (3,) rad
    area: Vector  # (3,) rad s, integral of theta
    moments: Vector  # (5,) of time
    sums: Vector  # (3, 2) of the parabolas' values
    squares: Vector  # (2,)
    seconds: float = 0.0
    blocks: int = 0
    phi: Vector = _ZERO
    P: Vector | None = None  # (12, 12) as the coarse stage's


def init(config: AlignConfig, given: NavInit | None) -> Standing[Lines]:
    """Begin from the coarse stage's attitude."""
    assert given is not None
    zeros = (np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(5), np.zeros((3, 2)), np.zeros(2))
    C = dcm_from_quat(given.q_gb)
    constant = with_constants(config, C, given.lat, given.height, np.zeros((3, 3)))
    noise = given.P_phi - constant[3:6, 3:6]
    return go_on(config, given, Lines(given, C, noise, *zeros))


def _work(state: Standing[Lines], block: Block) -> tuple[Standing[Lines], str | None]:
    """Add a block to the integrals and the fit."""
    own, dt = state.own, block.dt
    given, C = own.given, own.C
    v = own.v + C @ block.pushed + gravity_g(given.lat, given.height) * dt
    theta = own.theta + C @ block.turned - earth_rate_g(given.lat) * dt
    area = own.area + 0.5 * (own.theta + theta) * dt
    seconds = own.seconds + dt
    g = normal_gravity(math.sin(given.lat), given.height)
    u = np.array([v[1] / g - area[0], -v[0] / g - area[1]])
    s = seconds / _UNIT
    own = own._replace(
        v=v,
        theta=theta,
        area=area,
        moments=own.moments + s ** np.arange(5),
        sums=own.sums + np.outer(s ** np.arange(3), u),
        squares=own.squares + u**2,
        seconds=seconds,
        blocks=own.blocks + 1,
    )
    state = state._replace(own=own)
    return _fit(state) if own.blocks >= FEWEST else (state, None)


def _fit(state: Standing[Lines]) -> tuple[Standing[Lines], str | None]:
    config, own = state.config, state.own
    given, T = own.given, own.seconds
    g, w = normal_gravity(math.sin(given.lat), given.height), earth_rate_g(given.lat)
    p = np.linalg.solve(own.moments[np.add.outer(np.arange(3), np.arange(3))], own.sums)
    left = np.sqrt(np.maximum(own.squares - np.sum(p * own.sums, axis=0), 0.0) / own.blocks)
    start = p[1] / _UNIT  # the lines' b, of east and north
    slope = 2.0 * p[2] / _UNIT**2  # their a
    tilt = start + 0.5 * T * slope + own.area[:2] / T  # its mean, on which kappa depends
    phi = np.empty(3)
    phi[:2] = start + T * slope + own.theta[:2]
    phi[2] = (tilt[1] * w[2] - slope[0]) / w[1]
    # that is the mean azimuth
    phi[2] += own.theta[2] - own.area[2] / T + 0.5 * T * tilt[0] * w[1]
    each = _covariance(config, own.blocks, T, g)
    J = np.zeros((3, 4))  # by slope and end, of east and of north
    J[0, 1], J[1, 3], J[2, 0], J[2, 3] = 1.0, 1.0, -1.0 / w[1], w[2] / w[1]
    noise = J @ np.kron(np.eye(2), each) @ J.T
    noise[2, 2] += (0.5 * T * config.gyro_bias) ** 2 + config.angle_random_walk**2 * T
    # the coarse attitude, by the gyros now, has the same constant errors and other noise
    coarse = own.noise + np.eye(3) * ((T * config.gyro_bias) ** 2 + config.angle_random_walk**2 * T)
    apart = own.theta - phi
    # so much more may be in it by chance, `nav.align.drift`
    odds = float(apart @ np.linalg.solve(noise + CHANCE * coarse, apart))
    gain = np.linalg.solve(noise + coarse, noise).T
    phi += gain @ apart
    noise -= gain @ noise
    C = dcm_from_quat(quat_from_rotvec(phi)) @ own.C
    P = with_constants(config, C, given.lat, given.height, noise)
    expected = math.hypot(config.sway, config.velocity_random_walk * math.sqrt(T)) / g
    expected += config.angle_random_walk * T**1.5
    reason = None
    mean = config.velocity_random_walk**2 / config.coarse_s + 2.0 * (config.sway / config.coarse_s) ** 2
    level = max(TILTED, SIGMAS * math.sqrt(each[1, 1] + mean / g**2))
    odd = slope[1] + tilt[0] * w[2]
    off = float(np.max(np.abs(start)))
    slack = math.hypot(config.gyro_bias, math.sqrt(each[0, 0]), config.accel_bias / g * w[2])
    if float(np.max(left)) > max(SIGMAS * expected, MOVED / g):
        reason = f"the vehicle moves: {g * float(np.max(left)):.2f} m/s off a standstill"
    elif off > level:
        reason = f"the level differs by {math.degrees(off):.2f} deg from the coarse one"
    elif odds > SIGMAS**2:
        degrees = math.degrees(float(np.linalg.norm(apart)))
        reason = (
            f"attitude by the drift of the level is {degrees:.3f} deg off the coarse one: the vehicle moves, "
            "or a gyro or an accelerometer is wrong"
        )
    elif abs(odd) > SIGMAS * slack:
        reason = (
            f"by the accelerometers the level drifts by {math.degrees(odd) * 3600:.2f} deg/h that the gyros "
            "do not see: the vehicle moves, or a sensor drifts"
        )
    return fine_status(state._replace(own=own._replace(phi=phi, P=P)), T, C, P), reason


@lru_cache(maxsize=4096)
def _weights(blocks: int) -> tuple[Vector, Vector, Vector]:
    """Weights of the fit per second of data of length 1 in ``blocks``: of values, of pushes, of turns.

    Rows (2, blocks): the slope and the value at the end of the line, the latter with theta's part.
    """
    t = (np.arange(blocks) + 1.0) / blocks
    fit = np.linalg.pinv(np.stack([np.ones_like(t), t, t**2], axis=1))
    value = np.stack([2.0 * fit[2], fit[1] + 2.0 * fit[2]])
    push = np.cumsum(value[:, ::-1], axis=1)[:, ::-1]
    # the integral of theta by trapezoids: half a block for the one in which it turned
    turn = -(np.cumsum(push[:, ::-1], axis=1)[:, ::-1] - 0.5 * push) / blocks
    turn[1] += 1.0
    return value, push, turn


def _covariance(config: AlignConfig, blocks: int, seconds: float, g: float) -> Vector:
    """Covariance (2, 2) of slope (rad/s) and end (rad) of a line, due to noise and sway."""
    n = min(blocks, WEIGHED)
    value, push, turn = _weights(n)
    scale = np.array([1.0 / seconds**2, 1.0 / seconds])
    value, push = value * scale[:, None], push * scale[:, None]
    turn = turn * np.array([[1.0 / seconds], [1.0]])
    dt = seconds / n
    sway = config.sway**2 * n / blocks
    return np.asarray(
        value @ value.T * (sway / g**2)
        + push @ push.T * (config.velocity_random_walk**2 * dt / g**2)
        + turn @ turn.T * (config.angle_random_walk**2 * dt)
    )


def finish(state: Standing[Lines]) -> NavInit:
    """Attitude at the last sample."""
    own = state.own
    assert own.P is not None
    C = dcm_from_quat(quat_from_rotvec(own.phi)) @ own.C
    place, sigma_p = standing_at(state.config, own.given, state.still, C)
    return nav_init(state.config, state.still.t_ns, place, sigma_p, C, np.zeros(12), own.P)


OPEN_LOOP: Final = Stage(init=init, step=standing(_work), finish=finish)
