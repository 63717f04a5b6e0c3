"""The error models against the difference of two navigations: one exact, one with small errors.

Both navigate by the readable mechanisation with increments of one flight with turns, climbs and changes of
speed; the second starts with errors and its sensors have some. What the exact one says is the truth.
"""

import math

import numpy as np
import pytest
from scipy.linalg import block_diag

from nav import earth
from nav import rotation as rot
from nav.errors import geographic as geo
from nav.errors import psi
from nav.errors.model import error_dynamics
from nav.filter import states as st
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.strapdown.mechanize import NavState, frame_rates, update
from tests.nav.filter.making import difference

DT = 0.5
SECONDS = 600
ERROR = np.concatenate([[150.0, -200.0, 40.0], [0.2, -0.15, 0.1], [6e-5, -4e-5, 2e-4]])
"""Position in metres, velocity, and phi of the geographic form."""
GYRO, ACCEL = np.array([2e-8, -3e-8, 1.5e-8]), np.array([4e-4, -3e-4, 2e-4])


def body_rates(state, t):
    """Rate and force in b of a flight that turns, climbs and gains speed; the truth is what becomes of it."""
    C_nb = rot.dcm_from_quat(state.q_nb)
    frame = frame_rates(state.C_en[2], state.height, state.v_n)
    turn = 0.006 * math.sin(0.02 * t)
    spin = np.array([0.0, 0.0, turn])
    push = np.array([0.1, -0.05, 0.02 * math.cos(0.03 * t)])
    coriolis = np.cross(2.0 * frame.w_ie_n + frame.w_en_n, state.v_n)
    f_n = push + np.cross(spin, state.v_n) + coriolis - frame.gravity_n
    return C_nb.T @ (frame.w_ie_n + frame.w_en_n + spin), C_nb.T @ f_n


def step(state, w_b, f_b):
    d, u = 0.5 * DT * w_b, 0.5 * DT * f_b
    return update(state, np.array([d, d]), np.array([u, u]), DT)


def view(state):
    """Latitude, longitude, height, v_g, C_gb of a state."""
    lat, lon, _ = earth.position_angles(state.C_en)
    C_gn = earth.position_matrix(lat, lon).T @ state.C_en
    return lat, lon, state.height, C_gn @ state.v_n, C_gn @ rot.dcm_from_quat(state.q_nb)


def phi_error(computed, true):
    """States of `nav.errors.geographic` from two states, by definition."""
    (lat, lon, h, v, C), (lat0, lon0, h0, v0, C0) = view(computed), view(true)
    phi = -rot.rotvec_from_quat(rot.quat_from_dcm(C @ C0.T))
    return np.concatenate([[lat - lat0, lon - lon0, h - h0], v - v0, phi])


def psi_error(computed, true):
    """States of the psi form from two states: Earth-fixed vectors, written in the computed frame."""
    (lat, lon, h, v, C), (lat0, lon0, h0, v0, C0) = view(computed), view(true)
    C_ec, C_eg = earth.position_matrix(lat, lon), earth.position_matrix(lat0, lon0)
    away = np.array(earth.geodetic_to_xyz(lat, lon, h)) - np.array(earth.geodetic_to_xyz(lat0, lon0, h0))
    C_cb = C_ec.T @ C_eg @ C0
    angle = -rot.rotvec_from_quat(rot.quat_from_dcm(C @ C_cb.T))
    return np.concatenate([C_ec.T @ away, v - C_ec.T @ C_eg @ v0, angle])


def started(true, error):
    """A computed state with the geographic phi error ``error``."""
    lat, lon, h, v, C = view(true)
    lat, lon, h = np.array([lat, lon, h]) + geo.metres_to_angles(lat, h) @ error[:3]
    C = rot.dcm_from_quat(rot.quat_from_rotvec(-error[6:])) @ C
    return NavState(
        q_nb=rot.quat_from_dcm(C), v_n=v + error[3:6], C_en=earth.position_matrix(lat, lon), height=h
    )


def flight():
    C = rot.dcm_from_euler(0.6, 0.03, -0.2)
    return NavState(
        q_nb=rot.quat_from_dcm(C),
        v_n=np.array([120.0, 180.0, 3.0]),
        C_en=earth.position_matrix(0.75, 0.2),
        height=3000.0,
    )


def carried(F, forced, x):
    """States after an interval of constant dynamics: exponential series; the fifth term is below 1e-12."""
    out, term = x.copy(), x
    slope = forced
    for k in range(1, 5):
        term = (F @ term + slope) * DT / k
        out, slope = out + term, 0.0
    return out


