"""Level, heading and mounting of an IMU in a vehicle that says how fast it drives, without a standstill.

A vehicle with wheels moves along its forward axis, so that in b its velocity is its speed s times one
constant unit vector y. With b0 the IMU's axes at the start of the window, V and R as in
`nav.align.preintegrate` and G gravity in b0,

    V(t) + G t = s(t) R(t) y - s(0) y,

which is linear in y and G: speeding up, braking and every turn at speed show both the forward axis and the
vertical, whatever the attitude was. The path, the integral of s R y, laid on the positions gives heading. A
least-squares fit of everything with the biases follows. The velocity constraint is that of Groves, 2nd
edition, section 15.4.1, with the axis unknown.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.align.fit import (
    POSITION_FLOOR,
    SCALE_SLACK,
    UNSTATED_SIGMA,
    VELOCITY_FLOOR,
    Fit,
    Window,
    carried,
    ended,
    fit_heading,
    local,
    pulled,
)
from nav.align.level import level_dcm, rotate_heading
from nav.align.mounting import COURSE_NOISE, SLIP_LEVER, SLOWEST
from nav.align.preintegrate import P_ACCEL, P_GYRO, R_GYRO, V_ACCEL, V_GYRO, P, R, V, empty, running
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, skew
from nav.types import SpeedSample, Vector

Indices = NDArray[np.intp]

FEWEST_SPEEDS: Final = 5
SAME_INSTANT_NS: Final = 20_000_000
LONGEST_BRIDGE_NS: Final = 2_500_000_000
TURNS: Final = 12
UNMODELLED: Final = math.radians(0.1)  # rad
_ROUGH: Final = 0.3  # m/s: sigma of the first, linear fit
_G, _A, _V0, _P0, _Y = slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15), slice(15, 17)


def speeds_at(speeds: tuple[SpeedSample, ...], t_ns: list[int]) -> tuple[Vector, Vector]:
    """Speed and sigma (K,) m/s at instants, NaN where none is near: at the instant, or on either side."""
    times = np.array([s.t_ns for s in speeds], dtype=np.int64)
    out = np.full((2, len(t_ns)), math.nan)
    for k, t in enumerate(t_ns):
        i = int(np.searchsorted(times, t))
        near = [j for j in (i - 1, i) if 0 <= j < len(speeds) and abs(int(times[j]) - t) <= SAME_INSTANT_NS]
        if near:
            out[:, k] = speeds[near[0]].speed, speeds[near[0]].sigma
        elif 0 < i < len(speeds) and (span := int(times[i] - times[i - 1])) <= LONGEST_BRIDGE_NS:
            a, b, part = speeds[i - 1], speeds[i], (t - int(times[i - 1])) / span
            # between two speeds lies an acceleration that may change on the way
            own = 0.25 * abs(b.speed - a.speed) * (1.0 - abs(2.0 * part - 1.0))
            out[:, k] = a.speed + part * (b.speed - a.speed), math.hypot(max(a.sigma, b.sigma), own)
    return out[0], out[1]


def solve_driven(window: Window) -> Fit | None:
    """Fit the window with the speeds in it; None while there has been too little motion."""
    config, given = window.config, window.given
    fixes = [e.fix for e in window.epochs]
    speed, sigma_speed = speeds_at(window.speeds, [f.t_ns for f in fixes])
    driven = np.flatnonzero(np.isfinite(speed) & (np.abs(np.nan_to_num(speed)) > SLOWEST))
    if len(driven) < FEWEST_SPEEDS:
        return None
    pieces = np.array([empty()] + [e.piece for e in window.epochs[1:]])
    rates = np.array([e.rate for e in window.epochs])
    t = np.array([(f.t_ns - fixes[0].t_ns) * 1e-9 for f in fixes])
    position = local(fixes)
    coarse = _coarse(pieces, t, speed, driven, position, given.sigma_gyro_bias)
    if coarse is None:
        return None
    C, y, bias = coarse

    g, w_ie = gravity_g(fixes[0].lat, fixes[0].height), earth_rate_g(fixes[0].lat)
    known_v, known_p = pulled(t, position, np.gradient(position, t, axis=0), g, w_ie)
    claimed = np.array([f.sigma_position for f in fixes])
    sigma_p = np.hypot(
        np.where(np.isfinite(claimed) & (claimed > 0.0), claimed, UNSTATED_SIGMA), POSITION_FLOOR
    )
    s = speed[driven]
    turning = SLIP_LEVER * np.linalg.norm(rates[driven] - bias, axis=1)
    across = np.sqrt(turning**2 + (COURSE_NOISE * s) ** 2 + VELOCITY_FLOOR**2)
    sigma_s = np.stack([np.hypot(sigma_speed[driven], VELOCITY_FLOOR), across, across], axis=1)

    x = np.zeros(9)
    x[0:3] = bias
    rows = np.empty_like(pieces)
    running(pieces, x[0:3], x[3:6], rows)
    first = driven[0]
    moved_v = C @ rows[first, V]
    x[6:9] = C @ rows[first, R].reshape(3, 3) @ y * s[0] - moved_v - known_v[first]
    start = np.zeros(3)
    inflation_p = inflation_s = 1.0
    formal, delta = math.inf, np.full(17, math.inf)
    cov = np.eye(17)
    for turn in range(TURNS):
        running(pieces, x[0:3], x[3:6], rows)
        rotations = rows[:, R].reshape(-1, 3, 3)
        lever = np.einsum("kij,j->ki", rotations, config.gnss_lever_arm)
        moved = (rows[:, P] + lever) @ C.T
        Hp = np.zeros((len(t), 3, 17))
        Hp[:, :, 0:3] = -skew(moved)
        Hp[:, :, _G] = C @ rows[:, P_GYRO].reshape(-1, 3, 3)
        Hp[:, :, _A] = C @ rows[:, P_ACCEL].reshape(-1, 3, 3)
        Hp[:, :, _V0] = t[:, None, None] * np.eye(3)
        Hp[:, :, _P0] = np.eye(3)
        res_p = position - (moved + known_p + t[:, None] * x[6:9] + start)

        basis = _basis(y)
        moved = rows[driven, V] @ C.T
        v = x[6:9] + moved + known_v[driven]
        M = np.einsum("kji,lj->kil", rotations[driven], C)  # C_bg
        u = np.einsum("kij,kj->ki", M, v)
        Hs = np.zeros((len(s), 3, 17))
        Hs[:, :, 0:3] = M @ (skew(v) - skew(moved))
        Hs[:, :, _G] = M @ C @ rows[driven, V_GYRO].reshape(-1, 3, 3)
        Hs[:, :, _G] += skew(u) @ rows[driven, R_GYRO].reshape(-1, 3, 3)
        Hs[:, :, _A] = M @ C @ rows[driven, V_ACCEL].reshape(-1, 3, 3)
        Hs[:, :, _V0] = M
        Hs[:, :, _Y] = -s[:, None, None] * basis[1:].T
        Hs = basis @ Hs
        res_s = (s[:, None] * y - u) @ basis.T

        if turn >= 3:
            inflation_p, inflation_s = _inflation(res_p / sigma_p), _inflation(res_s / sigma_s)
        A_p, A_s = (Hp / sigma_p[:, :, None]).reshape(-1, 17), (Hs / sigma_s[:, :, None]).reshape(-1, 17)
        N_p, N_s = A_p.T @ A_p, A_s.T @ A_s
        prior = np.zeros(17)
        prior[_G] = 1.0 / given.sigma_gyro_bias**2
        prior[_A] = 1.0 / given.sigma_accel_bias**2
        prior[0:3] = prior[_V0] = prior[_P0] = 1e-8  # not known: enough to keep the matrix regular
        prior[_Y] = 1e-4
        N = N_p / inflation_p + N_s / inflation_s + np.diag(prior)
        cov = np.asarray(np.linalg.inv(N), dtype=np.float64)
        if turn == 3:
            formal = math.sqrt(float(np.linalg.inv(N_p + N_s + np.diag(prior))[2, 2]))
        b = A_p.T @ (res_p / sigma_p).ravel() / inflation_p + A_s.T @ (res_s / sigma_s).ravel() / inflation_s
        b[3:9] -= prior[3:9] * x[0:6]
        delta = cov @ b
        C = dcm_from_quat(quat_from_rotvec(delta[0:3])) @ C
        x = x + delta[3:12]
        start = start + delta[_P0]
        y = y + basis[1:].T @ delta[_Y]
        y = y / np.linalg.norm(y)
        if turn >= 4 and float(np.max(np.abs(delta[0:3]))) < 1e-4:
            break
    running(pieces, x[0:3], x[3:6], rows)
    trusted = float(np.max(np.abs(delta[0:3]))) < 1e-2
    J = carried(C, rows[-1])
    end = J @ cov[0:12, 0:12] @ J.T
    # what the window's straight sensors and a vehicle's own axis leave out
    end[0:3, 0:3] += np.eye(3) * UNMODELLED**2
    end[9:12, 9:12] += np.eye(3) * VELOCITY_FLOOR**2
    forward_cov = basis[1:].T @ cov[_Y, _Y] @ basis[1:]
    return Fit(
        C,
        x,
        rows,
        *ended(C, x, rows[-1], known_v[-1], position[-1], w_ie),
        end,
        formal,
        trusted,
        y,
        forward_cov,
    )


def _basis(y: Vector) -> Vector:
    """Rows (3, 3): ``y`` and two unit vectors across."""
    a = np.zeros(3)
    a[int(np.argmin(np.abs(y)))] = 1.0
    a -= y * (y @ a)
    a /= np.linalg.norm(a)
    return np.stack([y, a, np.cross(y, a)])


def _coarse(
    pieces: Vector, t: Vector, speed: Vector, driven: Indices, position: Vector, sigma_bias: Vector
) -> tuple[Vector, Vector, Vector] | None:
    """C_gb at the start, forward axis in b, added gyro bias; None while the motion does not show them."""
    bias = np.zeros(3)
    y, G = np.zeros(3), np.zeros(3)
    rows = np.empty_like(pieces)
    s, dt = speed[driven], (t[driven] - t[driven[0]])[1:]
    for turn in range(4):
        running(pieces, bias, np.zeros(3), rows)
        parts = rows[driven]
        turned = s[:, None, None] * parts[:, R].reshape(-1, 3, 3)
        A = np.zeros((len(dt), 3, 9))
        A[:, :, 0:3] = turned[1:] - turned[0]
        A[:, :, 3:6] = -dt[:, None, None] * np.eye(3)
        if turn:
            # a bias turns the axes, d(R y) = -R [y x] dtheta, and with them the force
            swung = -turned @ skew(y[None])[0] @ parts[:, R_GYRO].reshape(-1, 3, 3)
            pushed = parts[:, V_GYRO].reshape(-1, 3, 3)
            A[:, :, 6:9] = swung[1:] - swung[0] - (pushed[1:] - pushed[0])
        z = parts[1:, V] - parts[0, V]
        # the biases are known beforehand to their sigma, the rest just enough to be regular
        weight = np.concatenate([np.full(6, 1e-3), 1.0 / sigma_bias])
        A = np.concatenate([A.reshape(-1, 9) / _ROUGH, np.diag(weight)])
        right = np.concatenate([z.ravel() / _ROUGH, np.zeros(6), -bias / sigma_bias])
        found = np.linalg.lstsq(A, right, rcond=None)[0]
        y, G, bias = found[0:3], found[3:6], bias + found[6:9]
    length = float(np.linalg.norm(y))
    if abs(length - 1.0) > 2.0 * SCALE_SLACK:
        return None
    y = y / length
    C = level_dcm(-G)
    running(pieces, bias, np.zeros(3), rows)
    ahead = np.einsum("kij,j->ki", rows[driven, R].reshape(-1, 3, 3), y) * s[:, None]
    path = np.zeros_like(ahead)
    path[1:] = np.cumsum(0.5 * np.diff(t[driven])[:, None] * (ahead[1:] + ahead[:-1]), axis=0)
    psi, scale = fit_heading((path @ C.T)[:, :2], position[driven, :2])
    if abs(scale - 1.0) > SCALE_SLACK:
        return None
    return dcm_from_quat(rotate_heading(quat_from_dcm(C), psi)), y, bias


def _inflation(normed: Vector) -> float:
    """How much more residuals (K, 3) over sigma weigh than independent ones of that sigma; at least 1.

    Neighbours that agree count as fewer: (1 + rho) / (1 - rho) of a first-order process.
    """
    total = max(float(np.sum(normed**2)), 1e-12)
    rho = min(0.9, max(0.0, float(np.sum(normed[1:] * normed[:-1])) / total))
    return max(1.0, total / max(1, normed.size - 8) * (1.0 + rho) / (1.0 - rho))
