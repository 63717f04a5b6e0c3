"""Alignment in motion: a car with a MEMS IMU in any mounting, truth in closed form."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from nav.align import ALIGNMENTS, AlignConfig, advance, begin, result
from nav.align.level import level_dcm
from nav.align.preintegrate import DT as PIECE_DT
from nav.align.preintegrate import (
    P_ACCEL,
    P_GYRO,
    R_GYRO,
    SIZE,
    V_ACCEL,
    V_GYRO,
    P,
    R,
    V,
    empty,
    extend,
    sample_piece,
)
from nav.earth import earth_rate_g, geodetic_to_xyz, gravity_g, position_quat, radii
from nav.rotation import dcm_from_euler, dcm_from_quat, quat_from_dcm, rotvec_from_quat
from nav.types import FixType, GnssFix, ImuFlag, ImuSample, SpeedSample
from tests.nav import truth as closed_form

LAT, LON, HEIGHT = math.radians(40.1), math.radians(-105.1), 1600.0
DT = 0.02
REST = 12.0

# consumer MEMS after factory calibration
MEMS = AlignConfig(
    gyro_bias=math.radians(0.3),
    accel_bias=0.05,
    angle_random_walk=math.radians(0.3) / 60.0,
    velocity_random_walk=1e-3,
)


@cache
def drive(seconds=60.0):
    """Times (s), heading (rad) and speed (m/s) of a drive from rest."""
    t = np.arange(round(seconds / DT) + 1) * DT
    s = np.maximum(t - REST, 0.0)
    speed = np.where(s > 0.0, 9.0 * (1.0 - np.cos(np.minimum(s / 14.0, 1.0) * math.pi)) / 2.0, 0.0)
    speed += np.where(s > 15.0, 1.5 * np.sin(0.5 * (s - 15.0)), 0.0)
    turn = 0.9 * (1.0 - np.cos(0.25 * np.maximum(s - 3.0, 0.0))) * (s > 3.0)
    return t, turn, speed


def mems_drive(
    seed,
    *,
    velocity=True,
    rest=True,
    seconds=60.0,
    rate_hz=4.0,
    lever=(0.0, 0.0, 0.0),
    age=0.0,
    speed_sigma=None,
    sigma_position=0.01,
):
    """Samples in order of arrival, and the truth at each of the IMU's: (C_gb, v_g, C_vb, biases)."""
    rng = np.random.default_rng(seed)
    t, turn, speed = drive(seconds)
    heading = rng.uniform(0.0, 2.0 * math.pi) + turn
    C_vb = dcm_from_euler(
        *rng.uniform(-math.pi, math.pi, 1), *rng.uniform(-1.3, 1.3, 1), *rng.uniform(-3, 3, 1)
    )
    eps, nabla = MEMS.gyro_bias * rng.standard_normal(3), MEMS.accel_bias * rng.standard_normal(3)
    C_gv = dcm_from_euler(heading, np.zeros_like(heading), np.zeros_like(heading))
    C_gb = C_gv @ C_vb
    v = np.stack([speed * np.sin(heading), speed * np.cos(heading), np.zeros_like(speed)], axis=1)
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * DT * (v[1:] + v[:-1]), axis=0)])
    g, w_ie = gravity_g(LAT, HEIGHT), earth_rate_g(LAT)
    r_m, r_n = radii(math.sin(LAT))
    every = round(1.0 / rate_hz / DT)
    first = 0 if rest else round((REST + 8.0) / DT)
    lever_b = np.array(lever)
    samples, truth = [], {}
    root = math.sqrt(DT)
    for k in range(first + 1, len(t)):
        turn_b = rotvec_from_quat(quat_from_dcm(C_gb[k - 1].T @ C_gb[k]))
        force_g = (v[k] - v[k - 1]) - g * DT + 2.0 * np.cross(w_ie, v[k]) * DT
        dtheta = (
            turn_b + (C_gb[k].T @ w_ie + eps) * DT + MEMS.angle_random_walk * root * rng.standard_normal(3)
        )
        # the increment belongs to the start's axes after half the rotation back
        dv = C_gb[k - 1].T @ force_g
        dv = dv - 0.5 * np.cross(turn_b, dv)
        dv = dv + nabla * DT + MEMS.velocity_random_walk * root * rng.standard_normal(3)
        samples.append(ImuSample(round(t[k] * 1e9), DT, dtheta, dv, "imu"))
        truth[round(t[k] * 1e9)] = (C_gb[k], v[k], C_vb, eps, nabla)
        # fixes arrive 80 ms late and hold 3 ms after a sample
        j = k - 4
        if j > first and j % every == 0:
            w_b = rotvec_from_quat(quat_from_dcm(C_gb[j - 1].T @ C_gb[j])) / DT
            i = j - round(age / DT)
            v_a = v[i] + 0.003 * (v[i + 1] - v[i]) / DT + C_gb[j] @ np.cross(w_b, lever_b)
            p_a = p[j] + 0.003 * v[j] + C_gb[j] @ lever_b + sigma_position * rng.standard_normal(3)
            samples.append(
                GnssFix(
                    t_ns=round(t[j] * 1e9) + 3_000_000,
                    lat=LAT + p_a[1] / (r_m + HEIGHT),
                    lon=LON + p_a[0] / ((r_n + HEIGHT) * math.cos(LAT)),
                    height=HEIGHT + p_a[2],
                    sigma_position=np.full(3, sigma_position),
                    v_g=v_a + 0.05 * rng.standard_normal(3) if velocity else None,
                    sigma_velocity=np.full(3, 0.05) if velocity else None,
                    fix_type=FixType.RTK_FIXED,
                    device="gnss",
                )
            )
            if speed_sigma is not None:
                s_j = speed[j] + 0.003 * (speed[j + 1] - speed[j]) / DT
                s_j += speed_sigma * rng.standard_normal()
                samples.append(SpeedSample(samples[-1].t_ns, s_j, speed_sigma, "speed"))
    return samples, truth


