"""The error model against the mechanisation, its sparse twin, and the update against the textbook."""

import math

import numpy as np
import pytest

from nav.errors.model import error_dynamics
from nav.filter import states as st
from nav.filter.covariance import predict, predict_readable
from nav.filter.kalman import GATES, update, update_readable
from nav.filter.propagate import (
    ROW_D,
    ROW_DT,
    ROW_N,
    ROW_NOISE,
    WORK_MID,
    WORK_SIZE,
    propagate,
    row_size,
)
from nav.strapdown.azimuth import AZIMUTH_LAWS, azimuth_control
from nav.strapdown.kernels import M_C, M_EN, M_F, M_G, M_IE, M_K, M_SIZE, M_V
from tests.nav.filter.making import covariance, difference, disturbed, nominal

DT = 0.02


def row_of(x):
    """Increments of a turn and a force with everything in them."""
    row = np.zeros(row_size(2))
    d = row[ROW_D:]
    d[0:3] = d[3:6] = np.array([0.3, -0.2, 0.5]) * DT / 2
    d[6:9] = d[9:12] = np.array([4.0, -3.0, 9.0]) * DT / 2
    row[ROW_DT], row[ROW_NOISE], row[ROW_N] = DT, 1.0, 2
    return row


def through(x, u=0.0):
    work, par = np.zeros(WORK_SIZE), np.zeros(st.P_SIZE)
    par[st.P_U :] = u
    y, P = x.copy(), np.zeros((st.FULL, st.FULL))
    propagate(y, P, par, work, row_of(x))
    return y, work[WORK_MID : WORK_MID + M_SIZE].copy()


def dynamics(mid, y):
    return error_dynamics(
        mid[M_C : M_C + 9].reshape(3, 3),
        y[st.X_F : st.X_F + 3],
        y[st.X_W : st.X_W + 3],
        mid[M_V : M_V + 3],
        mid[M_IE : M_IE + 3],
        mid[M_EN : M_EN + 3],
        tuple(mid[M_K : M_K + 3]),
        mid[M_G],
        y[st.X_F0 : st.X_F0 + 3],
    )


STEPS = np.concatenate(
    [[2000.0] * 3, [3.0] * 3, [1e-4] * 3, [1e-4] * 3, [1e-3] * 3, [1e-3] * 3, [1.0], [1e-4] * 18]
)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("k", range(st.FULL))
def test_corrections_have_the_signs_of_the_definitions(k, seed):
    x = nominal(seed=seed)
    e = np.zeros(st.FULL)
    e[k] = STEPS[k]
    # second order: 2 km on the Earth's radius turn by 3e-4
    np.testing.assert_allclose(difference(disturbed(x, e), x), e, atol=4e-4 * STEPS[k], rtol=0)


@pytest.mark.parametrize("law", AZIMUTH_LAWS)
@pytest.mark.parametrize("k", range(st.FULL))
def test_errors_grow_as_the_model_says(k, law):
    """Two neighbouring mechanisations against F: central difference over one update.

    A rotating frame turns so fast here that a term which is missing would show.
    """
    x, u = nominal(), azimuth_control(law, 0.05 if AZIMUTH_LAWS[law].turns else 0.0)
    e = np.zeros(st.FULL)
    e[k] = STEPS[k]
    y, mid = through(x, u)
    plus, minus = through(disturbed(x, e), u)[0], through(disturbed(x, -e), u)[0]
    grown = (difference(plus, y) - difference(minus, y)) / 2
    start = (difference(disturbed(x, e), x) - difference(disturbed(x, -e), x)) / 2
    F = dynamics(mid, y)
    Phi = np.eye(st.FULL) + F * DT + F @ F * (DT * DT / 2)
    # the model is that of the middle of the interval and of first order in the eccentricity for
    # dw/dh; rounding of the position matrix is 1e-9 m
    scale = np.concatenate([[1e-6] * 3, [1e-6] * 3, [2e-9] * 3, np.full(st.FULL - 9, 1e-12)])
    bound = scale + 0.02 * np.abs(F * DT) @ np.abs(e)
    assert np.all(np.abs(grown - Phi @ start) <= bound)


