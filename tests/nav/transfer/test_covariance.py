"""Covariance through time and through corrections against textbook formulas over whole matrices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm

from nav import rotation as rot
from nav.align.types import AlignConfig, TransferConfig
from nav.earth import curvature, position_matrix
from nav.strapdown.kernels import M_C, M_EN, M_F, M_G, M_IE, M_K, M_V
from nav.strapdown.mechanize import frame_rates
from nav.transfer import matching
from nav.transfer.correction import Use, take, weigh
from nav.transfer.covariance import MARKOV, SEGMENT_NS, advance, noise, predict, turned_about_up
from nav.transfer.kernels import S_DT, S_FB, S_MID, S_SIZE, S_WB, run
from nav.transfer.stage import Transfer
from nav.transfer.states import (
    ACCEL_BIAS,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_BIAS,
    PHI,
    POSITION,
    SIZE,
    VELOCITY,
    X_REST,
    X_SIZE,
)
from nav.types import MasterState
from tests.nav.transfer.making import Set, config, dynamics, fly, s_turns

CONFIG = AlignConfig(1e-5, 1e-2, 2e-5, 1e-3, gyro_walk=1e-8, accel_walk=1e-5)
TRANSFER = TransferConfig(
    flexure=np.array([1e-3, 2e-3, 3e-4]), flexure_time=np.array([0.3, 0.5, 1.0]), vertical_walk=0.01
)
SIGMA = np.repeat(
    [5.0, 0.1, 1e-3, 5e-6, 1e-2, 1e-3, 1e-3, 5e-3, 1e-3, 2e-3, 0.02, 0.01],
    [3, 3, 3, 3, 3, 9, 9, 3, 3, 3, 3, 1],
)


def some_covariance(seed):
    """Everything hangs together with everything."""
    M = np.random.default_rng(seed).standard_normal((SIZE, 2 * SIZE)) * SIGMA[:, None]
    return M @ M.T / (2 * SIZE)


def off(found, expected):
    """Largest difference, as a share of the sigmas that belong to it."""
    sigma = np.sqrt(np.diag(expected))
    return float(np.max(np.abs(found - expected) / np.outer(sigma, sigma)))


class Moved(NamedTuple):
    """A second or less of steep motion: nominal state, what was summed up over it, and F (SIZE, SIZE)."""

    x: np.ndarray
    sums: np.ndarray
    F: np.ndarray


def moved(dt):
    C, v, w = rot.dcm_from_euler(0.7, 0.2, -0.9), np.array([60.0, 180.0, -9.0]), np.array([0.3, -0.1, 0.2])
    f = np.array([1.0, -3.0, 14.0])
    x, sums = np.zeros(X_SIZE), np.zeros(S_SIZE)
    x[X_REST:] = 0.1, 0.9, 9.7
    pole = position_matrix(0.6, 0.3, 0.2)[2]
    frame, k = frame_rates(pole, 3000.0, v), curvature(*pole.tolist(), 3000.0)
    mid = sums[S_MID:]
    mid[M_C : M_C + 9], mid[M_F : M_F + 3], mid[M_V : M_V + 3] = C.ravel(), C @ f, v
    mid[M_IE : M_IE + 3], mid[M_EN : M_EN + 3], mid[M_K : M_K + 3] = frame.w_ie_n, frame.w_en_n, k
    mid[M_G] = -2.0 * frame.gravity_n[2] * np.sqrt(k[0] * k[2] - k[1] ** 2)
    sums[S_WB : S_WB + 3], sums[S_FB : S_FB + 3], sums[S_DT] = w, f, 1.0
    return Moved(x, sums * dt, dynamics(C, f, w, v, frame, k, x[X_REST:]))


@pytest.mark.parametrize("seed", range(5))
def test_a_step_is_the_textbooks(seed: int) -> None:
    """``A P A' + Q`` with A = I + F dt + (F dt)^2 / 2, flexure by the matrix exponential; to rounding, 1e-12.

    Noise by the trapezoid: half of it comes at the beginning, and is moved, half at the end.
    """
    dt = 0.025
    x, sums, F = moved(dt)
    A = np.eye(SIZE) + F * dt + 0.5 * F @ F * dt**2
    Q = np.zeros((SIZE, SIZE))
    q = np.zeros(SIZE)
    q[VELOCITY], q[PHI], q[5] = 1e-6, 4e-10, 1e-6 + 1e-4
    Q[:9, :9] = 0.5 * dt * (np.diag(q[:9]) + A[:9, :9] @ np.diag(q[:9]) @ A[:9, :9].T)
    q[GYRO_BIAS], q[ACCEL_BIAS] = 1e-16, 1e-10
    Q[9:15, 9:15] = np.diag(q[9:15]) * dt
    for axis in range(3):
        beta, at = MARKOV / TRANSFER.flexure_time[axis], [FLEXURE.start + axis, FLEXURE_RATE.start + axis]
        B = expm(np.array([[0.0, 1.0], [-(beta**2), -2.0 * beta]]) * dt)
        steady = TRANSFER.flexure[axis] ** 2 * np.diag([1.0, beta**2])
        A[np.ix_(at, at)], Q[np.ix_(at, at)] = B, steady - B @ steady @ B.T
    P = some_covariance(seed)
    expected = A @ P @ A.T + Q
    predict(x, P, sums, noise(CONFIG, TRANSFER))
    assert off(P, expected) < 1e-12
    assert np.array_equal(P, P.T)


def test_flexure_is_stationary() -> None:
    """Its step leaves the steady covariance as it is, half steps make whole ones, and what bends decays."""
    par = noise(CONFIG, TRANSFER)
    beta = MARKOV / TRANSFER.flexure_time
    P = np.zeros((SIZE, SIZE))
    P[FLEXURE, FLEXURE] = np.diag(TRANSFER.flexure**2)
    P[FLEXURE_RATE, FLEXURE_RATE] = np.diag((TRANSFER.flexure * beta) ** 2)
    f = slice(FLEXURE.start, FLEXURE_RATE.stop)
    after = P.copy()
    x, sums, _ = moved(0.2)
    x[18 + 27 : 18 + 33] = 1e-3
    predict(x, after, sums, par)
    assert after[f, f] == pytest.approx(P[f, f], abs=1e-18)
    # critically damped: theta = (theta0 + (rate0 + beta theta0) t) exp(-beta t)
    assert x[18 + 27 : 18 + 30] == pytest.approx(
        1e-3 * (1.0 + (1.0 + beta) * 0.2) * np.exp(-beta * 0.2), rel=1e-12
    )
    whole, halves = some_covariance(9), some_covariance(9)
    predict(x, whole, sums, par)
    for _ in range(2):
        predict(x, halves, moved(0.1).sums, par)
    assert halves[f, f] == pytest.approx(whole[f, f], rel=1e-11, abs=1e-18)


def test_the_masters_vertical_velocity_walks() -> None:
    """By nothing else than its variance over time, where nothing is known wrongly: 0.01^2 x 4 s."""
    x, sums, _ = moved(4.0)
    walked, still = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    predict(x, walked, sums, noise(CONFIG, TransferConfig(vertical_walk=0.01)))
    predict(x, still, sums, noise(CONFIG, TransferConfig()))
    gained = walked - still
    # within a hundredth what the turn of n lets of it into the level
    assert gained[5, 5] == pytest.approx(4e-4, rel=1e-2)
    assert gained[PHI, PHI] == pytest.approx(np.zeros((3, 3)), abs=1e-15)


@pytest.mark.parametrize(
    ("uses", "own"),
    [
        ((Use.MATCH, Use.MATCH, Use.MATCH), PHI),
        ((Use.MATCH, Use.MATCH, Use.COPY), VELOCITY),
        ((Use.NOT, Use.NOT, Use.MATCH), PHI),
        ((Use.COPY, Use.COPY, Use.COPY), POSITION),
        ((Use.NOT, Use.NOT, Use.COPY), VELOCITY),
    ],
)
def test_a_correction_is_the_textbooks(uses: tuple[Use, Use, Use], own: slice) -> None:
    """Joseph's form ``(I - K H) P (I - K H)' + K R K'``, K of each row by what is done with it; 1e-12."""
    rng = np.random.default_rng(3)
    P, mask = some_covariance(4), (rng.random(SIZE) < 0.6).astype(float)
    H = rng.standard_normal((3, SIZE)) / SIGMA * (rng.random((3, SIZE)) < 0.3)
    H[:, own] = np.eye(3) / SIGMA[own] * 0.9
    M = rng.standard_normal((3, 3))
    r, R, dx = rng.standard_normal(3), M @ M.T + np.eye(3), rng.standard_normal(SIZE) * SIGMA
    columns = np.array([3, 7, SIZE - 1])
    used = [j for j in range(3) if uses[j] is not Use.NOT]
    matched = [j for j in range(3) if uses[j] is Use.MATCH]
    S = H @ P @ H.T + R
    G = np.zeros((SIZE, 3))
    if matched:
        G[:, matched] = mask[:, None] * (P @ H[matched].T @ np.linalg.inv(S[np.ix_(matched, matched)]))
    share = 0.3
    G[-1] *= share
    for j in used:
        if uses[j] is Use.COPY:
            G[own.start + j, j] = H[j, own.start + j]
    J = np.eye(SIZE) - G[:, used] @ H[used]
    expected = J @ P @ J.T + G[:, used] @ R[np.ix_(used, used)] @ G[:, used].T
    residual = (r - H @ dx)[used]
    found = dx + G[:, used] @ residual

    K, W, S_used, e, white = weigh(P, H, r, R, np.array(uses), own.start, mask, share, dx, columns)
    assert e == pytest.approx(residual, rel=1e-12)
    assert pytest.approx(S[np.ix_(used, used)], rel=1e-12) == S_used
    shown = np.column_stack([residual, H[used][:, columns]])
    assert white.T @ white == pytest.approx(
        shown.T @ np.linalg.inv(S[np.ix_(used, used)]) @ shown, rel=1e-11, abs=1e-9
    )
    take(P, dx, K, W, S_used, e)
    assert dx == pytest.approx(found, rel=1e-11)
    assert off(P, expected) < 1e-12
    assert np.array_equal(P, P.T)


