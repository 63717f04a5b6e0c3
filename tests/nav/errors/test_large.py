"""The model of large misalignments against navigators that have them."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from nav.earth import EARTH_RATE
from nav.errors.large import (
    angles,
    attitude_rate,
    misalignment,
    nearly_level_rate,
    standing_velocity_rate,
    velocity_rate,
)
from nav.rotation import dcm_from_quat, quat_from_rotvec, skew

# Yan Gongmin 2008, section 4.3.4: a sphere of constant gravity
R, G = 6378137.0, 9.797
LAT, HEIGHT = math.radians(30.0), 100.0
DRIFT = np.full(3, math.radians(0.05) / 3600.0)
OFFSET = np.full(3, 100e-6 * G)


def turn(rotvec):
    return dcm_from_quat(quat_from_rotvec(rotvec))


def test_small_angles_are_phi():
    phi = np.array([2e-5, -3e-5, 1e-5])
    # products of angles are left out: 1e-9
    assert np.max(np.abs(misalignment(phi) - (np.eye(3) - skew(phi)))) < 2e-9


def test_angles_come_back():
    alpha = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3)) * [1.5, 3.1, 3.1]
    assert np.max(np.abs(angles(misalignment(alpha)) - alpha)) < 1e-12


def test_attitude_rate_is_that_of_two_navigators():
    rng = np.random.default_rng(2)
    for _ in range(20):
        alpha = rng.uniform(-1.0, 1.0, 3) * [1.2, 3.0, 3.0]
        w, dw, drift, h = rng.normal(size=3), 0.3 * rng.normal(size=3), 0.2 * rng.normal(size=3), 1e-5
        C_bn = turn(rng.normal(size=3))
        w_nb = rng.normal(size=3)
        w_ib = C_bn @ (w - dw) + w_nb  # the true frame turns with w - dw
        C_pb = misalignment(alpha) @ C_bn.T

        def after(t, C_bn=C_bn, C_pb=C_pb, w=w, dw=dw, w_ib=w_ib, drift=drift):
            true = turn(-(w - dw) * t) @ C_bn.T @ turn(w_ib * t)
            computed = turn(-w * t) @ C_pb @ turn((w_ib + drift) * t)
            return angles(computed @ true.T)

        seen = (after(h) - after(-h)) / (2.0 * h)
        # central difference: h^2 by third derivatives of some tens, and rounding 1e-16/h
        assert np.max(np.abs(seen - attitude_rate(alpha, w, dw, C_pb @ drift))) < 1e-6


def drive():
    """Phases of the trajectory: duration, speed, acceleration, azimuth (left of north), its rate."""
    left = math.radians(9.0)
    yield 30.0, 10.0, 0.0, 0.0, 0.0
    yield 20.0, 10.0, 1.0, 0.0, 0.0
    yield 30.0, 30.0, 0.0, 0.0, 0.0
    yield 10.0, 30.0, 0.0, 0.0, left
    yield 30.0, 30.0, 0.0, 0.5 * math.pi, 0.0


def rates(t, y, phase):
    """Latitude, damped navigator (attitude, velocity) and the model (alpha, velocity error)."""
    _, speed, pull, azimuth, turning = phase
    lat, C_pb, alpha = y[0], y[1:10].reshape(3, 3), y[13:16]
    psi, s = azimuth + turning * t, speed + pull * t
    C_nb = np.array([[math.cos(psi), -math.sin(psi), 0.0], [math.sin(psi), math.cos(psi), 0.0], [0, 0, 1.0]])
    ahead, across = C_nb[:, 1], -C_nb[:, 0]
    v, a = s * ahead, pull * ahead + s * turning * across
    w_ie = EARTH_RATE * np.array([0.0, math.cos(lat), math.sin(lat)])
    w_en = np.array([-v[1], v[0], v[0] * math.tan(lat)]) / (R + HEIGHT)
    w_in = w_ie + w_en
    carried = np.cross(2.0 * w_ie + w_en, v) + np.array([0.0, 0.0, G])
    w_b = C_nb.T @ w_in + np.array([0.0, 0.0, turning]) + DRIFT
    f_b = C_nb.T @ (a + carried) + OFFSET
    model = misalignment(alpha) @ C_nb
    return np.concatenate(
        [
            [v[1] / (R + HEIGHT)],
            (C_pb @ skew(w_b) - skew(w_in) @ C_pb).ravel(),
            C_pb @ f_b - carried - a,
            attitude_rate(alpha, w_in, np.zeros(3), model @ DRIFT),
            velocity_rate(alpha, model @ f_b, model @ OFFSET),
        ]
    )


def test_the_model_is_the_difference_of_two_navigations():
    alpha, dv = np.radians([30.0, 30.0, 180.0]), np.array([0.0, -10.0, 0.0])
    y = np.concatenate([[LAT], misalignment(alpha).ravel(), dv, alpha, dv])
    for phase in drive():
        y = solve_ivp(rates, (0.0, phase[0]), y, "DOP853", args=(phase,), rtol=1e-11, atol=1e-11).y[:, -1]
    # the figures are printed to 0.01 m/s; the solver's tolerances are well below 1e-4 m/s of several hundred
    assert np.max(np.abs(y[10:13] - [-456.49, 597.53, -286.90])) < 0.1
    assert np.max(np.abs(y[16:19] - y[10:13])) < 1e-4


def test_the_model_with_nearly_level_axes():
    rng = np.random.default_rng(3)
    w = EARTH_RATE * np.array([0.0, math.cos(LAT), math.sin(LAT)])
    alpha = np.stack([*rng.uniform(-1e-3, 1e-3, (2, 40)), rng.uniform(-math.pi, math.pi, 40)], -1)
    short = nearly_level_rate(alpha, w[1], w[2], np.zeros(3))
    exact = attitude_rate(alpha, w, np.zeros(3), np.zeros(3))
    # to second order in the level angles
    assert np.max(np.abs(short - exact)) < 3e-6 * EARTH_RATE
    velocity = standing_velocity_rate(alpha, G, OFFSET)
    level = np.stack([-G * alpha[:, 1], G * alpha[:, 0], 0.0 * alpha[:, 0]], -1) + OFFSET
    assert np.max(np.abs(velocity - level)) < 2e-6 * G


def test_standing_the_two_forms_of_the_velocity_error_are_of_one_acceleration():
    alpha = np.radians([20.0, -35.0, 140.0])
    C_pn = misalignment(alpha)
    f_p = C_pn @ [0.0, 0.0, G]
    # computed specific force less gravity, in either form
    by_force, by_gravity = (
        velocity_rate(alpha, f_p, np.zeros(3)),
        standing_velocity_rate(alpha, G, np.zeros(3)),
    )
    assert np.max(np.abs(by_force - by_gravity)) < 1e-12
