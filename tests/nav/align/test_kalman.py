"""Kalman filters of eight, ten and twelve states at rest."""

import dataclasses
import math

import numpy as np
import pytest

from nav.align.kalman import EIGHT, TEN, TWELVE, _mean_noise, _transition
from nav.earth import normal_gravity
from nav.errors.psi import alignment_dynamics
from tests.nav.align import making
from tests.nav.align.making import DEG_PER_H, GRADE, LAT, QUICK, misalignment, moved, standing
from tests.nav.align.test_open_loop import IDEAL, settling

NAMES = ["kalman_closed", "kalman_open", "kalman_psi"]


@pytest.mark.parametrize("name", NAMES)
def test_five_minutes_reach_the_limit_and_sigma_agrees(name):
    seeds = 8
    phi, nees = np.zeros((seeds, 3)), np.zeros(seeds)
    for seed in range(seeds):
        C_gb, eps, nabla, samples = standing(200 + seed, sway=GRADE.sway if seed % 2 else 0.0)
        init, status, refusals, *_ = making.align(name, samples, GRADE)
        assert not refusals
        assert init.t_ns == samples[-1].t_ns
        np.testing.assert_allclose(status.estimate, init.q_gb, atol=1e-12)
        np.testing.assert_allclose(status.covariance, init.P_phi, rtol=1e-6, atol=1e-16)
        phi[seed] = misalignment(C_gb, init)
        nees[seed] = making.nees(C_gb, eps, nabla, init)
    # sway costs the azimuth something, and most where only windows see it
    assert np.all(np.sqrt(np.diag(status.covariance)) < 1.08 * status.limit)
    # 8 seeds: the mean square of one component is below 2.2 of its variance with 97.5 %
    assert np.all(np.mean(phi**2, axis=0) < 2.2 * status.limit**2)
    # mean of 8 chi-square values of 9 degrees of freedom: 99 % within 9 -+ 3.9
    assert abs(np.mean(nees) - 9.0) < 3.9


@pytest.mark.parametrize("name", NAMES)
def test_the_north_gyro_bias_is_found_and_the_east_one_not(name):
    """The level's drift shows the north one; the east one stays what it was, eq. (2-104)."""
    quiet = dataclasses.replace(GRADE, sway=1e-4, gyro_bias=0.1 * DEG_PER_H, fine_s=600.0)
    C_gb, eps, _, samples = standing(3, quiet, 660.0)
    init, _, _, *_ = making.align(name, samples, quiet)
    P = C_gb @ init.P[9:12, 9:12] @ C_gb.T
    sigma = np.sqrt(np.diag(P)) / quiet.gyro_bias
    assert sigma[0] > 0.95
    assert sigma[1] < 0.3
    error = C_gb @ (eps - init.gyro_bias) / quiet.gyro_bias
    assert abs(error[1]) < 4.0 * sigma[1]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_vehicle_that_settles_is_followed(name, axis):
    C_gb, _, _, samples = standing(3, IDEAL)
    samples, C_gb = settling(samples, math.radians(0.05) * np.eye(3)[axis], C_gb)
    init, _, refusals, *_ = making.align(name, samples, GRADE)
    assert not refusals
    phi = misalignment(C_gb, init)
    # the coarse stage ended at 60 s, before it began; the strapdown arithmetic follows all of it
    assert np.max(np.abs(phi[:2])) < 3e-6
    assert abs(phi[2]) < 5e-5


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("begin_s", [10.0, 35.0])
@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("pushed", lambda s, t: s._replace(dv=s.dv + (0.04 if t < 0.5 else 0.0))),
        ("turned by", lambda s, t: s._replace(dtheta=s.dtheta + (2e-3 if t < 0.5 else 0.0))),
    ],
)
def test_a_disturbance_is_refused_in_either_stage(name, begin_s, words, change):
    _, _, _, samples = standing(5, QUICK, 60.0)
    refusals = making.align(name, moved(samples, begin_s, change), QUICK).refusals
    assert words in refusals[0]


