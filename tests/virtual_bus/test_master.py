"""The simulated master against an inertial navigator that is really wrong, and against closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.linalg import expm

from nav import rotation as rot
from nav.errors.response import Sphere, static_dynamics
from nav.strapdown.mechanize import NavState, update
from tests.virtual_bus.conftest import trajectory_of
from virtual_bus import ellipsoid
from virtual_bus.flights import FLIGHTS, fly, scenario_of
from virtual_bus.manoeuvres import Accelerate, Cruise, Static, STurns, Turn
from virtual_bus.master import Master, MasterErrors, MasterNoise, master_of
from virtual_bus.tables import MasterTable

QUIET = MasterNoise(0.0, 0.0, 0.0, 0.0, 0.0)
POINT = np.array([0.5, 2.0, 0.3])


def navigated(ride, seconds, phi, dv, dp, gyro, accel):
    """Phi, level velocity and position errors (7,) of a navigator that begins and measures wrong."""
    m = ride.motion(np.array([0]))
    r = m.r_e + (ellipsoid.axes_eg(m.lat, m.lon)[0] @ np.append(dp, 0.0))[None]
    place = ellipsoid.to_geodetic(r)
    C_gb = (np.eye(3) - rot.skew(phi)) @ m.C_gv[0]
    v_g = m.v_g[0] + np.append(dv, 0.0)
    state = NavState(rot.quat_from_dcm(C_gb), v_g, ellipsoid.axes_eg(*place[:2])[0], float(m.height[0]))
    t = np.arange(0, round(seconds * 1e9) + 1, 50_000_000)
    dtheta, dvel = ride.increments(t)
    dtheta, dvel = dtheta + 0.05 * gyro, dvel + 0.05 * accel
    for k in range(0, len(dtheta), 4):
        state = update(state, dtheta[k : k + 4], dvel[k : k + 4], 0.2)
    up = state.C_en[:, 2]
    lat, lon = math.asin(up[2]), math.atan2(up[1], up[0])
    C_eg = ellipsoid.axes_eg(np.array([lat]), np.array([lon]))[0]
    return lat, lon, C_eg.T @ state.C_en @ state.v_n, C_eg.T @ state.C_en @ rot.dcm_from_quat(state.q_nb)


def test_errors_are_those_of_a_navigator_that_is_wrong():
    """Two navigators on exact increments, one of them wrong; what they differ by is what the master says.

    They are linear in errors of milliradians; wind-up of the second order, and of the vertical channel
    that is free here and held there, stays below a hundredth.
    """
    ride = trajectory_of(
        [
            Cruise(duration_s=5.0),
            STurns(duration_s=60.0, angle_deg=20.0),
            Accelerate(duration_s=15.0, speed_m_s=150.0),
            Turn(duration_s=40.0, angle_deg=-60.0),
        ],
        imu=POINT,
        mounting=(0.0, 0.0, 0.0),
        lean=(0.0, 0.0),
        speed=200.0,
        banks=True,
    )
    errors = MasterErrors(1e-3, 3e-3, 0.5, 1000.0, 0.0, 5e-7, 3e-3)
    master = Master(ride, POINT, errors, QUIET, np.random.default_rng(8))
    end = np.array([120_000_000_000])
    phi0, dv0, dp0 = (x[0] for x in master.errors(np.array([0])))
    phi, dv, dp = (x[0] for x in master.errors(end))
    wrong = navigated(ride, 120.0, phi0, dv0[:2], dp0[:2], master.gyro, master.accel)
    right = navigated(ride, 120.0, np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3))
    found_phi = rot.rotvec_from_quat(rot.quat_from_dcm(right[3] @ wrong[3].T))
    assert phi == pytest.approx(found_phi, rel=0.01, abs=1e-5)
    assert dv[:2] == pytest.approx((wrong[2] - right[2])[:2], rel=0.01, abs=0.02)
    r = 6.37e6
    found = np.array([r * math.cos(right[0]) * (wrong[1] - right[1]), r * (wrong[0] - right[0])])
    assert dp[:2] == pytest.approx(found, rel=0.01, abs=3.0)
    # the curves did it: a heading that is wrong turns 200 m/s to the side
    assert np.linalg.norm(dv[:2] - dv0[:2]) > 0.5


def test_errors_at_rest_swing_as_the_textbook_says():
    """Half a Schuler period of what sensors are wrong by: "Inertial navigation", eq. (2-90), on a sphere."""
    lat = math.radians(45.0)
    ride = trajectory_of([Static(duration_s=2600.0)], lat=lat, heading=0.0, imu=(0, 0, 0), mounting=(0, 0, 0))
    errors = MasterErrors(0.0, 0.0, 0.0, 0.0, 0.0, 1e-7, 1e-3)
    master = Master(ride, np.zeros(3), errors, QUIET, np.random.default_rng(0))
    F, G = static_dynamics(lat, Sphere(9.806, 6.378e6), coriolis=True)
    whole = np.zeros((12, 12))
    # a gyro that reads too much turns the computed axes the other way
    whole[:7, :7], whole[:7, 7:] = F, G * np.array([-1.0, -1.0, -1.0, 1.0, 1.0])
    t = np.array([600.0, 1300.0, 2500.0])
    phi, dv, dp = master.errors(np.rint(t * 1e9).astype(np.int64))
    begin = np.concatenate((np.zeros(7), master.gyro, master.accel[:2]))
    expected = np.array([(expm(whole * each) @ begin)[:7] for each in t])
    # the Earth is no sphere: its two radii of curvature differ by 0.3 %, and gravity is another at 500 m
    assert np.abs(dv[:, :2] - expected[:, :2]).max() < 0.005 * np.abs(expected[:, :2]).max()
    assert np.abs(phi - expected[:, 4:]).max() < 0.005 * np.abs(expected[:, 4:]).max()
    metres = expected[:, [3, 2]] * 6.38e6 * np.array([math.cos(lat), 1.0])
    assert np.abs(dp[:, :2] - metres).max() < 0.01 * np.abs(metres).max()


def test_lasting_errors_are_as_large_as_their_sigmas():
    ride = trajectory_of([Static(duration_s=10.0)], imu=(0, 0, 0), mounting=(0, 0, 0))
    table = MasterTable()
    many = [master_of(table, ride, np.random.default_rng(seed)) for seed in range(200)]
    x = np.array([np.concatenate([part[0] for part in m.errors(np.array([0]))]) for m in many])
    t = table
    sigma = [t.tilt_mrad * 1e-3] * 2 + [t.heading_mrad * 1e-3] + [t.velocity_m_s] * 2
    sigma += [t.height_m * 2.146 / 200.0] + [t.position_m] * 2 + [t.height_m]
    # a sample's sigma of 200 is known to 5 %: four of these
    assert np.sqrt((x**2).mean(axis=0)) == pytest.approx(sigma, rel=0.2)
    drift = np.array([m.gyro for m in many])
    assert np.degrees(np.sqrt((drift**2).mean())) * 3600.0 == pytest.approx(t.gyro_deg_per_h, rel=0.12)


def test_messages_are_the_truth_its_errors_and_their_noise():
    flown = fly(scenario_of("wing-rock"), 3, 6.0)
    t, said, table = flown.master_ns, flown.said, MasterTable()
    phi, dv, dp = flown.master.errors(t)
    true = flown.trajectory.motion(t, np.array(table.at_m))
    turn = np.einsum("nij,nkj->nik", true.C_gv, said.C_ga)
    off = 0.5 * np.stack((turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0]), axis=1)
    C_eg = ellipsoid.axes_eg(true.lat, true.lon)
    shift = np.einsum("nji,nj->ni", C_eg, ellipsoid.to_ecef(said.lat, said.lon, said.height) - true.r_e)
    rate = math.radians(table.rate_noise_deg_per_s)
    for left, noise in (
        (off - phi[:, :2], 1e-3 * table.attitude_noise_mrad),
        (said.v_g - true.v_g - dv, table.velocity_noise_m_s),
        (shift - dp, table.position_noise_m),
        (said.w_ia_a - true.w_iv_v - flown.master.gyro, rate),
        (said.f_a - true.f_v - flown.master.accel, table.force_noise_m_s2),
    ):
        # 300 messages: sigmas to 4 % by axes that are taken together, means to a seventeenth of them
        assert left.std() == pytest.approx(noise, rel=0.12)
        assert np.abs(left.mean(axis=0)).max() < 0.25 * noise


def test_what_it_says_may_be_older_than_it_tells():
    base = scenario_of("s-turn")
    quiet = msgspec.structs.replace(base.master, velocity_noise_m_s=0.0)
    late = msgspec.structs.replace(quiet, age_ms=100.0)
    said = [fly(msgspec.structs.replace(base, master=m), 1, 20.0).said.v_g for m in (quiet, late)]
    # 50 messages a second: a tenth is five of them
    assert said[1][5:] == pytest.approx(said[0][:-5], abs=1e-9)


@pytest.mark.parametrize("name", FLIGHTS)
def test_flights_are_what_they_say(name):
    scenario = scenario_of(name)
    flown = fly(scenario, 1, 130.0)
    m = flown.trajectory.motion(np.arange(0, 130_000_000_000, 50_000_000))
    roll = np.degrees(np.arctan2(-m.C_gv[:, 2, 0], m.C_gv[:, 2, 2]))
    nose = np.degrees(np.unwrap(np.arctan2(m.C_gv[:, 0, 1], m.C_gv[:, 1, 1])))
    speed = np.linalg.norm(m.v_g[:, :2], axis=1)
    if scenario.vehicle.banks:
        assert np.abs(speed - 200.0).max() < 6.0  # a wing tip that rocks, a nose that swings
    most = {"wing-rock": 30.0, "s-turn": 30.3, "coordinated-turn": 33.2}
    if name in most:
        assert np.abs(roll).max() == pytest.approx(most[name], abs=0.2)
    if name == "heading-wiggle":
        assert [nose.min(), nose.max()] == pytest.approx([35.0, 45.0], abs=0.1)
        course = np.degrees(np.arctan2(m.v_g[:, 0], m.v_g[:, 1]))
        assert np.abs(course - 40.0).max() < 0.6
    if name in ("s-turn", "coordinated-turn"):
        # it banks so that next to nothing pulls to the side: Coriolis, and the arm
        assert np.abs(m.f_v[:, 0]).max() < 0.06
    if name == "ship-roll":
        assert roll.std() == pytest.approx(5.0, rel=0.3)


def test_a_slave_measures_the_bent_truth_and_its_unit_is_wrong_by_its_grade():
    flown = fly(scenario_of("wing-rock"), 4, 10.0)
    dtheta, dv = flown.trajectory.increments(flown.t_ns)
    seconds = 10.0
    drift = (flown.dtheta - dtheta).sum(axis=0) / seconds
    push = (flown.dv - dv).sum(axis=0) / seconds
    # 1 deg/h and its random walk, 0.1 deg/sqrt(h) over ten seconds, and 150 ppm of 74 deg/s out and back
    walk = math.hypot(1.0, 0.1 * 60.0 / math.sqrt(seconds))
    assert np.abs(np.degrees(drift) * 3600.0).max() < 3.5 * walk
    assert 1e-4 < np.abs(push).max() < 3.5 * 9.8e-3 * 1.1
    with pytest.raises(ValueError, match="no master"):
        fly(msgspec.structs.replace(scenario_of("straight"), master=None), 1)
