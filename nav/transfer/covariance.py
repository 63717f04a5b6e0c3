"""Covariance of transfer alignment through time: the sparse way to ``A P A' + Q``, and state with it.

Only position, velocity and phi are moved by others, so only nine rows change by products. Navigation errors
are those of `nav.errors.model`; flexure is a second-order Markov process of each axis,
``theta'' = -beta^2 theta - 2 beta theta' + w``, whose step is exact.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig, TransferConfig
from nav.filter.covariance import nav_block
from nav.jit import in_place, kernel
from nav.strapdown.kernels import M_C, M_SIZE, X_V
from nav.transfer.instant import part_over
from nav.transfer.kernels import S_DT, S_FB, S_MID, S_SIZE, S_WB, run
from nav.transfer.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_AXES,
    GYRO_BIAS,
    MOVED,
    PHI,
    POSITION,
    SIZE,
    VELOCITY,
    X_REST,
    place,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Times = NDArray[np.int64]

MARKOV: Final = 2.146
"""Natural rate of a second-order Markov process times its correlation time (where 1/e is left of it)."""
SEGMENT_NS: Final = 25_000_000
"""Longest step of the covariance: attitude turns little in it."""

# Places in what `noise` makes.
N_Q: Final = 0  # densities of the states up to the accelerometers' biases, per second
N_BEND: Final = ACCEL_BIAS.stop  # sigma of flexure (3,), rad
N_BETA: Final = N_BEND + 3  # its natural rate (3,), 1/s
N_SIZE: Final = N_BETA + 3

_GYRO: Final = GYRO_BIAS.start
_ACCEL: Final = ACCEL_BIAS.start
_P: Final = POSITION.start
_V: Final = VELOCITY.start
_PHI: Final = PHI.start
_BENT: Final = FLEXURE.start
_RATE: Final = FLEXURE_RATE.start
_BENT_X: Final = place(FLEXURE).start
_RATE_X: Final = place(FLEXURE_RATE).start
_GYRO_AXES: Final = GYRO_AXES.start
_ACCEL_AXES: Final = ACCEL_AXES.start


def noise(config: AlignConfig, transfer: TransferConfig) -> Vector:
    """What drives the errors (N_SIZE,), for `predict`."""
    out = np.zeros(N_SIZE)
    q = out[N_Q:N_BEND]
    q[VELOCITY], q[PHI] = config.velocity_random_walk**2, config.angle_random_walk**2
    # relative to the master, whose vertical channel is not the free one of the equations
    q[VELOCITY.stop - 1] += transfer.vertical_walk**2
    q[GYRO_BIAS], q[ACCEL_BIAS] = config.gyro_walk**2, config.accel_walk**2
    if transfer.flexure is not None:
        out[N_BEND:N_BETA] = transfer.flexure
        out[N_BETA:] = MARKOV / transfer.flexure_time
    return out


@in_place
def _bend(beta: float, dt: float) -> tuple[float, float, float, float]:
    """Transition of a bend and its rate over ``dt`` s, by rows."""
    e = math.exp(-beta * dt)
    return e * (1.0 + beta * dt), e * dt, -e * beta * beta * dt, e * (1.0 - beta * dt)


@in_place
def _bent(x: Vector, P: Matrix, par: Vector, dt: float) -> None:
    """Let flexure in the nominal state and in ``P`` go on for ``dt`` seconds, in place."""
    for axis in range(3):
        beta = par[N_BETA + axis]
        steady = par[N_BEND + axis] * par[N_BEND + axis]
        if steady == 0.0:
            continue
        swing = steady * beta * beta
        a, b, c, d = _bend(beta, dt)
        i, j = _BENT_X + axis, _RATE_X + axis
        x[i], x[j] = a * x[i] + b * x[j], c * x[i] + d * x[j]
        i, j = _BENT + axis, _RATE + axis
        for k in range(SIZE):
            u, v = P[i, k], P[j, k]
            P[i, k], P[j, k] = a * u + b * v, c * u + d * v
        for k in range(SIZE):
            u, v = P[k, i], P[k, j]
            P[k, i], P[k, j] = a * u + b * v, c * u + d * v
        cross = P[i, j] - (a * c * steady + b * d * swing)
        P[i, i] += steady - (a * a * steady + b * b * swing)
        P[j, j] += swing - (c * c * steady + d * d * swing)
        P[i, j] = cross
        P[j, i] = cross


@in_place
def _carry(P: Matrix, F: Vector, C: Vector, w: Vector, U: Matrix, D: Matrix, out: Matrix, n: int) -> None:
    """First nine rows of A times ``P``, its columns up to ``n``, into ``out``; A to second order.

    ``F`` (81,) is F dt of position, velocity and phi, ``C`` (9,) C_nb dt. An error of scale or axes acts as a
    bias of its size at the rate and force in ``w`` (6,). ``U`` (6, SIZE), ``D`` (9, SIZE) are scratch.
    """
    for i in range(3):
        g, f = _GYRO_AXES + 3 * i, _ACCEL_AXES + 3 * i
        for c in range(n):
            U[i, c] = P[_GYRO + i, c] + (w[0] * P[g, c] + w[1] * P[g + 1, c] + w[2] * P[g + 2, c])
            U[3 + i, c] = P[_ACCEL + i, c] + (w[3] * P[f, c] + w[4] * P[f + 1, c] + w[5] * P[f + 2, c])
    for i in range(MOVED):
        for c in range(n):
            D[i, c] = 0.0
        for k in range(MOVED):
            a = F[MOVED * i + k]
            if a != 0.0:
                for c in range(n):
                    D[i, c] += a * P[k, c]
    for i in range(3):
        for k in range(3):
            a = C[3 * i + k]
            for c in range(n):
                D[_V + i, c] -= a * U[3 + k, c]
                D[_PHI + i, c] += a * U[k, c]
    for i in range(MOVED):
        for c in range(n):
            out[i, c] = P[i, c] + D[i, c]
        for k in range(MOVED):
            a = 0.5 * F[MOVED * i + k]
            if a != 0.0:
                for c in range(n):
                    out[i, c] += a * D[k, c]


@kernel
def predict(x: Vector, P: Matrix, sums: Vector, par: Vector) -> None:
    """Covariance ``P`` (SIZE, SIZE), and flexure in ``x`` (X_SIZE,), over an interval, in place.

    ``x`` is the nominal state at its end, ``sums`` (S_SIZE,) of `nav.transfer.kernels.run` over it, ``par``
    of `noise`. Transition to second order; noise by the trapezoid, so that what turns within the interval
    moves as well. ``P`` stays symmetric to the bit.
    """
    dt = sums[S_DT]
    mean, C, w = np.empty(M_SIZE), np.empty(9), np.empty(6)
    for k in range(M_SIZE):
        mean[k] = sums[S_MID + k] / dt
    for k in range(9):
        C[k] = mean[M_C + k] * dt
    for k in range(3):
        w[k] = sums[S_WB + k] / dt
        w[3 + k] = sums[S_FB + k] / dt - x[X_REST + k]
    F = np.zeros(MOVED * MOVED)
    nav_block(F, 0, mean, dt)
    _bent(x, P, par, dt)
    U, D, out = np.empty((6, SIZE)), np.empty((MOVED, SIZE)), np.empty((MOVED, SIZE))
    _carry(P, F, C, w, U, D, out, SIZE)
    for i in range(MOVED):
        for c in range(SIZE):
            P[i, c] = out[i, c]
    for c in range(SIZE):
        for i in range(MOVED):
            P[c, i] = out[i, c]
    # the columns hold the transpose of A P now, and the corner wants A once more
    _carry(P, F, C, w, U, D, out, MOVED)
    # transition of what the noise puts in at the beginning
    N = np.empty((MOVED, MOVED))
    for i in range(MOVED):
        for j in range(MOVED):
            t = F[MOVED * i + j] + (1.0 if i == j else 0.0)
            for k in range(MOVED):
                t += 0.5 * F[MOVED * i + k] * F[MOVED * k + j]
            N[i, j] = t
    for i in range(MOVED):
        for j in range(i + 1):
            t = par[N_Q + i] if i == j else 0.0
            for k in range(_V, MOVED):
                t += N[i, k] * par[N_Q + k] * N[j, k]
            t = out[i, j] + 0.5 * dt * t
            P[i, j] = t
            P[j, i] = t
    for k in range(MOVED, N_BEND):
        P[k, k] += par[N_Q + k] * dt


@kernel
def turned_about_up(P: Matrix, angle: float) -> Matrix:
    """``P`` (SIZE, SIZE) with position, velocity and phi in axes that n is turned by ``angle`` (rad) from."""
    out = P.copy()
    c, s = math.cos(angle), math.sin(angle)
    for i in (_P, _V, _PHI):
        for k in range(SIZE):
            u, v = out[i, k], out[i + 1, k]
            out[i, k], out[i + 1, k] = c * u - s * v, s * u + c * v
        for k in range(SIZE):
            u, v = out[k, i], out[k, i + 1]
            out[k, i], out[k, i + 1] = c * u - s * v, s * u + c * v
    return out


@kernel
def advance(
    x: Vector,
    P: Matrix,
    t_ns: Times,
    rows: Matrix,
    first: int,
    share: float,
    from_ns: int,
    to_ns: int,
    par: Vector,
    sums: Vector,
    a_n: Vector,
) -> tuple[int, float]:
    """Bring state and covariance from one time to another, in place; steps of `SEGMENT_NS` at most.

    ``rows`` as `nav.transfer.kernels.run` takes them end at ``t_ns``; ``share`` of the ``first`` one is
    over by ``from_ns``. ``sums`` (S_SIZE,) receives those of the last step and ``a_n`` (3,) m/s^2 the rate
    of v_n in it. Returns the place at ``to_ns``, which the rows reach, and the share of it.
    """
    while from_ns < to_ns:
        goal = min(to_ns, from_ns + SEGMENT_NS)
        last = first
        while t_ns[last] < goal:
            last += 1
        end = part_over(t_ns, rows, last, goal)
        for k in range(S_SIZE):
            sums[k] = 0.0
        vx, vy, vz = x[X_V], x[X_V + 1], x[X_V + 2]
        run(x, rows, first, share, last, end, sums)
        first, share, from_ns = last, end, goal
        dt = sums[S_DT]
        if dt > 0.0:
            a_n[0], a_n[1], a_n[2] = (x[X_V] - vx) / dt, (x[X_V + 1] - vy) / dt, (x[X_V + 2] - vz) / dt
            predict(x, P, sums, par)
    return first, share
