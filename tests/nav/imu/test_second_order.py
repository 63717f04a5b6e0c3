"""Second-order terms and temperature: closed forms, the inverse, and what has none."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav.imu.pulses import (
    CONTRACTION,
    RANGE,
    Calibration,
    Thermal,
    compensate,
    compensate_readable,
    expected_pulses,
    second_order,
)

G = 9.80665
DEG_PER_H = math.radians(1.0) / 3600.0
ONE = np.ones(3)


def unit(seed: int = 1) -> Calibration:
    """Terms as large as those of poor instruments: 200 ug/g^2, 5 deg/h/g^2."""
    rng = np.random.default_rng(seed)
    gyro, accel = 5e-6 * rng.uniform(0.3, 3.0, 3), 1e-5 * rng.uniform(0.3, 3.0, 3)
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
        gyro_square=5.0 * DEG_PER_H / G**2 * rng.uniform(-1.0, 1.0, (3, 3)),
        gyro_product=5.0 * DEG_PER_H / G**2 * rng.uniform(-1.0, 1.0, (3, 3)),
        accel_square=2e-4 / G * rng.uniform(-1.0, 1.0, (3, 3)),
        accel_product=2e-4 / G * rng.uniform(-1.0, 1.0, (3, 3)),
    )


vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)


def compensated(c: Calibration, counts: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray]:
    dtheta, dv = np.empty(3), np.empty(3)
    compensate(c.table(), counts, tau, dtheta, dv)
    return dtheta, dv


# forces up to twice the range: the inverse does not end there
@settings(deadline=None, max_examples=200)  # the first example compiles the kernel
@given(turn=vectors, push=vectors, tau=st.floats(5e-4, 0.1), seed=st.integers(0, 20))
def test_compensation_inverts_the_measurement_model(turn, push, tau, seed):
    c = unit(seed)
    dtheta, dv = 10.0 * turn * tau, 2.0 * RANGE * push * tau
    gyro, accel = expected_pulses(c, dtheta, dv, tau)
    for got_dtheta, got_dv in (
        compensated(c, np.concatenate((gyro, accel)), tau),
        compensate_readable(c, gyro, accel, tau),
    ):
        # rounding of sums of terms, of which f tau and w tau are the largest
        np.testing.assert_allclose(got_dv, dv, rtol=0.0, atol=1e-12 * tau * (1.0 + RANGE * abs(push).max()))
        np.testing.assert_allclose(got_dtheta, dtheta, rtol=0.0, atol=1e-12 * tau * (1.0 + abs(turn).max()))


@settings(deadline=None)
@given(counts=st.lists(st.integers(-32768, 32767), min_size=6, max_size=6), tau=st.floats(5e-4, 0.1))
def test_kernel_is_its_readable_twin(counts, tau):
    n = np.array(counts, dtype=np.float64)
    want_dtheta, want_dv = compensate_readable(unit(3), n[:3], n[3:], tau)
    dtheta, dv = compensated(unit(3), n, tau)
    np.testing.assert_allclose(dtheta, want_dtheta, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(dv, want_dv, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("tau", [0.0, -1.0, 1e-300, 1e300])
def test_every_count_has_increments(tau):
    """The driver may ask for an interval that it then finds to be none."""
    for count in (-32768.0, 0.0, 32767.0):
        dtheta, dv = compensated(unit(), np.full(6, count), tau)
        assert np.all(np.isfinite((dtheta, dv)))


def test_a_plain_calibration_has_no_second_order_part():
    assert Calibration(ONE, ONE).table().shape == (45,)
    assert Calibration(ONE, ONE, gyro_product=1e-9 * np.eye(3)).table().shape == (81,)


@pytest.mark.parametrize("g", [-90.0, -5.0, -1.0, 0.0, 1.0, 5.0, 90.0])
def test_square_of_one_axis_is_a_quadratic_equation(g):
    k2, tau = 50e-6 / G, 0.005
    square = np.zeros((3, 3))
    square[0, 0] = k2
    c = Calibration(1e-6 * ONE, 1e-6 * ONE, accel_square=square)
    read = g * G  # what the sensor puts out: f + k2 f^2
    f = 2.0 * read / (1.0 + math.sqrt(1.0 + 4.0 * k2 * read))
    _, dv = compensated(c, np.array([0.0, 0.0, 0.0, read * tau / 1e-6, 0.0, 0.0]), tau)
    np.testing.assert_allclose(dv, [f * tau, 0.0, 0.0], rtol=1e-14)


def test_each_coefficient_acts_where_the_texts_say():
    """(2-13): B_axz f_x f_z of the x gyro; (2-25): B_y f_x f_y of the x accelerometer; K_2 f_z^2 of z."""
    tau, f = 0.01, G * np.array([1.0, -2.0, 3.0])
    product, cross, square = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    product[0, 1] = 2e-9
    cross[0, 2] = 3e-6
    square[2, 2] = 5e-6
    c = Calibration(ONE, ONE, gyro_product=product, accel_product=cross, accel_square=square)
    gyro, accel = expected_pulses(c, np.zeros(3), f * tau, tau)
    np.testing.assert_allclose(gyro, [2e-9 * G * G * 3.0 * tau, 0.0, 0.0], rtol=1e-14)
    np.testing.assert_allclose(
        accel - f * tau, [3e-6 * G * G * -2.0 * tau, 0.0, 5e-6 * G * G * 9.0 * tau], atol=1e-15
    )


def test_what_the_mean_force_leaves_out():
    """A force on a line through the interval, and a vibration that the increments do not show."""
    square, product = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    x = (np.arange(4000) + 0.5) / 4000.0

    def left_out(f: np.ndarray) -> float:
        every = np.mean([second_order(square, product, one)[0] for one in f])
        return float(every - second_order(square, product, f.mean(axis=0))[0])

    mean, change = np.array([3.0, 5.0, 0.0]), np.array([2.0, -7.0, 0.0])
    assert left_out(mean + np.outer(x - 0.5, change)) == pytest.approx(-14.0 / 12.0, rel=1e-6)
    shaken = np.outer(np.sin(2.0 * np.pi * x), change)
    assert left_out(mean + shaken) == pytest.approx(-14.0 / 2.0, rel=1e-9)


@given(one=vectors, other=vectors, seed=st.integers(0, 20))
def test_the_contraction_is_a_bound(one, other, seed):
    c = unit(seed)
    back = np.linalg.inv(c.accel_axes)
    f = RANGE * np.array([one, other])
    moved = [back @ second_order(c.accel_square, c.accel_product, v) for v in f]
    distance = np.linalg.norm(f[1] - f[0])
    assert np.linalg.norm(moved[1] - moved[0]) <= c.contraction() * distance * (1.0 + 1e-9) + 1e-12
    assert c.contraction() < CONTRACTION


THERMAL = Thermal(
    25.0,
    -40.0,
    60.0,
    gyro_scale=np.array([[1e-5, 2e-7], [0.0, 0.0], [-1e-5, 0.0]]),
    accel_bias=np.array([[1e-4, 2e-6, -3e-8], [0.0, 0.0, 0.0], [0.0, 0.0, 1e-7]]),
)


@pytest.mark.parametrize(
    ("temperature", "d"),
    [(25.0, 0.0), (35.0, 10.0), (-40.0, -65.0), (60.0, 35.0), (-90.0, -65.0), (99.0, 35.0)],
)
def test_polynomials_in_temperature(temperature, d):
    """By hand; beyond the range what holds at its end."""
    c = Calibration(2e-6 * ONE, 1e-5 * ONE, 3e-6 * ONE, accel_bias=0.1 * ONE, thermal=THERMAL)
    at = c.at(temperature)
    gain = 1.0 + np.array([1e-5 * d + 2e-7 * d * d, 0.0, -1e-5 * d])
    np.testing.assert_allclose(at.gyro_scale_plus, 2e-6 * gain, rtol=1e-14)
    np.testing.assert_allclose(at.gyro_scale_minus, 3e-6 * gain, rtol=1e-14)
    np.testing.assert_array_equal(at.accel_scale_plus, 1e-5)
    np.testing.assert_array_equal(at.gyro_bias, 0.0)
    rise = [1e-4 * d + 2e-6 * d**2 - 3e-8 * d**3, 0.0, 1e-7 * d**3]
    np.testing.assert_allclose(at.accel_bias, 0.1 + np.array(rise), rtol=1e-13)
    assert at.thermal is None
    np.testing.assert_array_equal(at.table()[:18], c.scales_and_biases(temperature))
    np.testing.assert_array_equal(at.table()[18:], c.table()[18:])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: Calibration(ONE, ONE, accel_square=1e-3 * np.eye(3)),
            "accel_square, accel_product: too large",
        ),
        (
            lambda: Calibration(ONE, ONE, accel_product=np.ones((3, 3))),
            "accel_square, accel_product: too large",
        ),
        (lambda: Calibration(ONE, ONE, gyro_square=np.ones(3)), r"gyro_square: expected shape \(3, 3\)"),
        (lambda: Calibration(ONE, ONE, gyro_product=np.full((3, 3), np.inf)), "gyro_product: a value is not"),
        (lambda: Thermal(70.0, -40.0, 60.0), "reference temperature: expected one in the range -40 to 60"),
        (lambda: Thermal(25.0, -40.0, math.nan), "reference temperature"),
        (
            lambda: Thermal(25.0, -40.0, 60.0, gyro_bias=np.ones((2, 2))),
            r"gyro_bias: expected shape \(3, 2\)",
        ),
        (lambda: Thermal(25.0, -40.0, 60.0, accel_bias=np.array(1.0)), "accel_bias: expected shape"),
        (
            lambda: Thermal(0.0, -10.0, 10.0, gyro_scale=np.full((3, 1), 0.1)),
            "gyro_scale: it may become zero",
        ),
    ],
)
def test_coefficients_that_cannot_be_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
