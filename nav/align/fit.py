"""The fit behind the heading from motion: integrated specific force against GNSS, over a window of fixes.

With b0 the IMU's axes at the start of the window,

    v_g(t) = v_g(0) + C_gb0 (V(t) + R(t) (w x l)) + g t + small terms of Earth rate,

V and R from the gyros and accelerometers alone. A linear fit in (cos, sin) of the unknown heading starts
it; a filter of attitude, velocity and the sensors' constant errors (`nav.align.match_filter`), with the
standstill's level and gyro bias as prior, goes through the fixes and ends it. It is repeated about what it
finds until that stays (an iterated extended Kalman smoother, of which only the two ends are wanted: Bell,
"The iterated Kalman smoother as a Gauss-Newton method", SIAM J. Optimization 4(3), 1994), and its innovations
say how far the receiver is to be trusted. A receiver without velocity is matched in position, once more
integrated. The equation of motion is Groves', 2nd edition, section 5.3, integrated once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from nav.align.level import rotate_heading
from nav.align.match_filter import model, own_errors, through
from nav.align.preintegrate import DT, R_GYRO, V_ACCEL, V_GYRO, P, R, V, empty, running
from nav.align.types import AlignConfig, NavInit
from nav.earth import SEMI_MAJOR, convergence, earth_rate_g, ecef, gravity_g, position_quat
from nav.rotation import (
    dcm_from_quat,
    quat_conjugate,
    quat_from_dcm,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    skew,
)
from nav.types import GnssFix, SpeedSample, Vector

SMALLEST_EXCITATION: Final = 0.5  # m/s rms of integrated specific force about its mean
VELOCITY_FLOOR: Final = 0.03  # m/s, of what is known of a vehicle's motion beside a receiver's claims
RESOLUTION: Final = 0.005  # m or m/s: no receiver says less
POSITION_FLOOR: Final = 0.02  # m
UNSTATED_SIGMA: Final = 0.3  # m or m/s, of a receiver that claims nothing
SCALE_SLACK: Final = 0.2  # of 1: the fitted length of the specific force against GNSS
TURNS: Final = 8
SURE: Final = 1e-5  # rad: nobody levels better, and no covariance is singular
SAME: Final = 1e-3  # rad: where repeating ends; the next step would be the square of it
_ANY: Final = np.array([10.0, 1e3, 1e4])  # rad of heading, m/s, m: no prior at all


@dataclass(frozen=True, slots=True)
class Epoch:
    """A fix, and the motion from the one before it."""

    fix: GnssFix
    piece: Vector
    rate: Vector  # w_ib_b (3,) rad/s at the fix


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a fit: where the window starts and ends, and how well its end is known."""

    C: Vector  # C_gb at the start of the window
    x: Vector  # (9,) added gyro bias, added accelerometer bias, velocity at the start
    rows: Vector  # (K, SIZE) running pieces with the corrected biases
    C_end: Vector  # C_gb and velocity at the last fix, of whose time east and north at the first fix
    v_end: Vector
    cov: Vector  # (12, 12) of phi, gyro bias, accelerometer bias, velocity there
    formal: float  # rad, heading sigma from the receiver's own claims, without the residuals' say
    trusted: bool
    forward: Vector | None = None  # the vehicle's forward axis in b, where speeds show it
    forward_cov: Vector | None = None  # (3, 3) rad^2, of its end in b


