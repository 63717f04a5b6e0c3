"""The readable definition of one navigation update; `nav.strapdown.kernels` holds its fast twin.

Attitude, velocity, position matrix and height are integrated in the wander-azimuth frame n, whose
vertical transport rate is zero: regular on the whole globe. Source: Groves, 2nd ed., sections 5.3, 5.5
and 15.2; Savage 1998 (see `nav.strapdown.coning`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav import earth
from nav import rotation as rot
from nav.strapdown.coning import rotation_vector, velocity_increment

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NavState:
    """Attitude ``q_nb`` (4,), velocity ``v_n`` (3,) m/s, position matrix ``C_en`` (3, 3), ``height`` m."""

    q_nb: Vector
    v_n: Vector
    C_en: Matrix
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Rates and gravity in n at one place and velocity.

    ``w_ie_n`` and ``w_en_n`` (3,) rad/s, ``gravity_n`` (3,) m/s^2.
    """

    w_ie_n: Vector
    w_en_n: Vector
    gravity_n: Vector


def frame_rates(pole_n: Vector, height: float, v_n: Vector) -> Frame:
    """Earth rate, transport rate and gravity in n.

    ``pole_n`` (3,) is the polar axis in n (last row of C_en), ``height`` m, ``v_n`` (3,) m/s. The
    azimuth law is wander: no vertical transport rate.
    """
    kxx, kxy, kyy = earth.curvature(pole_n[0], pole_n[1], pole_n[2], height)
    w_en_n = np.array([-kxy * v_n[0] - kyy * v_n[1], kxx * v_n[0] + kxy * v_n[1], 0.0])
    # north component of gravity along north, whose level part is pole_n over cos L
    north = earth.gravity_north(pole_n[2], 1.0, height)
    gravity_n = np.array([north * pole_n[0], north * pole_n[1], -earth.normal_gravity(pole_n[2], height)])
    return Frame(earth.EARTH_RATE * pole_n, w_en_n, gravity_n)


def update(state: NavState, dtheta: Vector, dv: Vector, dt: float) -> NavState:
    """One navigation update over two inertial samples.

    ``dtheta`` (2, 3) rad and ``dv`` (2, 3) m/s are increments in b over equal halves of ``dt``
    seconds. Velocity first, then position with the mean velocity, then attitude. Groves, section 5.5,
    with rates taken in the middle of the interval.
    """
    C_nb = rot.dcm_from_quat(state.q_nb)
    dv_b = velocity_increment(dtheta, dv)
    start = frame_rates(state.C_en[2], state.height, state.v_n)

    # the middle of the interval, well enough for terms that change by 1e-6 of themselves over it
    v_mid = state.v_n + 0.5 * (C_nb @ dv_b + start.gravity_n * dt)
    pole_mid = state.C_en[2] - np.cross(start.w_en_n, state.C_en[2]) * 0.5 * dt
    mid = frame_rates(pole_mid, state.height + 0.5 * dt * v_mid[2], v_mid)

    zeta = (mid.w_ie_n + mid.w_en_n) * dt
    dv_n = C_nb @ dv_b
    dv_n = dv_n - 0.5 * np.cross(zeta, dv_n)
    coriolis = np.cross(2.0 * mid.w_ie_n + mid.w_en_n, v_mid)
    v_n = state.v_n + dv_n + (mid.gravity_n - coriolis) * dt

    v_mean = 0.5 * (state.v_n + v_n)
    height = state.height + v_mean[2] * dt
    w_en_n = frame_rates(pole_mid, 0.5 * (state.height + height), v_mean).w_en_n
    C_en = state.C_en @ rot.dcm_from_quat(rot.quat_from_rotvec(w_en_n * dt))
    C_en = 0.5 * C_en @ (3.0 * np.eye(3) - C_en.T @ C_en)

    turn_n = rot.quat_from_rotvec(-(mid.w_ie_n + w_en_n) * dt)
    turn_b = rot.quat_from_rotvec(rotation_vector(dtheta))
    q_nb = rot.quat_normalize(rot.quat_multiply(rot.quat_multiply(turn_n, state.q_nb), turn_b))
    return NavState(q_nb, v_n, C_en, height)
