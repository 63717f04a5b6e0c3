"""States, errors and differences for the tests of the filter."""

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.filter import states as st
from nav.filter.kalman import correct
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V


def nominal(lat=0.9, lon=0.3, wander=0.4, height=5000.0, v=(180.0, -90.0, 5.0), seed=1):
    """A state vector with everything non-zero."""
    rng = np.random.default_rng(seed)
    x = np.zeros(st.X_SIZE)
    x[X_Q : X_Q + 4] = rot.quat_from_rotvec(rng.normal(size=3))
    x[X_V : X_V + 3] = v
    x[X_C : X_C + 9] = earth.position_matrix(lat, lon, wander).ravel()
    x[X_H] = height
    x[st.X_BG : st.X_BG + 3] = rng.normal(size=3) * 1e-3
    x[st.X_BA : st.X_BA + 3] = rng.normal(size=3) * 1e-2
    x[st.X_KO] = 0.01
    x[st.X_QV : st.X_QV + 4] = rot.quat_from_rotvec(rng.normal(size=3))
    x[st.X_Q0 : st.X_Q0 + 4] = x[st.X_QV : st.X_QV + 4]
    x[st.X_BB] = 3.0
    x[st.X_MG : st.X_MG + 9] = rng.normal(size=9) * 1e-3
    x[st.X_MA : st.X_MA + 9] = rng.normal(size=9) * 1e-3
    x[st.X_F0 : st.X_F0 + 3] = rng.normal(size=3) * 5.0
    x[st.X_W : st.X_W + 3] = rng.normal(size=3) * 0.1
    x[st.X_F : st.X_F + 3] = rng.normal(size=3) * 5.0
    x[st.X_A : st.X_A + 3] = rng.normal(size=3)
    x[st.X_WD : st.X_WD + 3] = rng.normal(size=3) * 3.0
    x[st.X_WT] = 0.005
    return x


def disturbed(x, error):
    """A computed state whose error (computed minus true) against ``x`` is ``error``."""
    y = x.copy()
    correct(y, -np.asarray(error))
    return y


def difference(y, x):
    """Error (FULL,) of the computed state ``y`` against the true ``x``, from the definitions alone.

    The true frame is first turned about its vertical until it is the shortest turn away from the
    computed one, as the error model has it.
    """
    C_ec, C_en = y[X_C : X_C + 9].reshape(3, 3), x[X_C : X_C + 9].reshape(3, 3)
    C_nc = C_en.T @ C_ec
    spin = rot.rotvec_from_quat(rot.quat_from_dcm(C_nc))[2]
    C_nt = rot.dcm_from_quat(rot.quat_from_rotvec([0.0, 0.0, spin]))
    dtheta = rot.rotvec_from_quat(rot.quat_from_dcm(C_nt.T @ C_nc))
    kxx, kxy, kyy = earth.curvature(*C_en[2], x[X_H])
    # dtheta = up x (k dp)
    level = np.linalg.solve([[kxx, kxy], [kxy, kyy]], [dtheta[1], -dtheta[0]])
    e = np.zeros(st.FULL)
    e[0:2], e[2] = level, y[X_H] - x[X_H]
    e[st.VELOCITY] = y[X_V : X_V + 3] - C_nt.T @ x[X_V : X_V + 3]
    C_cb = rot.dcm_from_quat(y[X_Q : X_Q + 4])
    C_tb = C_nt.T @ rot.dcm_from_quat(x[X_Q : X_Q + 4])
    e[st.PHI] = -rot.rotvec_from_quat(rot.quat_from_dcm(C_cb @ C_tb.T))
    e[st.GYRO_BIAS] = y[st.X_BG : st.X_BG + 3] - x[st.X_BG : st.X_BG + 3]
    e[st.ACCEL_BIAS] = y[st.X_BA : st.X_BA + 3] - x[st.X_BA : st.X_BA + 3]
    e[15] = y[st.X_KO] - x[st.X_KO]
    mu = rot.quat_multiply(y[st.X_QV : st.X_QV + 4], rot.quat_conjugate(x[st.X_QV : st.X_QV + 4]))
    e[st.MOUNTING] = -rot.rotvec_from_quat(mu)[[0, 2]]
    e[18] = y[st.X_BB] - x[st.X_BB]
    e[st.GYRO_AXES] = y[st.X_MG : st.X_MG + 9] - x[st.X_MG : st.X_MG + 9]
    e[st.ACCEL_AXES] = y[st.X_MA : st.X_MA + 9] - x[st.X_MA : st.X_MA + 9]
    return e


def covariance(n, seed=0):
    """A full covariance with the scales of the states."""
    rng = np.random.default_rng(seed)
    scale = np.concatenate(
        [[10] * 3, [1] * 3, [1e-2] * 3, [1e-3] * 3, [1e-2] * 3, [1e-2], [1e-2] * 2, [5.0], [1e-3] * 18]
    )[:n]
    A = rng.normal(size=(n, n)) * scale[:, None]
    return A @ A.T
