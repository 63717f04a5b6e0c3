"""The loops on paper against print, and against the loops that run."""

import math

import numpy as np
import pytest

from nav.align import compass_theory as theory
from nav.align.compass_loop import L_SIZE, head, lead, set_gains
from nav.earth import EARTH_RATE, earth_rate_g, gravity_g
from nav.rotation import rotvec_from_quat

LAT, HEIGHT = math.radians(34.18), 400.0
AT = theory.place(LAT, HEIGHT)
PERIOD, LEVEL_PERIOD = 150.0, 20.0


def gains(sign=1.0, period=PERIOD):
    g = AT.gravity
    return (
        theory.level_gains(sign * theory.decay(LEVEL_PERIOD), g),
        theory.azimuth_gains(sign * theory.decay(period), g),
    )


def settled(eps, nabla, sign=1.0, seconds=1500.0, dt=0.02, nabla_slope=None, velocity=(0.0, 0.0, 0.0)):
    """phi (3,) of the running loops around axes east, north, up, at rest, with these sensor errors."""
    law = np.zeros(L_SIZE)
    set_gains(law, AT, *gains(sign))
    x = head(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), LAT, 1.9, HEIGHT)
    n = 100
    count = round(seconds / dt)
    rows = np.empty((count, 6))
    rows[:, 0:3] = (earth_rate_g(LAT) + eps) * dt
    rows[:, 3:6] = (-gravity_g(LAT, HEIGHT) + nabla) * dt
    if nabla_slope is not None:
        rows[:, 3:6] += np.outer((np.arange(count) + 0.5) * dt * dt, nabla_slope)
    told = np.tile(np.asarray(velocity), (n, 1))
    for k in range(0, count, n):
        lead(x, law, rows[k : k + n], np.full(n, dt), told, sign > 0.0)
    return -rotvec_from_quat(x[0:4])


def test_poles_are_where_the_gains_put_them():
    for period, damping in [(150.0, theory.DAMPING), (600.0, 0.5)]:
        sigma = theory.decay(period, damping)
        # eq. (2-11): the damped period is that of the oscillating pair
        assert 2.0 * math.pi / sigma * damping / math.sqrt(1.0 - damping**2) == pytest.approx(period)
        level = theory.level_gains(sigma, AT.gravity, damping)
        roots = theory.poles(AT, level, None)
        wanted = np.append(np.roots([1.0, 2.0 * sigma, sigma**2 / damping**2]), -sigma)
        # each of them once for either channel
        apart = np.abs(roots[:, None] - wanted)
        np.testing.assert_array_equal(np.count_nonzero(apart < 1e-6 * sigma, axis=0), [2, 2, 2])
    level, azimuth = gains()
    sigma = theory.decay(PERIOD)
    # the azimuth loop's two equal pairs: their characteristic polynomial, which is not sensitive
    F, _ = theory.dynamics(AT, level, azimuth, coupled=False)
    loop = [theory.V_N, 2, 4, theory.W_U]
    pair = np.array([1.0, 2.0 * sigma, 2.0 * sigma**2])
    np.testing.assert_allclose(np.poly(F[np.ix_(loop, loop)]), np.convolve(pair, pair), rtol=1e-9)


def test_printed_form_of_the_gains():
    g, radius = 9.80665, 6378137.0
    schuler2, sigma, xi = g / radius, 0.05, 0.6
    level = theory.level_gains(sigma, g, xi)
    assert level.k1 == pytest.approx(3.0 * sigma)
    assert level.k2 * radius - 1.0 == pytest.approx(sigma**2 / schuler2 * (2.0 + 1.0 / xi**2) - 1.0)
    assert level.k3 == pytest.approx(sigma**3 / (g * xi**2))
    azimuth = theory.azimuth_gains(sigma, g)
    assert azimuth.k2 * radius - 1.0 == pytest.approx(4.0 * sigma**2 / schuler2 - 1.0)
    assert azimuth.k3 == pytest.approx(4.0 * sigma**4 / g)
    assert azimuth.k1 == azimuth.k4 == pytest.approx(2.0 * sigma)


