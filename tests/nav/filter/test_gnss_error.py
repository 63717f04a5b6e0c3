"""The slowly varying error of a receiver's position: how it decays, what it does to a fix, what it costs."""

import math

import numpy as np
import pytest

from nav.filter import states as st
from nav.filter.initial import initial_state
from nav.filter.kalman import correct
from nav.filter.measurements import gnss_position
from nav.filter.propagate import ROW_D, ROW_DT, ROW_N, ROW_NOISE, WORK_SIZE, propagate, row_size
from nav.filter.settings import ImuErrors, NavigatorConfig, parameters
from nav.navigator import Navigator
from tests.nav.filter.making import nominal
from tests.nav.truth import Drive, fix, hand_over, play, samples

SLOW, TAU, DT = (0.3, 0.5), 100.0, 0.02
CONFIG = NavigatorConfig(ImuErrors(1e-5, 1e-4, 1e-6, 1e-3), gnss_correlated=SLOW, gnss_correlation=TAU)
STEADY = np.diag(np.square([SLOW[0], SLOW[0], SLOW[1]]))


def row():
    out = np.zeros(row_size(2))
    out[ROW_D + 8] = out[ROW_D + 11] = 9.8 * DT / 2
    out[ROW_DT], out[ROW_NOISE], out[ROW_N] = DT, 1.0, 2
    return out


def test_it_keeps_its_sigma_and_forgets_with_its_time():
    x, par = nominal(v=(0.0, 0.0, 0.0)), parameters(CONFIG)
    P, work = np.zeros((st.RECEIVER, st.RECEIVER)), np.zeros(WORK_SIZE)
    P[st.GNSS, st.GNSS] = STEADY
    P[0, st.GNSS.start] = P[st.GNSS.start, 0] = -0.09
    x[st.X_GB : st.X_GB + 3] = 1.0
    for _ in range(500):
        propagate(x, P, par, work, row())
    left = math.exp(-10.0 / TAU)
    # steps of first order: (dt / tau) times what is lost in the time
    np.testing.assert_allclose(P[st.GNSS, st.GNSS], STEADY, rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(x[st.X_GB : st.X_GB + 3], left, rtol=1e-4)
    assert P[0, st.GNSS.start] == pytest.approx(-0.09 * left, rel=1e-4)
    np.testing.assert_array_equal(P, P.T)


def test_a_fix_is_off_by_it():
    """The residual moves with the state by one, and the update takes out what it must."""
    par, out = parameters(CONFIG), np.zeros(12)
    z = np.concatenate(([0.0], [4e6, 5e5, 4.9e6], [0.2, 0.2, 0.2]))
    residual = []
    for error in (0.0, 0.25):
        x = nominal(wander=0.0)
        x[st.X_GB] = error
        gnss_position(x, np.eye(st.RECEIVER), par, z.copy(), -1.0, out)
        residual.append(out[0])
    # differences of positions at 6400 km are good to 1e-9 m
    assert residual[1] - residual[0] == pytest.approx(0.25, abs=1e-8)
    dx = np.zeros(st.RECEIVER)
    dx[st.GNSS] = 0.1, 0.2, 0.3
    x = nominal()
    correct(x, dx)
    np.testing.assert_allclose(x[st.X_GB : st.X_GB + 3], [-0.1, -0.2, -0.3])


def test_the_first_position_carries_it():
    init = hand_over(Drive(radius=0.0), sigmas=np.full(15, 0.1))
    _, P, _ = initial_state(init, CONFIG)
    np.testing.assert_allclose(P[st.POSITION, st.GNSS], -STEADY)
    # what a fix measures is position plus error: known to the alignment's own sigma
    H = np.zeros((3, st.RECEIVER))
    H[:, st.POSITION] = H[:, st.GNSS] = np.eye(3)
    np.testing.assert_allclose(H @ P @ H.T, 0.01 * np.eye(3), atol=1e-12)


def test_many_fixes_with_one_error_are_not_many():
    """Ten seconds at rest with one error of the receiver: sigma stays above it, the white part averages."""
    drive = Drive(radius=0.0, sway=0.0, nod=0.0)
    rng = np.random.default_rng(0)
    sigma = np.hypot(0.2, [SLOW[0], SLOW[0], SLOW[1]])
    aids = [(0.2 * k + 0.003, fix(drive, 0.2 * k + 0.003, sigma=sigma)) for k in range(1, 50)]
    aids = [(t, f._replace(lat=f.lat + rng.normal() * 0.2 / 6.4e6, height=f.height + 0.5)) for t, f in aids]
    navigator = Navigator(CONFIG)
    navigator.begin(hand_over(drive))
    dtheta, dv = drive.increments(500, DT)
    play(navigator, samples(dtheta, dv, DT), aids)
    claimed = np.sqrt(np.diag(navigator.covariance())[0:3])
    assert np.all(claimed > 0.9 * np.array([SLOW[0], SLOW[0], SLOW[1]]))
    assert np.all(claimed < 1.2 * np.array([SLOW[0], SLOW[0], SLOW[1]]))