@dataclass(frozen=True, slots=True)
class Window:
    """What is fitted: the motion since the first of ``epochs``, and what was known before it.

    ``before``: the piece from what was ``given``, its heading arbitrary, to that fix. ``speeds`` in the order
    of time.
    """

    config: AlignConfig
    given: NavInit
    before: Vector
    epochs: tuple[Epoch, ...] = ()
    speeds: tuple[SpeedSample, ...] = ()

    @property
    def q_hb(self) -> Vector:
        """Attitude (4,) at the first fix, heading arbitrary."""
        return quat_multiply(self.given.q_gb, quat_from_dcm(self.before[R].reshape(3, 3)))


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
    g, w_ie = gravity_g(fixes[0].lat, fixes[0].height), earth_rate_g(fixes[0].lat)
    position = local(fixes)
    t = np.array([(f.t_ns - fixes[0].t_ns) * 1e-9 for f in fixes])
    age = config.gnss_velocity_age if all(f.v_g is not None for f in fixes) else None
    if age is not None:
        measured = way = velocities(fixes)
        claimed = np.array([f.sigma_velocity for f in fixes])
        lever = np.cross(np.array([e.rate for e in window.epochs]), config.gnss_lever_arm)
    else:
        measured, way = position, np.gradient(position, t, axis=0)
        claimed = np.array([f.sigma_position for f in fixes])
        lever = np.tile(config.gnss_lever_arm, (len(fixes), 1))
    known_v, known_p = pulled(t, position, way, g, w_ie)
    known = known_p if age is None else known_v - age * g
    sigma = np.where(np.isfinite(claimed) & (claimed > 0.0), np.maximum(claimed, RESOLUTION), UNSTATED_SIGMA)

    rows = np.empty_like(pieces)
    x = np.zeros(9)  # added gyro bias, added accelerometer bias, velocity at the start
    running(pieces, x[0:3], x[3:6], rows)
    C = dcm_from_quat(window.q_hb)
    excited = (rows[:, V] @ C.T + t[:, None] * g)[:, :2]
    if float(np.sqrt(np.mean(np.sum((excited - excited.mean(axis=0)) ** 2, axis=1)))) < SMALLEST_EXCITATION:
        return None
    psi, _ = _seen_heading(t, _moved(rows, lever, t, age) @ C.T + known, measured, age)
    C = dcm_from_quat(rotate_heading(window.q_hb, psi))
    start = measured[0] if age is not None else np.zeros(3)  # what is measured, at the start
    x[6:9] = measured[0] if age is not None else (position[-1] - position[0]) / t[-1]

    gravity, moving = float(-g[2]), 6 if age is not None else 9
    inflation, formal = 1.0, math.inf
    normed = np.empty_like(measured)
    for turn in range(TURNS):
        running(pieces, x[0:3], x[3:6], rows)
        own = model(config, pieces, rows, C, g, lever, age)
        moved = _moved(rows, lever, t, age) @ C.T + known
        z = measured - moved - (x[6:9] if age is not None else t[:, None] * x[6:9] + start)
        e, P = _prior(window, C, x, gravity, moving)
        total = np.empty(own.F.shape[1:])
        through(e, P, own.F, own.Q, own.H, own.walk, z, sigma**2 * inflation, normed, total)
        # what the end says of the start, had there been no noise on the way: that is gone through again
        back = np.linalg.solve(total[:, :moving], e[:moving] - total[:, moving:] @ e[moving:])
        C = dcm_from_quat(quat_from_rotvec(back[0:3])) @ C
        x = x + np.concatenate([e[moving : moving + 6], back[3:6]])
        start = start + back[6:9] if age is None else start
        if float(np.max(np.abs(back[0:3]))) > SAME and turn + 2 < TURNS:
            continue
        if not math.isinf(formal):
            break
        formal = math.sqrt(P[2, 2])
        inflation = _inflation(normed)
        if inflation == 1.0:
            break
    running(pieces, x[0:3], x[3:6], rows)
    error, scale = _seen_heading(t, _moved(rows, lever, t, age) @ C.T + known, measured, age)
    trusted = abs(scale - 1.0) < SCALE_SLACK and abs(error) < 0.2
    C_end, v_end = ended(C, x, rows[-1], known_v[-1], position[-1], w_ie)
    # the sensors' scales and axes, which no row knows
    unseen = np.zeros(6) if own.F.shape[2] == moving + 6 else total[0:6, moving + 6 :] @ e[moving + 6 :]
    keep = np.r_[0:3, moving : moving + 6, 3:6]
    return Fit(
        C,
        x,
        rows,
        dcm_from_quat(quat_from_rotvec(unseen[0:3])) @ C_end,
        v_end + unseen[3:6],
        P[np.ix_(keep, keep)],
        formal,
        trusted,
    )


def pulled(t: Vector, position: Vector, velocity: Vector, g: Vector, w_ie: Vector) -> tuple[Vector, Vector]:
    """Velocity and position (K, 3) that gravity and the Earth's turning add by ``t`` (K,) s.

    ``position``, ``velocity`` (K, 3): the way, known well enough for small terms. Along east, north and up,
    which turn away from those of the start; gravity ``g`` (3,) does so too, and towards the start of a way
    along the Earth's surface.
    """
    half = 0.5 * np.diff(t)[:, None]

    def summed(y: Vector) -> Vector:
        return np.concatenate([np.zeros((1, 3)), np.cumsum(half * (y[1:] + y[:-1]), axis=0)])

    once, t = summed(position), t[:, None]
    home = float(np.linalg.norm(g)) / SEMI_MAJOR * np.array([1.0, 1.0, 0.0])
    turning = np.cross(w_ie, g)
    v = t * g + 0.5 * t**2 * turning - np.cross(w_ie, position + t * velocity) - home * once
    p = 0.5 * t**2 * g + t**3 / 6.0 * turning - t * np.cross(w_ie, position) - home * summed(once)
    return v, p


def ended(C: Vector, x: Vector, row: Vector, v: Vector, way: Vector, w_ie: Vector) -> tuple[Vector, Vector]:
    """C_gb (3, 3) and velocity (3,) at the last fix, along east and north at the first.

    ``C``, ``x`` as `Fit` has them, ``row`` the whole window's piece, ``v`` (3,) of `pulled` and ``way`` (3,)
    m from the first fix there.
    """
    # the gyros carry it on, and the Earth turns under it, or it drives round the Earth
    round_earth = np.array([-way[1], way[0], 0.0]) / SEMI_MAJOR
    turn = dcm_from_quat(quat_from_rotvec(-float(row[DT]) * w_ie - round_earth))
    return turn @ C @ row[R].reshape(3, 3), x[6:9] + C @ row[V] + v


