"""Alignment by odometer on the road, against the bench's truth: straight and winding, whole ticks, wrong
mounting."""

import dataclasses
import functools
import math
import re

import numpy as np
import pytest

from bridge.studies.alignment_truth import (
    HEIGHT,
    LAT,
    LON,
    TICK,
    G,
    drive,
    merged,
    misalignment,
    road,
    rough,
    sensed,
    ticks,
    times,
)
from nav.align.rolled import gravity_change, transport
from nav.earth import EARTH_RATE, ecef, gravity_g, position_matrix, transport_rate_g, xyz_to_geodetic
from nav.rotation import dcm_from_quat, quat_from_rotvec
from nav.types import ImuSample
from tests.nav.align import making
from virtual_bus.manoeuvres import Accelerate, Static

DT, ODO = 0.05, 0.1
BEGIN = 20.0  # s: the vehicle is on its way by then
SECONDS = 600.0
IMU = np.array([0.3, 1.2, 0.8])  # m from the rear axle

GRADE = dataclasses.replace(
    making.GRADE,
    fine_s=SECONDS - 60.0,
    position=None,
    sigma_position=0.1,
    C_vb=np.eye(3),
    odometer_scale=0.003,
    sigma_mounting=math.radians(0.05),
    odometer_lever_arm=-IMU,
    slip=0.002,
)
PERFECT = dataclasses.replace(
    GRADE, gyro_bias=1e-11, accel_bias=1e-7, angle_random_walk=1e-9, velocity_random_walk=1e-8
)
EPOCHS = tuple(range(60, 600, 45))


@functools.cache
def truth(kind, number):
    """A trajectory of 5 m/s with its increments; headings of the start are spread over the circle."""
    rng = np.random.default_rng(number)
    C_vb = dcm_from_quat(quat_from_rotvec(math.radians(0.05) * rng.standard_normal(3)))
    trajectory = drive(road(kind, SECONDS + 2.0), 1.0 + 1.6 * number, LAT, LON, HEIGHT, IMU, C_vb)
    t_ns = times(BEGIN, SECONDS, DT)
    return trajectory, C_vb, t_ns, trajectory.increments(t_ns)


def driven(kind, seed, config=GRADE, scale=None):
    """Trajectory, mounting, configuration, samples, and biases of the sensors."""
    trajectory, C_vb, t_ns, (dtheta, dv) = truth(kind, seed % 4)
    rng = np.random.default_rng(seed)
    start = trajectory.state(int(t_ns[0]))
    config = dataclasses.replace(config, position=(start.lat, start.lon, start.height))
    inertial, eps, nabla = sensed(rng, config, dtheta, dv, DT)
    inertial = [s._replace(t_ns=s.t_ns + int(t_ns[0])) for s in inertial]
    scale = 1.0 + 0.002 * rng.standard_normal() if scale is None else scale
    wheel = ticks(trajectory, times(BEGIN - 0.03, SECONDS, ODO), scale)
    return trajectory, C_vb, config, merged(inertial, wheel), eps, nabla


def align(samples, config, at_s=()):
    return making.align("odometer", samples, config, at_s, insist=False)


def off(init, true):
    """Displacement (3,) m east, north, up from the true place."""
    d = ecef(init.lat, init.lon, init.height) - ecef(true.lat, true.lon, true.height)
    return position_matrix(true.lat, true.lon).T @ d


def test_gravity_changes_with_place_as_the_ellipsoids_does():
    for d in ([3000.0, 0.0, 0.0], [0.0, 3000.0, 0.0], [0.0, 0.0, 100.0]):
        C = position_matrix(LAT, LON)
        r = ecef(LAT, LON, HEIGHT) + C @ d
        lat, lon, height = xyz_to_geodetic(*r)
        true = C.T @ position_matrix(lat, lon) @ -gravity_g(lat, height) + gravity_g(LAT, HEIGHT)
        # second order in displacement over radius, and the bend of plumb lines
        np.testing.assert_allclose(gravity_change(LAT, HEIGHT) @ d, true, atol=5e-6)
    v = np.array([12.0, -5.0, 0.0])
    np.testing.assert_allclose(
        transport((LAT, LON, HEIGHT), 3.0 * v), 3.0 * transport_rate_g(LAT, HEIGHT, v), rtol=1e-12
    )


