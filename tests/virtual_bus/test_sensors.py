"""Sensors: statistics against the densities they are specified by, and pulses against the truth."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.virtual_bus.conftest import trajectory_of
from virtual_bus import ellipsoid
from virtual_bus.faults import Faults, GnssJump, GnssOutage, GnssOutlier, SensorStuck, WheelSlip
from virtual_bus.grades import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, GRADES, UG, draw_imu, ideal_imu
from virtual_bus.manoeuvres import Accelerate, STurns
from virtual_bus.sensors import (
    COUNT_MAX,
    Barometer,
    GaussMarkov,
    Gnss,
    GnssErrors,
    Imu,
    Odometer,
    Quantiser,
    SpeedLog,
    generator,
    isa_pressure,
    isa_temperature,
)

NONE = Faults([])


def blocks(end_ns, period_ns, count):
    t = np.arange(0, end_ns + 1, period_ns)
    for first in range(0, len(t) - 1, count):
        yield t[first : first + count + 1]


@given(
    amounts=arrays(np.float64, (60, 2), elements=st.floats(-50.0, 50.0)),
    cuts=st.lists(st.integers(1, 59), max_size=5),
)
def test_no_fraction_of_a_pulse_is_lost(amounts, cuts):
    whole, parts = Quantiser(2), Quantiser(2)
    pulses = whole.pulses(amounts)
    assert np.abs(pulses.cumsum(axis=0) - amounts.cumsum(axis=0)).max() <= 0.5 + 1e-9
    edges = sorted({0, 60, *cuts})
    split = np.concatenate([parts.pulses(amounts[a:b]) for a, b in pairwise(edges)])
    # rounding of the carried residual may move a pulse that is exactly due by one sample
    assert np.abs(split.cumsum(axis=0) - pulses.cumsum(axis=0)).max() <= 1


def test_pulses_of_an_ideal_unit_add_up_to_the_true_motion(ride):
    for grade in GRADES.values():
        imu = Imu(ride, grade, ideal_imu(grade), generator(1, "imu"), NONE, noise=False)
        end_ns = ride.profile.end_ns // 1_000_000_000 * 1_000_000_000
        counts = np.concatenate([imu.block(t)[0] for t in blocks(end_ns, 5_000_000, 200)])
        dtheta, dv = ride.increments(np.array([0, end_ns]))
        pulse = np.repeat([grade.gyro_arcsec_per_pulse * ARCSEC, grade.accel_m_s_per_pulse], 3)
        assert np.abs(counts.sum(axis=0) - np.concatenate((dtheta[0], dv[0])) / pulse).max() <= 1.0


def test_a_real_unit_obeys_the_measurement_model(ride):
    """Textbook eqs. (2-27), (2-28), written out per sensor, with pulses of two sizes."""
    grade = dataclasses.replace(GRADES["mems"], gyro_asymmetry_ppm=5000.0, accel_asymmetry_ppm=5000.0)
    errors = draw_imu(grade, generator(3, "unit"))
    imu = Imu(ride, grade, errors, generator(3, "imu"), NONE, noise=False)
    t = np.arange(0, 60_000_000_001, 5_000_000)
    counts = imu.block(t)[0]
    dtheta, dv = ride.increments(t)
    expected = np.zeros((len(t) - 1, 6))
    for i in range(3):
        gyro = 0.005 * errors.gyro.bias[i] + dtheta @ errors.gyro.axes[i] + dv @ errors.gyro.g_sensitivity[i]
        accel = 0.005 * errors.accel.bias[i] + dv @ errors.accel.axes[i]
        for column, out, triad in ((i, gyro, errors.gyro), (3 + i, accel, errors.accel)):
            excess = 0.5 * triad.asymmetry[i]
            per_pulse = triad.scale[i] / np.where(out > 0, 1.0 + excess, 1.0 - excess)
            expected[:, column] = out / per_pulse
    assert np.abs(counts.cumsum(axis=0) - expected.cumsum(axis=0)).max() <= 0.5 + 1e-6


def test_a_count_beyond_sixteen_bits_is_cut_and_flagged(ride):
    grade = dataclasses.replace(GRADES["fog"], gyro_arcsec_per_pulse=0.01, accel_m_s_per_pulse=1e-6)
    imu = Imu(ride, grade, ideal_imu(grade), generator(1, "imu"), NONE, noise=False)
    t = np.arange(0, 60_000_000_001, 5_000_000)
    counts, saturated = imu.block(t)
    assert saturated[:, 5].all()  # gravity alone is 49000 pulses a sample
    assert (counts[:, 5] == COUNT_MAX).all()
    assert (saturated == (np.abs(counts) == COUNT_MAX)).all()


def static_noise(rest, name, seconds=2000, per_second=50):
    """Angle and velocity noise (seconds, 6) of a resting unit with random walk alone, per second."""
    grade = dataclasses.replace(
        GRADES[name],
        gyro_instability_deg_per_h=0.0,
        accel_instability_ug=0.0,
        gyro_arcsec_per_pulse=1e-3,
        accel_m_s_per_pulse=7e-6,  # 0.2 m/s of gravity a sample must fit 16 bits
    )
    errors = ideal_imu(grade)
    imu = Imu(rest, grade, errors, generator(7, name), NONE)
    t = np.arange(0, seconds * 1_000_000_000 + 1, 1_000_000_000 // per_second)
    counts, saturated = imu.block(t)
    assert not saturated.any()
    truth = np.concatenate(rest.increments(t), axis=1)
    noise = counts * np.concatenate((errors.gyro.scale, errors.accel.scale)) - truth
    return noise.reshape(seconds, per_second, 6).sum(axis=1), grade


@pytest.mark.parametrize("name", sorted(GRADES))
def test_random_walk_has_its_density(rest, name):
    noise, grade = static_noise(rest, name)
    density = np.repeat(
        [
            grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H,
            grade.accel_random_walk_ug_per_sqrt_hz * UG,
        ],
        3,
    )
    ratio = noise.var(axis=0) / density**2
    # relative spread of a variance of n samples is sqrt(2 / n); five of them over 18 channels.
    # Pulses add a sixth of their square, 0.2 % of the least of these variances
    assert np.abs(ratio - 1.0).max() < 5.0 * math.sqrt(2.0 / len(noise))
    assert np.abs(noise.mean(axis=0) / density).max() < 5.0 / math.sqrt(len(noise))


def test_allan_variance_of_random_walk_falls_with_the_averaging_time(rest):
    noise, grade = static_noise(rest, "fog", seconds=4000)
    n2 = (grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H) ** 2
    for tau in (1, 4, 16):
        mean = noise[:, :3].reshape(-1, tau, 3).mean(axis=1)
        allan = 0.5 * (np.diff(mean, axis=0) ** 2).mean(axis=0)
        # IEEE Std 952, annex C: N^2 / tau. Successive differences share a sample, so the
        # relative spread over m differences is sqrt(3 / m)
        assert np.abs(allan * tau / n2 - 1.0).max() < 5.0 * math.sqrt(3.0 / len(mean))


def test_gauss_markov_is_stationary_and_forgets_in_its_time():
    rng = generator(5, "gm")
    process = GaussMarkov(2.0, 10.0, 4000, rng)
    start = process.value.copy()
    for _ in range(10):
        process.step(1.0)
    spread = 5.0 / math.sqrt(4000)
    assert process.value.std() == pytest.approx(2.0, rel=spread)
    assert np.corrcoef(start, process.value)[0, 1] == pytest.approx(math.exp(-1.0), abs=spread)


def test_units_of_a_grade_have_its_spread():
    grade = GRADES["fog"]
    units = [draw_imu(grade, generator(seed, "imu/unit")) for seed in range(400)]
    n = 3 * len(units)
    for true, sheet, sigma in (
        ("gyro", "calibrated_gyro", grade.gyro_bias_deg_per_h * DEG_PER_H),
        ("accel", "calibrated_accel", grade.accel_bias_ug * UG),
    ):
        left = np.array([getattr(u, true).bias - getattr(u, sheet).bias for u in units]).ravel()
        assert left.std() == pytest.approx(sigma, rel=5.0 / math.sqrt(2 * n))
        assert abs(left.mean()) < 5.0 * sigma / math.sqrt(n)
        factory = np.array([getattr(u, sheet).bias for u in units]).std()
        assert factory == pytest.approx(grade.factory * sigma, rel=5.0 / math.sqrt(2 * n))


def test_a_random_stream_depends_on_its_name_alone():
    assert generator(1, "imu").random() == generator(1, "imu").random()
    values = {generator(seed, name).random() for seed in (1, 2) for name in ("imu", "gnss", "imu/bus")}
    assert len(values) == 6


def test_odometer_ticks_are_the_distance(ride):
    odometer = Odometer(ride, m_per_tick=0.05, scale_error=0.01, faults=NONE)
    ticks, direction, still = [], [], []
    for t in blocks(ride.profile.end_ns, 20_000_000, 50):
        for out, part in zip((ticks, direction, still), odometer.block(t), strict=True):
            out.extend(part)
    t = np.arange(0, ride.profile.end_ns + 1, 20_000_000)[1:]
    expected = ride.profile.distance(t) * 1.01 / 0.05
    assert np.abs(np.array(ticks) + 0.5 - expected).max() <= 0.5 + 1e-6
    speed = ride.profile.speed(t)
    assert (np.array(direction)[speed < -0.01] == 2).all()
    assert (np.array(direction)[speed > 0.01] == 1).all()
    assert np.array(still)[t < 5_000_000_000].all()
    assert not np.array(still)[np.abs(speed) > 0.1].any()


def test_a_wheel_stands_anywhere_between_two_ticks_at_first(ride):
    t = np.array([0, 5_900_000_000], np.int64)
    rolled = float(ride.profile.distance(t)[-1]) / 0.02
    ticks = np.array(
        [Odometer(ride, 0.02, 0.0, NONE, 0.0, generator(k, "wheel")).block(t)[0][0] for k in range(400)]
    )
    # one more than whole ticks in as many cases as there is of a tick left
    part = rolled % 1.0
    assert set(ticks) == {math.floor(rolled), math.ceil(rolled)}
    assert ticks.mean() == pytest.approx(rolled, abs=5.0 * math.sqrt(part * (1.0 - part) / 400.0))


def test_a_slipping_wheel_turns_too_far(ride):
    slip = WheelSlip(start_s=15.0, duration_s=2.0, factor=1.5)
    t = np.arange(0, 40_000_000_001, 20_000_000)
    with_slip = Odometer(ride, 0.01, 0.0, Faults([slip])).block(t)[0][-1]
    without = Odometer(ride, 0.01, 0.0, NONE).block(t)[0][-1]
    way = np.diff(ride.profile.distance(np.array([15_000_000_000, 17_000_000_000])))[0]
    # the interval's ends fall on samples: one period of 15 m/s at most
    assert (with_slip - without) * 0.01 == pytest.approx(0.5 * way, abs=0.5 * 15.0 * 0.02 + 0.02)


def test_speed_log(ride):
    log = SpeedLog(ride, sigma=0.1, scale_error=0.02, rng=generator(1, "speed"))
    t = np.arange(0, ride.profile.end_ns, 10_000_000)
    error = log.block(t) - 1.02 * ride.profile.speed(t)
    assert error.std() == pytest.approx(0.1, rel=5.0 / math.sqrt(2 * len(t)))


def test_pressure_of_the_standard_atmosphere():
    """ICAO Doc 7488/3: 0, 1000, 5000 m, the tropopause, and the top of the layer above it."""
    heights = np.array([0.0, 1000.0, 5000.0, 11_000.0, 20_000.0])
    assert isa_pressure(heights) == pytest.approx([101325.0, 89874.6, 54019.9, 22632.1, 5474.89], abs=0.1)
    assert isa_temperature(heights) == pytest.approx([288.15, 281.65, 255.65, 216.65, 216.65])


def test_barometer_is_off_by_a_datum_that_drifts_slowly(rest):
    offsets = []
    for seed in range(300):
        baro = Barometer(rest, 5.0, 1.0, 1000.0, 0.0, generator(seed, "baro"))
        pressure, temperature = baro.block(np.array([0, 40_000_000]))
        offsets.append((isa_pressure(np.array([500.0])) - pressure)[0] / 11.33)  # Pa per metre at 500 m
        assert temperature == pytest.approx([11.75], abs=0.01)
    assert np.std(offsets) == pytest.approx(math.hypot(5.0, 1.0), rel=5.0 / math.sqrt(600))


def gnss(ride, errors, faults=NONE, seed=1):
    return Gnss(ride, np.array([0.1, 0.7, 1.6]), errors, generator(seed, "gnss"), faults)


def offsets(ride, fixes, t):
    """Errors (n, 3) east, north, up of the fixes against the antenna's true place."""
    m = ride.motion(t, np.array([0.1, 0.7, 1.6]))
    return np.stack(
        (
            (fixes.lon - m.lon) * np.cos(m.lat) * 6.389e6,
            (fixes.lat - m.lat) * 6.372e6,
            fixes.height - m.height,
        ),
        axis=1,
    )