def test_it_is_told_in_other_axes() -> None:
    """Level axes of position, velocity and phi turned about the vertical, the rest as it is."""
    P, T = some_covariance(2), np.eye(SIZE)
    C = rot.dcm_from_quat(rot.quat_from_rotvec(np.array([0.0, 0.0, 0.7])))
    for part in (POSITION, VELOCITY, PHI):
        T[part, part] = C
    assert off(turned_about_up(P, 0.7), T @ P @ T.T) < 1e-14


def test_the_way_is_cut_into_steps() -> None:
    """Of 25 ms and what is left, wherever samples end."""
    rng = np.random.default_rng(5)
    n = 40
    rows = np.column_stack(
        [
            np.full(n, 0.01),
            5e-3 * rng.standard_normal((n, 3)),
            rng.normal([0.0, 0.0, 0.098], 0.02, (n, 3)),
        ]
    )
    t_ns = np.arange(1, n + 1) * 10_000_000
    x = np.zeros(X_SIZE)
    x[0:4], x[4:7] = rot.quat_from_euler(0.7, 0.1, -0.4), (60.0, 180.0, -3.0)
    x[7:16], x[16], x[X_REST:] = position_matrix(0.6, 0.3, 0.2).ravel(), 3000.0, (0.0, 0.9, 9.7)
    par, P = noise(CONFIG, TRANSFER), some_covariance(1)
    y, Q = x.copy(), P.copy()
    sums, a_n = np.zeros(S_SIZE), np.zeros(3)
    begin, goal = 13_000_000, 92_000_000
    place, share = advance(x, P, t_ns, rows, 1, 0.3, begin, goal, par, sums, a_n)
    assert (place, share) == (9, pytest.approx(0.2))
    at = (1, 0.3)
    for k in range(4):
        first, last = begin + k * SEGMENT_NS, min(goal, begin + (k + 1) * SEGMENT_NS)
        before = y[4:7].copy()
        step = np.zeros(S_SIZE)
        end = (last - 1) // 10_000_000, (last / 1e7) % 1.0 or 1.0
        run(y, rows, *at, *end, step)
        predict(y, Q, step, par)
        assert step[S_DT] == pytest.approx((last - first) * 1e-9, rel=1e-9)
        at = end
    # shares of samples are a rounding apart
    assert x == pytest.approx(y, rel=1e-12)
    assert off(P, Q) < 1e-12
    assert a_n == pytest.approx((y[4:7] - before) / step[S_DT], rel=1e-9)


def test_it_stays_a_covariance_for_half_an_hour() -> None:
    """Position matching over S-turns: symmetric to the bit, correlations positive definite to rounding.

    46 states, 72,000 steps and 1,800 corrections: rounding of each is some 1e-16 of the sigmas; where it
    added up like a walk it would be 1e-13 of them.
    """
    s = Set(profile=s_turns(), seconds=1800.0, imu_hz=4.0, master_hz=1.0, flexure=np.full(3, 3e-4))
    flight = fly(s, 1)
    told = config(s, vertical_walk=0.01, duration=np.inf)
    state, checked = Transfer(told, matching.POSITION_10), 0
    for sample in flight.samples:
        if isinstance(sample, MasterState):
            state.message(sample)
            P = state.slave.P
            if not state.slave.started or sample.t_ns // 10**9 % 60:
                continue
            assert np.array_equal(P, P.T)
            sigma = np.sqrt(np.diag(P))
            sigma[sigma == 0.0] = 1.0
            assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > -1e-13
            checked += 1
        else:
            assert state.inertial(sample) is None
    assert checked >= 29