def test_constant_errors_leave_equation_2_12():
    eps, nabla = np.array([2e-8, -3e-8, 5e-8]), np.array([3e-4, -2e-4, 1e-4])
    F, G = theory.dynamics(AT, *gains(), coupled=False)
    e = np.concatenate([eps, nabla, np.zeros(2)])
    phi = theory.steady(F, G, e)[theory.PHI]
    wanted = theory.constant_errors(AT, theory.decay(PERIOD), eps, nabla)
    # phi_E of the loop as drawn keeps a velocity that holds against eps_U, which (2-12) leaves out
    held = theory.ramp_errors(AT, PERIOD, LEVEL_PERIOD, np.zeros(3), np.zeros(3), eps[2])[0]
    np.testing.assert_allclose(phi, wanted + np.array([held, 0.0, 0.0]), rtol=1e-6)
    # the same as printed: 2 T_d cos L / T_ie times eps_U / w_N
    day = 2.0 * math.pi / EARTH_RATE
    share = 2.0 * PERIOD * math.cos(LAT) / day / AT.north
    assert wanted[2] + eps[0] / AT.north == pytest.approx(-share * eps[2], rel=1e-6)


def test_growing_errors_leave_equations_2_14_to_2_17():
    F, G = theory.dynamics(AT, *gains(), coupled=False)
    for place, size in [(0, 1e-10), (1, 1e-10), (4, 1e-6)]:
        slope = np.zeros(8)
        slope[place] = size
        ends, _ = theory.following(F, G, slope)
        wanted = theory.ramp_errors(AT, PERIOD, LEVEL_PERIOD, slope[0:3], slope[3:6], 0.0)
        k = {0: 0, 1: 1, 4: 2}[place]
        assert ends[theory.PHI][k] == pytest.approx(wanted[k], rel=1e-6)
    # 1e-4 g in five minutes is 0.2619 deg sec L, in the direction of the accelerometer's error
    g = AT.gravity
    slope = np.array([0.0, 1e-4 * g / 300.0, 0.0])
    phi = theory.ramp_errors(AT, PERIOD, LEVEL_PERIOD, np.zeros(3), slope, 0.0)[2]
    assert math.degrees(phi) * math.cos(LAT) == pytest.approx(0.2619, abs=5e-5)


def test_a_knot_of_the_reference_is_0_0634_degrees():
    knot = 1852.0 / 3600.0
    sphere = AT._replace(along_north=1.0 / 6378137.0)
    phi = math.degrees(theory.speed_error(sphere, knot)) * math.cos(LAT)
    assert phi == pytest.approx(-0.06337, abs=1e-5)
    # and the running loop, told so while it stands: apart from Coriolis' force, 2 w_U tan L R w_N / g of it
    told = settled(np.zeros(3), np.zeros(3), velocity=(0.0, knot, 0.0))
    none = settled(np.zeros(3), np.zeros(3))
    assert told[2] - none[2] == pytest.approx(theory.speed_error(AT, knot), rel=5e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_running_loops_settle_where_they_should(sign):
    """Forwards, and backwards in time with the gains of a negative sigma."""
    eps, nabla = np.array([2e-10, -3e-10, 5e-10]), np.array([3e-6, -2e-6, 0.0])
    F, G = theory.dynamics(AT, *gains(sign))
    wanted = theory.steady(F, G, np.concatenate([eps, nabla, np.zeros(2)]))[theory.PHI]
    # the even part, what the finite updates and second order leave, is taken off
    phi = 0.5 * (settled(eps, nabla, sign) - settled(-eps, -nabla, sign))
    # rounding of 7.5e4 updates of the attitude, 1e-16 each in the memory of the loop: below 1e-13 rad
    np.testing.assert_allclose(phi, wanted, rtol=1e-6, atol=1e-12)


def test_the_running_loop_follows_a_growing_accelerometer_error():
    slope = np.array([0.0, 1e-9, 0.0])
    phi = settled(np.zeros(3), np.zeros(3), nabla_slope=slope) - settled(np.zeros(3), np.zeros(3))
    F, G = theory.dynamics(AT, *gains())
    e = np.zeros(8)
    e[3:6] = slope
    ends, rate = theory.following(F, G, e)
    wanted = (ends + 1500.0 * rate)[theory.PHI]
    # with the sign of the error, where (2-17) prints a minus; what couples the channels is below a hundredth
    assert wanted[2] == pytest.approx(slope[1] / (AT.gravity * AT.north), rel=1e-2)
    # half an update of 0.04 s in the 1500 s of growth
    np.testing.assert_allclose(phi, wanted, rtol=5e-5, atol=1e-12)
