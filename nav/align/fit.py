"""The fit behind the heading from motion: integrated specific force against GNSS, over a window of fixes.

With b0 the IMU's axes at the start of the window,

    v_g(t) = v_g(0) + C_gb0 (V(t) + R(t) (w x l)) + g t + small terms of Earth rate,

V and R from the gyros and accelerometers alone. A linear fit in (cos, sin) of the unknown heading starts
it; a least-squares fit of attitude, biases and initial velocity, with the standstill's level and gyro
bias as prior, ends it, and its residuals say how far the result is to be trusted. A receiver without
velocity is matched in position, once more integrated. The equation of motion is Groves', 2nd edition,
section 5.3, integrated once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from nav.align.level import UNKNOWN_HEADING, rotate_heading
from nav.align.preintegrate import P_ACCEL, P_GYRO, V_ACCEL, V_GYRO, P, R, V, empty, running
from nav.align.types import AlignConfig, NavInit
from nav.earth import convergence, earth_rate_g, ecef, gravity_g, position_quat
from nav.rotation import dcm_from_quat, quat_conjugate, quat_from_rotvec, quat_rotate
from nav.types import GnssFix, SpeedSample, Vector

SMALLEST_EXCITATION: Final = 0.5  # m/s rms of integrated specific force about its mean
VELOCITY_FLOOR: Final = 0.03  # m/s, time tags and vibration beyond what the receiver claims
POSITION_FLOOR: Final = 0.02  # m
UNSTATED_SIGMA: Final = 0.3  # m or m/s, of a receiver that claims nothing
SCALE_SLACK: Final = 0.2  # of 1: the fitted length of the specific force against GNSS


@dataclass(frozen=True, slots=True)
class Epoch:
    """A fix, and the motion from the one before it."""

    fix: GnssFix
    piece: Vector
    rate: Vector  # w_ib_b (3,) rad/s around the fix


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a fit: attitude at the start of the window, corrections, and their covariance."""

    C: Vector  # C_gb at the start of the window
    x: Vector  # (9,) added gyro bias, added accelerometer bias, velocity at the start
    cov: Vector  # (12, 12) of phi at the start, gyro bias, accelerometer bias, velocity at the start
    formal: float  # rad, heading sigma from the receiver's own claims, without the residuals' say
    rows: Vector  # (K, SIZE) running pieces with the corrected biases
    trusted: bool
    forward: Vector | None = None  # the vehicle's forward axis in b, where speeds show it
    forward_cov: Vector | None = None  # (3, 3) rad^2, of its end in b


@dataclass(frozen=True, slots=True)
class Window:
    """What is fitted: the motion since the first of ``epochs``, and what was known before it.

    ``q_hb`` (4,): attitude at that fix, heading arbitrary; ``level_sigma`` rad: of its level, beyond what the
    accelerometer bias explains. ``speeds`` in the order of time.
    """

    config: AlignConfig
    given: NavInit
    q_hb: Vector
    level_sigma: float
    epochs: tuple[Epoch, ...] = ()
    speeds: tuple[SpeedSample, ...] = ()


def local(fixes: list[GnssFix]) -> Vector:
    """Positions (K, 3) m east, north, up of the first fix; up is the difference of heights."""
    first = fixes[0]
    place = np.array([(f.lat, f.lon, f.height) for f in fixes])
    apart_e = ecef(*place.T) - ecef(first.lat, first.lon, first.height)
    apart = quat_rotate(quat_conjugate(position_quat(first.lat, first.lon)), apart_e)
    apart[:, 2] = place[:, 2] - first.height
    return apart


def velocities(fixes: list[GnssFix]) -> Vector:
    """Velocities (K, 3) m/s of fixes that have one, along east and north as they are at the first, and up."""
    place = np.array([(f.lat, f.lon) for f in fixes])
    turn = convergence(place[:, 0], place[:, 1], *place[0])
    c, s = np.cos(turn), np.sin(turn)
    east, north, up = np.array([f.v_g for f in fixes]).T
    return np.stack([c * east + s * north, c * north - s * east, up], axis=1)


