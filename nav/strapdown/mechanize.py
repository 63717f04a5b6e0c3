"""The readable definition of one navigation update; `nav.strapdown.kernels` holds its fast twin.

Attitude, velocity, position matrix and height are integrated in a local-level frame n. With no control
its vertical transport rate is zero (wander azimuth): regular on the whole globe. What can be fed in is
said in `nav.strapdown.control`. Source: Groves, 2nd ed., sections 5.3, 5.5 and 15.2; Savage 1998 (see
`nav.strapdown.coning`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav import earth
from nav import rotation as rot
from nav.strapdown.coning import rotation_vector, velocity_increment
from nav.strapdown.control import U_FREE, U_H, U_KH, U_KV, U_NORTH, U_TURN, U_V, U_WC, control

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NavState:
    """Attitude ``q_nb`` (4,), velocity ``v_n`` (3,) m/s, position matrix ``C_en`` (3, 3), ``height`` m.

    ``height_correction`` (m/s^2) is what a third-order height channel takes off the vertical acceleration.
    """

    q_nb: Vector
    v_n: Vector
    C_en: Matrix
    height: float
    height_correction: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Rates and gravity in n at one place and velocity.

    ``w_ie_n`` and ``w_en_n`` (3,) rad/s, ``gravity_n`` (3,) m/s^2.
    """

    w_ie_n: Vector
    w_en_n: Vector
    gravity_n: Vector


def vertical_rate(pole_n: Vector, height: float, v_n: Vector, u: Vector) -> float:
    """Vertical transport rate (rad/s) by the azimuth law in the control vector ``u``.

    Other arguments as `frame_rates`. Not defined at a pole for the north law.
    """
    rate = float(u[U_TURN] - u[U_FREE] * earth.EARTH_RATE * pole_n[2])
    if u[U_NORTH] != 0.0:
        cos_lat = math.hypot(pole_n[0], pole_n[1])
        v_east = (pole_n[1] * v_n[0] - pole_n[0] * v_n[1]) / cos_lat
        _, r_n = earth.radii(pole_n[2])
        rate += float(u[U_NORTH] * v_east * pole_n[2] / cos_lat / (r_n + height))
    return rate


def frame_rates(pole_n: Vector, height: float, v_n: Vector, u: Vector | None = None) -> Frame:
    """Earth rate, transport rate and gravity in n.

    ``pole_n`` (3,) is the polar axis in n (last row of C_en), ``height`` m, ``v_n`` (3,) m/s, ``u``
    (U_SIZE,) the control vector, of which the azimuth law counts here; None: wander azimuth.
    """
    kxx, kxy, kyy = earth.curvature(pole_n[0], pole_n[1], pole_n[2], height)
    w_z = 0.0 if u is None else vertical_rate(pole_n, height, v_n, u)
    w_en_n = np.array([-kxy * v_n[0] - kyy * v_n[1], kxx * v_n[0] + kxy * v_n[1], w_z])
    # north component of gravity along north, whose level part is pole_n over cos L
    north = earth.gravity_north(pole_n[2], 1.0, height)
    gravity_n = np.array([north * pole_n[0], north * pole_n[1], -earth.normal_gravity(pole_n[2], height)])
    return Frame(earth.EARTH_RATE * pole_n, w_en_n, gravity_n)


def moved(C_en: Matrix, angle_n: Vector) -> Matrix:
    """Position matrix (3, 3) after n has turned by ``angle_n`` (3,), rad, with respect to e: exact.

    One step towards the nearest rotation matrix takes out what rounding adds. Textbook chapter "Inertial
    navigation", solution of eq. (2-54).
    """
    C = C_en @ rot.dcm_from_quat(rot.quat_from_rotvec(angle_n))
    return np.asarray(0.5 * C @ (3.0 * np.eye(3) - C.T @ C))


def moved_second_order(C_en: Matrix, angle_n: Vector) -> Matrix:
    """As `moved`, to second order in the angle, without trigonometry: a sixth of its cube is lost.

    Textbook chapter "Inertial navigation", eq. (2-55).
    """
    turn = rot.skew(angle_n)
    return np.asarray(C_en @ (np.eye(3) + turn + 0.5 * turn @ turn))


def update(state: NavState, dtheta: Vector, dv: Vector, dt: float, u: Vector | None = None) -> NavState:
    """One navigation update over N inertial samples, N = 1 to 6.

    ``dtheta`` (N, 3) rad and ``dv`` (N, 3) m/s are increments in b over equal parts of ``dt`` seconds;
    ``u`` (U_SIZE,) is the control vector of `nav.strapdown.control`, None: no control. Velocity first, then
    position with the mean velocity, then attitude. Groves, section 5.5, with rates taken in the middle of
    the interval.
    """
    u = control() if u is None else u
    w_c = u[U_WC : U_WC + 3]
    k1, k2, k3 = u[U_KH : U_KH + 3]
    damping = np.array([u[U_KV], u[U_KV], u[U_KV + 1]])
    up = np.array([0.0, 0.0, 1.0])

    def acceleration(frame: Frame, v_n: Vector, height: float, correction: float) -> Vector:
        """All of v_n' but specific force."""
        turn = 2.0 * frame.w_ie_n + frame.w_en_n + w_c
        aid = damping * (v_n - u[U_V : U_V + 3]) + (k2 * (height - u[U_H]) + correction) * up
        return np.asarray(frame.gravity_n - np.cross(turn, v_n) - aid)

    C_nb = rot.dcm_from_quat(state.q_nb)
    dv_b = velocity_increment(dtheta, dv)
    start = frame_rates(state.C_en[2], state.height, state.v_n, u)

    # the middle of the interval, well enough for terms that change by 1e-6 of themselves over it
    correction = state.height_correction
    push = acceleration(start, state.v_n, state.height, correction)
    v_mid = state.v_n + 0.5 * (C_nb @ dv_b + push * dt)
    pole_mid = state.C_en[2] - np.cross(start.w_en_n, state.C_en[2]) * 0.5 * dt
    h_mid = state.height + 0.5 * dt * (v_mid[2] - k1 * (state.height - u[U_H]))
    mid = frame_rates(pole_mid, h_mid, v_mid, u)
    correction_mid = correction + 0.5 * dt * k3 * (state.height - u[U_H])

    zeta = (mid.w_ie_n + mid.w_en_n + w_c) * dt
    dv_n = C_nb @ dv_b
    dv_n = dv_n - 0.5 * np.cross(zeta, dv_n)
    v_n = state.v_n + dv_n + acceleration(mid, v_mid, h_mid, correction_mid) * dt

    v_mean = 0.5 * (state.v_n + v_n)
    height = state.height + (v_mean[2] - k1 * (h_mid - u[U_H])) * dt
    w_en_n = frame_rates(pole_mid, 0.5 * (state.height + height), v_mean, u).w_en_n
    C_en = moved(state.C_en, w_en_n * dt)

    turn_n = rot.quat_from_rotvec(-(mid.w_ie_n + w_en_n + w_c) * dt)
    turn_b = rot.quat_from_rotvec(rotation_vector(dtheta))
    q_nb = rot.quat_normalize(rot.quat_multiply(rot.quat_multiply(turn_n, state.q_nb), turn_b))
    return NavState(q_nb, v_n, C_en, float(height), float(correction + k3 * (h_mid - u[U_H]) * dt))