def align(samples, config=MEMS):
    run = begin(ALIGNMENTS["motion"], config)
    refusals = []
    for sample in samples:
        run, status = advance(run, sample)
        if status.refusal:
            refusals.append(status.refusal)
        if status.done:
            return result(run), refusals
    return None, refusals


def errors(init, truth):
    """phi, velocity error and mounting error (rotation vector in v) of a hand-over."""
    C_gb, v, C_vb, _, _ = truth[init.t_ns]
    phi = rotvec_from_quat(quat_from_dcm(C_gb @ dcm_from_quat(init.q_gb).T))
    mounting = rotvec_from_quat(quat_from_dcm(C_vb @ init.C_vb.T))
    return phi, v - init.v_g, mounting


@pytest.mark.parametrize(("velocity", "seeds"), [(True, 8), (False, 6)])
def test_any_heading_and_mounting_is_found_and_sigma_is_honest(velocity, seeds):
    ratio, mounting_ratio, nees = [], [], []
    for seed in range(seeds):
        samples, truth = mems_drive(seed, velocity=velocity)
        init, refusals = align(samples)
        assert not refusals
        assert init is not None
        # within 16 s of driving off
        assert init.t_ns * 1e-9 < REST + 16.0
        phi, dv, mounting = errors(init, truth)
        assert abs(phi[2]) < math.radians(6.0)
        assert np.max(np.abs(phi[:2])) < math.radians(1.5)
        assert np.max(np.abs(dv)) < 0.5
        nees.append(phi @ np.linalg.solve(init.P_phi, phi))
        ratio.append(phi[2] / math.sqrt(init.P_phi[2, 2]))
        mounting_ratio.append(mounting[[0, 2]] / init.sigma_mounting[[0, 2]])
    # sigma must not promise too much: rms of the ratio of n samples is 1 -+ 1/sqrt(2n), twice that allowed
    slack = 1.0 + 2.0 / math.sqrt(2.0 * seeds)
    assert math.sqrt(np.mean(np.square(ratio))) < slack
    assert math.sqrt(np.mean(np.square(mounting_ratio))) < slack
    assert np.mean(nees) < 3.0 * slack**2


