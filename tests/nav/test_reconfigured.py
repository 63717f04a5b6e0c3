"""What a navigator makes of a redundant unit that goes on with other sensors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from nav import earth
from nav.align import NavInit
from nav.imu.geometry import GEOMETRIES
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.rotation import dcm_from_quat, quat_from_euler
from nav.types import FixType, GnssFix, ImuChange, ImuSample, S, Solution

LAT, HEIGHT, DT_NS = 0.8, 300.0, 10_000_000
Q = quat_from_euler(0.7, 0.02, -0.01)
OWED = np.array([[1e-3, -2e-3, 3e-3], [0.3, -0.2, 0.1]])
OVER = 10.0
RUNS = 200
BIAS = np.array([[1e-6, 2e-6, 3e-6], [1e-3, 2e-3, 3e-3]])
WALK = np.zeros((2, 3, 3))


def known(size: float = 1e-6) -> NavInit:
    """At rest, as sure of everything as ``size`` says."""
    three = size * np.ones(3)
    return NavInit(
        t_ns=0, lat=LAT, lon=0.0, height=HEIGHT, v_g=np.zeros(3), q_gb=Q, P_phi=np.eye(3) * 1e-8 * size**2,
        sigma_v=0.01 * three, sigma_p=three, gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
        sigma_gyro_bias=three * 1e-7, sigma_accel_bias=three * 1e-3,
    )  # fmt: skip


def navigator() -> Navigator:
    imu = ImuErrors(1e-6, 1e-4, 1e-7, 1e-3)
    made = Navigator(NavigatorConfig(imu=imu, zero_velocity=None))
    made.begin(known(1.0))
    return made


def rest(k: int) -> ImuSample:
    C_bg = dcm_from_quat(Q).T
    rate = C_bg @ (earth.EARTH_RATE * np.array([0.0, math.cos(LAT), math.sin(LAT)]))
    force = -C_bg @ earth.gravity_g(LAT, HEIGHT)
    return ImuSample(k * DT_NS, 1e-2, rate * 1e-2, force * 1e-2, "imu")


def driven(change: bool, fixes: bool) -> tuple[np.ndarray, np.ndarray]:
    """Solution row and covariance after a second at rest, half of it after a change of sensors."""
    nav, row = navigator(), np.zeros(S.SIZE)
    for k in range(1, 101):
        if k == 51 and change:
            nav.step(ImuChange(k * DT_NS, "imu", 8, 0, 0, 0, OWED, OVER, BIAS, WALK))
        for event in nav.step(rest(k)):
            if isinstance(event, Solution):
                row = event.state
        if fixes and k in (10, 30):
            sigma = np.ones(3)
            nav.step(GnssFix(k * DT_NS, LAT, 0.0, HEIGHT, sigma, None, None, FixType.FIX_3D, "gnss"))
    return row, nav.covariance()


def test_without_aids_what_is_owed_is_put_right() -> None:
    (row, P), (plain, P0) = driven(True, False), driven(False, False)
    # half a second with the tilt that was put right: 0.5 s * g * 3.7 mrad of more velocity at most
    np.testing.assert_allclose(row[S.V] - plain[S.V], dcm_from_quat(Q) @ OWED[1], atol=0.02)
    turned = dcm_from_quat(plain[S.Q]).T @ dcm_from_quat(row[S.Q])
    np.testing.assert_allclose(
        [turned[2, 1], turned[0, 2], turned[1, 0]], OWED[0], atol=2e-5
    )  # second order of 4 mrad
    # nothing but the biases became less sure: over half a second that is 5e-4 m/s and 1.5e-6 rad
    np.testing.assert_allclose(np.sqrt(np.diag(P)[3:6]), np.sqrt(np.diag(P0)[3:6]), rtol=0.02)


def test_with_aids_the_state_stays_and_is_less_sure() -> None:
    (row, P), (plain, P0) = driven(True, True), driven(False, True)
    np.testing.assert_allclose(row[S.V], plain[S.V], atol=1e-9)
    np.testing.assert_allclose(row[S.Q], plain[S.Q], atol=1e-12)
    more = np.diag(P) - np.diag(P0)
    turn, push = np.sum(OWED**2, axis=1)
    # a fault that has grown to twice its mean: in the biases, and the force as a tilt of so much
    grown, level, half = (2.0 / OVER) ** 2, np.array([1.0, 1.0, 0.0]), 0.5
    tilt = turn + grown * push / 9.8**2
    # what tilt and biases have made of it half a second later
    velocity = push * (1.0 + grown * half**2) + tilt * 9.8**2 * half**2 * level
    assert more[3:6] == pytest.approx(velocity, rel=5e-3)
    assert more[6:9] == pytest.approx(turn * (1.0 + grown * half**2) + level * (tilt - turn), rel=5e-3)
    # two metres by a velocity that was wrong for half of the time; half a second adds less than a hundredth
    assert more[0:3] == pytest.approx(np.full(3, push * (0.5 * OVER) ** 2), rel=0.02)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_while_it_stands_by_nothing_happens() -> None:
    nav = Navigator(NavigatorConfig(imu=ImuErrors(1e-6, 1e-4, 1e-7, 1e-3)))
    assert nav.step(ImuChange(0, "imu", 8, 0, 0, 0, OWED, OVER, BIAS, WALK)) == []
    nav.start(0, "static")
    nav.step(rest(1))
    assert nav.step(ImuChange(2 * DT_NS, "imu", 8, 0, 0, 0, OWED, OVER, BIAS, WALK)) == []


def test_noise_is_that_of_the_sensors_that_are_left() -> None:
    """Attitude and velocity of many runs without aids, after the change as wrong as they say they are."""
    left = np.delete(GEOMETRIES["cone"], (0, 1), axis=0)
    cofactor = np.linalg.inv(left.T @ left)
    sensor = np.array([1e-4, 1e-3])
    walk = sensor[:, None, None] ** 2 * cofactor
    root = np.linalg.cholesky(walk * DT_NS * 1e-9)
    # six sensors on a cone have half the variance of one
    config = NavigatorConfig(imu=ImuErrors(*(np.sqrt(0.5) * sensor), 1e-12, 1e-12), zero_velocity=None)
    rng = np.random.default_rng(7)
    total = 0.0
    for run in range(RUNS + 1):
        nav = Navigator(config)
        nav.begin(known())
        nav.step(ImuChange(DT_NS, "imu", 3, 0, 3, 0, np.zeros((2, 3)), OVER, np.zeros((2, 3)), walk))
        row = np.zeros(S.SIZE)
        for k in range(1, 21):
            noise = root @ rng.standard_normal((2, 3, 1)) if run else np.zeros((2, 3, 1))
            one = rest(k)
            one = one._replace(dtheta=one.dtheta + noise[0, :, 0], dv=one.dv + noise[1, :, 0])
            for event in nav.step(one):
                if isinstance(event, Solution):
                    row = event.state
        if not run:
            truth = row
            continue
        C = dcm_from_quat(row[S.Q]) @ dcm_from_quat(truth[S.Q]).T
        error = np.concatenate((row[S.V] - truth[S.V], [C[2, 1], C[0, 2], C[1, 0]]))
        total += error @ np.linalg.solve(nav.covariance()[3:, 3:], error)
    # 999 of 1000 such sums; with the noise of all six it would be 16.4 of a run, not 6
    low, high = stats.chi2(6 * RUNS).ppf([5e-4, 1.0 - 5e-4])
    assert low < total < high
