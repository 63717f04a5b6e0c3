"""The gimballed platform: command rates, torquing, heading, and what turning it does to its errors."""

import math

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from nav import earth
from nav.platform import (
    SWING_AMPLITUDE,
    Modulation,
    command_rate,
    command_rate_g,
    gimbal_matrix,
    grid_heading,
    heading_drift,
    heading_limit,
    heading_n,
    modulation_turn,
    swing,
    torque,
    true_heading,
    uniform,
    zhao,
)
from nav.rotation import quat_from_rotvec
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.control import U_FREE, U_TURN, control
from nav.strapdown.kernels import M_EN, M_IE, M_SIZE, X_C, X_H, X_HEAD, X_Q, X_V, increments, strapdown
from nav.strapdown.mechanize import frame_rates

DEG_PER_H = math.radians(1.0) / 3600.0
ARCMIN = math.radians(1.0) / 60.0
DAY = 86400.0
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def state(lat, azimuth=0.0, v_n=(0.0, 0.0, 0.0), height=0.0, lon=0.0):
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = UPRIGHT
    x[X_V : X_V + 3] = v_n
    x[X_C : X_C + 9] = earth.position_matrix(lat, lon, azimuth).ravel()
    x[X_H] = height
    return x


def random_states():
    rng = np.random.default_rng(7)
    for _ in range(50):
        lat, azimuth = rng.uniform(-1.5, 1.5), rng.uniform(-np.pi, np.pi)
        yield lat, azimuth, rng.normal(size=3) * 200.0, rng.uniform(-100.0, 1e4)


@pytest.mark.parametrize(
    "u",
    [azimuth_control("wander"), azimuth_control("free"), control(free=-1.0, turn=3e-4)],
    ids=["wander", "free", "modulated"],
)
def test_command_rates_are_those_of_the_kernels_frame(u):
    for lat, azimuth, v_n, height in random_states():
        x = state(lat, azimuth, v_n, height)
        frame = frame_rates(x[13:16], height, v_n, u)
        ours = np.array(command_rate(x, u))
        np.testing.assert_allclose(ours, frame.w_ie_n + frame.w_en_n, rtol=1e-12, atol=1e-19)
        turn = u[U_TURN] - u[U_FREE] * earth.EARTH_RATE * math.sin(lat)
        # a component may be the small difference of two: relative to the whole
        size = np.linalg.norm(ours)
        by_hand = command_rate_g(lat, height, azimuth, v_n, turn)
        np.testing.assert_allclose(by_hand, ours, rtol=0, atol=1e-12 * size)
        # the kernel itself, over a step too short for anything to change
        mid, dt = np.empty(M_SIZE), 1e-9
        strapdown(x, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8 * dt]), dt, u, mid)
        kernel = mid[M_IE : M_IE + 3] + mid[M_EN : M_EN + 3]
        np.testing.assert_allclose(ours, kernel, rtol=0, atol=1e-12 * size)


def test_command_rates_at_a_pole():
    x = state(math.pi / 2.0, 0.3, (3.0, 4.0, 0.0))
    r, _ = earth.radii(1.0)
    w = command_rate(x, control())
    np.testing.assert_allclose(w, (-4.0 / r, 3.0 / r, earth.EARTH_RATE), rtol=1e-12)


def test_the_north_pointing_platform_of_the_textbook():
    lat, v = 0.9, np.array([30.0, -20.0, 0.0])
    r_m, r_n = (r + 100.0 for r in earth.radii(math.sin(lat)))
    east = v[0] / r_n
    w = earth.EARTH_RATE
    expected = (-v[1] / r_m, w * math.cos(lat) + east, w * math.sin(lat) + east * math.tan(lat))
    np.testing.assert_allclose(
        command_rate(state(lat, 0.0, v, 100.0), control(north=1.0)), expected, rtol=1e-12
    )


def test_an_untorqued_azimuth_gyro_is_torqued_by_the_rate_alone():
    law = zhao(-60.0 * DEG_PER_H)
    u = control(free=law.free, turn=modulation_turn(law.array, 100.0, 1.0))
    assert command_rate(state(1.2, 0.4), u)[2] == pytest.approx(-60.0 * DEG_PER_H, rel=1e-12)
    # the other sense turns as fast past the Earth, and is torqued with the Earth's rate twice
    other = zhao(60.0 * DEG_PER_H)
    u = control(free=other.free, turn=other.rate)
    expected = 60.0 * DEG_PER_H + 2.0 * earth.EARTH_RATE * math.sin(1.2)
    assert command_rate(state(1.2, 0.4), u)[2] == pytest.approx(expected, rel=1e-12)


