"""Covariance of what a solution says, with its cross terms: the readable twin of the row's sigmas."""

from __future__ import annotations

import math

import numpy as np

from nav.filter import states as st
from nav.filter.motion import eb_rate, place_beside
from nav.rotation import dcm_from_quat
from nav.strapdown.kernels import X_Q
from nav.types import Vector


def solution_covariance(x: Vector, P: Vector, par: Vector) -> Vector:
    """Covariance (9, 9) of the errors of position, velocity and attitude of a solution.

    Errors are solution minus truth of the output point: m, m/s, and the rotation vector (rad) that takes
    the true vehicle attitude to the solution's; each east, north, up. ``x`` (X_SIZE,), ``P`` (N, N) and
    ``par`` (P_SIZE,) as the filter has them. The square roots of the diagonal are the sigmas of
    `nav.filter.propagate.solution_row`.
    """
    C_nb = dcm_from_quat(x[X_Q : X_Q + 4])
    C_vb = dcm_from_quat(x[st.X_QV : st.X_QV + 4])
    lever = par[st.P_LP : st.P_LP + 3]
    arm = C_nb @ lever
    pole_x, pole_y, *_ = place_beside(x, arm[0], arm[1])
    cos_lat = math.hypot(pole_x, pole_y)
    sin_a, cos_a = (pole_x / cos_lat, pole_y / cos_lat) if cos_lat > 1e-14 else (0.0, 1.0)
    C_gn = np.array([[cos_a, -sin_a, 0.0], [sin_a, cos_a, 0.0], [0.0, 0.0, 1.0]])
    w_eb_b = np.array(eb_rate(x, 0.0))
    C_nv = C_nb @ C_vb.T

    T = np.zeros((9, len(P)))
    T[0:3, st.POSITION] = C_gn
    T[0:3, st.PHI] = C_gn @ _skew(arm)
    T[3:6, st.VELOCITY] = C_gn
    T[3:6, st.PHI] = C_gn @ _skew(C_nb @ np.cross(w_eb_b, lever))
    T[6:9, st.PHI] = -C_gn
    T[6:9, st.MOUNTING] = (C_gn @ C_nv)[:, [0, 2]]
    covariance = T @ P @ T.T
    ahead = (C_gn @ C_nv)[:, 1]
    covariance[6:9, 6:9] += np.outer(ahead, ahead) * x[st.X_ROLL]
    return np.asarray(covariance)


def _skew(v: Vector) -> Vector:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
