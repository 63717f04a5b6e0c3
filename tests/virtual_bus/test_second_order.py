"""Second-order terms and temperature of simulated units: closed forms, and what compensation leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bridge.calibration import read_calibration
from nav.imu.pulses import compensate
from virtual_bus.configuration import calibration_toml
from virtual_bus.ellipsoid import G0
from virtual_bus.faults import Faults
from virtual_bus.grades import ARCSEC, DEG_PER_H, GRADES, UG, draw_imu, ideal_imu
from virtual_bus.sensors import Imu, Warming, forces_squared, generator
from virtual_bus.truth import Trajectory

DTG = GRADES["dtg"]
NONE = Faults([])
STEP_NS = 5_000_000


class Known(Trajectory):
    """A specific force that is told, (n, 3) m/s of its integral at any times (n,) s."""

    def __init__(self, velocity) -> None:
        self.velocity = velocity

    def increments(self, t_ns):
        return np.zeros((len(t_ns) - 1, 3)), np.diff(self.velocity(t_ns * 1e-9), axis=0)


def test_square_of_a_force_on_a_line():
    """f = a + b t: the integral of f f^T by hand."""
    a, b = np.array([1.0, -2.0, 3.0]), np.array([0.5, 4.0, -7.0])
    line = Known(lambda t: np.outer(t, a) + 0.5 * np.outer(t**2, b))
    t = np.array([0.0, 0.3, 0.5, 1.7])
    got = forces_squared(line, (t * 1e9).astype(np.int64))
    # int f f^T = a a^T t + (a b^T + b a^T) t^2 / 2 + b b^T t^3 / 3
    aa, ab, bb = np.outer(a, a), np.outer(a, b) + np.outer(b, a), np.outer(b, b)
    whole = np.array([aa * s + 0.5 * ab * s**2 + bb * s**3 / 3.0 for s in t])
    np.testing.assert_allclose(got, np.diff(whole, axis=0), rtol=1e-12, atol=1e-12)


def test_square_of_a_turning_force():
    """Gravity round the x axis once in 10 s: half of its square to each side, nothing mixed, over a turn."""
    w = 2.0 * np.pi / 10.0
    circle = Known(lambda t: G0 / w * np.stack((0.0 * t, np.sin(w * t), -np.cos(w * t)), axis=1))
    t_ns = np.arange(0, 10_000_000_001, STEP_NS)
    total = forces_squared(circle, t_ns).sum(axis=0)
    np.testing.assert_allclose(total, np.diag([0.0, 5.0, 5.0]) * G0**2, atol=1e-9 * G0**2)


EVEN = Warming(25.0, 25.0)


def resting(errors, warming=EVEN, seconds=20):
    """Pulses per second (6,) of a unit without noise that rests, from 25 degC on."""
    flat = Known(lambda t: np.outer(t, G0 * np.array([0.6, 0.0, 0.8])))
    imu = Imu(flat, DTG, errors, generator(1, "imu"), NONE, noise=False, warming=warming)
    return imu.block(np.arange(0, seconds * 10**9 + 1, STEP_NS))[0].sum(axis=0) / seconds


def test_each_term_acts_on_its_own_sensor():
    ideal = ideal_imu(DTG)
    second = np.zeros((3, 3, 3))
    second[0, 0, 2] = second[0, 2, 0] = 0.5 * 10.0 * DEG_PER_H / G0**2  # 10 deg/h/g^2 of f_x f_z
    square = np.zeros((3, 3, 3))
    square[2, 2, 2] = 1e-3 / G0  # 1000 ug/g^2 of f_z^2
    unit = replace(ideal, gyro=replace(ideal.gyro, second=second), accel=replace(ideal.accel, second=square))
    got = resting(unit) * np.repeat([DTG.gyro_arcsec_per_pulse * ARCSEC, DTG.accel_m_s_per_pulse], 3)
    wanted = [10.0 * DEG_PER_H * 0.48, 0.0, 0.0, 0.6 * G0, 0.0, 0.8 * G0 + 1000.0 * UG * 0.64]
    half = 0.5 * np.repeat([DTG.gyro_arcsec_per_pulse * ARCSEC, DTG.accel_m_s_per_pulse], 3) / 20.0
    assert np.all(np.abs(got - wanted) <= half + 1e-12)


def test_temperature_acts_on_scales_and_biases():
    """A second at the end of a warming up of 10 degC."""
    ideal = ideal_imu(DTG)
    accel = replace(
        ideal.accel,
        scale_temperature=np.array([[1e-4, 1e-6]] * 3),
        bias_temperature=np.array([[50.0 * UG, -1.0 * UG]] * 3),
    )
    got = resting(replace(ideal, accel=accel), Warming(25.0, 35.0, 1e-3))[3:]
    force = np.array([0.6, 0.0, 0.8]) * G0 + (500.0 - 100.0) * UG
    wanted = force / (DTG.accel_m_s_per_pulse * (1.0 + 1e-3 + 1e-4))
    # half a pulse at the end, and a millisecond's warming up at the beginning
    np.testing.assert_allclose(got, wanted, atol=0.5 / 20.0 + 1e-3 * wanted.max() * 1e-3 / 20.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_compensation_takes_off_what_the_bench_puts_on(ride, seed):
    """A tuned unit that warms up as it drives, with a sheet that is right: two implementations, one model."""
    true = draw_imu(DTG, generator(seed, "unit"))
    true = replace(
        true, gyro=replace(true.gyro, asymmetry=np.zeros(3)), accel=replace(true.accel, asymmetry=np.zeros(3))
    )
    sheet = replace(true, calibrated_gyro=true.gyro, calibrated_accel=true.accel)
    c = read_calibration(calibration_toml(sheet, DTG).encode(), "cal.toml").calibration
    warming = Warming(-10.0, 50.0, 40.0)
    imu = Imu(ride, DTG, true, generator(seed, "imu"), NONE, noise=False, warming=warming)
    t_ns = np.arange(0, 60 * 10**9 + 1, STEP_NS)
    counts = imu.block(t_ns)[0].astype(np.float64)
    dtheta, dv = np.empty((len(counts), 3)), np.empty((len(counts), 3))
    table = c.table()
    for k, temperature in enumerate(warming.at(t_ns[:-1] + STEP_NS // 2)):
        table[:18] = c.scales_and_biases(temperature)
        compensate(table, counts[k], STEP_NS * 1e-9, dtheta[k], dv[k])
    turned, pushed = ride.increments(t_ns)
    # what is left are the fractions of pulses at the end, mixed a little by the axes, and the mean of squares
    pulses = np.repeat([DTG.gyro_arcsec_per_pulse * ARCSEC, DTG.accel_m_s_per_pulse], 3)
    error = np.concatenate((dtheta - turned, dv - pushed), axis=1).cumsum(axis=0)
    assert np.all(np.abs(error) < 0.55 * pulses)


def test_other_grades_have_none_of_it():
    for name in ("rlg", "fog", "mems"):
        unit = draw_imu(GRADES[name], generator(1, "unit"))
        for triad in (unit.gyro, unit.accel, unit.calibrated_gyro, unit.calibrated_accel):
            assert not triad.second.any()
            assert not triad.scale_temperature.any()
            assert not triad.bias_temperature.any()


def test_terms_are_as_large_as_the_grade_says():
    """400 units: root mean squares of what calibration has left, within 4 sigma of the sample's own."""
    units = [draw_imu(DTG, generator(seed, "unit")) for seed in range(400)]

    def left(kind, name, pick):
        return np.array(
            [
                pick(getattr(getattr(u, kind), name) - getattr(getattr(u, f"calibrated_{kind}"), name))
                for u in units
            ]
        )

    per_g2 = G0**2
    cases = (
        (2.0 * left("gyro", "second", lambda m: m[:, 0, 2]) * per_g2 / DEG_PER_H, 0.01),
        (left("accel", "second", lambda m: np.einsum("iii->i", m)) * per_g2 / UG, 1.0),
        (2.0 * left("accel", "second", lambda m: m[[0, 1, 2], [0, 1, 2], [1, 2, 0]]) * per_g2 / UG, 1.0),
        (left("gyro", "scale_temperature", lambda m: m[:, 0]) * 1e6, 2.0),
        (left("gyro", "bias_temperature", lambda m: m[:, 0]) / DEG_PER_H, 0.003),
        (left("accel", "scale_temperature", lambda m: 30.0 * m[:, 1]) * 1e6, 5.0),
        (left("accel", "bias_temperature", lambda m: m[:, 0]) / UG, 2.0),
    )
    for values, sigma in cases:
        assert np.sqrt(np.mean(values**2)) == pytest.approx(sigma, rel=4.0 / np.sqrt(2.0 * values.size))