def test_a_speed_shows_level_heading_and_mounting_to_a_vehicle_that_never_stands():
    # once a second a position good to 1 m and a speed, no velocity; at first no level either
    seeds = 10
    phis, ratio, mounting_ratio = [], [], []
    for seed in range(seeds):
        samples, truth = mems_drive(
            seed, velocity=False, rest=False, rate_hz=1.0, speed_sigma=0.1, sigma_position=1.0
        )
        init, refusals = align(samples)
        assert not refusals
        assert init is not None
        assert init.t_ns * 1e-9 < REST + 8.0 + 35.0
        phi, dv, mounting = errors(init, truth)
        assert np.max(np.abs(dv)) < 1.0
        phis.append(phi / np.sqrt(np.diag(init.P_phi)))
        ratio.append(phi[2] / math.radians(2.0))
        mounting_ratio.append(mounting[[0, 2]] / init.sigma_mounting[[0, 2]])
    # as above; 2 deg is what the alignment waits for
    assert math.sqrt(np.mean(np.square(phis))) < 1.0 + 2.0 / math.sqrt(2.0 * 3 * seeds)
    assert math.sqrt(np.mean(np.square(ratio))) < 1.0 + 2.0 / math.sqrt(2.0 * seeds)
    assert math.sqrt(np.mean(np.square(mounting_ratio))) < 1.0 + 2.0 / math.sqrt(2.0 * 2 * seeds)


def test_a_moving_start_is_levelled_by_the_motion_itself():
    for seed in range(6):
        samples, truth = mems_drive(seed + 50, rest=False, seconds=70.0)
        init, refusals = align(samples)
        assert not refusals
        assert init is not None
        phi, _, _ = errors(init, truth)
        sigma = np.sqrt(np.diag(init.P_phi))
        assert np.all(np.abs(phi) < 4.0 * sigma)
        assert abs(phi[2]) < math.radians(8.0)


def test_lever_arm_of_the_antenna():
    lever = (0.3, 2.0, 1.0)
    config = dataclasses.replace(MEMS, gnss_lever_arm=np.array(lever))
    samples, truth = mems_drive(77, lever=lever, seconds=60.0)
    init, _ = align(samples, config)
    phi, _, _ = errors(init, truth)
    assert abs(phi[2]) < 4.0 * math.sqrt(init.P_phi[2, 2])


def test_a_velocity_older_than_its_fix():
    """Receivers that difference carrier phases give the mean velocity of the last interval."""
    age = 0.12
    samples, truth = mems_drive(31, age=age)
    ratio = {}
    for told in (0.0, age):
        init, _ = align(samples, dataclasses.replace(MEMS, gnss_velocity_age=told))
        phi, dv, _ = errors(init, truth)
        ratio[told] = np.max(np.abs(dv))
        assert abs(phi[2]) < 4.0 * math.sqrt(init.P_phi[2, 2])
    assert ratio[age] < 0.15
    assert ratio[age] < ratio[0.0]


def test_the_noise_at_rest_is_handed_over():
    samples, _ = mems_drive(3)
    init, _ = align(samples)
    np.testing.assert_allclose(init.rest_rate, MEMS.angle_random_walk / math.sqrt(DT), rtol=0.15)
    np.testing.assert_allclose(init.rest_force, MEMS.velocity_random_walk / math.sqrt(DT), rtol=0.15)


def test_a_known_mounting_is_kept():
    samples, truth = mems_drive(5)
    C_vb = next(iter(truth.values()))[2]
    init, _ = align(samples, dataclasses.replace(MEMS, C_vb=C_vb))
    np.testing.assert_array_equal(init.C_vb, C_vb)
    assert np.all(init.sigma_mounting == 0.0)


def test_a_standing_vehicle_waits():
    samples, _ = mems_drive(1)
    init, refusals = align([s for s in samples if s.t_ns < REST * 1e9])
    assert init is None
    assert not refusals


