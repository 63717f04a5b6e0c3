"""The fine stage of a static alignment: a Kalman filter of velocity, misalignment and sensor biases.

It observes zero velocity, and feeds what it finds back into the strapdown arithmetic of its blocks.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from nav.align import still as watch
from nav.align.fit import skew
from nav.align.static import SIGMAS, limits, nav_init, standing_at
from nav.align.still import Still
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec
from nav.types import ImuSample, Sample, Vector

_VEL, _PHI, _EPS, _NAB = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


class Fine(NamedTuple):
    """State of the fine stage: attitude, velocity, biases and their covariance, and the watch."""

    config: AlignConfig
    given: NavInit
    still: Still
    C: Vector  # C_gb
    x: Vector  # (12,): velocity, nothing, gyro bias, accelerometer bias
    P: Vector  # (12, 12) of velocity, phi, gyro bias, accelerometer bias
    status: AlignStatus
    seconds: float = 0.0


def fine_init(config: AlignConfig, given: NavInit | None) -> Fine:
    """Begin from the coarse stage's attitude and covariance."""
    assert given is not None
    assert given.P is not None
    P = given.P[3:15, 3:15].copy()
    C = dcm_from_quat(given.q_gb)
    status = AlignStatus(given.q_gb, given.P_phi, _limits(config, given), 0.0, False)
    return Fine(config, given, Still(), C, np.zeros(12), P, status)


def _limits(config: AlignConfig, given: NavInit) -> Vector:
    return limits(config, given.lat, given.height, config.coarse_s + config.fine_s)


def fine_step(state: Fine, sample: Sample) -> tuple[Fine, AlignStatus]:
    """Propagate with every sample, observe zero velocity with every block."""
    if isinstance(sample, ImuSample):
        reason = watch.fault(sample)
        config, given, still, C, x, P, status, seconds = state
        still = watch.add(still, sample, x[_EPS], x[_NAB])
        state = Fine(config, given, still, C, x, P, status, seconds)
        if reason is None and watch.full(still):
            state, reason = _update(state)
    else:
        still, reason = watch.aid(state.still, sample)
        state = state._replace(still=still)
    if reason is not None:
        return state, state.status._replace(done=False, refusal=reason)
    return state, state.status


def _update(state: Fine) -> tuple[Fine, str | None]:
    """One block: strapdown, prediction, zero velocity, feedback."""
    # here and not above: it brings all of SciPy's statistics, 0.7 s that other alignments have no use for
    from filterpy.kalman import KalmanFilter

    config, given = state.config, state.given
    rotation, dv, _, dt = watch.block(state.still)
    still, reason = watch.close(state.still, config)
    g, w_ie = gravity_g(given.lat, given.height), earth_rate_g(given.lat)
    f_g = state.C @ dv / dt
    v = state.x[_VEL] + state.C @ dv + g * dt + 0.5 * dt**2 * np.cross(w_ie, g)
    C = dcm_from_quat(quat_from_rotvec(-w_ie * dt)) @ state.C @ rotation

    kalman = KalmanFilter(dim_x=12, dim_z=3)
    kalman.P = state.P
    kalman.F, kalman.Q = _transition(config, state.C, f_g, w_ie, dt)
    kalman.H = np.zeros((3, 12))
    kalman.H[:, _VEL] = np.eye(3)
    kalman.R = np.eye(3) * config.sway**2
    kalman.predict()
    kalman.update(-v.reshape(3, 1))
    S = np.asarray(kalman.S, dtype=np.float64)
    nis = float(v @ np.linalg.solve(S, v))
    speed = float(np.linalg.norm(v))
    if reason is None and nis > SIGMAS**2 and speed > watch.PUSHED:
        reason = f"the vehicle moves: {speed:.2f} m/s against a standstill"
    if reason is not None:
        return state._replace(still=still), reason
    error = np.asarray(kalman.x, dtype=np.float64).ravel()
    P = np.asarray(kalman.P, dtype=np.float64)
    x = state.x + error
    x[_VEL] = v + error[_VEL]
    x[_PHI] = 0.0
    C = dcm_from_quat(quat_from_rotvec(error[_PHI])) @ C
    seconds = state.seconds + dt
    status = AlignStatus(
        estimate=quat_from_dcm(C),
        covariance=P[_PHI, _PHI],
        limit=state.status.limit,
        progress=min(1.0, seconds / config.fine_s),
        done=seconds >= config.fine_s - 0.5 * watch.BLOCK_S,
    )
    return state._replace(still=still, C=C, x=x, P=0.5 * (P + P.T), seconds=seconds, status=status), None


def _transition(
    config: AlignConfig, C: Vector, f_g: Vector, w_ie: Vector, dt: float
) -> tuple[Vector, Vector]:
    """Transition and noise of the errors at standstill, both (12, 12).

    The phi-angle equations without motion, "Inertial navigation", eqs. (2-84), (2-88), biases true minus
    estimate: dv' = phi x f - C nabla, phi' = -w_ie x phi - C eps.
    """
    F = np.zeros((12, 12))
    F[_VEL, _VEL] = -2.0 * skew(w_ie[None])[0]
    F[_VEL, _PHI] = -skew(f_g[None])[0]
    F[_VEL, _NAB] = -C
    F[_PHI, _PHI] = -skew(w_ie[None])[0]
    F[_PHI, _EPS] = -C
    A = F * dt
    transition = np.eye(12) + A + 0.5 * A @ A
    noise = np.zeros(12)
    noise[_VEL] = config.velocity_random_walk**2
    noise[_PHI] = config.angle_random_walk**2
    # trapezoid over the interval: the tilt that walks within it moves the velocity
    Q = 0.5 * dt * (np.diag(noise) + transition @ np.diag(noise) @ transition.T)
    return transition, Q


def fine_finish(state: Fine) -> NavInit:
    """Attitude, biases and their covariance at the last closed block."""
    still = state.still
    place, sigma_p = standing_at(state.config, state.given, still, state.C)
    # the block just closed ends at the last sample
    return nav_init(state.config, still.t_ns, place, sigma_p, state.C, state.x, state.P)


FINE: Final = Stage(init=fine_init, step=fine_step, finish=fine_finish)
