"""The filter's error model and the psi form across the pole, under every azimuth law that goes there.

Two navigations by the kernel, an exact and a disturbed one, fly over the pole; what the models make of the
disturbance on the way is held to their difference, by the definitions alone.
"""

import math

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.errors import psi
from nav.errors.geographic import sensor_inputs
from nav.errors.model import error_dynamics
from nav.filter import states as st
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.kernels import (
    M_C,
    M_EN,
    M_F,
    M_G,
    M_IE,
    M_K,
    M_SIZE,
    M_V,
    X_C,
    X_H,
    X_HEAD,
    X_Q,
    X_V,
    increments,
    strapdown,
)
from nav.strapdown.mechanize import frame_rates
from tests.nav.filter.making import difference

DT = 0.5
SECONDS = 400
SPEED = 250.0
GYRO, ACCEL = np.array([2e-8, -3e-8, 1.5e-8]), np.array([4e-4, -3e-4, 2e-4])


def start():
    """50 km before the pole, level, flying north."""
    x = np.zeros(st.X_SIZE)
    x[X_Q : X_Q + 4] = rot.quat_from_euler(0.0, 0.02, 0.05)
    x[X_V : X_V + 3] = 0.0, SPEED, 1.0
    x[X_C : X_C + 9] = earth.position_matrix(math.pi / 2 - 50e3 / 6.4e6, 1.0).ravel()
    x[X_H] = 9000.0
    return x


def disturbed(x):
    """A state with errors of all kinds, made by turns and sums alone."""
    y = x.copy()
    turn = rot.dcm_from_quat(rot.quat_from_rotvec([3e-5, 2e-5, 0.0]))
    y[X_C : X_C + 9] = (x[X_C : X_C + 9].reshape(3, 3) @ turn).ravel()
    y[X_H] += 40.0
    y[X_V : X_V + 3] += [0.2, -0.15, 0.1]
    y[X_Q : X_Q + 4] = rot.quat_multiply(rot.quat_from_rotvec([-6e-5, 4e-5, -2e-4]), x[X_Q : X_Q + 4])
    return y


def psi_error(y, x):
    """States of the psi form in the computed frame, by definition: Earth-fixed vectors."""
    C_ec, C_en = y[X_C : X_C + 9].reshape(3, 3), x[X_C : X_C + 9].reshape(3, 3)
    C_cn = C_ec.T @ C_en
    places = [
        np.array(earth.geodetic_to_xyz(*earth.position_angles(C)[:2], s[X_H]))
        for C, s in ((C_ec, y), (C_en, x))
    ]
    C_pc = rot.dcm_from_quat(y[X_Q : X_Q + 4]) @ (C_cn @ rot.dcm_from_quat(x[X_Q : X_Q + 4])).T
    angle = -rot.rotvec_from_quat(rot.quat_from_dcm(C_pc))
    return np.concatenate(
        [C_ec.T @ (places[0] - places[1]), y[X_V : X_V + 3] - C_cn @ x[X_V : X_V + 3], angle]
    )


def step(x, w_b, f_b, u):
    inc, mid, head = np.empty(6), np.zeros(M_SIZE), x[:X_HEAD].copy()
    half = 0.5 * DT
    increments(np.concatenate([w_b * half, w_b * half, f_b * half, f_b * half]), 2, inc)
    strapdown(head, inc, DT, u, mid)
    y = x.copy()
    y[:X_HEAD] = head
    return y, mid


def carried(F, forced, x):
    """States after an interval of constant dynamics: exponential series; the fifth term is below 1e-12."""
    out, term, slope = x.copy(), x, forced
    for k in range(1, 5):
        term = (F @ term + slope) * DT / k
        out, slope = out + term, 0.0
    return out


@pytest.fixture(scope="module")
def inertial():
    """Rates and forces in b of a flight straight on over the pole that sways and climbs a little."""
    x, out = start(), []
    u = azimuth_control("wander")
    for k in range(round(SECONDS / DT)):
        t = k * DT
        C_bn = rot.dcm_from_quat(x[X_Q : X_Q + 4]).T
        frame = frame_rates(x[X_C + 6 : X_C + 9], x[X_H], x[X_V : X_V + 3], u)
        coriolis = np.cross(2.0 * frame.w_ie_n + frame.w_en_n, x[X_V : X_V + 3])
        push = np.array([0.3 * math.cos(0.1 * t), 0.05, 0.02 * math.cos(0.03 * t)])
        sway = np.array([0.01 * math.cos(0.2 * t), 0.02 * math.sin(0.3 * t), 0.004 * math.cos(0.05 * t)])
        out.append((C_bn @ (frame.w_ie_n + frame.w_en_n) + sway, C_bn @ (push + coriolis - frame.gravity_n)))
        x, _ = step(x, *out[-1], u)
    return out


@pytest.mark.parametrize(("law", "rate"), [("wander", 0.0), ("free", 0.0), ("rotating", 3e-4)])
def test_models_cross_the_pole(inertial, law, rate):
    u = azimuth_control(law, rate)
    x = start()
    y = disturbed(x)
    vector, filtered = psi_error(y, x), difference(y, x)[:9]
    sensors = np.concatenate([GYRO, ACCEL])
    nearest = math.inf
    for w_b, f_b in inertial:
        C_en = x[X_C : X_C + 9].reshape(3, 3)
        lat, lon, _ = earth.position_angles(C_en)
        nearest = min(nearest, math.hypot(*C_en[2, :2]) * 6.4e6)
        x, mid = step(x, w_b, f_b, u)
        y, _ = step(y, w_b + GYRO, f_b + ACCEL, u)
        C_nb, f_n = mid[M_C : M_C + 9].reshape(3, 3), mid[M_F : M_F + 3]
        w_ie, w_en = mid[M_IE : M_IE + 3], mid[M_EN : M_EN + 3]
        G = sensor_inputs(C_nb)
        C_gn = earth.position_matrix(lat, lon).T @ C_en
        gradient = C_gn.T @ psi.gravity_gradient(lat, x[X_H]) @ C_gn
        vector = carried(psi.psi_dynamics(w_ie, w_en, f_n, gradient), G @ sensors, vector)
        curved = (mid[M_K], mid[M_K + 1], mid[M_K + 2])
        F = error_dynamics(C_nb, C_nb.T @ f_n, w_b, mid[M_V : M_V + 3], w_ie, w_en, curved, mid[M_G])[:9]
        filtered = carried(F[:, :9], -F[:, 9:15] @ sensors, filtered)
    assert nearest < 150.0
    assert x[X_C + 8] < math.sin(math.pi / 2 - 40e3 / 6.4e6), "well beyond the pole"
    # products of two errors, 2e-4 of each, and 1e-4 for models that are constant over half a second
    bound = 3e-4 * np.array([400.0] * 3 + [0.5] * 3 + [2e-4] * 3)
    assert np.all(np.abs(psi_error(y, x) - vector) <= bound)
    # the filter's model takes 2 g / R for the gradient of gravity: 0.35 % of 6e-4 m/s^2 for 400 s
    slack = np.array([0.05, 0.05, 0.2, 2e-4, 2e-4, 1e-3, 0.0, 0.0, 0.0])
    assert np.all(np.abs(difference(y, x)[:9] - filtered) <= bound + slack)
