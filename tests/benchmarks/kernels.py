"""What one inertial sample costs: compensation, strapdown and covariance, against two references.

``python -m tests.benchmarks.kernels`` prints the table. The live path makes one navigation update (two-sample
coning and sculling, strapdown, covariance of 19 states) of two samples, each compensated; all is told per
sample.

- *NumPy twin*: the readable definitions of the same step.
- *dense loops*: a hand-written ``Phi P Phi' + Q`` of 18 x 18 in plain loops, compiled, once a sample: what a
  filter costs that does not know which of its elements are zero, and nothing else. Once with the size taken
  from the arrays, once with 18 as a constant, which the compiler unrolls and vectorises.
"""

from __future__ import annotations

import sys

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.errors.model import error_dynamics
from nav.filter import states as st
from nav.filter.covariance import predict_readable
from nav.filter.propagate import ROW_D, ROW_DT, ROW_N, ROW_NOISE, WORK_SIZE, propagate, row_size
from nav.imu.pulses import Calibration, compensate, compensate_readable
from nav.jit import in_place, kernel
from nav.strapdown import mechanize
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.types import Vector
from tests.benchmarks.measure import interleaved, print_table

DT = 0.005  # s, 200 Hz
DENSE = 18
LAT, HEIGHT = 0.84, 500.0
COUNTS = np.array([12.0, -7.0, 30.0, 40.0, -25.0, 980.0])
CALIBRATION = Calibration(
    gyro_scale_plus=np.full(3, 5e-7),
    accel_scale_plus=np.full(3, 5e-5),
    gyro_bias=np.array([1e-6, -2e-6, 1e-6]),
    accel_bias=np.array([1e-3, 2e-3, -1e-3]),
    gyro_g=np.full((3, 3), 1e-9),
    gyro_axes=np.eye(3) + 1e-4,
    accel_axes=np.eye(3) - 1e-4,
)


def start() -> tuple[Vector, Vector, Vector]:
    """State, covariance and parameters of a vehicle under way."""
    x = np.zeros(st.X_SIZE)
    x[X_Q : X_Q + 4] = rot.quat_from_rotvec(np.array([0.02, -0.01, 1.1]))
    x[X_V : X_V + 3] = [8.0, 5.0, 0.1]
    x[X_C : X_C + 9] = earth.position_matrix(LAT, 0.2, 0.3).ravel()
    x[X_H] = HEIGHT
    x[st.X_QV] = 1.0
    sigma = np.concatenate(
        [np.full(3, 1.0), np.full(3, 0.1), np.full(3, 1e-3), np.full(3, 1e-6), np.full(3, 1e-3)]
    )
    P = np.diag(np.concatenate([sigma, np.full(4, 1e-2)]) ** 2)
    par = np.zeros(st.P_SIZE)
    par[st.P_Q : st.P_Q + st.BASIC] = 1e-10
    return x, P, par


@in_place
def fast_steps(
    x: Vector, P: Vector, par: Vector, table: Vector, counts: Vector, row: Vector, work: Vector, n: int
) -> None:
    """``n`` samples through the kernels of the live path."""
    for k in range(n):
        i = 3 * (k % 2)
        d = row[ROW_D:]
        compensate(table, counts, DT, d[i : i + 3], d[6 + i : 9 + i])
        if k % 2:
            propagate(x, P, par, work, row)


@kernel
def dense_steps(P: Vector, Phi: Vector, Q: Vector, n: int) -> None:
    """``n`` dense covariance steps of whatever size."""
    size = P.shape[0]
    T = np.zeros((size, size))
    for _ in range(n):
        for i in range(size):
            for j in range(size):
                total = 0.0
                for k in range(size):
                    total += Phi[i, k] * P[k, j]
                T[i, j] = total
        for i in range(size):
            for j in range(size):
                total = Q[i, j]
                for k in range(size):
                    total += T[i, k] * Phi[j, k]
                P[i, j] = total


@kernel
def unrolled_steps(P: Vector, Phi: Vector, Q: Vector, n: int) -> None:
    """``n`` dense covariance steps of 18 x 18."""
    T = np.zeros((DENSE, DENSE))
    for _ in range(n):
        for i in range(DENSE):
            for j in range(DENSE):
                total = 0.0
                for k in range(DENSE):
                    total += Phi[i, k] * P[k, j]
                T[i, j] = total
        for i in range(DENSE):
            for j in range(DENSE):
                total = Q[i, j]
                for k in range(DENSE):
                    total += T[i, k] * Phi[j, k]
                P[i, j] = total


def readable_steps(n: int) -> None:
    """``n`` samples through the readable definitions."""
    x, P, par = start()
    state = mechanize.NavState(x[X_Q : X_Q + 4], x[X_V : X_V + 3], x[X_C : X_C + 9].reshape(3, 3), HEIGHT)
    q = par[st.P_Q : st.P_Q + st.BASIC]
    for _ in range(n // 2):
        pairs = [compensate_readable(CALIBRATION, COUNTS[:3], COUNTS[3:], DT) for _ in range(2)]
        dtheta, dv = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
        dt = 2.0 * DT
        before = state
        state = mechanize.update(state, dtheta, dv, dt)
        frame = mechanize.frame_rates(before.C_en[2], before.height, before.v_n)
        pole = before.C_en[2]
        F = error_dynamics(
            rot.dcm_from_quat(before.q_nb),
            dv.sum(axis=0) / dt,
            dtheta.sum(axis=0) / dt,
            before.v_n,
            frame.w_ie_n,
            frame.w_en_n,
            earth.curvature(pole[0], pole[1], pole[2], before.height),
            3.1e-6,
        )
        P = predict_readable(P, F[: st.BASIC, : st.BASIC], q, dt)


def measure(rounds: int = 15, samples: int = 20_000) -> dict[str, float]:
    """Seconds per sample of each case."""
    table = CALIBRATION.table()
    row = np.zeros(row_size(2))
    row[ROW_DT], row[ROW_NOISE], row[ROW_N] = 2.0 * DT, 1.0, 2
    work = np.zeros(WORK_SIZE)
    slow = max(samples // 100, 2)
    rng = np.random.default_rng(1)
    Phi = np.eye(DENSE) + 1e-6 * rng.standard_normal((DENSE, DENSE))
    Q = np.eye(DENSE) * 1e-12

    def fast() -> None:
        x, P, par = start()
        fast_steps(x, P, par, table, COUNTS, row, work, samples)

    def dense() -> None:
        dense_steps(np.eye(DENSE), Phi, Q, samples)

    def unrolled() -> None:
        unrolled_steps(np.eye(DENSE), Phi, Q, samples)

    cases = {"kernel": fast, "dense": dense, "unrolled": unrolled, "readable": lambda: readable_steps(slow)}
    times = interleaved(cases, rounds)
    return {
        "kernel": times["kernel"] / samples,
        "dense": times["dense"] / samples,
        "unrolled": times["unrolled"] / samples,
        "readable": times["readable"] / slow,
    }


def main() -> int:
    """Print the table."""
    seconds = measure()
    names = {
        "kernel": "kernels of the live path, 19 states",
        "dense": "dense 18 x 18 covariance loop alone, size from the arrays",
        "unrolled": "dense 18 x 18 covariance loop alone, size constant",
        "readable": "NumPy twin, 19 states",
    }
    rows = [
        (text, f"{seconds[name] * 1e6:.3f}", f"{seconds[name] / seconds['kernel']:.1f}")
        for name, text in names.items()
    ]
    print_table("compensation, strapdown and covariance per inertial sample", ("", "us", "ratio"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