def carried(C: Vector, row: Vector) -> Vector:
    """What errors (12) of phi, gyro bias, accelerometer bias, velocity become over ``row`` from ``C`` on."""
    J = np.eye(12)
    J[0:3, 3:6] = C @ row[R].reshape(3, 3) @ row[R_GYRO].reshape(3, 3)
    J[9:12, 0:3] = -skew(C @ row[V])
    J[9:12, 3:6] = C @ row[V_GYRO].reshape(3, 3)
    J[9:12, 6:9] = C @ row[V_ACCEL].reshape(3, 3)
    return J


def _seen_heading(t: Vector, u: Vector, y: Vector, age: float | None) -> tuple[float, float]:
    """`fit_heading` of what is computed ``u`` (K, 3) and measured ``y`` (K, 3), velocities or positions."""
    if age is None:
        u, y = _detrended(t, u), _detrended(t, y)
    return fit_heading(u[:, :2], y[:, :2])


def _moved(rows: Vector, lever: Vector, t: Vector, age: float | None) -> Vector:
    """What the fixes show of V (m/s), or P (m), (K, 3) in b at the start, with the lever arm's part.

    A velocity that is ``age`` s older than its fix is met by going back along the mean acceleration since the
    fix before.
    """
    if age is None:
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


def _prior(window: Window, C: Vector, x: Vector, gravity: float, moving: int) -> tuple[Vector, Vector]:
    """Errors (n,) at the start and their covariance by what was known before the drive: level, biases.

    A level from gravity is tilted by the accelerometer bias, "Inertial navigation", eq. (2-104):
    phi_E = -nabla_N/g, phi_N = nabla_E/g. So it is the sum of tilt and bias that a standstill knows well; and
    it knows the sum of a gyro's bias and Earth rate, whose level part the heading of now divides.
    """
    config, given, before = window.config, window.given, window.before
    C0, w_ie = dcm_from_quat(window.q_hb), earth_rate_g(window.epochs[0].fix.lat)
    own = own_errors(config)[2]
    bg, ba = slice(moving, moving + 3), slice(moving + 3, moving + 6)
    any_, variance = _ANY**2, np.zeros(moving + 6 + len(own))
    tilt = float(given.P_phi[0, 0]) - (config.accel_bias / gravity) ** 2
    tilt = max(tilt, SURE**2) + config.angle_random_walk**2 * float(before[DT])
    variance[0:3] = tilt, tilt, any_[0]
    variance[3:moving] = np.repeat(any_[1:], 3)[: moving - 3]
    variance[bg], variance[ba] = config.gyro_bias**2, given.sigma_accel_bias**2
    variance[moving + 6 :] = own
    # the level's part of the biases: what they did at rest, and since
    T = np.eye(len(variance))
    T[0:2, bg] = (C @ before[R_GYRO].reshape(3, 3))[0:2]
    T[0, ba], T[1, ba] = -C[1] / gravity, C[0] / gravity
    e = np.zeros(len(variance))
    up = C @ C0[2]  # where the present attitude sees what levelling took for the vertical
    e[0:2] = np.array([up[1], -up[0]]) - float(before[DT]) * w_ie[0:2] - T[0:2, bg] @ given.gyro_bias
    e[bg], e[ba] = -given.gyro_bias - x[0:3], -x[3:6]
    P = T * variance @ T.T
    # of what the gyros said at rest, but Earth rate about the vertical, `level` took a part for bias
    part = 1.0 - np.square(given.sigma_gyro_bias / config.gyro_bias)
    if np.all(part > 0.0):
        to_rest = before[R].reshape(3, 3) @ C.T
        level = np.array([w_ie[0], w_ie[1], 0.0])
        H = np.zeros((3, len(e)))
        H[:, 0:3], H[:, bg] = to_rest @ skew(level), np.eye(3)
        noise = np.square(given.sigma_gyro_bias) / part - 0.5 * (level @ level)
        gain = np.linalg.solve(H @ P @ H.T + np.diag(noise), H @ P).T
        z = given.gyro_bias / part - given.gyro_bias - x[0:3] - to_rest @ level
        e, P = e + gain @ (z - H @ e), P - gain @ H @ P
    return e, P


def _inflation(normed: Vector) -> float:
    """How much larger the measurements' variance is than claimed, from innovations (K, 3) over their sigmas.

    Neighbours that agree count as fewer: (1 + rho) / (1 - rho) of a first-order process. A claim is
    believed until innovations exceed it by more than two sigmas of chance.
    """
    dof = max(1, normed.size - 9)
    square = float(np.sum(normed**2))
    rho = float(np.sum(normed[1:] * normed[:-1])) / max(square, 1e-12)
    rho = min(0.9, max(-0.9, rho))
    found = square / dof * (1.0 + rho) / (1.0 - rho)
    return found if found > 1.0 + 2.0 * math.sqrt(6.0 / dof) else 1.0
