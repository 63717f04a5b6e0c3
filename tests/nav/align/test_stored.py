"""Alignment from a stored heading or an attitude from outside: what is taken, what is refused."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align import ALIGNMENTS, lack
from nav.rotation import dcm_from_euler, dcm_from_quat, quat_from_dcm, quat_from_rotvec
from tests.nav.align import making
from tests.nav.align.making import DEG_PER_H, LAT, QUICK, G, misalignment, moved, standing

NAME = "stored"
DEG = math.radians(1.0)
# tactical grade: 1 deg/h, 0.05 deg/sqrt(h), 1 mg
TACTICAL = dataclasses.replace(
    QUICK,
    gyro_bias=DEG_PER_H,
    accel_bias=1e-3 * G,
    angle_random_walk=math.radians(0.05) / 60.0,
    velocity_random_walk=5e-5 * G,
)
POOR = dataclasses.replace(TACTICAL, gyro_bias=50.0 * DEG_PER_H, angle_random_walk=math.radians(0.3) / 60.0)


def heading_of(C_gb, C_vb=None):
    """Clockwise from north, of the vehicle's forward axis."""
    forward = C_gb @ (np.eye(3) if C_vb is None else C_vb)[1]
    return math.atan2(forward[0], forward[1])


def by_heading(seed, config, sigma, error=None, **known):
    C_gb, eps, nabla, samples = standing(seed, config, 21.0)
    off = sigma * np.random.default_rng(seed + 500).standard_normal() if error is None else error
    heading = heading_of(C_gb, known.get("C_vb")) + off
    config = dataclasses.replace(config, heading=(heading, sigma), **{"C_vb": np.eye(3), **known})
    return C_gb, eps, nabla, samples, config


def by_attitude(seed, config, sigma, error=None):
    C_gb, eps, nabla, samples = standing(seed, config, 21.0)
    rng = np.random.default_rng(seed + 500)
    phi = sigma * rng.standard_normal(3) if error is None else np.asarray(error)
    given = quat_from_dcm(dcm_from_quat(quat_from_rotvec(-phi)) @ C_gb)
    return C_gb, eps, nabla, samples, dataclasses.replace(config, attitude=(given, sigma))


@pytest.mark.parametrize("config", [QUICK, TACTICAL, POOR])
@pytest.mark.parametrize("known", ["heading", "attitude"])
def test_it_is_as_good_as_it_says(config, known):
    seeds = 8
    nees, ratio = np.zeros(seeds), np.zeros((seeds, 3))
    for seed in range(seeds):
        if known == "heading":
            made = by_heading(seed, config, 0.3 * DEG)
        else:
            made = by_attitude(seed, config, np.array([0.1, 0.1, 0.5]) * DEG)
        C_gb, eps, nabla, samples, full = made
        init, status, refusals, *_ = making.align(NAME, samples, full)
        assert not refusals
        assert init.t_ns == round(20e9)
        np.testing.assert_allclose(status.covariance, init.P_phi)
        phi = misalignment(C_gb, init)
        nees[seed] = making.nees(C_gb, eps, nabla, init)
        ratio[seed] = phi / status.limit
        assert np.all(np.sqrt(np.diag(init.P_phi)) > 0.7 * status.limit)
    # 8 seeds: the mean square of one component is below 2.2 of its variance with 97.5 %; sway, of which there
    # is none here, is not in it
    assert np.all(np.mean(ratio**2, axis=0) < 2.2)
    # mean of 8 chi-square values of 9 degrees of freedom: 99 % within 9 -+ 3.9
    assert abs(np.mean(nees) - 9.0) < 3.9


def test_good_gyros_sharpen_the_heading_and_the_heading_shows_poor_gyros():
    *_, samples, config = by_heading(3, QUICK, 0.3 * DEG)
    init, _, _, *_ = making.align(NAME, samples, config)
    assert math.sqrt(init.P_phi[2, 2]) < 0.2 * DEG
    *_, samples, config = by_heading(3, POOR, 0.3 * DEG)
    init, _, _, *_ = making.align(NAME, samples, config)
    assert math.sqrt(init.P_phi[2, 2]) == pytest.approx(0.3 * DEG, rel=1e-2)
    # 0.3 deg/sqrt(h) in 20 s are 4 deg/h, of 50
    assert np.all(init.sigma_gyro_bias < 5.0 * DEG_PER_H)


