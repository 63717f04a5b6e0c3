"""Kalman filters of a static alignment, by which states they carry: fine stages after a coarse one.

All have the dynamics of an alignment at rest in psi form (`nav.errors.psi.alignment_dynamics`; at a known
place psi and phi are the same) or a part of them:

- `CLOSED`: ten states, level velocity, phi, gyro errors, level accelerometer errors; what it finds goes back
  into the strapdown arithmetic with every block. "Inertial navigation", eq. (2-136) and the states before it.
- `OPEN`: eight states, without velocity; level specific force is what is measured, nothing goes back. Eqs.
  (2-137) to (2-139). Without a velocity to remember, sway is noise of every measurement and not
  of its integral, so means over longer windows are taken, which fade in and out.
- `PSI`: twelve states, with the vertical velocity and accelerometer; closed like the first. Excerpt on
  psi-angle and phi-angle error models, eqs. (2.2.7), (2.2.9).

Velocity is *computed minus true*, and true C_gb = (I + [phi x]) C_gb; accelerometer errors are what they read
too much; gyro errors are drifts of a platform, which a strapdown gyro's reading has with the opposite
sign. All in east, north, up: sensors of a vehicle at rest keep their directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from nav.align.static import fine_status, go_on, nav_init, standing_at
from nav.align.still import PUSHED, Block, Lean, Standing, angle_walk, contradiction, standing
from nav.align.types import AlignConfig, NavInit, Stage
from nav.earth import earth_rate_g, gravity_g, normal_gravity
from nav.errors.psi import alignment_dynamics
from nav.rotation import cross, dcm_from_quat, quat_from_rotvec
from nav.types import Vector

WINDOW_S: Final = 29  # blocks of a window without velocity, an odd number
TILTED: Final = 0.005  # m/s^2 that such a window may differ by before anything is said
_VEL, _PHI, _NAB, _EPS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


class Model(NamedTuple):
    """Which of the twelve states, what is measured, and whether it is fed back."""

    keep: tuple[int, ...]
    measured: tuple[int, ...]  # velocities, or, where these are no states, their rates

    @property
    def closed(self) -> bool:
        """Whether velocity is a state: then corrections go back into the strapdown arithmetic."""
        return self.measured[0] in self.keep


TEN: Final = Model((0, 1, 3, 4, 5, 6, 7, 9, 10, 11), (0, 1))
EIGHT: Final = Model((3, 4, 5, 6, 7, 9, 10, 11), (0, 1))
TWELVE: Final = Model(tuple(range(12)), (0, 1, 2))


class Filter(NamedTuple):
    """Strapdown attitude and velocity, errors that are not fed back, covariance."""

    given: NavInit
    C: Vector  # C_gb (3, 3)
    v: Vector  # (3,) m/s
    x: Vector  # (12,) not fed back; places that the model lacks stay zero
    P: Vector  # (12, 12); of the places that the model lacks as the coarse stage left it
    window: Vector  # (3,) sums of weights, and of weighted level specific force
    lean: Lean = Lean()
    blocks: int = 0  # in the window
    seconds: float = 0.0


def _to_states(C: Vector) -> Vector:
    """T (12, 12): (velocity, phi, gyro bias, accelerometer bias), true minus estimate in b, to the states."""
    T = np.zeros((12, 12))
    T[_VEL, 0:3], T[_PHI, 3:6] = -np.eye(3), np.eye(3)
    T[_EPS, 6:9], T[_NAB, 9:12] = -C, C
    return T


def init(config: AlignConfig, given: NavInit | None) -> Standing[Filter]:
    """Begin from what the coarse stage found, velocity and biases as well where it finds some."""
    assert given is not None
    assert given.P is not None
    C = dcm_from_quat(given.q_gb)
    T = _to_states(C)
    P = T @ given.P[3:15, 3:15] @ T.T
    own = Filter(given, C, given.v_g, np.zeros(12), P, np.zeros(3))
    return go_on(config, given, own, np.concatenate([given.gyro_bias, given.accel_bias]))


def working(model: Model) -> Callable[[Standing[Filter], Block], tuple[Standing[Filter], str | None]]:
    """What a stage with these states does with a block: strapdown, prediction, measurement, feedback."""

    def work(state: Standing[Filter], block: Block) -> tuple[Standing[Filter], str | None]:
        return _update(state, block, model)

    return work


def _update(state: Standing[Filter], block: Block, model: Model) -> tuple[Standing[Filter], str | None]:
    # here and not above: it brings all of SciPy's statistics, 0.7 s that other alignments have no use for
    from filterpy.kalman import KalmanFilter

    config, own = state.config, state.own
    given, dt, dv = own.given, block.dt, block.dv
    g, w_ie = gravity_g(given.lat, given.height), earth_rate_g(given.lat)
    gained = own.C @ dv + g * dt + 0.5 * dt**2 * cross(w_ie, g)
    C = dcm_from_quat(quat_from_rotvec(-w_ie * dt)) @ own.C @ block.rotation
    v = own.v + gained
    F = _dynamics(given.lat, given.height)
    keep, measured = np.array(model.keep), np.array(model.measured)
    part = np.ix_(keep, keep)

    kalman = KalmanFilter(dim_x=len(keep), dim_z=len(measured))
    kalman.x = own.x[keep].reshape(-1, 1)
    kalman.P = own.P[part]
    kalman.F = _transition(F[part], dt)
    # trapezoid over the interval: the tilt that walks within it moves the velocity
    # a coarse stage that hands no line on has counted what it shows into the covariance
    walk = config.angle_random_walk**2 if given.line is None else angle_walk(state.still, config)
    q = np.diag(_noise(config, walk)[keep])
    kalman.Q = 0.5 * dt * (q + kalman.F @ q @ kalman.F.T)
    kalman.predict()
    if model.closed:
        window, blocks = own.window, 0
        kalman.H = np.eye(12)[np.ix_(measured, keep)]
        kalman.R = np.eye(len(measured)) * config.sway**2
        z, floor, unit = v[measured], PUSHED, "m/s"
    else:
        window, blocks, z, back = _faded(config, own, gained[:2] / dt, dt)
        # the mean is of the window's middle
        kalman.H = F[np.ix_(measured, keep)] @ _transition(F[part], -back)
        kalman.R = np.eye(2) * _mean_noise(config, dt)
        floor, unit = TILTED, "m/s^2"
    reason, leaning = None, own.lean
    if blocks == 0:
        kalman.update(z.reshape(-1, 1))
        leaning, reason = contradiction(leaning, kalman.y.ravel(), kalman.S, floor, unit)
    x, P = np.zeros(12), own.P.copy()
    x[keep] = np.asarray(kalman.x, dtype=np.float64).ravel()
    P[part] = 0.5 * (np.asarray(kalman.P, dtype=np.float64) + np.asarray(kalman.P, dtype=np.float64).T)
    biases = state.biases
    if model.closed:
        v = v - x[_VEL]
        C = dcm_from_quat(quat_from_rotvec(x[_PHI])) @ C
        biases = biases + np.concatenate([-C.T @ x[_EPS], C.T @ x[_NAB]])
        x = np.zeros(12)
    seconds = own.seconds + dt
    own = Filter(given, C, v, x, P, window, leaning, blocks, seconds)
    state = state._replace(own=own, biases=biases)
    return fine_status(state, seconds, dcm_from_quat(quat_from_rotvec(x[_PHI])) @ C, P), reason


@lru_cache(maxsize=16)
def _dynamics(lat: float, height: float) -> Vector:
    return alignment_dynamics(lat, normal_gravity(math.sin(lat), height), vertical=True)


def _noise(config: AlignConfig, walk: float) -> Vector:
    """Spectral densities (12,) of the states' white noise, that of phi being ``walk`` rad^2/s."""
    q = np.zeros(12)
    q[_VEL], q[_PHI] = config.velocity_random_walk**2, walk
    return q


