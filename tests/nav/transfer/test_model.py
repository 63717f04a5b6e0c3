"""Rows against their own differences, and the kernel against its readable parts."""

from __future__ import annotations

import numpy as np
import pytest

from nav import rotation as rot
from nav.align.types import TransferConfig
from nav.earth import EARTH_RATE, ecef, geodetic, gravity_g, position_angles, position_matrix
from nav.strapdown.mechanize import NavState, update
from nav.transfer import model
from nav.transfer.correction import correct
from nav.transfer.instant import (
    I_DW,
    I_GAINED,
    I_RATES,
    I_SIGMA,
    I_SIZE,
    I_SPREAD,
    I_TURNS,
    I_W,
    I_WAY,
    instant,
)
from nav.transfer.kernels import S_DT, S_FB, S_SIZE, S_WB, run
from nav.transfer.moved import moved
from nav.transfer.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    DELAY,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_AXES,
    GYRO_BIAS,
    LEVER,
    MOUNTING,
    SIZE,
    X_REST,
    X_SIZE,
    place,
)
from nav.types import MasterState
from tests.nav.transfer.making import shown

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
    G = np.eye(3) + x[place(GYRO_AXES)].reshape(3, 3)
    A = np.eye(3) + x[place(ACCEL_AXES)].reshape(3, 3)
    for i, share in ((1, 0.7), (2, 1.0), (3, 1.0), (4, 0.4)):
        dt = share * rows[i, 0]
        turn = np.linalg.solve(G, share * rows[i, 1:4] - x[place(GYRO_BIAS)] * dt)
        rest = x[X_REST:] * dt
        push = np.linalg.solve(A, share * rows[i, 4:7] - x[place(ACCEL_BIAS)] * dt - rest) + rest
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
    C_ab = rot.dcm_from_quat(rot.quat_from_rotvec(x[place(MOUNTING)])) @ built
    C_gn = rot.dcm_from_quat(rot.quat_from_rotvec(np.array([0.0, 0.0, 0.2])))
    q_ga = rot.quat_from_dcm(C_gn @ C @ C_ab.T)
    m = MasterState(0, 0.6, 0.3, 2999.0, C_gn @ x[4:7], q_ga, C_ab @ w, None, *(np.ones(3),) * 3, True, "")

    def rows(dx):
        """At the state with these errors taken out, which the rate feels too."""
        y = x.copy()
        correct(y, dx)
        return shown(make, y, w + dx[GYRO_BIAS] + dx[GYRO_AXES].reshape(3, 3) @ w, m, transfer)

    H = rows(np.zeros(SIZE))[1]
    for k in range(SIZE):
        if k == DELAY:
            continue
        step = np.zeros(SIZE)
        step[k] = 1e-4
        # what is taken out lowers the residual by its row
        difference = (rows(-step)[0] - rows(step)[0]) / 2e-4
        # rows hold to first order in the residual's own angles, of some mrad
        assert difference == pytest.approx(H[:, k], abs=0.02 * max(1.0, float(np.abs(H[:, k]).max()))), k


def test_nothing_is_left_where_the_master_is_as_the_slave_thinks() -> None:
    """Arm, mounting and bend by matrices: residuals vanish but for the level's turn along the arm, 1e-6.

    Four metres are a millionth of the Earth's radius, by which the master's vertical is another.
    """
    built = rot.dcm_from_euler(0.3, 0.2, -0.1)
    transfer = TransferConfig(lever_arm=np.array([4.0, -1.0, 0.5]), C_ab=built)
    x, w = state(), np.array([0.02, 0.5, -0.03])
    C, C_en = rot.dcm_from_quat(x[0:4]), x[7:16].reshape(3, 3)
    C_ba = built.T @ rot.dcm_from_quat(rot.quat_from_rotvec(-x[place(MOUNTING)]))
    C_fa = C_ba @ rot.dcm_from_quat(rot.quat_from_rotvec(-x[place(FLEXURE)]))
    arm = C_ba @ (transfer.lever_arm + x[place(LEVER)])
    lat, lon, wander = position_angles(C_en)
    there = ecef(lat, lon, x[16]) - C_en @ C @ arm
    lat, lon, height = (float(part) for part in geodetic(there))
    C_gn = rot.dcm_from_quat(rot.quat_from_rotvec(np.array([0.0, 0.0, wander])))
    v = C_gn @ (x[4:7] - C @ rot.cross(w - C.T @ (EARTH_RATE * C_en[2]), arm))
    w_a = C_fa.T @ (w - C_ba @ x[place(FLEXURE_RATE)])
    q_ga = rot.quat_from_dcm(C_gn @ C @ C_fa)
    m = MasterState(0, lat, lon, height, v, q_ga, w_a, None, *(np.ones(3),) * 3, True, "")
    for kind, largest in (
        (model.position_rows, 1e-8),
        (model.velocity_rows, 2e-6 * float(np.linalg.norm(v))),
        (model.attitude_rows, 2e-6),
        (model.rate_rows, 1e-15),
    ):
        r, _ = shown(kind, x, w, m, transfer)
        assert np.all(np.abs(r) < largest), kind


