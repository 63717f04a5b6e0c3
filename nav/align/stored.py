"""Starting from what is known: a heading stored before the vehicle was switched off, or a whole attitude.

The vehicle stands for ``coarse_s``. Its mean specific force and rate are what gravity and Earth rate are in
the attitude known, plus sensor biases: one small least-squares problem of phi and biases, in which
everything counts by its covariance. So gravity gives the level, however well an attitude from outside
claims to know it; gyros good enough to see Earth rate sharpen the heading; and the heading in turn shows
the biases of gyros that are not. What does not fit says that the vehicle was moved in the meantime.

The measurements are those of eqs. (2-109), (2-110) of "Inertial navigation"; the estimate is Groves', 2nd
edition, section 3.1.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align import still as watch
from nav.align.static import (
    SIGMAS,
    Coarse,
    Meaning,
    at_its_place,
    average,
    coarse_init,
    limit_of_means,
    nav_init,
    not_gravity,
    place_of,
    sigma_of_place,
    turning,
)
from nav.align.still import Still
from nav.align.types import AlignConfig, NavInit, Stage
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_quat, quat_from_rotvec, skew
from nav.types import Vector

PASSES: Final = 3
_FORCE_FLOOR: Final = 1e-7  # m/s^2 and rad/s: ideal sensors have no noise to divide by
_RATE_FLOOR: Final = 1e-12
_PHI, _EPS, _NAB = slice(0, 3), slice(3, 6), slice(6, 9)
_EYE: Final = np.eye(3)


class Known(NamedTuple):
    """C_gb (3, 3), gyro and accelerometer bias (6,), covariance (9, 9) with phi; and what does not fit."""

    C: Vector
    biases: Vector
    P: Vector
    conflict: str | None


class _Seen(NamedTuple):
    """A vector (3,) that is ``v_g`` in g, as seen in b with noise of covariance ``R`` (3, 3)."""

    v_b: Vector
    v_g: Vector
    R: Vector
    bias: slice


def prior(config: AlignConfig, force: Vector) -> tuple[Vector, Vector]:
    """C_gb (3, 3) and information (3,) about phi, 1/rad^2, before gravity is asked; ``force`` (3,) in b.

    An attitude counts before a heading. The heading is that of the vehicle's forward axis, so it needs
    the mounting; of the level it says nothing.
    """
    if config.attitude is not None:
        q_gb, sigma = config.attitude
        return dcm_from_quat(q_gb), 1.0 / np.maximum(np.asarray(sigma, np.float64), 1e-9) ** 2
    assert config.heading is not None
    assert config.C_vb is not None
    heading, sigma_h = config.heading
    up = force / np.linalg.norm(force)
    east = np.cross(config.C_vb[1], up)
    east /= np.linalg.norm(east)
    c, s = math.cos(heading), math.sin(heading)
    # rows: right of the heading, along it, up; turned to east and north
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn @ np.stack([east, np.cross(up, east), up]), np.array(
        [0.0, 0.0, 1.0 / max(sigma_h, 1e-9) ** 2]
    )


def know(config: AlignConfig, still: Still, lat: float, height: float) -> Known:
    """The attitude known, after what the means of a standstill say about it."""
    C0, information = prior(config, still.force)
    T = still.seconds
    push = config.velocity_random_walk**2 / T + 2.0 * (config.sway / T) ** 2 + _FORCE_FLOOR**2
    force = _Seen(still.force, -gravity_g(lat, height), _EYE * push, _NAB)
    drift, turn = watch.mean_rate(still, config)
    turn = turn + _EYE * _RATE_FLOOR**2
    rate = _Seen(drift.rate, earth_rate_g(lat), turn, _EPS)
    N0 = np.zeros((9, 9))
    N0[_PHI, _PHI] = np.diag(information)
    N0[_EPS, _EPS] = _EYE / max(config.gyro_bias, _RATE_FLOOR) ** 2
    N0[_NAB, _NAB] = _EYE / max(config.accel_bias, _FORCE_FLOOR) ** 2
    conflict = None
    if config.attitude is not None:
        tilt, chi2 = _surprise(C0, np.zeros(9), _covariance(N0), force, slice(0, 2))
        if chi2 > SIGMAS**2:
            g = float(np.linalg.norm(force.v_g))
            off = math.degrees(tilt / g)
            conflict = f"the vehicle stands {off:.2f} deg off the level of the attitude it was given"
    level = _solve(C0, N0, (force,))
    x = np.concatenate([np.zeros(3), level.biases])
    miss, chi2 = _surprise(level.C, x, level.P, rate, slice(0, 1))
    if conflict is None and chi2 > SIGMAS**2:
        heading = math.degrees(miss / float(rate.v_g[1]))
        conflict = f"the vehicle has turned since: by Earth rate its heading is about {heading:.1f} deg off"
    found = _solve(C0, N0, (force, rate))
    # what is no mean rate has turned the vehicle since the middle
    C = found.C @ dcm_from_quat(quat_from_rotvec(drift.now))
    P = found.P.copy()
    P[_PHI, _PHI] += (0.5 * T) ** 2 * C @ turn @ C.T
    return Known(C, found.biases, 0.5 * (P + P.T), conflict)


def _design(C: Vector, seen: _Seen) -> Vector:
    """H (3, 9) of what is seen: b axes, errors true minus estimate."""
    H = np.zeros((3, 9))
    H[:, _PHI] = C.T @ skew(seen.v_g)
    H[:, seen.bias] = _EYE
    return H


def _surprise(C: Vector, x: Vector, P: Vector, seen: _Seen, axes: slice) -> tuple[float, float]:
    """What is seen against what was expected along ``axes`` of g: size, and normalised square."""
    H = (C @ _design(C, seen))[axes]
    nu = (C @ (seen.v_b - x[seen.bias]) - seen.v_g)[axes]
    S = H @ P @ H.T + (C @ seen.R @ C.T)[axes, axes]
    return float(np.linalg.norm(nu)), float(nu @ np.linalg.solve(S, nu))


def _solve(C0: Vector, N0: Vector, all_seen: tuple[_Seen, ...]) -> Known:
    """Gauss-Newton from the prior: what was known is ``C0`` (3, 3), no biases, information ``N0`` (9, 9)."""
    x, C, P = np.zeros(9), C0, np.zeros((9, 9))
    for _ in range(PASSES):
        N, b = N0.copy(), -N0 @ x
        for seen in all_seen:
            H = _design(C, seen)
            weight = np.linalg.inv(seen.R)
            N += H.T @ weight @ H
            b += H.T @ weight @ (seen.v_b - x[seen.bias] - C.T @ seen.v_g)
        P = _covariance(N)
        x = x + P @ b
        C = dcm_from_quat(quat_from_rotvec(x[_PHI])) @ C0
    return Known(C, x[3:], 0.5 * (P + P.T), None)


def _covariance(N: Vector) -> Vector:
    """Inverse of an information matrix whose units differ by many powers of ten."""
    scale = 1.0 / np.sqrt(np.diag(N))
    return np.asarray(np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale), dtype=np.float64)


def _missing(config: AlignConfig) -> str | None:
    if config.attitude is not None:
        return None
    if config.heading is None:
        return "neither a heading nor an attitude is known"
    return None if config.C_vb is not None else "a stored heading is the vehicle's: it needs a known mounting"


def _against(config: AlignConfig, still: Still, lat: float, height: float) -> str | None:
    return (
        _missing(config)
        or not_gravity(config, still.force * still.seconds, still.seconds, lat, height)
        or turning(config, still, lat)
        or know(config, still, lat, height).conflict
    )


def _attitude(config: AlignConfig, still: Still, lat: float, height: float) -> tuple[Vector, Vector] | None:
    if _missing(config) is not None:
        return None
    found = know(config, still, lat, height)
    return found.C, found.P[_PHI, _PHI]


def _limit(config: AlignConfig, lat: float, height: float) -> Vector:
    """What is known from outside and what these sensors see, together."""
    sensors = limit_of_means(config, lat, height)
    if config.attitude is not None:
        outside = np.asarray(config.attitude[1], np.float64)
    elif config.heading is not None:
        outside = np.array([math.inf, math.inf, config.heading[1]])
    else:
        return sensors
    return np.asarray(1.0 / np.sqrt(1.0 / sensors**2 + 1.0 / np.maximum(outside, 1e-9) ** 2))


def finish(state: Coarse) -> NavInit:
    """Attitude and biases at the last sample."""
    config, still = state.config, state.still
    place = place_of(config, still)
    assert place is not None
    found = know(config, still, place[0], place[2])
    P, x = np.zeros((12, 12)), np.zeros(12)
    P[0:3, 0:3] = _EYE * config.sway**2
    P[3:, 3:], x[6:] = found.P, found.biases
    given = nav_init(config, still.t_ns, place, sigma_of_place(config, still), found.C, x, P, True)
    return at_its_place(config, still, given)


STORED: Final = Stage(init=coarse_init, step=average(Meaning(_against, _attitude, _limit)), finish=finish)
