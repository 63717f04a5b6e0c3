"""The covariance of a solution against the row's sigmas and against errors that are drawn."""

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.filter import states as st
from nav.filter.propagate import ROW_D, ROW_DT, ROW_N, ROW_NOISE, WORK_SIZE, propagate, row_size, solution_row
from nav.filter.report import solution_covariance
from nav.strapdown.kernels import X_C, X_H, X_Q
from nav.types import S
from tests.nav.filter.making import covariance, disturbed, nominal

LEVER = np.array([0.4, -1.3, 0.8])


def parameters():
    par = np.zeros(st.P_SIZE)
    par[st.P_LP : st.P_LP + 3] = LEVER
    return par


def row(x, P, par):
    out = np.empty(S.SIZE)
    assert solution_row(x, P, par, out)
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


def test_axes_of_accelerometers_make_nothing_of_the_force_at_rest():
    """What they make of gravity is in the bias that was found at rest; a force beside it shows them."""
    row = np.zeros(row_size(2))
    row[ROW_DT], row[ROW_NOISE], row[ROW_N] = 0.02, 1.0, 2
    x, par = nominal(seed=2), np.zeros(st.P_SIZE)
    axes = np.eye(3) + x[st.X_MA : st.X_MA + 9].reshape(3, 3)
    rest, bias = x[st.X_F0 : st.X_F0 + 3], x[st.X_BA : st.X_BA + 3]
    for beside in (np.zeros(3), np.array([1.0, -2.0, 0.5])):
        y = x.copy()
        row[ROW_D + 6 : ROW_D + 9] = row[ROW_D + 9 : ROW_D + 12] = 0.01 * (rest + axes @ beside + bias)
        propagate(y, np.zeros((st.FULL, st.FULL)), par, np.zeros(WORK_SIZE), row)
        np.testing.assert_allclose(y[st.X_F : st.X_F + 3], rest + beside, rtol=1e-12)


@pytest.mark.parametrize("distance", [0.5, 3.0, 2e5])  # m from the pole
def test_the_output_point_is_where_it_is_in_space(distance):
    """Position and heading next to a pole, where half a metre turns longitude by as much as you like."""
    lat, lon, wander = np.pi / 2 - distance / 6_399_594.0, 2.0, 0.7
    x, par = nominal(seed=3), parameters()
    C_en = earth.position_matrix(lat, lon, wander)
    x[X_C : X_C + 9] = C_en.ravel()
    q_vb = x[st.X_QV : st.X_QV + 4]
    out = row(x, np.zeros((st.FULL, st.FULL)), par)
    here = np.array(earth.geodetic_to_xyz(lat, lon, x[X_H]))
    C_eb = C_en @ rot.dcm_from_quat(x[X_Q : X_Q + 4])
    said = np.array(earth.geodetic_to_xyz(*out[:3]))
    # straight on and along the curved surface differ by l^2 / 2R
    assert np.linalg.norm(said - (here + C_eb @ LEVER)) < 5e-7
    C_ev = earth.position_matrix(out[0], out[1]) @ rot.dcm_from_quat(out[S.Q])
    # its vertical is another, by the lever arm over the Earth's radius, and its vehicle is turned with that
    turned = rot.rotvec_from_quat(rot.quat_from_dcm(C_ev.T @ C_eb @ rot.dcm_from_quat(q_vb).T))
    assert np.linalg.norm(turned) < 1.1 * np.linalg.norm(LEVER) / 6.35e6
