"""The covariance of a solution against the row's sigmas and against errors that are drawn."""

import numpy as np
import pytest

from nav import rotation as rot
from nav.filter import states as st
from nav.filter.propagate import ROW_D, ROW_DT, ROW_N, ROW_NOISE, WORK_SIZE, propagate, row_size, solution_row
from nav.filter.report import solution_covariance
from nav.types import S
from tests.nav.filter.making import covariance, disturbed, nominal

LEVER = np.array([0.4, -1.3, 0.8])


def parameters():
    par = np.zeros(st.P_SIZE)
    par[st.P_LP : st.P_LP + 3] = LEVER
    return par


def row(x, P, par):
    out = np.empty(S.SIZE)
    assert solution_row(x, P, par, np.zeros(st.FULL), out)
    return out


@pytest.mark.parametrize("seed", range(3))
def test_its_diagonal_is_the_rows_sigmas(seed):
    x, P, par = nominal(seed=seed), covariance(st.FULL), parameters()
    x[st.X_ROLL] = 1e-3
    sigma = np.sqrt(np.diag(solution_covariance(x, P, par)))
    out = row(x, P, par)
    said = np.concatenate((out[S.SIGMA_P], out[S.SIGMA_V], out[S.SIGMA_PHI]))
    np.testing.assert_allclose(sigma, said, rtol=1e-9)


def test_velocity_and_attitude_vary_together_as_it_says():
    """A rank-one covariance is one error: the solution moves along it, in every component."""
    x, par = nominal(seed=1), parameters()
    e = np.zeros(st.FULL)
    # small, so that second order is 1e-5 of it
    e[st.VELOCITY], e[st.PHI], e[st.MOUNTING] = [3e-5, -2e-5, 1e-5], [2e-5, -1e-5, 3e-5], [1e-5, -4e-5]
    P = np.outer(e, e)
    zero = np.zeros((st.FULL, st.FULL))
    true, wrong = row(x, zero, par), row(disturbed(x, e), zero, par)
    turn = rot.quat_multiply(wrong[S.Q], rot.quat_conjugate(true[S.Q]))
    moved = np.concatenate((wrong[S.V] - true[S.V], rot.rotvec_from_quat(turn)))
    expected = np.outer(moved, moved)
    scale = np.max(np.abs(moved)) ** 2
    assert np.max(np.abs(solution_covariance(x, P, par)[3:, 3:] - expected)) < 1e-3 * scale


def test_motion_adds_what_scale_and_axes_do_to_it():
    """A turn adds variance about its axis only, a change of speed to every velocity."""
    par = np.zeros(st.P_SIZE)
    par[st.P_TURN], par[st.P_PUSH] = 4e-10, 2e-6
    P = np.zeros((st.BASIC, st.BASIC))
    x = nominal(seed=2, v=(0.0, 0.0, 0.0))
    x[st.X_BG : st.X_BG + 3] = x[st.X_BA : st.X_BA + 3] = 0.0
    work = np.zeros(WORK_SIZE)
    increments = np.zeros(row_size(2))
    increments[ROW_DT], increments[ROW_NOISE], increments[ROW_N] = 0.02, 1.0, 2
    axis_b, pushed = np.array([0.0, 0.0, 1.0]), 0.0
    for _ in range(50):
        increments[ROW_D + 2] = increments[ROW_D + 5] = 0.005
        increments[ROW_D + 8] = increments[ROW_D + 11] = 0.1
        propagate(x, P, par, work, increments)
        pushed += np.linalg.norm(x[st.X_A : st.X_A + 3]) * 0.02
    # half a radian about an axis that stays where it is; Earth rate is 7e-5 / 0.5 of it
    axis_n = rot.dcm_from_quat(x[:4]) @ axis_b
    expected = par[st.P_TURN] * 0.5 * np.outer(axis_n, axis_n)
    np.testing.assert_allclose(P[st.PHI, st.PHI], expected, atol=2e-3 * par[st.P_TURN] * 0.5)
    # phi reaches velocity by the force within the second: less than a hundredth of the push's share
    np.testing.assert_allclose(np.diag(P)[st.VELOCITY], par[st.P_PUSH] * pushed, rtol=1e-2)