@pytest.mark.parametrize("kind", ["straight", "winding"])
def test_error_free_sensors_give_attitude_and_place(kind):
    trajectory, _C_vb, config, samples, _, _ = driven(kind, 1, PERFECT, 1.0)
    init = align(samples, config).init
    true = trajectory.state(init.t_ns)
    phi = misalignment(dcm_from_quat(true.q_gb), init.q_gb)
    # ticks, 24 mm over the square root of the samples of an epoch, against 1900 m/rad of heading
    assert abs(phi[2]) < 1e-5
    assert np.max(np.abs(phi[:2])) < 5e-7
    assert np.linalg.norm(off(init, true)[:2]) < 2.0


@pytest.mark.parametrize("kind", ["straight", "winding"])
def test_ten_minutes_reach_the_limit_and_the_normalised_error_is_what_it_should_be(kind):
    seeds = 8
    nees, heading, left = np.zeros((seeds, len(EPOCHS))), np.zeros(seeds), np.zeros(seeds)
    place, twelve, sigma = np.zeros((seeds, 2)), np.zeros(seeds), np.zeros(seeds)
    for seed in range(seeds):
        trajectory, C_vb, config, samples, eps, nabla = driven(kind, seed)
        init, _, _, seen, _ = align(samples, config, EPOCHS)
        motion = trajectory.motion(np.array([sample.t_ns for sample, _ in seen]))
        for k, (_, status) in enumerate(seen):
            phi = misalignment(motion.C_gv[k] @ C_vb, status.estimate)
            nees[seed, k] = phi @ np.linalg.solve(status.covariance, phi)
        true = trajectory.state(init.t_ns)
        C = dcm_from_quat(true.q_gb)
        phi = misalignment(C, init.q_gb)
        error = np.concatenate([true.v_g - init.v_g, phi, eps - init.gyro_bias, nabla - init.accel_bias])
        twelve[seed] = error @ np.linalg.solve(init.P[3:, 3:], error)
        heading[seed], sigma[seed] = phi[2], math.sqrt(init.P_phi[2, 2])
        place[seed] = off(init, true)[:2]
        static = -(C @ eps)[0] / (EARTH_RATE * math.cos(LAT)) + math.tan(LAT) * (C @ nabla)[0] / G
        left[seed] = phi[2] - static
    rms = math.degrees(np.sqrt(np.mean(heading**2)))
    # a mean of 8 squares is below 1.94 at 95 %
    limit = math.degrees(float(seen[-1][1].limit[2]))
    assert rms < math.sqrt(1.94) * limit
    if kind == "straight":
        # beside a static alignment of the same IMU: published 0.107 deg
        assert math.degrees(np.sqrt(np.mean(left**2))) < 0.03
    else:
        # turns tell the biases apart, which a static alignment cannot
        assert rms < 0.6 * limit
    # chi-square of 8: 99.9 % below 26.1
    assert np.sum((heading / sigma) ** 2) < 26.1
    mean = nees.mean(axis=0)
    assert np.mean(mean < 4.92) >= 0.9
    assert mean.mean() > 0.8
    assert 5.0 < twelve.mean() < 18.2
    # published: 0.1 % of 3 km
    assert np.sqrt(np.mean(place**2)) < 3.0


def test_an_unknown_mounting_is_found_where_the_road_winds():
    trajectory, _C_vb, config, samples, _, _ = driven("winding", 2)
    config = dataclasses.replace(config, C_vb=None)
    init = align(samples, config).init
    phi = misalignment(dcm_from_quat(trajectory.state(init.t_ns).q_gb), init.q_gb)
    assert abs(phi[2]) < 3.0 * math.sqrt(init.P_phi[2, 2])
    assert math.degrees(math.sqrt(init.P_phi[2, 2])) < 0.03