@pytest.mark.parametrize("n", [st.BASIC, st.FULL])
@pytest.mark.parametrize("turn", [0.0, 3e-3])
def test_prediction_is_the_twin(n, turn):
    y, mid = through(nominal())
    mid[M_EN + 2] = turn
    # the record holds the force of the whole update; the readable model turns it from b
    mid[M_F : M_F + 3] = mid[M_C : M_C + 9].reshape(3, 3) @ y[st.X_F : st.X_F + 3]
    P = covariance(n)
    par = np.zeros(st.P_SIZE)
    par[st.P_Q : st.P_Q + st.FULL] = np.linspace(1e-6, 1e-3, st.FULL)
    expected = predict_readable(P, dynamics(mid, y)[:n, :n], par[st.P_Q : st.P_Q + n], DT)
    work = np.zeros(WORK_SIZE)
    predict(P, mid, y, DT, par, 1.0, 0.0, 0.0, work)
    d = np.sqrt(np.diag(expected))
    assert np.max(np.abs(P - expected) / np.outer(d, d)) < 1e-12
    np.testing.assert_array_equal(P, P.T)


@pytest.mark.parametrize("m", [1, 2, 3, 6])
def test_update_is_the_textbooks(m):
    rng = np.random.default_rng(m)
    n = st.FULL
    P = covariance(n)
    H = rng.normal(size=(m, n)) / np.sqrt(np.diag(P))
    R = np.diag(rng.uniform(0.5, 2.0, m))
    X = 0.05 * rng.normal(size=(n, m)) * np.sqrt(np.diag(P))[:, None]
    r = rng.normal(size=m)
    dx, expected, nis = update_readable(P, H, r, R, X)
    got, S, Q = np.empty(n), np.empty((m, m)), P.copy()
    assert update(Q, H, r, R, X, np.inf, got, S) == pytest.approx(nis, rel=1e-10)
    d = np.sqrt(np.diag(P))
    assert np.max(np.abs(Q - expected) / np.outer(d, d)) < 1e-11
    assert np.max(np.abs(got - dx) / d) < 1e-11


def test_gate_leaves_everything_alone():
    n = st.BASIC
    P = covariance(n)
    H = np.zeros((1, n))
    H[0, 0] = 1.0
    R = np.eye(1)
    r = np.array([100.0 * np.sqrt(P[0, 0] + 1.0)])
    Q, dx, S = P.copy(), np.ones(n), np.empty((1, 1))
    assert update(Q, H, r, R, np.zeros((n, 1)), GATES[1], dx, S) == pytest.approx(1e4)
    np.testing.assert_array_equal(Q, P)
    assert not dx.any()


def test_covariance_stays_positive_under_precise_measurements():
    """From kilometres to a tenth of a millimetre and on: the short form would lose the sign."""
    n = st.BASIC
    P = covariance(n) * 1e4
    dx, S = np.empty(n), np.empty((3, 3))
    for k in range(200):
        H = np.zeros((3, n))
        H[:, 3 * (k % 5) : 3 * (k % 5) + 3] = np.eye(3)
        nis = update(P, H, np.zeros(3), np.eye(3) * 1e-8, np.zeros((n, 3)), np.inf, dx, S)
        assert nis == 0.0
        d = np.sqrt(np.diag(P))
        assert np.linalg.eigvalsh(P / np.outer(d, d)).min() > -1e-9


def test_gates_are_the_quantiles():
    """Survival function of chi-square in closed form: erfc and exp with finite sums."""
    for m in range(1, 7):
        y = GATES[m] / 2
        if m % 2 == 0:
            tail = math.exp(-y) * sum(y**k / math.factorial(k) for k in range(m // 2))
        else:
            tail = math.erfc(math.sqrt(y)) + math.exp(-y) * sum(
                y ** (k + 0.5) / math.gamma(k + 1.5) for k in range(m // 2)
            )
        assert tail == pytest.approx(1e-4, rel=1e-4)