def test_the_heading_is_of_the_vehicle_and_the_mounting_counts():
    C_vb = dcm_from_euler(2.0, 0.1, 0.05).T
    C_gb, *_, samples, config = by_heading(4, POOR, 0.3 * DEG, 0.0, C_vb=C_vb)
    init, _, refusals, *_ = making.align(NAME, samples, config)
    assert not refusals
    # the level is off by 1 mg
    assert abs(heading_of(dcm_from_quat(init.q_gb), C_vb) - heading_of(C_gb, C_vb)) < 1e-3


def test_without_a_mounting_a_heading_is_refused():
    *_, samples, config = by_heading(4, POOR, 0.3 * DEG)
    init, _, refusals, *_ = making.align(NAME, samples, dataclasses.replace(config, C_vb=None))
    assert init is None
    assert "mounting" in refusals[0]


def test_it_needs_something_known():
    assert lack(ALIGNMENTS[NAME], set(), QUICK) == "heading"
    *_, samples = standing(5, QUICK, 21.0)
    init, _, refusals, *_ = making.align(NAME, samples, QUICK)
    assert init is None
    assert "neither a heading nor an attitude" in refusals[0]


@pytest.mark.parametrize("config", [QUICK, TACTICAL])
def test_a_vehicle_that_was_turned_round_is_refused(config):
    # 1 deg/h and 0.05 deg/sqrt(h) in 20 s are 8 deg of heading: what they see is more than 6 times that
    *_, samples, full = by_heading(6, config, 0.3 * DEG, 0.5 * math.pi)
    init, _, refusals, *_ = making.align(NAME, samples, full)
    assert init is None
    assert "turned since" in refusals[0]


def test_a_level_that_disagrees_is_refused_beyond_its_sigma():
    for known, refused in ((0.05 * DEG, True), (0.5 * DEG, False)):
        sigma = np.array([known, known, 0.5 * DEG])
        C_gb, *_, samples, config = by_attitude(7, TACTICAL, sigma, [1.0 * DEG, 0.0, 0.0])
        init, _, refusals, *_ = making.align(NAME, samples, config)
        if refused:
            assert init is None
            # 0.06 deg of it may be the accelerometer's
            assert "deg off the level" in refusals[0]
        else:
            phi = misalignment(C_gb, init)
            assert phi @ np.linalg.solve(init.P_phi, phi) < 16.3


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("pushed", lambda s, t: s._replace(dv=s.dv + (0.04 if t < 0.5 else 0.0))),
        ("turned by", lambda s, t: s._replace(dtheta=s.dtheta + (2e-3 if t < 0.5 else 0.0))),
        ("turns", lambda s, t: s._replace(dtheta=s.dtheta + np.array([0.0, 0.0, 3e-5]))),
    ],
)
def test_it_refuses_with_the_cause(words, change):
    *_, samples, config = by_heading(8, TACTICAL, 0.3 * DEG)
    begin_s = 0.0 if words == "turns" else 10.0
    refusals = making.align(NAME, moved(samples, begin_s, change), config).refusals
    assert words in refusals[0]


def test_a_stuck_accelerometer_is_named():
    *_, samples, config = by_heading(8, TACTICAL, 0.3 * DEG)
    last = samples[49].dv[0]
    stuck = moved(samples, 10.0, lambda s, t: s._replace(dv=np.array([last, *s.dv[1:]])))
    refusals = making.align(NAME, stuck, config).refusals
    assert "the right accelerometer is stuck" in refusals[0]


def test_a_wrong_latitude_is_noticed_by_gyros_that_see_it():
    *_, samples, config = by_heading(9, QUICK, 0.3 * DEG)
    wrong = dataclasses.replace(config, position=(LAT + 0.3, 1.9, 400.0))
    refusals = making.align(NAME, samples, wrong).refusals
    assert "latitude" in refusals[0]
