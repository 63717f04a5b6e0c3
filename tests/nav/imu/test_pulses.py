"""Pulse compensation: the measurement model and its inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav.imu.pulses import Calibration, compensate, compensate_readable, expected_pulses

ARCSEC = np.pi / 648000.0
DEG_PER_H = np.pi / 648000.0
G = 9.80665


def calibration(seed: int = 1) -> Calibration:
    rng = np.random.default_rng(seed)
    gyro = ARCSEC * rng.uniform(0.3, 3.0, 3)
    accel = 1e-4 * rng.uniform(0.3, 3.0, 3)
    return Calibration(
        gyro_scale_plus=gyro,
        gyro_scale_minus=gyro * (1.0 + 2e-4 * rng.standard_normal(3)),
        accel_scale_plus=accel,
        accel_scale_minus=accel * (1.0 + 6e-4 * rng.standard_normal(3)),
        gyro_bias=5.0 * DEG_PER_H * rng.standard_normal(3),
        accel_bias=3e-3 * G * rng.standard_normal(3),
        gyro_g=2.0 * DEG_PER_H / G * rng.standard_normal((3, 3)),
        gyro_axes=np.eye(3) + 3e-3 * rng.standard_normal((3, 3)),
        accel_axes=np.eye(3) + 3e-3 * rng.standard_normal((3, 3)),
    )


increments = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3).map(np.array)


@given(dtheta=increments, dv=increments, tau=st.floats(5e-4, 0.1), seed=st.integers(0, 20))
def test_compensation_inverts_the_measurement_model(dtheta, dv, tau, seed):
    c = calibration(seed)
    gyro, accel = expected_pulses(c, dtheta, dv, tau)
    got_dtheta, got_dv = compensate_readable(c, gyro, accel, tau)
    # only rounding is left: 1e-14 relative on terms up to 0.05
    np.testing.assert_allclose(got_dtheta, dtheta, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(got_dv, dv, rtol=0.0, atol=1e-15)


@settings(deadline=None)  # the first example compiles the kernel
@given(counts=st.lists(st.integers(-32768, 32767), min_size=6, max_size=6), tau=st.floats(5e-4, 0.1))
def test_kernel_is_its_readable_twin(counts, tau):
    c = calibration(3)
    n = np.array(counts, dtype=np.float64)
    dtheta, dv = np.empty(3), np.empty(3)
    compensate(c.table(), n, tau, dtheta, dv)
    want_dtheta, want_dv = compensate_readable(c, n[:3], n[3:], tau)
    np.testing.assert_allclose(dtheta, want_dtheta, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(dv, want_dv, rtol=1e-12, atol=1e-15)


def test_each_coefficient_acts_where_the_text_says():
    """(2-190), (2-191) by hand: one coefficient at a time on a known motion."""
    one = np.ones(3)
    tau = 0.01
    dv_true = np.array([0.02, -0.01, 0.098])
    dtheta_true = np.array([1e-3, -2e-3, 3e-3])
    skew = np.eye(3)
    skew[0, 1] = 1e-3  # K_yx: the x sensor sees 1 mrad of y
    c = Calibration(one, one, accel_axes=skew)
    _, accel = expected_pulses(c, dtheta_true, dv_true, tau)
    np.testing.assert_allclose(accel - dv_true, [1e-3 * dv_true[1], 0.0, 0.0], atol=1e-17)

    drift = np.zeros((3, 3))
    drift[2, 1] = 1e-4  # B_2z: the z gyro drifts with f_y
    c = Calibration(one, one, gyro_g=drift)
    gyro, _ = expected_pulses(c, dtheta_true, dv_true, tau)
    np.testing.assert_allclose(gyro - dtheta_true, [0.0, 0.0, 1e-4 * dv_true[1]], atol=1e-17)

    # the drift is proportional to the interval for the same f: the factor missing in the printed (2-191)
    gyro_twice, _ = expected_pulses(c, np.zeros(3), 2.0 * dv_true, 2.0 * tau)
    gyro_once, _ = expected_pulses(c, np.zeros(3), dv_true, tau)
    np.testing.assert_allclose(gyro_twice, 2.0 * gyro_once, rtol=1e-15)


def test_scale_of_each_sign():
    c = Calibration(np.full(3, 2.0), np.full(3, 2.0), np.full(3, 3.0), np.full(3, 5.0))
    dtheta, dv = compensate_readable(c, np.array([1.0, -1.0, 0.0]), np.array([-1.0, 1.0, 0.0]), 1.0)
    np.testing.assert_array_equal(dtheta, [2.0, -3.0, 0.0])
    np.testing.assert_array_equal(dv, [-5.0, 2.0, 0.0])


def test_permuted_and_reversed_sensor_axes():
    """Sensors mounted along other axes of b, one of them backwards, are an arrangement like any other."""
    axes = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    c = Calibration(np.ones(3), np.ones(3), gyro_axes=axes, accel_axes=axes)
    dtheta, _ = compensate_readable(c, np.array([-2.0, 1.0, 3.0]), np.zeros(3), 1.0)
    np.testing.assert_allclose(dtheta, [1.0, 2.0, 3.0], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gyro_bias": np.zeros(2)}, "gyro_bias: expected shape"),
        ({"accel_bias": np.array([0.0, np.nan, 0.0])}, "accel_bias: a value is not finite"),
        ({"gyro_scale_minus": np.array([1.0, 0.0, 1.0])}, "gyro_scale_minus: a scale of zero"),
        ({"accel_axes": np.ones((3, 3))}, "accel_axes: the sensor axes do not span"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        Calibration(np.ones(3), np.ones(3), **change)