@pytest.mark.parametrize("name", NAMES)
def test_creeping_off_and_a_stuck_accelerometer_are_refused(name):
    _, _, _, samples = standing(7, QUICK, 61.0)
    creep = moved(samples, 30.0, lambda s, t: s._replace(dv=s.dv + np.array([0.004, 0.0, 0.0])))
    refusals = making.align(name, creep, QUICK).refusals
    assert "the vehicle moves" in refusals[0]
    last = samples[199].dv[1]
    stuck = moved(samples, 40.0, lambda s, t: s._replace(dv=np.array([s.dv[0], last, s.dv[2]])))
    refusals = making.align(name, stuck, QUICK).refusals
    assert "the forward accelerometer is stuck" in refusals[0]


@pytest.mark.parametrize("name", ["kalman_closed", "kalman_psi"])
def test_an_angle_that_only_the_gyros_saw_is_refused(name):
    """0.006 deg in two seconds: 1 mm/s a second of velocity, which sway hides, but it leans to one side."""
    C_gb, _, _, samples = standing(4, sway=GRADE.sway)
    step = C_gb.T @ np.array([1e-4, 0.0, 0.0]) / 10.0
    seen = moved(samples, 120.0, lambda s, t: s._replace(dtheta=s.dtheta + (step if t < 2.0 else 0.0)))
    assert not making.align(name, samples, GRADE).refusals
    assert "contradict a standstill" in making.align(name, seen, GRADE, insist=False).refusals[0]


@pytest.mark.parametrize("name", NAMES)
def test_gyros_and_latitude_are_looked_at_first(name):
    _, _, _, samples = standing(9, QUICK, 25.0)
    poor = dataclasses.replace(QUICK, gyro_bias=10.0 * DEG_PER_H)
    assert "align in motion" in making.align(name, samples, poor).refusals[0]
    wrong = dataclasses.replace(QUICK, position=(math.radians(50.0), 1.9, 400.0))
    assert "latitude" in making.align(name, samples, wrong).refusals[0]


def test_the_models_are_those_of_the_book():
    """Eqs. (2-137) to (2-139) by element."""
    g = normal_gravity(math.sin(LAT), 0.0)
    F = alignment_dynamics(LAT, g, vertical=True)
    north, up = 7.292115e-5 * math.cos(LAT), 7.292115e-5 * math.sin(LAT)
    eight = F[np.ix_(EIGHT.keep, EIGHT.keep)]
    expected = np.zeros((8, 8))
    expected[0:3, 0:3] = [[0.0, up, -north], [-up, 0.0, 0.0], [north, 0.0, 0.0]]
    expected[0:3, 5:8] = np.eye(3)
    np.testing.assert_allclose(eight, expected, atol=1e-12)
    measured = F[np.ix_(EIGHT.measured, EIGHT.keep)]
    np.testing.assert_allclose(measured, [[0, -g, 0, 1, 0, 0, 0, 0], [g, 0, 0, 0, 1, 0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(F[np.ix_(TEN.keep, TEN.keep)], alignment_dynamics(LAT, g))
    assert (TEN.closed, EIGHT.closed, TWELVE.closed) == (True, False, True)


def test_a_window_fades_in_and_out():
    """Noise of its mean, against many; and the way back in time undoes the way there."""
    rng = np.random.default_rng(1)
    config, n = GRADE, 29
    v = config.sway * rng.standard_normal((4000, n + 1))
    f = np.diff(v, axis=1) + config.velocity_random_walk * rng.standard_normal((4000, n))
    w = np.minimum(np.arange(1, n + 1), np.arange(n, 0, -1))
    # 4000 draws: a variance to 3 sigma of 7 %
    assert np.var(f @ w / w.sum()) == pytest.approx(_mean_noise(config, 1.0), rel=0.07)
    F = alignment_dynamics(LAT, 9.8)
    np.testing.assert_allclose(_transition(F, 15.0) @ _transition(F, -15.0), np.eye(10), atol=1e-2)