def test_an_instant_is_what_the_samples_say() -> None:
    """Of a rate that grows evenly, in samples of 4 ms: means over even spans are exact; biases come off."""
    x = np.zeros(X_SIZE)
    x[place(GYRO_BIAS)] = 1e-3, -2e-3, 3e-3
    x[place(GYRO_AXES)] = 1e-3 * np.arange(9)
    M = x[place(GYRO_AXES)].reshape(3, 3)
    w, dw, dt = np.array([0.3, -0.1, 0.2]), np.array([2.0, 1.0, -3.0]), 0.004
    t = dt * np.arange(1, 41)
    mean = w + np.outer(t - 0.5 * dt - 0.08, dw)
    f, jerk, pull = np.array([0.5, 1.0, 9.0]), np.array([20.0, -30.0, 10.0]), np.array([1.0, 2.0, 3.0])
    x[place(ACCEL_BIAS)] = 0.02, -0.01, 0.03
    x[place(ACCEL_AXES)] = 1e-3 * np.arange(9)
    x[X_REST:] = 0.1, -0.2, 9.7
    x[0:4] = rot.quat_from_rotvec(np.array([0.3, -0.4, 1.0]))
    felt = f + np.outer(t - 0.5 * dt - 0.08, jerk) + x[place(ACCEL_BIAS)]
    rows = np.column_stack([np.full(40, dt), (mean + x[place(GYRO_BIAS)]) * dt, felt * dt])
    t_ns = np.round(t * 1e9).astype(np.int64)
    now = instant(x, t_ns, rows, 40, 80_000_000, 0.02, 1e-4, pull)
    kept = np.eye(3) - M
    assert now[I_W : I_W + 3] == pytest.approx(kept @ w, rel=1e-12)
    assert now[I_DW : I_DW + 3] == pytest.approx(kept @ dw, rel=1e-9)
    # a sample long to either side: 8 ms
    assert now[I_SIGMA] == pytest.approx(1e-4 / np.sqrt(0.008), rel=1e-12)
    assert now[[I_SPREAD, I_WAY]] == pytest.approx(0.02)
    kept_f = np.eye(3) - x[place(ACCEL_AXES)].reshape(3, 3)
    for k, sign in enumerate((-1.0, 1.0)):
        turn, rate = now[I_TURNS + 3 * k :][:3], now[I_RATES + 3 * k :][:3]
        assert turn == pytest.approx(kept @ (w * 0.02 + sign * dw * 0.02**2 / 2.0), rel=1e-9)
        assert rate == pytest.approx(kept @ (sign * dw * 0.02), rel=1e-9)
        mean = f + sign * jerk * 0.01
        mean = x[X_REST:] + kept_f @ (mean - x[X_REST:])
        half = rot.quat_multiply(x[0:4], rot.quat_from_rotvec(0.5 * sign * turn))
        gained = sign * 0.02 * (rot.quat_rotate(half, mean) + pull)
        assert now[I_GAINED + 3 * k :][:3] == pytest.approx(gained, rel=1e-9)
    # a delay that is known to less than a change is taken over
    now = instant(x, t_ns, rows, 40, 80_000_000, 0.001, 1e-4, pull)
    assert now[[I_SPREAD, I_WAY]] == pytest.approx([0.001, 0.01])