def test_losing_gnss_or_the_imu_is_said():
    samples, _ = mems_drive(2)
    begin_ns = round((REST + 3.0) * 1e9)
    deaf = [s for s in samples if isinstance(s, ImuSample) or s.t_ns < begin_ns]
    _, refusals = align(deaf)
    assert "no GNSS fix for 10 s" in refusals[0]
    gap = [
        s._replace(flags=int(ImuFlag.GAP))
        if isinstance(s, ImuSample) and abs(s.t_ns - begin_ns) < 11_000_000
        else s
        for s in samples
    ]
    init, refusals = align(gap)
    assert "samples are missing" in refusals[0]
    assert init is not None  # and it goes on from a moving start


def test_level_from_gravity_near_any_axis():
    for f in np.vstack([np.eye(3), -np.eye(3), [[0.99, 0.1, -0.1]]]) * 9.8:
        C = level_dcm(f)
        np.testing.assert_allclose(C @ f, [0.0, 0.0, np.linalg.norm(f)], atol=1e-14)
        np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(C) == pytest.approx(1.0)


def joined(dtheta, dv, dt, gyro_bias, accel_bias):
    total, piece, zero = empty(), np.empty(SIZE), np.zeros(3)
    for k in range(len(dtheta)):
        sample_piece(dtheta[k], dv[k], dt, gyro_bias, accel_bias, piece)
        extend(total, piece, zero, zero)
    return total


def test_pieces_join_and_their_derivatives_are_differences():
    rng = np.random.default_rng(4)
    n, dt, zero = 100, 0.01, np.zeros(3)
    dtheta, dv = 0.005 * rng.standard_normal((n, 3)), 0.02 * rng.standard_normal((n, 3)) + [0.0, 0.0, 0.098]
    whole = joined(dtheta, dv, dt, zero, zero)
    halves = joined(dtheta[:40], dv[:40], dt, zero, zero)
    extend(halves, joined(dtheta[40:], dv[40:], dt, zero, zero), zero, zero)
    np.testing.assert_allclose(halves, whole, atol=1e-13)
    assert whole[PIECE_DT] == pytest.approx(1.0)
    for k in range(3):
        e = np.zeros(3)
        e[k] = 1e-6
        changed = joined(dtheta, dv, dt, e, zero)
        turn = rotvec_from_quat(quat_from_dcm(whole[R].reshape(3, 3).T @ changed[R].reshape(3, 3))) / 1e-6
        # first-order derivatives per sample: what is left is dt |dtheta| of the column, 1 s long
        np.testing.assert_allclose(turn, whole[R_GYRO].reshape(3, 3)[:, k], atol=5e-3)
        np.testing.assert_allclose(
            (changed[V] - whole[V]) / 1e-6, whole[V_GYRO].reshape(3, 3)[:, k], atol=5e-3 * 9.8
        )
        np.testing.assert_allclose(
            (changed[P] - whole[P]) / 1e-6, whole[P_GYRO].reshape(3, 3)[:, k], atol=5e-3 * 9.8
        )
        changed = joined(dtheta, dv, dt, zero, e)
        np.testing.assert_allclose(
            (changed[V] - whole[V]) / 1e-6, whole[V_ACCEL].reshape(3, 3)[:, k], atol=5e-3
        )
        np.testing.assert_allclose(
            (changed[P] - whole[P]) / 1e-6, whole[P_ACCEL].reshape(3, 3)[:, k], atol=5e-3
        )


def test_reusing_a_piece_with_another_bias_equals_doing_it_again():
    rng = np.random.default_rng(5)
    n, dt, zero = 50, 0.01, np.zeros(3)
    dtheta, dv = 0.005 * rng.standard_normal((n, 3)), 0.02 * rng.standard_normal((n, 3)) + [0.0, 0.0, 0.098]
    bias, nabla = np.array([1e-3, -2e-3, 5e-4]), np.array([0.02, 0.01, -0.03])
    reused = empty()
    extend(reused, joined(dtheta, dv, dt, zero, zero), bias, nabla)
    again = joined(dtheta, dv, dt, bias, nabla)
    # second order in bias times time: (1e-3)^2 of 5 m/s
    np.testing.assert_allclose(reused[V], again[V], atol=3e-5)
    np.testing.assert_allclose(reused[R], again[R], atol=1e-5)


