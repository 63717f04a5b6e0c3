"""Static alignment against closed forms: a body fixed to the turning Earth senses constant rate and force."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align.static import limits, triad
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_euler, quat_from_dcm, rotvec_from_quat
from nav.types import ImuFlag, ImuSample, OdoSample
from tests.nav.align import making
from tests.nav.align.making import (
    DEG_PER_H,
    DT,
    GRADE,
    HEIGHT,
    LAT,
    LON,
    QUICK,
    G,
    fix,
    misalignment,
    moved,
    standing,
)


def align(samples, config=GRADE):
    return making.align("static", samples, config)[:3]


def test_error_free_sensors_give_the_attitude_in_any_orientation():
    perfect = dataclasses.replace(GRADE, gyro_bias=1e-9, accel_bias=1e-6)
    for heading, pitch, roll in [(0.3, 0.1, -0.2), (3.0, -1.2, 2.5), (5.5, 0.0, math.pi / 2)]:
        C_gb = dcm_from_euler(heading, pitch, roll)
        step = round(DT * 1e9)
        dtheta, dv = C_gb.T @ earth_rate_g(LAT) * DT, C_gb.T @ -gravity_g(LAT, HEIGHT) * DT
        samples = [ImuSample((k + 1) * step, DT, dtheta, dv, "imu") for k in range(3000)]
        init, _, refusals = align(samples, perfect)
        assert not refusals
        # second-order terms of a block (w t)^2 g t against a filter that looks 300 s long: below 1e-7 rad of
        # tilt, and that over w_N t of azimuth
        assert np.max(np.abs(misalignment(C_gb, init))) < 5e-6


def test_five_minutes_reach_the_limit_and_sigma_agrees_with_the_spread():
    seeds = 30
    phi, nees, sigma = np.zeros((seeds, 3)), np.zeros(seeds), np.zeros((seeds, 3))
    bias_nees = np.zeros(seeds)
    for seed in range(seeds):
        C_gb, eps, nabla, samples = standing(seed)
        init, status, refusals = align(samples)
        assert not refusals
        phi[seed] = misalignment(C_gb, init)
        sigma[seed] = np.sqrt(np.diag(init.P_phi))
        nees[seed] = phi[seed] @ np.linalg.solve(init.P_phi, phi[seed])
        bias_nees[seed] = making.nees(C_gb, eps, nabla, init)
    limit = status.limit
    rms = np.sqrt(np.mean(phi**2, axis=0))
    # a bias of 0.007 deg/h is 0.032 deg of heading at 34 deg
    assert limit[2] == pytest.approx(math.radians(0.033), rel=0.05)
    assert np.all(rms < 1.2 * limit)
    assert np.all(np.mean(sigma, axis=0) < 1.05 * limit)
    # mean of 30 chi-square values: 95 % within 3 -+ 0.88, 9 -+ 1.5
    assert abs(np.mean(nees) - 3.0) < 0.9
    assert abs(np.mean(bias_nees) - 9.0) < 1.6
    # no direction preferred: mean within three of its standard deviations
    assert np.all(np.abs(np.mean(phi, axis=0)) < 3.0 * limit / math.sqrt(seeds))


def test_limit_is_equation_2_104():
    config = dataclasses.replace(GRADE, angle_random_walk=0.0, velocity_random_walk=0.0, accel_bias=0.0)
    # 0.01 deg/h at 45 deg: 0.9402 mrad
    config = dataclasses.replace(config, gyro_bias=0.01 * DEG_PER_H)
    assert limits(config, math.pi / 4, 0.0, 900.0)[2] == pytest.approx(0.9402e-3, rel=1e-4)
    # and 0.005 deg/sqrt(h) over 15 min is the same
    config = dataclasses.replace(config, gyro_bias=0.0, angle_random_walk=math.radians(0.005) / 60.0)
    assert limits(config, math.pi / 4, 0.0, 900.0)[2] == pytest.approx(0.9402e-3, rel=1e-4)


def test_signs_of_equation_2_104():
    """East gyro bias and level accelerometer biases, IMU axes east-north-up."""
    eps, nab = 0.01 * DEG_PER_H, 1e-4 * G
    north = earth_rate_g(LAT)[1]
    g = -gravity_g(LAT, HEIGHT)[2]
    rate, force = earth_rate_g(LAT), -gravity_g(LAT, HEIGHT)
    for d_rate, d_force, phi in [
        ([eps, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -eps / north]),
        ([0.0, 0.0, 0.0], [nab, 0.0, 0.0], [0.0, nab / g, math.tan(LAT) * nab / g]),
        ([0.0, 0.0, 0.0], [0.0, nab, 0.0], [-nab / g, 0.0, 0.0]),
    ]:
        C = triad(force + d_force, rate + d_rate, LAT, HEIGHT)
        found = rotvec_from_quat(quat_from_dcm(C.T))  # truth is the unit matrix
        # second order in the tilt: 1e-4 of it
        np.testing.assert_allclose(found, phi, atol=2e-4 * np.max(np.abs(phi)))


def test_position_comes_from_gnss_and_the_lever_arm_is_taken_off():
    config = dataclasses.replace(QUICK, position=None, gnss_lever_arm=np.array([0.0, 10.0, 2.0]))
    _, _, _, samples = standing(3, config, 61.0, (0.0, 0.0, 0.0))
    mixed = []
    for k, sample in enumerate(samples):
        mixed.append(sample)
        if k % 5 == 4:
            mixed.append(fix(sample.t_ns * 1e-9))
    init, _, refusals = align(mixed, config)
    assert not refusals
    # heading north: the IMU lies 10 m south of the antenna and 2 m below
    assert (LAT - init.lat) * 6.37e6 == pytest.approx(10.0, abs=0.1)
    assert HEIGHT - init.height == pytest.approx(2.0, abs=1e-3)


def test_a_fix_far_from_the_others_is_refused():
    config = dataclasses.replace(QUICK, position=None)
    _, _, _, samples = standing(3, config, 90.0)
    for jump, refused in ((5e-6, True), (1e-6, False)):  # 32 m and 6 m, of a receiver good to 1.7 m
        mixed = []
        for k, sample in enumerate(samples):
            mixed.append(sample)
            if k % 5 == 4:
                t = sample.t_ns * 1e-9
                mixed.append(fix(t, lat=LAT + (jump if t > 15.0 else 0.0)))
        init, _, refusals = align(mixed, config)
        assert init is not None
        assert bool(refusals) == refused
        if refused:
            assert "by GNSS it is 32 m from where it stood" in refusals[0]


def test_without_a_position_it_says_so():
    config = dataclasses.replace(QUICK, position=None)
    _, _, _, samples = standing(4, config, 90.0)
    init, _, refusals = align(samples, config)
    assert init is None
    assert "no position" in refusals[0]


@pytest.mark.parametrize("begin_s", [10.0, 35.0])  # in the coarse and in the fine stage
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda s, t: s._replace(dtheta=s.dtheta + (2e-3 if t < 0.5 else 0.0)),
            "turned by",
        ),
        (
            lambda s, t: s._replace(dv=s.dv + (np.array([0.04, 0.0, 0.0]) if t < 0.5 else 0.0)),
            "pushed",
        ),
        (lambda s, t: s._replace(flags=int(ImuFlag.GAP)) if t < 0.25 else s, "missing"),
    ],
)
def test_a_disturbance_is_named_and_the_alignment_starts_again(begin_s, change, words):
    # after the disturbance there is time for a whole alignment
    _, _, _, samples = standing(5, QUICK, 130.0)
    init, _, refusals = align(moved(samples, begin_s, change), QUICK)
    assert words in refusals[0]
    assert init is not None
    assert init.t_ns * 1e-9 > begin_s + 59.0


def test_wheels_and_gnss_tell_of_driving_off():
    _, _, _, samples = standing(6, QUICK, 30.0)
    odo = OdoSample(samples[-1].t_ns, 0.1, 0.1, False, "odo")
    _, _, refusals = align([*samples, odo], QUICK)
    assert "odometer rolls" in refusals[0]
    _, _, refusals = align([*samples, fix(30.0, v=3.0)], QUICK)
    assert "drives: 3.0 m/s by GNSS" in refusals[0]


def test_creeping_off_is_seen_by_the_filter():
    """0.02 m/s^2 passes as noise of a block, but not as a standstill's velocity."""
    _, _, _, samples = standing(7, QUICK, 60.0)
    creep = moved(samples, 30.0, lambda s, t: s._replace(dv=s.dv + np.array([0.004, 0.0, 0.0])))
    _, _, refusals = align(creep, QUICK)
    assert refusals
    assert "the vehicle moves" in refusals[0]


def test_gyros_that_cannot_see_earth_rate_are_refused():
    config = dataclasses.replace(QUICK, gyro_bias=10.0 * DEG_PER_H)
    _, _, _, samples = standing(8, config, 25.0)
    init, _, refusals = align(samples, config)
    assert init is None
    assert "align in motion" in refusals[0]


def test_a_wrong_latitude_is_noticed():
    _, _, _, samples = standing(9, QUICK, 25.0)
    config = dataclasses.replace(QUICK, position=(math.radians(50.0), LON, HEIGHT))
    _, _, refusals = align(samples, config)
    assert "latitude" in refusals[0]