def test_an_arm_that_swings_tells_no_delay() -> None:
    """The slave swings about a master that flies straight on: nothing of the slope of velocity is left.

    A roll of 60 deg/s, gathered within a third of a second; 8 m/s^2 at the arm's end. What is left is of the
    samples' ends: 1 % of it.
    """
    dt, arm = 0.004, np.array([3.0, 0.0, 0.5])
    t = dt * np.arange(41)

    def roll(t):
        return 3.0 * (t - 0.08) ** 2 + 0.6 * (t - 0.08)

    def rate(t):
        return 6.0 * (t - 0.08) + 0.6

    x = np.zeros(X_SIZE)
    x[0] = 1.0
    x[7:16] = np.eye(3).ravel()
    q = rot.quat_from_rotvec(np.outer(roll(t), [0.0, 1.0, 0.0]))
    v = rot.quat_rotate(q, np.cross(np.outer(rate(t), [0.0, 1.0, 0.0]), arm))
    middle = rot.quat_conjugate(0.5 * (q[1:] + q[:-1]))
    gained = rot.quat_rotate(middle, np.diff(v, axis=0))
    rows = np.column_stack([np.full(40, dt), np.outer(np.diff(roll(t)), [0.0, 1.0, 0.0]), gained])
    t_ns = np.round(t[1:] * 1e9).astype(np.int64)
    transfer = TransferConfig(lever_arm=arm)
    m = MasterState(0, 0.6, 0.3, 0.0, np.zeros(3), None, None, None, *(np.ones(3),) * 3, True, "")
    seen, told = model.master(m), model.told(transfer)
    r, H, R = np.empty(3), np.empty((3, SIZE)), np.empty((3, 3))
    for spread in (0.0, 0.05):
        now = instant(x, t_ns, rows, 40, 80_000_000, spread, 0.0, np.zeros(3))
        scene = model.scene(x, now, seen, told)
        straight, _ = model.velocity_rows(x, now, seen, told, scene, r, H, R)
        assert straight
        assert np.all(np.abs(H[:, DELAY]) < 0.08), (spread, H[:, DELAY])


def test_both_sides_tell_how_they_moved() -> None:
    """Turned between two messages, and the force felt, from the master and from the slave, in b."""
    built = rot.dcm_from_euler(0.3, 0.2, -0.1)
    transfer = TransferConfig(lever_arm=np.array([0.4, -0.1, 0.5]), C_ab=built)
    x, turn = state(), np.array([0.02, -0.01, 0.03])
    before = rot.quat_multiply(x[0:4], rot.quat_from_rotvec(-turn))
    q, q_before = (rot.quat_multiply(one, rot.quat_from_dcm(built.T)) for one in (x[0:4], before))
    v, gained, seconds = np.array([60.0, 180.0, -3.0]), np.array([0.3, -0.2, 0.1]), 0.2
    here = (0.6, 0.3, 3000.0)
    last = MasterState(0, *here, v, q_before, None, None, *(np.ones(3),) * 3, True, "")
    m, t = model.master(last._replace(v_g=v + gained, q_ga=q)), model.told(transfer)
    now = np.zeros(I_SIZE)
    scene = model.scene(x, now, m, t)
    told, own, force = moved(x, before, model.master(last), m, seconds, now, scene, t)
    assert own == pytest.approx(turn, abs=1e-12)
    assert told == pytest.approx(turn, abs=1e-12)
    expected = gained / seconds - gravity_g(0.6, 3000.0)
    assert force == pytest.approx(rot.dcm_from_quat(x[0:4]).T @ expected, rel=1e-12)
    now[I_DW] = 10.0  # half a metre away, this is 5 m/s^2
    assert not np.any(moved(x, before, model.master(last), m, seconds, now, scene, t)[2])


def test_what_is_found_is_taken_out() -> None:
    """Attitude by ``exp(phi)``, place by the curvature's turn, the rest by differences; 1e-12."""
    x = state()
    dx = RNG.standard_normal(SIZE) * 1e-3
    y = x.copy()
    correct(y, dx)
    assert y[0:4] == pytest.approx(rot.quat_multiply(rot.quat_from_rotvec(dx[6:9]), x[0:4]), abs=1e-15)
    assert y[4:7] == pytest.approx(x[4:7] - dx[3:6])
    C_en = x[7:16].reshape(3, 3)
    lat, lon, _ = position_angles(C_en)
    lat_after, lon_after, _ = position_angles(y[7:16].reshape(3, 3))
    way = ecef(lat_after, lon_after, y[16]) - ecef(lat, lon, x[16])
    # rounding of coordinates of 6e6 m; level and height part at second order, 1e-6 m^2 of 6e6 m
    assert C_en.T @ way == pytest.approx(-dx[0:3], abs=1e-8)
    assert y[18:X_REST] == pytest.approx(x[18:X_REST] - dx[9:], rel=1e-12)
    assert np.array_equal(y[X_REST:], x[X_REST:])
