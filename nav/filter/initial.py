"""From an alignment's hand-over to the filter's first state and covariance."""

from __future__ import annotations

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.align.types import NavInit
from nav.filter import states as st
from nav.filter.settings import NavigatorConfig
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.types import Vector

_MOUNTING_FOUND = np.radians(3.0)


def initial_state(init: NavInit, config: NavigatorConfig) -> tuple[Vector, Vector, bool]:
    """State (X_SIZE,), covariance (N, N), and whether the mounting is known.

    n starts as east-north-up. A configured mounting goes before one that the alignment found.
    """
    x = np.zeros(st.X_SIZE)
    x[X_Q : X_Q + 4] = rot.quat_normalize(init.q_gb)
    x[X_V : X_V + 3] = init.v_g
    x[X_C : X_C + 9] = earth.position_matrix(init.lat, init.lon).ravel()
    x[X_H] = init.height
    x[st.X_F0 : st.X_F0 + 3] = rot.dcm_from_quat(init.q_gb).T @ -earth.gravity_g(init.lat, init.height)
    x[st.X_BG : st.X_BG + 3] = init.gyro_bias
    x[st.X_BA : st.X_BA + 3] = init.accel_bias

    P = np.zeros((st.ALL, st.ALL))
    imu = config.imu
    d = np.zeros(st.ALL)
    d[st.POSITION] = init.sigma_p
    d[st.VELOCITY] = init.sigma_v
    d[st.GYRO_BIAS] = init.sigma_gyro_bias
    d[st.ACCEL_BIAS] = init.sigma_accel_bias
    d[st.ODO_SCALE] = config.odometer_scale if config.odometer else 0.0
    d[st.BARO_BIAS] = config.baro_bias
    d[st.GYRO_AXES] = _axes(imu.gyro_scale, imu.gyro_axes)
    d[st.ACCEL_AXES] = _axes(imu.accel_scale, imu.accel_axes)
    C_vb, known = config.C_vb, True
    if C_vb is not None:
        d[st.MOUNTING] = config.sigma_mounting
    elif init.C_vb is not None:
        C_vb = init.C_vb
        sigma = init.sigma_mounting if init.sigma_mounting is not None else np.full(3, _MOUNTING_FOUND)
        d[st.MOUNTING] = sigma[[0, 2]]
        x[st.X_ROLL] = sigma[1] ** 2
    else:
        # v is b until it is found; what is shown then is b's attitude, with b's sigma
        C_vb, known = np.eye(3), False
    x[st.X_QV : st.X_QV + 4] = rot.quat_from_dcm(C_vb)
    x[st.X_Q0 : st.X_Q0 + 4] = x[st.X_QV : st.X_QV + 4]
    P[np.diag_indices(st.ALL)] = d**2
    if init.P is not None:
        # the alignment's errors are true minus estimate but for phi
        sign = np.ones(15)
        sign[st.PHI] = -1.0
        P[:15, :15] = init.P * np.outer(sign, sign)
    else:
        P[st.PHI, st.PHI] = init.P_phi
    horizontal, vertical = config.gnss_correlated
    slow = np.diag(np.square([horizontal, horizontal, vertical]))
    P[st.GNSS, st.GNSS] = slow
    if config.align is None or config.align.position is None:
        # the first position is the receiver's, and all of this is in it
        P[st.POSITION, st.POSITION] += slow
        P[st.POSITION, st.GNSS] = P[st.GNSS, st.POSITION] = -slow
    n = config.states
    return x, P[:n, :n].copy(), known


def _axes(scale: float, axes: float) -> Vector:
    """Sigmas (9,) of scale errors and misalignment, row by row."""
    return np.where(np.eye(3) > 0.0, scale, axes).ravel()
