"""Vibration faster than half the sampling rate: noise that the increments themselves show."""

import numpy as np

from nav.filter import states as st
from nav.filter.propagate import ROW_DT, ROW_NOISE, ROW_SIZE, WORK_ROWS, propagate
from nav.strapdown.kernels import M_C
from tests.nav.filter.making import covariance, nominal

DT = 0.02


def through(row, gyro, accel):
    x, P = nominal(), covariance(st.FULL)
    work = np.zeros((WORK_ROWS, st.FULL))
    par = np.zeros(st.P_SIZE)
    par[st.P_VIB_G], par[st.P_VIB_A] = gyro, accel
    propagate(x, P, par, work, row)
    return P, work[19, M_C : M_C + 9].reshape(3, 3).copy()


def test_it_enters_along_the_axis_that_shakes():
    row = np.zeros(ROW_SIZE)
    row[ROW_DT], row[ROW_NOISE] = DT, 1.0
    shake, jolt = np.array([0.0, 3e-3, 1e-4]), np.array([0.05, 0.0, 0.01])
    row[0:3], row[3:6] = -shake / 2, shake / 2
    row[6:9], row[9:12] = -jolt / 2, jolt / 2
    quiet, C = through(row, 0.0, 0.0)
    P, _ = through(row, 1.0, 0.5)
    added = P - quiet
    # rounding of the covariance's largest elements
    np.testing.assert_allclose(added[st.PHI, st.PHI], C @ np.diag(shake**2) @ C.T, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        added[st.VELOCITY, st.VELOCITY], C @ np.diag(0.5 * jolt**2) @ C.T, rtol=1e-9, atol=1e-12
    )
