"""Accelerometers that sit apart: formulas against vectors and places, the live twin, the fit of arms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav.imu.pulses import Calibration, compensate_readable, expected_pulses
from nav.imu.size_effect import (
    SizeEffect,
    excess,
    excess_readable,
    felt,
    fresh,
    in_origin,
    levers,
    meeting_point,
)
from nav.imu.size_fit import fit_arms

G = 9.80665


def unit(seed=1, arm=0.05):
    rng = np.random.default_rng(seed)
    return Calibration(
        gyro_scale_plus=np.full(3, 1e-6),
        accel_scale_plus=np.full(3, 1e-5),
        accel_bias=1e-3 * rng.standard_normal(3),
        gyro_g=1e-6 * rng.standard_normal((3, 3)),
        accel_axes=np.eye(3) + 0.2 * rng.standard_normal((3, 3)),
        accel_arms=arm * rng.standard_normal((3, 3)),
    )


def test_own_axes_are_5_17():
    w, dw, arms = np.array([1.0, -2.0, 3.0]), np.array([9.0, 8.0, 7.0]), np.diag([0.1, 0.2, 0.3])
    want = [-(4.0 + 9.0) * 0.1, -(1.0 + 9.0) * 0.2, -(1.0 + 4.0) * 0.3]
    np.testing.assert_allclose(felt(np.eye(3), arms, w, dw), want, rtol=1e-15)


def test_what_is_felt_is_the_second_derivative_of_where_it_is():
    """A point of a body turned by exp(phi(t)): its place, differentiated numerically in the room."""
    from scipy.spatial.transform import Rotation

    arm = np.array([[0.3, -0.2, 0.5]])

    def turn(t):
        return Rotation.from_rotvec([0.4 * np.sin(t), 0.3 * t, 0.2 * t * t])

    t, h = 0.7, 1e-3
    places = [turn(t + k * h).apply(arm[0]) for k in (-2, -1, 0, 1, 2)]
    second = (-places[0] + 16 * places[1] - 30 * places[2] + 16 * places[3] - places[4]) / (12 * h * h)

    def rate(at):
        return (turn(at - h).inv() * turn(at + h)).as_rotvec() / (2 * h)

    fine = (4.0 * rate(t) - (turn(t - 2 * h).inv() * turn(t + 2 * h)).as_rotvec() / (4 * h)) / 3.0
    change = (rate(t + h) - rate(t - h)) / (2 * h)
    for axis in np.eye(3):
        got = felt(axis[None], arm, fine, change)[0]
        # the differences above are good to h^2 times a fifth derivative of about one
        assert got == pytest.approx(float(turn(t).inv().apply(second) @ axis), abs=2e-6)


@given(seed=st.integers(0, 10_000))
def test_any_geometry_comes_back_to_its_origin(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    axes = rng.standard_normal((n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    if np.linalg.cond(axes) > 30.0:
        return
    arms = rng.uniform(-0.1, 0.1, (n, 3))
    w, dw, f = rng.uniform(-5, 5, 3), rng.uniform(-50, 50, 3), rng.uniform(-20, 20, 3)
    read = np.sum(axes * (f + np.cross(w, np.cross(w, arms)) + np.cross(dw, arms)), axis=1)
    np.testing.assert_allclose(in_origin(axes, arms, read, w, dw), f, rtol=0, atol=1e-12)


@settings(deadline=None, max_examples=30)  # the first example compiles the kernel
@given(
    seed=st.integers(0, 20),
    steps=st.lists(st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3), min_size=1, max_size=8),
    tau=st.sampled_from([0.0025, 0.01]),
)
def test_the_kernel_is_its_readable_twin(seed, steps, tau):
    c, state, out = unit(seed), fresh(), np.empty(3)
    increments = np.array(steps)
    for k in range(len(steps)):
        excess(levers(c), state, increments[k], tau, out)
        want = excess_readable(c, increments[max(0, k - 3) : k + 1], tau)
        # rates of 20 rad/s by differences of 100 times as much, arms of 0.1 m, inverse axes of some units
        np.testing.assert_allclose(out, want, rtol=1e-12, atol=1e-12)


def test_compensation_inverts_what_pulses_and_arms_make():
    """Counts of a unit with arms: through both steps exactly the increments that went in."""
    c, rng = unit(5), np.random.default_rng(5)
    one, other = SizeEffect(c), fresh()
    more = np.empty(3)
    for _ in range(20):
        dtheta, dv = 0.02 * rng.standard_normal(3), 0.1 * rng.standard_normal(3)
        excess(levers(c), other, dtheta, 0.01, more)
        gyro, accel = expected_pulses(c, dtheta, dv + more, 0.01)
        got_dtheta, got_dv = compensate_readable(c, gyro, accel, 0.01)
        one.take_off(got_dtheta, got_dv, 0.01)
        np.testing.assert_allclose(got_dtheta, dtheta, rtol=0, atol=1e-15)
        # rounding of the angle, 1e-17 rad, over the interval times the arms
        np.testing.assert_allclose(got_dv, dv, rtol=0, atol=1e-14)


def test_arms_do_not_touch_the_compensation_of_pulses():
    """(5-23): one half knows nothing of the other."""
    c = unit(6)
    without = replace(c, accel_arms=np.zeros((3, 3)))
    np.testing.assert_array_equal(c.table(), without.table())
    counts = np.array([500.0, -300.0, 200.0])
    got = compensate_readable(c, counts, counts, 0.01)
    np.testing.assert_array_equal(got, compensate_readable(without, counts, counts, 0.01))


def test_an_angular_acceleration_makes_no_velocity_that_stays():
    """Tossed about and brought to rest again: what the acceleration put on has been taken off."""
    c = Calibration(np.ones(3), np.ones(3), accel_arms=np.roll(0.05 * np.eye(3), 1, axis=1))
    t = 0.01 * np.arange(201)
    angle = 0.3 * np.sin(np.pi * t) ** 4
    effect, total, largest = SizeEffect(c), np.zeros(3), 0.0
    for d in np.concatenate((np.zeros(1), np.diff(angle), np.zeros(3))):
        left = np.zeros(3)
        effect.take_off(np.array([0.0, 0.0, d]), left, 0.01)
        total += left
        largest = max(largest, float(np.abs(total).max()))
    # arms across the axes: no centripetal part, so nothing at all but rounding
    assert largest > 0.02
    np.testing.assert_allclose(total, 0.0, atol=1e-15)


def test_the_axes_of_a_usual_unit_meet_where_they_do():
    centre = np.array([0.01, -0.02, 0.03])
    axes = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.2], [0.1, 0.0, 1.0]])
    along = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    arms = centre + np.array([[0.05], [-0.04], [0.03]]) * along
    np.testing.assert_allclose(meeting_point(axes, arms), centre, atol=1e-15)
    with pytest.raises(ValueError, match="parallel"):
        meeting_point(np.tile([0.0, 0.0, 1.0], (3, 1)), arms)


TAU = 0.01
EARTH = 7.292115e-5


def table(turns, axes, arms, tau=TAU, seconds=6.0):
    """Ideal increments of a unit on a table that swings about each of ``turns`` in turn: dtheta, read.

    A swing starts and ends at rest; readings are integrals by Gauss's rule of gravity, which the Earth turns,
    and of the acceleration of points about the table's centre.
    """
    x, weights = np.polynomial.legendre.leggauss(6)
    steps = round(seconds / tau)
    at = tau * (np.arange(steps)[:, None] + 0.5 * (x + 1.0))
    dthetas, reads = [], []
    g_start = np.array([0.3, -0.2, -9.79])  # a table that is not level
    for number, turn in enumerate(np.asarray(turns, dtype=float)):
        turned = (EARTH * (at + number * seconds))[..., None] * np.array([0.0, 0.8, 0.6])
        g_table = g_start + np.cross(turned, g_start) + 0.5 * np.cross(turned, np.cross(turned, g_start))
        f = 2.0 * np.pi / seconds
        angle = 1.5 * (1.0 - np.cos(f * at)) * np.sin(2.0 * f * at)
        rate = 1.5 * f * (np.sin(f * at) * np.sin(2 * f * at) + 2 * (1 - np.cos(f * at)) * np.cos(2 * f * at))
        change = (
            1.5
            * f
            * f
            * (
                np.cos(f * at) * np.sin(2 * f * at)
                + 4 * np.sin(f * at) * np.cos(2 * f * at)
                - 4 * (1 - np.cos(f * at)) * np.sin(2 * f * at)
            )
        )
        ends = tau * np.arange(steps + 1)
        dthetas.append(np.diff(1.5 * (1.0 - np.cos(f * ends)) * np.sin(2.0 * f * ends))[:, None] * turn)
        w, dw = rate[..., None] * turn, change[..., None] * turn
        # gravity in b: turned back by the angle about an axis that both frames share
        sine, cosine = np.sin(angle)[..., None], np.cos(angle)[..., None]
        cross = np.cross(turn, g_table)
        g_b = cosine * g_table - sine * cross + (1.0 - cosine) * (g_table @ turn)[..., None] * turn
        for axis, arm in zip(axes, arms, strict=True):
            acc = np.cross(w, np.cross(w, arm)) + np.cross(dw, arm) - g_b
            reads.append(0.5 * tau * (acc @ axis) @ weights)
    n = len(axes)
    read = np.array(reads).reshape(len(turns), n, steps).transpose(0, 2, 1).reshape(-1, n)
    return np.concatenate(dthetas), read


AXES = np.array([[1.0, 0.02, -0.01], [0.01, 1.0, 0.03], [-0.02, 0.01, 1.0]])
ARMS = np.array([[0.03, 0.01, -0.02], [0.02, -0.04, 0.01], [-0.01, 0.03, 0.05]])


def test_arms_come_out_of_turns_without_noise():
    dtheta, read = table(np.eye(3), AXES, ARMS)
    bias = np.array([2e-3, -1e-3, 3e-3])
    found = fit_arms(AXES, [(dtheta, read + bias * TAU)], TAU)
    # rates between samples by differences: fourth order in 10 ms of a swing of a few rad/s
    np.testing.assert_allclose(found.arms, ARMS, atol=3e-6)
    away = found.from_meeting_point(AXES)
    np.testing.assert_allclose(away.arms, ARMS - meeting_point(AXES, ARMS), atol=5e-6)


def test_sigmas_of_arms_cover_their_errors():
    """100 seeds of nine arms: 95.45 % within two sigma, and what 900 draws scatter about that."""
    dtheta, read = table(np.eye(3), AXES, ARMS, tau=0.02, seconds=3.0)
    truth = fit_arms(AXES, [(dtheta, read)], 0.02).arms  # the differences' own error, far below the noise
    assert np.abs(truth - ARMS).max() < 1e-4
    rng = np.random.default_rng(11)
    normal = []
    for _ in range(100):
        found = fit_arms(AXES, [(dtheta, read + 2e-3 * rng.standard_normal(read.shape))], 0.02)
        normal.append((found.arms - truth) / found.sigma())
    z = np.abs(np.array(normal))
    assert 0.93 < np.mean(z < 2.0) < 0.975
    assert z.max() < 4.5
    assert found.residual == pytest.approx(2e-3, rel=0.1)


def test_what_noise_of_the_gyros_alone_shows_is_not_shown():
    """It would come out as nothing, with a small sigma: what is regressed on is noise."""
    dtheta, read = table([[0.0, 0.0, 1.0]], np.eye(3), ARMS)
    noisy = dtheta + 5e-6 * np.random.default_rng(12).standard_normal(dtheta.shape)
    with pytest.raises(ValueError, match="accelerometer 1 up, accelerometer 2 up, accelerometer 3 right"):
        fit_arms(np.eye(3), [(noisy, read + 1e-6)], TAU)


def test_arms_that_turns_do_not_show_are_named():
    dtheta, read = table([[0.0, 0.0, 1.0]], np.eye(3), ARMS)
    with pytest.raises(ValueError, match="accelerometer 1 up, accelerometer 2 up, accelerometer 3 right"):
        fit_arms(np.eye(3), [(dtheta, read)], TAU)
    with pytest.raises(ValueError, match="too few"):
        fit_arms(np.eye(3), [(dtheta[:9], read[:9])], TAU)


def test_turns_about_one_axis_each_show_together_what_none_does_alone():
    """Three swings, one about each axis of the unit."""
    bias = np.array([2e-3, -1e-3, 3e-3])
    turns = []
    for k, along in enumerate(np.eye(3)):
        dtheta, read = table([along], AXES, ARMS)
        turns.append((dtheta, read + TAU * bias))
        with pytest.raises(ValueError, match="do not show the arm"):
            fit_arms(AXES, [turns[k]], TAU)
    found = fit_arms(AXES, turns, TAU)
    np.testing.assert_allclose(found.arms, ARMS, atol=3e-6)