class Flown:
    """Both navigations and the three models side by side, with errors ``size`` times those above."""

    def __init__(self, size):
        true, computed = flight(), started(flight(), size * ERROR)
        lat, _, h, v, _ = view(true)
        self.phi = size * block_diag(geo.metres_to_angles(lat, h), np.eye(6)) @ ERROR
        self.psi = size * np.linalg.solve(psi.phi_from_psi(geo.frame_turn(lat, h), v), ERROR)
        # the true frame of the filter's model is the shortest turn away; n is g at the start
        D = geo.frame_turn(lat, h)
        D[2] = 0.0
        self.wander = psi.phi_from_psi(D, v) @ self.psi
        sensors = size * np.concatenate([GYRO, ACCEL])
        apart = []
        for k in range(round(SECONDS / DT)):
            w_b, f_b = body_rates(true, k * DT)
            after = step(true, w_b, f_b)
            computed = step(computed, w_b + size * GYRO, f_b + size * ACCEL)
            self.carry(true, after, w_b, f_b, sensors)
            true = after
            lat, _, h, v, _ = view(true)
            T = block_diag(geo.metres_to_angles(lat, h), np.eye(6)) @ psi.phi_from_psi(
                geo.frame_turn(lat, h), v
            )
            apart.append(T @ self.psi - self.phi)
        self.apart = np.max(np.abs(apart), axis=0)
        self.true, self.computed = true, computed

    def carry(self, before, after, w_b, f_b, sensors):
        """The models over one interval, taken in its middle."""
        half = rot.dcm_from_quat(rot.quat_from_rotvec(0.5 * DT * w_b))
        (lat, _, h, v, C_gb), (lat1, _, h1, v1, _) = view(before), view(after)
        lat, h, v, C_gb = 0.5 * (lat + lat1), 0.5 * (h + h1), 0.5 * (v + v1), C_gb @ half
        G = geo.sensor_inputs(C_gb)
        f = C_gb @ f_b
        self.phi = carried(geo.phi_dynamics(lat, h, v, f), G @ sensors, self.phi)
        w_ie, w_en = earth.earth_rate_g(lat), earth.transport_rate_g(lat, h, v)
        F = psi.psi_dynamics(w_ie, w_en, f, psi.gravity_gradient(lat, h))
        self.psi = carried(F, G @ sensors, self.psi)

        pole, v_n = 0.5 * (before.C_en[2] + after.C_en[2]), 0.5 * (before.v_n + after.v_n)
        C_nb = rot.dcm_from_quat(before.q_nb) @ half
        frame = frame_rates(pole, h, v_n)
        r_m, r_n = earth.radii(pole[2])
        gradient = 2.0 * earth.normal_gravity(pole[2], h) / (math.sqrt(r_m * r_n) + h)
        F = error_dynamics(
            C_nb, f_b, w_b, v_n, frame.w_ie_n, frame.w_en_n, earth.curvature(*pole, h), gradient
        )[:9]
        # the filter's biases are what is taken away from the sensors: an output error is minus one of them
        self.wander = carried(F[:, :9], -F[:, 9:15] @ sensors, self.wander)


@pytest.fixture(scope="module")
def flown():
    return Flown(1.0)


# products of two errors, the largest of which is the 2e-4 rad of heading; and 1e-4 of the error for a model
# that is taken as constant over half a second of turning. Errors of position, velocity and angle are 400 m,
# 0.5 m/s and 2e-4 rad.
METRES = 3e-4 * np.array([400.0] * 3 + [0.5] * 3 + [2e-4] * 3)
ANGLES = np.concatenate([METRES[:2] / 4.6e6, METRES[2:]])


def test_the_forms_stay_tied(flown):
    """phi = psi + dtheta and dv_phi = dv_psi - dtheta x v at every update of the flight.

    The tie itself moves within an update, of which the models know the middle: 1e-5 of the error.
    """
    assert np.all(flown.apart <= 0.05 * ANGLES)


def test_phi_form_is_the_difference_of_two_navigations(flown):
    error = phi_error(flown.computed, flown.true)
    assert np.all(np.abs(error - flown.phi) <= ANGLES)
    # and it has become another one on the way
    assert abs(error[3] - ERROR[3]) > 0.1


def test_psi_form_is_the_difference_of_two_navigations(flown):
    assert np.all(np.abs(psi_error(flown.computed, flown.true) - flown.psi) <= METRES)


def test_filters_model_is_the_difference_of_two_navigations(flown):
    """The filter's model leaves out e^2 of gravity's change with place: seen in the vertical channel.

    250 m of northward error change gravity by 2e-6 m/s^2, 200 m of height by 6e-4, of which 2 g / R misses
    0.35 %: together 4e-6 m/s^2, 2.4 mm/s and 0.7 m in ten minutes. The level channels get 1 / 4 of that
    through the transport rate, which takes one mean radius.
    """
    x, y = np.zeros(st.X_SIZE), np.zeros(st.X_SIZE)
    for vector, state in ((x, flown.true), (y, flown.computed)):
        vector[X_Q : X_Q + 4], vector[X_V : X_V + 3] = state.q_nb, state.v_n
        vector[X_C : X_C + 9], vector[X_H] = state.C_en.ravel(), state.height
    slack = np.array([0.18, 0.18, 0.7, 6e-4, 6e-4, 2.4e-3, 0.0, 0.0, 0.0])
    assert np.all(np.abs(difference(y, x)[:9] - flown.wander) <= METRES + slack)