def _transition(F: Vector, dt: float) -> Vector:
    """Of dynamics ``F`` (n, n) over ``dt`` s, also backwards; Earth turns little in that."""
    A = F * dt
    return np.asarray(np.eye(len(F)) + A + 0.5 * A @ A, dtype=np.float64)


def _length(config: AlignConfig) -> int:
    """Blocks of a window: an odd number, some windows to an alignment."""
    return int(min(WINDOW_S, max(3, 2 * int(config.fine_s / 12.0) + 1)))


def _weight(config: AlignConfig, k: int) -> float:
    half = (_length(config) + 1) // 2
    return float(half - abs(k + 1 - half))


def _faded(config: AlignConfig, own: Filter, force: Vector, dt: float) -> tuple[Vector, int, Vector, float]:
    """Take a block into the window: it, its blocks (0: it is full), its mean, how far back that lies (s)."""
    k = own.blocks
    w = _weight(config, k)
    window = own.window + w * np.array([1.0, force[0], force[1]])
    if k + 1 < _length(config):
        return window, k + 1, np.zeros(2), 0.0
    return np.zeros(3), 0, window[1:] / window[0], 0.5 * _length(config) * dt


def _mean_noise(config: AlignConfig, dt: float) -> float:
    """Variance of a window's mean: accelerometer noise, and the velocity of the sway, differenced."""
    w = np.array([_weight(config, k) for k in range(_length(config))])
    w /= np.sum(w)
    edges = np.diff(np.concatenate([[0.0], w, [0.0]]))
    return float(w @ w * config.velocity_random_walk**2 / dt + edges @ edges * (config.sway / dt) ** 2)


def finish(state: Standing[Filter]) -> NavInit:
    """Attitude, biases and their covariance at the last sample."""
    own = state.own
    C = dcm_from_quat(quat_from_rotvec(own.x[_PHI])) @ own.C
    T = np.linalg.inv(_to_states(C))
    x = T @ own.x
    x[6:] += state.biases
    place, sigma_p = standing_at(state.config, own.given, state.still, C)
    return nav_init(state.config, state.still.t_ns, place, sigma_p, C, x, T @ own.P @ T.T)


CLOSED: Final = Stage(init=init, step=standing(working(TEN)), finish=finish)
OPEN: Final = Stage(init=init, step=standing(working(EIGHT)), finish=finish)
PSI: Final = Stage(init=init, step=standing(working(TWELVE)), finish=finish)