def test_gnss_errors_have_their_sigmas(rest):
    errors = GnssErrors(white=(0.5, 0.8), correlated=(0.0, 0.0), correlation_s=100.0, velocity=(0.03, 0.05))
    t = np.arange(200_000_000, 1_000_000_000_001, 200_000_000)
    fixes = gnss(rest, errors).block(t)
    band = 5.0 / math.sqrt(2 * len(t))
    # 3e-3: radii at 48 degrees and 500 m taken as round numbers above
    assert offsets(rest, fixes, t).std(axis=0) == pytest.approx([0.5, 0.5, 0.8], rel=band + 3e-3)
    assert fixes.v_g.std(axis=0) == pytest.approx([0.03, 0.03, 0.05], rel=band)
    assert errors.sigma_position() == pytest.approx([0.5, 0.5, 0.8])
    assert fixes.fix.all()


def test_correlated_gnss_errors_are_correlated(rest):
    errors = GnssErrors(white=(0.0, 0.0), correlated=(1.0, 1.5), correlation_s=20.0, velocity=(0.01, 0.01))
    assert errors.sigma_position() == pytest.approx([1.0, 1.0, 1.5])
    t = np.arange(1, 5001) * 1_000_000_000
    east = offsets(rest, gnss(rest, errors).block(t), t)[:, 0]
    lag = (east[20:] * east[:-20]).mean() / east.var()
    # 5000 s hold about 5000 / 20 / 2 independent values
    assert lag == pytest.approx(math.exp(-1.0), abs=5.0 / math.sqrt(125))
    assert east.std() == pytest.approx(1.0, rel=5.0 / math.sqrt(250))


