"""Lines through the drift of the level: accuracy, what a settling vehicle does, refusals."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align.open_loop import _covariance
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, quat_rotate
from tests.nav.align import making
from tests.nav.align.making import DEG_PER_H, DT, GRADE, QUICK, misalignment, moved, standing

NAME = "open_loop"
IDEAL = dataclasses.replace(
    GRADE, gyro_bias=1e-12, accel_bias=1e-9, angle_random_walk=1e-12, velocity_random_walk=1e-9
)


def test_five_minutes_reach_the_limit_and_sigma_agrees():
    seeds = 8
    phi, nees = np.zeros((seeds, 3)), np.zeros(seeds)
    for seed in range(seeds):
        C_gb, eps, nabla, samples = standing(100 + seed)
        init, status, refusals, *_ = making.align(NAME, samples, GRADE)
        assert not refusals
        assert init.t_ns == samples[-1].t_ns
        phi[seed] = misalignment(C_gb, init)
        nees[seed] = making.nees(C_gb, eps, nabla, init)
    # the configured sway, of which there is none here, costs something
    assert np.all(np.sqrt(np.diag(status.covariance)) < 1.1 * status.limit)
    # 8 seeds: the mean square of one component is below 2.2 of its variance with 97.5 %
    assert np.all(np.mean(phi**2, axis=0) < 2.2 * status.limit**2)
    # mean of 8 chi-square values of 9 degrees of freedom: 99 % within 9 -+ 3.9
    assert abs(np.mean(nees) - 9.0) < 3.9


def test_the_covariance_of_a_line_is_that_of_many():
    """Slope and end of the fit to simulated noise, 4000 times; 3 sigma of a variance then are 7 %."""
    rng = np.random.default_rng(2)
    runs, n, g = 4000, 60, 9.8
    config = dataclasses.replace(GRADE, angle_random_walk=3e-7, velocity_random_walk=2e-5, sway=2e-4)
    theta = np.cumsum(config.angle_random_walk * rng.standard_normal((runs, n)), axis=1)
    before = np.concatenate([np.zeros((runs, 1)), theta[:, :-1]], axis=1)
    v = np.cumsum(config.velocity_random_walk * rng.standard_normal((runs, n)), axis=1)
    v += config.sway * rng.standard_normal((runs, n))
    u = v / g - np.cumsum(0.5 * (theta + before), axis=1)
    t = np.arange(1.0, n + 1.0)
    p = np.polynomial.polynomial.polyfit(t, u.T, 2)
    found = np.cov(np.stack([2.0 * p[2], p[1] + 2.0 * n * p[2] + theta[:, -1]]))
    np.testing.assert_allclose(found, _covariance(config, n, float(n), g), rtol=0.15)


def settling(samples, tilt, C_gb):
    """The vehicle turns by ``tilt`` (3,) rad, g axes, between 100 s and 220 s, too slowly to be seen."""
    out, total = [], np.zeros(3)
    for sample in samples:
        part = tilt * DT / 120.0 if 100.0 < sample.t_ns * 1e-9 <= 220.0 else np.zeros(3)
        middle = total + 0.5 * part
        total = total + part
        back = quat_from_rotvec(-(C_gb.T @ middle))
        turned = quat_rotate(back, sample.dtheta) + C_gb.T @ part
        out.append(sample._replace(dtheta=turned, dv=quat_rotate(back, sample.dv)))
    return out, dcm_from_quat(quat_from_rotvec(total)) @ C_gb


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_vehicle_that_settles_is_followed(axis):
    """0.05 deg in two minutes are 1.5 deg/h, which taken for Earth rate would be 7 deg of heading."""
    C_gb, _, _, samples = standing(3, IDEAL)
    samples, C_gb = settling(samples, math.radians(0.05) * np.eye(3)[axis], C_gb)
    init, _, refusals, *_ = making.align(NAME, samples, GRADE)
    assert not refusals
    phi = misalignment(C_gb, init)
    # squares of the tilt, 1e-6; a plain mean of the motion for kappa, where the fit weighs the middle more:
    # a few per cent of its 0.9 mrad
    assert np.max(np.abs(phi[:2])) < 3e-6
    assert abs(phi[2]) < 5e-5


@pytest.mark.parametrize("begin_s", [10.0, 35.0])
@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("pushed", lambda s, t: s._replace(dv=s.dv + (0.04 if t < 0.5 else 0.0))),
        ("turned by", lambda s, t: s._replace(dtheta=s.dtheta + (2e-3 if t < 0.5 else 0.0))),
    ],
)
def test_a_disturbance_is_refused_in_either_stage(begin_s, words, change):
    _, _, _, samples = standing(5, QUICK, 130.0)
    init, _, refusals, *_ = making.align(NAME, moved(samples, begin_s, change), QUICK)
    assert words in refusals[0]
    assert init is not None
    assert init.t_ns * 1e-9 > begin_s + 59.0


def test_creeping_off_is_refused():
    _, _, _, samples = standing(7, QUICK, 61.0)
    creep = moved(samples, 35.0, lambda s, t: s._replace(dv=s.dv + np.array([0.004, 0.0, 0.0])))
    refusals = making.align(NAME, creep, QUICK).refusals
    assert "moves" in refusals[0]


def test_an_accelerometer_that_drifts_is_refused():
    """3 mg an hour look like a level that drifts by 0.17 deg/h, and the gyro contradicts."""
    C_gb, _, _, samples = standing(8)

    def change(sample, t):
        return sample._replace(dv=sample.dv + C_gb.T @ np.array([3e-3 * 9.8 / 3600.0 * t * DT, 0.0, 0.0]))

    refusals = making.align(NAME, moved(samples, 0.0, change), GRADE).refusals
    assert "the gyros do not see" in refusals[0]


def test_gyros_and_latitude_are_looked_at_first():
    _, _, _, samples = standing(9, QUICK, 25.0)
    poor = dataclasses.replace(QUICK, gyro_bias=10.0 * DEG_PER_H)
    assert "align in motion" in making.align(NAME, samples, poor).refusals[0]
    wrong = dataclasses.replace(QUICK, position=(math.radians(50.0), 1.9, 400.0))
    assert "latitude" in making.align(NAME, samples, wrong).refusals[0]


def test_the_estimate_is_that_of_the_hand_over():
    _, _, _, samples = standing(10, QUICK, 61.0)
    init, status, _, *_ = making.align(NAME, samples, QUICK)
    np.testing.assert_allclose(status.estimate, init.q_gb, atol=1e-15)
    np.testing.assert_allclose(status.covariance, init.P_phi)
    assert status.progress == 1.0
    assert quat_from_dcm(dcm_from_quat(init.q_gb)) == pytest.approx(init.q_gb)