def test_level_velocity_on_a_turning_platform():
    """Zhao, eq. (26) with the 2 that is missing in print, for level motion."""
    lat, v, a, dt = 1.1, np.array([5.0, -3.0, 0.0]), np.array([0.02, 0.05, 9.8]), 1e-3
    turn = 3e-4
    x, mid = state(lat, 0.7, v), np.empty(M_SIZE)
    u = control(turn=turn)
    w = np.array(command_rate(x, u))
    inc = np.empty(6)
    increments(np.concatenate((w * dt, a * dt)), 1, inc)
    pole = x[15]
    strapdown(x, inc, dt, u, mid)
    coriolis = 2.0 * earth.EARTH_RATE * pole + turn
    expected = np.array([a[0] + coriolis * v[1], a[1] - coriolis * v[0]])
    # velocity changes by 1e-5 of itself over the step, Coriolis acceleration with it
    np.testing.assert_allclose((x[4:6] - v[:2]) / dt, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("law", [Modulation(), uniform(3e-4), zhao(-3e-4), swing(1800.0)])
def test_the_turn_of_a_cycle_adds_up_to_the_azimuth(law):
    t = np.arange(0.0, 5000.0, 7.0)
    turned = np.cumsum([modulation_turn(law.array, one, 7.0) * 7.0 for one in t])
    k = law.rate * (t + 7.0) + law.amplitude * (np.cos(law.frequency * (t + 7.0)) - 1.0)
    np.testing.assert_allclose(turned, k, rtol=0, atol=1e-12)


def test_a_swing_averages_level_errors_out_from_its_start():
    period = 1800.0
    law = swing(period)
    t = np.linspace(0.0, period, 4001)
    k = law.amplitude * (np.cos(law.frequency * t) - 1.0)
    integral = cumulative_trapezoid(np.exp(1j * k), t, initial=0.0)
    # trapezoids of a periodic function: exact to rounding after a period
    assert abs(integral[-1]) < 1e-9 * period
    # and the path keeps its middle where it began
    assert abs(integral.mean()) < 1e-4 * period
    # how far it strays, in periods: J1(A) / pi and a little of the higher ones
    assert np.abs(integral).max() < 0.19 * period
    # no jump, and at rest when it begins
    rate = np.gradient(k, t)
    assert abs(rate[0]) < 1e-3 * np.abs(rate).max()
    assert np.abs(rate).max() == pytest.approx(SWING_AMPLITUDE * 2.0 * math.pi / period, rel=1e-5)


def test_gimbals_and_platform():
    k, (x, y, z) = 0.4, (1.0, 2.0, 3.0)
    C_pf = gimbal_matrix(k)
    # Zhao, eq. (1)
    by_hand = (x * math.cos(k) - y * math.sin(k), x * math.sin(k) + y * math.cos(k), z)
    np.testing.assert_allclose(C_pf.T @ (x, y, z), by_hand, rtol=1e-15)
    np.testing.assert_allclose(C_pf @ C_pf.T, np.eye(3), atol=1e-15)
    many = gimbal_matrix([0.0, k])
    np.testing.assert_array_equal(many[0], np.eye(3))
    np.testing.assert_array_equal(many[1], C_pf)
    # the vehicle's forward axis stands k to the right of the platform's y axis
    np.testing.assert_allclose(C_pf[:, 1], (math.sin(k), math.cos(k), 0.0))


@pytest.mark.parametrize("weight_arcsec", [0.01, 0.3, 5.0])
def test_torquing_pulses_are_whole_and_none_is_lost(weight_arcsec):
    weight = math.radians(weight_arcsec / 3600.0)
    x, u = state(1.2, 0.3), control(height_gains=(2.0 / 30.0, 1.0 / 900.0, 0.0))
    w, g = np.array(command_rate(x, u)), earth.normal_gravity(math.sin(1.2), 0.0)
    pulses, inc, mid, total = np.empty(3), np.empty(6), np.empty(M_SIZE), np.zeros(3)
    dt, cycles = 0.5, 400
    known = []
    for _ in range(cycles):
        torque(x, u, dt, weight, pulses)
        np.testing.assert_array_equal(pulses, np.rint(pulses))
        total += pulses * weight
        increments(np.array([*(pulses * weight), 0.0, 0.0, g * dt]), 1, inc)
        strapdown(x, inc, dt, u, mid)
        known.append(2.0 * x[1:4])
    # what has been sent is the turn of n to half a pulse, and the computer knows what is left
    left = total - w * dt * cycles
    # 1e-8: coarse pulses tilt p by some arcsec, its accelerometers feel gravity, and n moves a little
    assert np.abs(left).max() <= 0.5 * weight + 1e-8
    assert np.abs(known).max() <= 0.5 * weight * (1.0 + 1e-6) + 1e-8


def test_torquing_takes_a_known_misalignment_away():
    x, u, weight = state(0.8), control(), 1e-9
    x[X_Q : X_Q + 4] = quat_from_rotvec([2e-3, -1e-3, 4e-3])
    pulses, mid = np.empty(3), np.empty(M_SIZE)
    torque(x, u, 1.0, weight, pulses)
    strapdown(x, np.array([*(pulses * weight), 0.0, 0.0, 9.8]), 1.0, u, mid)
    # tilts let gravity move n during the cycle: 1e-2 m/s over R
    assert np.abs(x[1:4]).max() < 1e-8


def test_heading_is_the_gimbals_less_the_wander_angle():
    for lat, azimuth, _, _ in random_states():
        C_en = earth.position_matrix(lat, 0.3, azimuth)
        for heading in (0.1, 3.0, 6.0):
            # a vehicle heading so is at heading + wander from the platform, for the platform is left of north
            k = heading + azimuth
            assert true_heading(C_en, UPRIGHT, k) == pytest.approx(heading, abs=1e-12)
            # what the computer knows the platform to be off counts: off to the left, the gimbal shows more
            off = quat_from_rotvec([0.0, 0.0, 0.02])
            assert true_heading(C_en, off, k + 0.02) == pytest.approx(heading, abs=1e-12)
    np.testing.assert_allclose(heading_n([UPRIGHT, UPRIGHT], [0.5, 7.0]), [0.5, 7.0])


def test_grid_heading_goes_on_over_the_pole():
    # level at the pole, then back and forth along the meridian of 20 deg east and 160 deg west
    lon = math.radians(20.0)
    over = np.linspace(-0.01, 0.01, 21)
    start = earth.position_matrix(math.pi / 2.0 - 0.01, lon, 0.0)
    track = [start @ Rotation.from_rotvec([-(s + 0.01), 0.0, 0.0]).as_matrix() for s in over]
    q = np.tile(UPRIGHT, (len(track), 1))
    grid = grid_heading(np.array(track), q, np.full(len(track), 0.25))
    # northwards with wander zero, the vehicle 0.25 to the right; grid angle at the pole is the longitude
    np.testing.assert_allclose(grid, 0.25 - lon + 2.0 * math.pi, rtol=0, atol=1e-4)
    assert np.abs(np.diff(grid)).max() < 1e-4
    true = true_heading(np.array(track), q, np.full(len(track), 0.25))
    assert true[0] == pytest.approx(0.25, abs=1e-9)
    assert true[-1] == pytest.approx(0.25 + math.pi, abs=1e-9)


BIAS = np.array([0.003, 0.003, 0.001]) * DEG_PER_H


@pytest.mark.parametrize("lat_deg", [-40.0, 0.0, 55.0, 85.0])
@pytest.mark.parametrize("rate", [0.0, 60.0, -60.0, -15.041067, 15.041067])
def test_heading_drift_is_the_integral_of_the_turning_bias(lat_deg, rate):
    """Integrate the drift in inertial axes, by another library, and look at it along the right axis."""
    lat, rate = math.radians(lat_deg), rate * DEG_PER_H
    if rate and abs(abs(rate) - 15.041067 * DEG_PER_H) < 1e-12:
        rate = math.copysign(earth.EARTH_RATE, rate)
    t = np.linspace(0.0, DAY, 28801)
    C_eg = earth.position_matrix(lat, 0.0)
    day = Rotation.from_rotvec(np.outer(earth.EARTH_RATE * t, [0.0, 0.0, 1.0]))
    turned = Rotation.from_rotvec(np.outer(rate * t, [0.0, 0.0, 1.0]))
    drift_i = cumulative_trapezoid(-day.apply(turned.apply(BIAS) @ C_eg.T), t, axis=0, initial=0.0)
    drift_g = day.inv().apply(drift_i) @ C_eg
    expected = drift_g[:, 2] - drift_g[:, 1] * math.tan(lat)
    # trapezoids of 3 s of something that turns by 1e-3 in them
    size = np.linalg.norm(BIAS) * DAY / math.cos(lat)
    np.testing.assert_allclose(heading_drift(t, lat, BIAS, rate), expected, rtol=0, atol=1e-6 * size)


@pytest.mark.parametrize("lat_deg", [0.0, 55.0, 65.0, 75.0, 85.0])
def test_the_drift_of_a_platform_that_is_not_turned_has_the_closed_limit(lat_deg):
    lat = math.radians(lat_deg)
    t = np.linspace(0.0, DAY, 86401)
    for signs in ((1, 1, 1), (-1, 1, 1), (1, -1, 1), (0, 1, 0)):
        bias = BIAS * signs
        assert np.abs(heading_drift(t, lat, bias)).max() == pytest.approx(heading_limit(lat, bias), rel=1e-6)


def physical_day(lat, law, bias, dt=30.0):
    """Heading errors of a day at rest of a platform modelled with another library's rotations."""
    x, u = state(lat), control(free=law.free, height_gains=(2.0 / 300.0, 1.0 / 90000.0, 0.0))
    weight = math.radians(0.01 / 3600.0)
    C_eg = earth.position_matrix(lat, 0.0)
    up_e = C_eg[:, 2] * earth.normal_gravity(math.sin(lat), 0.0)
    C_ip = Rotation.from_matrix(C_eg)
    pulses, inc, mid, out = np.empty(3), np.empty(6), np.empty(M_SIZE), []
    for step in range(round(DAY / dt)):
        t = step * dt
        u[U_TURN] = modulation_turn(law.array, t, dt)
        torque(x, u, dt, weight, pulses)
        half = Rotation.from_rotvec(0.5 * (pulses * weight - bias * dt))
        middle = C_ip * half
        force_i = Rotation.from_rotvec([0.0, 0.0, earth.EARTH_RATE * (t + 0.5 * dt)]).apply(up_e)
        increments(np.concatenate((pulses * weight, middle.inv().apply(force_i) * dt)), 1, inc)
        strapdown(x, inc, dt, u, mid)
        C_ip = middle * half
        y_e = Rotation.from_rotvec([0.0, 0.0, -earth.EARTH_RATE * (t + dt)]).apply(C_ip.as_matrix()[:, 1])
        y_g = C_eg.T @ y_e
        gimbal = -math.atan2(y_g[0], y_g[1])
        out.append(true_heading(x[X_C : X_C + 9].reshape(3, 3), x[X_Q : X_Q + 4], gimbal).item())
    error = np.mod(np.array(out) + np.pi, 2.0 * np.pi) - np.pi
    return np.arange(1, len(out) + 1) * dt, error


@pytest.mark.parametrize("rate", [0.0, 60.0, -60.0])
def test_the_platform_drifts_as_the_closed_form_and_schuler_say(rate):
    lat, law = math.radians(65.0), uniform(rate * DEG_PER_H)
    t, error = physical_day(lat, law, BIAS)
    drift = heading_drift(t, lat, BIAS, law.rate)
    # Schuler's oscillation of the tilt, bias over Schuler's rate, stands in heading with tan L; position
    # and drift each have a part of it
    level = math.hypot(BIAS[0], BIAS[1])
    schuler = level / math.sqrt(9.82 / 6.38e6)
    assert np.abs(error - drift).max() < 2.0 * schuler / math.cos(lat)
    if rate:
        # turning averages the level biases: what is left is of bias over rate, and the azimuth gyro's drift
        bound = 2.0 * level / (abs(law.rate) - earth.EARTH_RATE) / math.cos(lat)
        azimuth = 2.0 * abs(BIAS[2]) / earth.EARTH_RATE
        assert np.abs(error).max() < bound + azimuth + 2.0 * schuler / math.cos(lat)
        assert np.abs(error).max() < 0.65 * heading_limit(lat, BIAS)
    else:
        assert np.abs(error).max() == pytest.approx(heading_limit(lat, BIAS), rel=0.05)


def test_a_platform_without_errors_stays():
    _, error = physical_day(math.radians(65.0), uniform(60.0 * DEG_PER_H), np.zeros(3))
    # cycles of 30 s leave w_ie cos L k' g dt^2 / 6 of the turn of n within one: 1.4e-6 g, times 2 tan L
    assert np.abs(error).max() < 0.05 * ARCMIN