@pytest.mark.parametrize(
    ("lat", "lon"),
    [(math.pi / 2 - 1e-5, 0.0), (-math.pi / 2, 1.0), (1.0, math.pi - 1e-6), (1.0, -math.pi + 1e-6)],
)
def test_a_receiver_at_a_pole_and_on_the_date_line(lat, lon):
    """Over it and on: positions and velocities are valid, and their errors have their sigmas in space."""
    ride = trajectory_of(
        [Accelerate(duration_s=5.0, speed_m_s=30.0), STurns(duration_s=95.0, angle_deg=60.0, count=9)],
        lat=lat,
        lon=lon,
        heading=0.02,
    )
    errors = GnssErrors(white=(0.5, 0.8), correlated=(0.3, 0.2), correlation_s=5.0, velocity=(0.03, 0.05))
    t = np.arange(1, 1001) * 100_000_000
    fixes = gnss(ride, errors).block(t)
    assert np.abs(fixes.lat).max() <= math.pi / 2
    assert np.abs(fixes.lon).max() <= math.pi
    at = ride.motion(t, np.array([0.1, 0.7, 1.6]))
    C_eg = ellipsoid.axes_eg(fixes.lat, fixes.lon)
    apart = ellipsoid.to_ecef(fixes.lat, fixes.lon, fixes.height) - at.r_e
    # correlated errors of 5 s: 100 s hold some twenty of them
    assert np.sqrt((apart**2).sum(axis=1).mean()) == pytest.approx(math.sqrt(2 * 0.34 + 0.68), rel=0.1)
    v_e = np.einsum("nij,nj->ni", C_eg, fixes.v_g)
    off = np.einsum("nij,ni->nj", C_eg, v_e - at.v_e)
    assert off.std(axis=0) == pytest.approx([0.03, 0.03, 0.05], rel=5.0 / math.sqrt(2000))


