"""Rows against their own differences, and the kernel against its readable parts."""

from __future__ import annotations

import numpy as np
import pytest

from nav import rotation as rot
from nav.align.types import TransferConfig
from nav.earth import position_matrix
from nav.strapdown.mechanize import NavState, update
from nav.transfer import model
from nav.transfer.kernels import S_DT, S_FB, S_SIZE, S_WB, run
from nav.transfer.model import Instant
from nav.transfer.stage import correct
from nav.transfer.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    DELAY,
    GYRO_AXES,
    GYRO_BIAS,
    SIZE,
    X_REST,
    X_SIZE,
)
from nav.types import MasterState

RNG = np.random.default_rng(7)


def state():
    """A nominal state with something in every place."""
    x = np.zeros(X_SIZE)
    x[0:4] = rot.quat_from_euler(0.7, 0.1, -0.4)
    x[4:7] = 60.0, 180.0, -3.0
    x[7:16] = position_matrix(0.6, 0.3, 0.2).ravel()
    x[16] = 3000.0
    scale = np.concatenate(
        [[1e-4] * 3, [1e-2] * 3, [1e-3] * 18, [5e-3] * 3, [1e-3] * 3, [2e-3] * 3, [0.1] * 4]
    )
    x[18:X_REST] = scale * RNG.standard_normal(len(scale))
    x[X_REST:] = 0.0, 0.9, 9.7
    return x


def test_kernel_is_the_readable_update() -> None:
    """Sample by sample: biases, axes and the force at rest taken out, then `mechanize.update`; 1e-12."""
    x = state()
    rows = np.column_stack(
        [
            np.full(7, 0.01),
            5e-3 * RNG.standard_normal((7, 3)),
            [0.0, 0.0, 0.098] + RNG.standard_normal((7, 3)) * 0.02,
        ]
    )
    nav = NavState(x[0:4], x[4:7], x[7:16].reshape(3, 3), float(x[16]))
    sums = np.zeros(S_SIZE)
    turned, gained = np.zeros(3), np.zeros(3)
    G = np.eye(3) + x[model.place(GYRO_AXES)].reshape(3, 3)
    A = np.eye(3) + x[model.place(ACCEL_AXES)].reshape(3, 3)
    for i, share in ((1, 0.7), (2, 1.0), (3, 1.0), (4, 0.4)):
        dt = share * rows[i, 0]
        turn = np.linalg.solve(G, share * rows[i, 1:4] - x[model.place(GYRO_BIAS)] * dt)
        rest = x[X_REST:] * dt
        push = np.linalg.solve(A, share * rows[i, 4:7] - x[model.place(ACCEL_BIAS)] * dt - rest) + rest
        nav = update(nav, turn[None], push[None], dt)
        turned, gained = turned + turn, gained + push
    run(x, rows, 1, 0.3, 4, 0.4, sums)
    assert x[0:4] == pytest.approx(nav.q_nb, abs=1e-12)
    assert x[4:7] == pytest.approx(nav.v_n, rel=1e-12)
    assert x[7:16] == pytest.approx(nav.C_en.ravel(), abs=1e-12)
    assert x[16] == pytest.approx(nav.height, rel=1e-12)
    assert sums[S_DT] == pytest.approx(0.031, rel=1e-12)
    assert sums[S_WB : S_WB + 3] == pytest.approx(turned, abs=1e-12)
    assert sums[S_FB : S_FB + 3] == pytest.approx(gained, abs=1e-12)


@pytest.mark.parametrize(
    "make", [model.position_rows, model.velocity_rows, model.attitude_rows, model.rate_rows]
)
def test_rows_are_the_derivatives_of_the_residuals(make) -> None:
    """By central differences over every state but the delay, which moves the time."""
    built = rot.dcm_from_euler(0.3, 0.2, -0.1)
    transfer = TransferConfig(lever_arm=np.array([4.0, -1.0, 0.5]), C_ab=built, latency=0.0)
    x, w = state(), np.array([0.02, 0.5, -0.03])
    # the master as the slave sees it, so that residuals are small, as linear rows want them
    C = rot.dcm_from_quat(x[0:4])
    C_ab = rot.dcm_from_quat(rot.quat_from_rotvec(x[model.place(model.MOUNTING)])) @ built
    C_gn = rot.dcm_from_quat(rot.quat_from_rotvec(np.array([0.0, 0.0, 0.2])))
    q_ga = rot.quat_from_dcm(C_gn @ C @ C_ab.T)
    m = MasterState(0, 0.6, 0.3, 2999.0, C_gn @ x[4:7], q_ga, C_ab @ w, None, *(np.ones(3),) * 3, True, "")

    def rows(dx):
        """At the state with these errors taken out, which the rate feels too."""
        y = x.copy()
        correct(y, dx)
        felt = w + dx[GYRO_BIAS] + dx[GYRO_AXES].reshape(3, 3) @ w
        now = Instant(felt, np.zeros(3), np.zeros(3), 0.0, 0.0, np.zeros((2, 3)), np.zeros((2, 3)))
        return make(model.scene(y, now, m, transfer))

    H = rows(np.zeros(SIZE)).H
    for k in range(SIZE):
        if k == DELAY:
            continue
        step = np.zeros(SIZE)
        step[k] = 1e-4
        # what is taken out lowers the residual by its row
        difference = (rows(-step).r - rows(step).r) / 2e-4
        # rows hold to first order in the residual's own angles, of some mrad
        assert difference == pytest.approx(H[:, k], abs=0.02 * max(1.0, float(np.abs(H[:, k]).max()))), k
