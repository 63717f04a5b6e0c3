"""Vibration faster than half the sampling rate: noise that the increments themselves show."""

import numpy as np

from nav.filter import states as st
from nav.filter.propagate import ROW_D, ROW_DT, ROW_N, ROW_NOISE, WORK_MID, WORK_SIZE, propagate, row_size
from nav.strapdown.kernels import M_C
from tests.nav.filter.making import covariance, nominal

DT = 0.02


def through(row, gyro, accel):
    x, P = nominal(), covariance(st.FULL)
    work = np.zeros(WORK_SIZE)
    par = np.zeros(st.P_SIZE)
    par[st.P_VIB_G], par[st.P_VIB_A] = gyro, accel
    propagate(x, P, par, work, row)
    c = WORK_MID + M_C
    return P, work[c : c + 9].reshape(3, 3).copy()


def test_it_enters_along_the_axis_that_shakes():
    row = np.zeros(row_size(2))
    row[ROW_DT], row[ROW_NOISE], row[ROW_N] = DT, 1.0, 2
    shake, jolt = np.array([0.0, 3e-3, 1e-4]), np.array([0.05, 0.0, 0.01])
    d = row[ROW_D:]
    d[0:3], d[3:6] = -shake / 2, shake / 2
    d[6:9], d[9:12] = -jolt / 2, jolt / 2
    quiet, C = through(row, 0.0, 0.0)
    P, _ = through(row, 1.0, 0.5)
    added = P - quiet
    # rounding of the covariance's largest elements
    np.testing.assert_allclose(added[st.PHI, st.PHI], C @ np.diag(shake**2) @ C.T, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        added[st.VELOCITY, st.VELOCITY], C @ np.diag(0.5 * jolt**2) @ C.T, rtol=1e-9, atol=1e-12
    )