def skew(rows: Vector) -> Vector:
    """[r x] (K, 3, 3) of rows (K, 3)."""
    out = np.zeros((len(rows), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -rows[:, 2], rows[:, 1], -rows[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = rows[:, 2], -rows[:, 1], rows[:, 0]
    return out


def fit_heading(u: Vector, y: Vector) -> tuple[float, float]:
    """Rotation psi (rad, counter-clockwise) and scale that take ``u`` (K, 2) to ``y`` (K, 2).

    Both are level and each about its mean. Linear in (scale cos psi, scale sin psi) and the initial velocity.
    """
    u, y = u - u.mean(axis=0), y - y.mean(axis=0)
    c = float(np.sum(u * y))
    s = float(np.sum(u[:, 0] * y[:, 1] - u[:, 1] * y[:, 0]))
    return math.atan2(s, c), math.hypot(c, s) / max(float(np.sum(u * u)), 1e-12)


def solve(window: Window) -> Fit | None:
    """Fit the window; None while there has been too little motion in it."""
    config = window.config
    fixes = [e.fix for e in window.epochs]
    pieces = np.array([empty()] + [e.piece for e in window.epochs[1:]])
    rates = np.array([e.rate for e in window.epochs])
    lat, height = fixes[0].lat, fixes[0].height
    g, w_ie = gravity_g(lat, height), earth_rate_g(lat)
    position = local(fixes)
    by_velocity = all(f.v_g is not None for f in fixes)
    t = np.array([(f.t_ns - fixes[0].t_ns) * 1e-9 for f in fixes])
    if by_velocity:
        measured = velocities(fixes)
        claimed = np.array([f.sigma_velocity for f in fixes])
        floor, lever = VELOCITY_FLOOR, np.cross(rates, config.gnss_lever_arm)
        t_v = t - config.gnss_velocity_age
        # gravity, Coriolis, and what the turning of g with the Earth does to the first term
        known = (
            t_v[:, None] * g - 2.0 * np.cross(w_ie, position) + 0.5 * t_v[:, None] ** 2 * np.cross(w_ie, g)
        )
    else:
        measured = position
        claimed = np.array([f.sigma_position for f in fixes])
        floor, lever = POSITION_FLOOR, np.tile(config.gnss_lever_arm, (len(fixes), 1))
        known = 0.5 * t[:, None] ** 2 * g + t[:, None] ** 3 / 6.0 * np.cross(w_ie, g)
    sigma = np.hypot(np.where(np.isfinite(claimed) & (claimed > 0.0), claimed, UNSTATED_SIGMA), floor)

    rows = np.empty_like(pieces)
    x = np.zeros(9)  # added gyro bias, added accelerometer bias, velocity at the start
    running(pieces, x[0:3], x[3:6], rows)
    C = dcm_from_quat(window.q_hb)
    age = config.gnss_velocity_age
    moved = _moved(rows, lever, t, age, by_velocity)
    u = (moved - moved[0]) @ C.T + known
    excited = (rows[:, V] @ C.T + t[:, None] * g)[:, :2]
    if float(np.sqrt(np.mean(np.sum((excited - excited.mean(axis=0)) ** 2, axis=1)))) < SMALLEST_EXCITATION:
        return None
    if by_velocity:
        psi, _ = fit_heading(u[:, :2], measured[:, :2])
    else:
        psi, _ = fit_heading(_detrended(t, u[:, :2]), _detrended(t, measured[:, :2]))
    C = dcm_from_quat(rotate_heading(window.q_hb, psi))
    start = np.zeros(3)  # position at the start, of the position match
    x[6:9] = measured[0] if by_velocity else (position[-1] - position[0]) / t[-1]
    inflation, formal = 1.0, math.inf
    cov = np.eye(15)
    gravity = float(-g[2])
    for turn in range(6):
        running(pieces, x[0:3], x[3:6], rows)
        moved = _moved(rows, lever, t, age, by_velocity) @ C.T
        columns = np.zeros((len(t), 3, 15))
        columns[:, :, 0:3] = -skew(moved)
        gyro, accel = (V_GYRO, V_ACCEL) if by_velocity else (P_GYRO, P_ACCEL)
        columns[:, :, 3:6] = C @ rows[:, gyro].reshape(-1, 3, 3)
        columns[:, :, 6:9] = C @ rows[:, accel].reshape(-1, 3, 3)
        columns[:, :, 9:12] = np.eye(3) if by_velocity else t[:, None, None] * np.eye(3)
        predicted = moved + known + (x[6:9] if by_velocity else t[:, None] * x[6:9] + start)
        if not by_velocity:
            columns[:, :, 12:15] = np.eye(3)
        residual = measured - predicted
        A = (columns / sigma[:, :, None]).reshape(-1, 15)
        r = (residual / sigma).ravel()
        N_prior, b_prior = _prior(window, C, x, gravity)
        if turn >= 2:
            inflation = _inflation(residual / sigma)
        N = A.T @ A / inflation + N_prior
        cov = np.asarray(np.linalg.inv(N), dtype=np.float64)
        if turn == 2:
            formal = math.sqrt(float(np.linalg.inv(A.T @ A + N_prior)[2, 2]))
        delta = cov @ (A.T @ r / inflation + b_prior)
        C = dcm_from_quat(quat_from_rotvec(delta[0:3])) @ C
        x = x + delta[3:12]
        start = start + delta[12:15]
        if turn >= 3 and float(np.max(np.abs(delta[0:3]))) < 1e-4:
            break
    running(pieces, x[0:3], x[3:6], rows)
    u = _moved(rows, lever, t, age, by_velocity) @ C.T + known
    if by_velocity:
        error, scale = fit_heading(u[:, :2], measured[:, :2])
    else:
        error, scale = fit_heading(_detrended(t, u[:, :2]), _detrended(t, measured[:, :2]))
    trusted = abs(scale - 1.0) < SCALE_SLACK and abs(error) < 0.2
    return Fit(C, x, cov[0:12, 0:12], formal, rows.copy(), trusted)


def _moved(rows: Vector, lever: Vector, t: Vector, age: float, by_velocity: bool) -> Vector:
    """What the fixes show of V (m/s), or P (m), (K, 3) in b at the start, with the lever arm's part.

    A velocity that is ``age`` s older than its fix is met by going back along the mean acceleration since the
    fix before.
    """
    if not by_velocity:
        return np.asarray(rows[:, P] + _turned(rows, lever))
    v = rows[:, V]
    if age > 0.0:
        slope = np.diff(v, axis=0) / np.diff(t)[:, None]
        v = v - age * np.concatenate([slope[:1], slope])
    return np.asarray(v + _turned(rows, lever))


def _turned(rows: Vector, lever: Vector) -> Vector:
    """R(t) times vectors (K, 3) given in b at each fix."""
    turned: Vector = np.einsum("kij,kj->ki", rows[:, R].reshape(-1, 3, 3), lever)
    return turned


def _detrended(t: Vector, y: Vector) -> Vector:
    """Columns of ``y`` (K, M) without their best straight lines in ``t``."""
    A = np.stack([np.ones_like(t), t], axis=1)
    rest: Vector = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return rest


def _prior(window: Window, C: Vector, x: Vector, gravity: float) -> tuple[Vector, Vector]:
    """Normal matrix and right side of what was known before the drive: level, biases.

    A level from gravity is tilted by the accelerometer bias, "Inertial navigation", eq. (2-104):
    phi_E = -nabla_N/g, phi_N = nabla_E/g. So it is the sum of tilt and bias that a standstill knows well.
    """
    given, C0 = window.given, dcm_from_quat(window.q_hb)
    up = C @ C0[2]  # where the present attitude sees what levelling took for the vertical
    H = np.zeros((2, 15))
    bias_g = C @ x[3:6]
    H[0, 0], H[0, 6:9] = 1.0, C[1] / gravity
    H[1, 1], H[1, 6:9] = 1.0, -C[0] / gravity
    z = np.array([up[1] - bias_g[1] / gravity, -up[0] + bias_g[0] / gravity])
    weight = 1.0 / window.level_sigma**2
    N = weight * H.T @ H
    b = weight * H.T @ z
    gyro, accel = 1.0 / given.sigma_gyro_bias**2, 1.0 / given.sigma_accel_bias**2
    i = np.arange(3)
    N[3 + i, 3 + i] += gyro
    N[6 + i, 6 + i] += accel
    b[3:6] -= gyro * x[0:3]
    b[6:9] -= accel * x[3:6]
    # the rest is not known: enough to keep the matrix regular
    N[2, 2] += 1.0 / UNKNOWN_HEADING**2 * 1e-4
    N[9 + i, 9 + i] += 1e-8
    N[12 + i, 12 + i] += 1e-8
    return N, b


def _inflation(normed: Vector) -> float:
    """How much larger the measurements' variance is than claimed, from residuals (K, 3) over sigma.

    Neighbouring residuals that agree count as fewer: (1 + rho) / (1 - rho) of a first-order process.
    """
    dof = max(1, normed.size - 9)
    chi2 = float(np.sum(normed**2)) / dof
    rho = float(np.sum(normed[1:] * normed[:-1])) / max(float(np.sum(normed**2)), 1e-12)
    rho = min(0.9, max(0.0, rho))
    return max(1.0, chi2) * (1.0 + rho) / (1.0 - rho)