def test_gnss_faults(rest):
    errors = GnssErrors(white=(0.01, 0.01), correlated=(0.0, 0.0), correlation_s=1.0, velocity=(0.01, 0.01))
    faults = Faults(
        [
            GnssOutage(start_s=10.0, duration_s=5.0),
            GnssOutage(start_s=20.0, duration_s=5.0, silent=True),
            GnssOutlier(start_s=30.0, duration_s=5.0, size_m=50.0),
            GnssJump(start_s=40.0, duration_s=5.0, north_m=7.0, up_m=-3.0),
        ]
    )
    t = np.arange(0, 60) * 1_000_000_000
    fixes = gnss(rest, errors, faults).block(t)
    assert np.flatnonzero(~fixes.fix).tolist() == [*range(10, 15), *range(20, 25)]
    assert np.flatnonzero(fixes.silent).tolist() == list(range(20, 25))
    error = offsets(rest, fixes, t)
    assert np.hypot(*error[30:35, :2].T) == pytest.approx(50.0, abs=0.3)
    assert error[40:45] == pytest.approx(np.tile([0.0, 7.0, -3.0], (5, 1)), abs=0.1)
    clean = np.r_[0:30, 35:40, 45:60]
    assert np.abs(error[clean]).max() < 0.06


def test_a_stuck_accelerometer_repeats_itself(ride):
    grade = GRADES["mems"]
    fault = SensorStuck(start_s=7.0, duration_s=2.0, sensor="accel", number=2)
    imu = Imu(ride, grade, ideal_imu(grade), generator(1, "imu"), Faults([fault]))
    counts = np.concatenate([imu.block(t)[0] for t in blocks(12_000_000_000, 5_000_000, 200)])
    t = np.arange(1, len(counts) + 1) * 5_000_000
    during = (t >= 7_000_000_000) & (t < 9_000_000_000)
    assert len(set(counts[during, 1 + 3])) == 1
    assert counts[during, 4][0] == counts[np.flatnonzero(during)[0] - 1, 4]
    assert len(set(counts[~during, 4])) > 20
    assert len(set(counts[during, 3])) > 5