def test_a_push_before_driving_off_keeps_the_level_and_standing_again_renews_it():
    samples, truth = mems_drive(9, velocity=False)
    pushed = []
    for s in samples:
        if isinstance(s, ImuSample) and 6.0 < s.t_ns * 1e-9 <= 6.5:
            # back and forth: half a second of 1 m/s^2
            sign = 1.0 if s.t_ns * 1e-9 <= 6.25 else -1.0
            s = s._replace(dv=s.dv + sign * np.array([0.02, 0.0, 0.0]))
        pushed.append(s)
    init, refusals = align(pushed)
    assert not refusals
    phi, _, _ = errors(init, truth)
    assert init.rest_rate is not None  # it has been at rest
    assert np.all(np.abs(phi) < 4.0 * np.sqrt(np.diag(init.P_phi)))


@pytest.mark.parametrize(
    ("lat", "lon"), [(0.8, 0.2), (0.8, math.pi - 1e-6), (math.pi / 2 - 2e-5, 0.5), (math.pi / 2 - 5e-6, -3.0)]
)
def test_no_meridian_is_special(lat, lon):
    """A drive in figures of eight in mid latitude, across the date line, and at the pole, without noise."""
    ride = closed_form.Drive(lat=lat, lon=lon, sway=0.0, nod=0.0)
    config = AlignConfig(5e-7, 2e-3, 3e-6, 4e-4, sigma_heading=math.radians(0.3), C_vb=np.eye(3))
    samples = []
    for k, sample in enumerate(closed_form.samples(*ride.increments(2000, DT), DT), start=1):
        samples.append(sample)
        if k % 10 == 0:
            samples.append(closed_form.fix(ride, k * DT - 0.004, sigma_v=(0.03, 0.03, 0.03)))
    init, refusals = align(samples, config)
    assert init is not None
    assert not refusals
    t = np.array(init.t_ns * 1e-9)
    C_ge = dcm_from_quat(position_quat(init.lat, init.lon)).T
    r_e = np.array(geodetic_to_xyz(init.lat, init.lon, init.height))
    # two seconds' worth of what the fit leaves out: the Earth's curvature and turning
    assert np.abs(C_ge @ (r_e - ride.position(t))).max() < 0.05
    assert np.abs(init.v_g - C_ge @ ride.velocity_e(t)).max() < 0.02
    phi = rotvec_from_quat(quat_from_dcm(C_ge @ ride.C_eb(t) @ dcm_from_quat(init.q_gb).T))
    assert np.abs(phi).max() < math.radians(0.1)


def test_a_standstill_does_not_spoil_gyros_that_are_better_than_earth_rate():
    """What it shows of a bias holds the level Earth rate, 11 deg/h here, in an unknown direction."""
    deg_per_h = math.radians(1.0) / 3600.0
    config = AlignConfig(0.1 * deg_per_h, 2e-3, math.radians(0.01) / 60.0, 4e-4, C_vb=np.eye(3))
    C_gb = dcm_from_euler(0.4, 0.0, 0.0)
    rate, force = C_gb.T @ earth_rate_g(LAT), C_gb.T @ -gravity_g(LAT, HEIGHT)
    run = begin(ALIGNMENTS["motion"], config)
    none, sigma = np.zeros(3), np.full(3, 0.03)
    for k in range(1, 1201):
        run, _ = advance(run, ImuSample(k * 20_000_000, DT, rate * DT, force * DT, "imu"))
        if k % 10 == 0:
            # it drives off after 20 s, or so says the receiver
            v = none if k < 1000 else np.array([0.0, 2.0, 0.0])
            fix = GnssFix(k * 20_000_000, LAT, LON, HEIGHT, sigma, v, sigma, FixType.FIX_3D, "gnss")
            run, _ = advance(run, fix)
    given = run.state.window.given
    assert np.abs(given.gyro_bias).max() < 0.2 * 0.1 * deg_per_h
    # and it is not taken to have learnt what it cannot see
    assert given.sigma_gyro_bias == pytest.approx(np.full(3, 0.1 * deg_per_h), rel=0.3)