def test_a_stand_before_and_on_the_way_tells_no_more_than_ticks_can():
    # wheels stand anywhere between two ticks: off by 24 mm, by the same in all epochs of a stand
    runs, at_s = 8, (40, 60, 80, 110, 140, 179)
    begin, going = road("winding", 200.0)[0:3], road("winding", 200.0)[3:]
    halt = [Accelerate(duration_s=8.0, speed_m_s=0.0), Static(duration_s=20.0), *begin[1:]]
    way = [Static(duration_s=25.0), *begin, *going[0:2], *halt, *going[2:]]
    t_ns, odo_ns = times(1.0, 186.0, ODO), times(0.97, 186.0, ODO)
    nees = np.zeros((runs, len(at_s)))
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        C_vb = dcm_from_quat(quat_from_rotvec(GRADE.sigma_mounting * rng.standard_normal(3)))
        trajectory = drive(way, rng.uniform(0.0, 2.0 * math.pi), LAT, LON, HEIGHT, IMU, C_vb)
        start = trajectory.state(int(t_ns[0]))
        config = dataclasses.replace(
            GRADE, fine_s=120.0, position=(start.lat, start.lon, start.height), odometer_quantum=TICK
        )
        inertial, _, _ = sensed(rng, config, *rough(rng, trajectory, t_ns, config.slip), ODO)
        inertial = [s._replace(t_ns=s.t_ns + int(t_ns[0])) for s in inertial]
        wheel = ticks(trajectory, odo_ns, 1.0 + config.odometer_scale * rng.standard_normal(), rng=rng)
        found = align(merged(inertial, wheel), config, at_s)
        assert found.refusals == []
        for k, (sample, status) in enumerate(found.seen):
            phi = misalignment(dcm_from_quat(trajectory.state(sample.t_ns).q_gb), status.estimate)
            nees[seed, k] = phi @ np.linalg.solve(status.covariance, phi)
    # chi-square of 24 over 8: 99.9 % of means below 6.4
    mean = nees.mean(axis=0)
    assert np.all(mean < 6.4), mean
    assert mean.mean() > 0.8


# ---- refusals -----------------------------------------------------------------------------------


def test_wheel_slip_is_named():
    _, _, config, samples, _, _ = driven("straight", 3)
    slipping = [
        s._replace(distance=1.5 * s.distance)
        if not isinstance(s, ImuSample) and 100.0 < s.t_ns * 1e-9 - BEGIN < 102.0
        else s
        for s in samples
    ]
    assert "wheel slip" in align(slipping, config).refusals[0]


def test_missing_odometer_samples_are_named():
    _, _, config, samples, _, _ = driven("straight", 0)
    some = [s for s in samples if isinstance(s, ImuSample) or not 50.0 < s.t_ns * 1e-9 - BEGIN < 52.0]
    assert "odometer samples" in align(some, config).refusals[0]


def test_a_wrong_latitude_and_a_stuck_accelerometer_are_named():
    _, _, config, samples, _, _ = driven("straight", 1)
    lat, lon, height = config.position
    wrong = dataclasses.replace(config, position=(lat + math.radians(2.0), lon, height))
    assert "latitude" in align(samples, wrong).refusals[0]
    stuck = [
        s._replace(dv=np.array([s.dv[0], 1e-3, s.dv[2]])) if isinstance(s, ImuSample) and s.t_ns > 90e9 else s
        for s in samples
    ]
    assert "forward accelerometer is stuck" in align(stuck, config).refusals[0]


def northward(config, off_deg):
    """Four minutes, told of a place so far north of where it is."""
    lat, lon, height = config.position
    return dataclasses.replace(config, position=(lat + math.radians(off_deg), lon, height), fine_s=180.0)


def test_a_tenth_of_a_degree_of_latitude_is_allowed_for():
    # 0.026 deg/h of Earth's rate, nearly four sigma of a gyro's bias: no test names that in every run
    trajectory, _C_vb, config, samples, _, _ = driven("winding", 3)
    init = align(samples, northward(config, 0.1)).init
    phi = misalignment(dcm_from_quat(trajectory.state(init.t_ns).q_gb), init.q_gb)
    # 99.9 %
    assert phi @ np.linalg.solve(init.P_phi, phi) < 16.3


def test_more_latitude_than_that_is_told():
    _, _, config, samples, _, _ = driven("winding", 3)
    told = re.search(
        r"([\d.]+) deg further south: the latitude", align(samples, northward(config, 0.6)).refusals[0]
    )
    # the gyros' biases are 0.027 deg, noise as much; what is told is seen to better than 0.1: three sigma
    assert float(told[1]) == pytest.approx(0.6, abs=0.3)


def test_without_a_position_it_says_so():
    _, _, config, samples, _, _ = driven("straight", 2)
    assert "no position" in align(samples, dataclasses.replace(config, position=None)).refusals[0]
