"""The filter through a window of fixes: what the heading from motion knows at the window's end.

Errors, true minus what `nav.align.preintegrate` makes of the window with one start and one set of biases:
phi, velocity (and position, where that is what is measured) along the axes of the window's start, then what
stays: gyro bias, accelerometer bias, and errors of scale and axes where there are any. Between two fixes

    phi' = phi + C_k (R_gyro dbg + M_g theta) + w
    v'   = v - [dV x] phi + C_k-1 (V_gyro dbg + V_accel dba + M_a a) + u

with white w and u of the sensors' random walks, dV the specific force of the interval, a what is left of it
without gravity. The random walk of the gyros tilts the level, so that velocities long after it are off
together: no weight of single fixes says that. Kalman filter with scalar updates: Groves, 2nd edition,
sections 3.2 and 14.2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.align.preintegrate import DT, P_ACCEL, P_GYRO, R_GYRO, V_ACCEL, V_GYRO, P, R, V
from nav.align.types import AlignConfig
from nav.jit import kernel
from nav.rotation import exponential, multiply, skew
from nav.types import Vector

Indices = NDArray[np.intp]


class Model(NamedTuple):
    """K fixes of n errors, of which the first d move: see `through`."""

    F: Vector  # (K, d, n)
    Q: Vector  # (K, d, d)
    H: Vector  # (K, 3, n)
    walk: Vector  # (K, n), what an interval adds to the variance of those that stay


def own_errors(config: AlignConfig) -> tuple[Indices, Indices, Vector]:
    """Which entries of M_g and of M_a, row by row, are errors, and their variances."""
    one = np.eye(3, dtype=bool)
    gyro = np.where(one, config.gyro_scale, config.gyro_axes).ravel()
    accel = np.where(one, config.accel_scale, config.accel_axes).ravel()
    g, a = np.flatnonzero(gyro), np.flatnonzero(accel)
    return g, a, np.concatenate([gyro[g], accel[a]]) ** 2


def model(
    config: AlignConfig,
    pieces: Vector,
    rows: Vector,
    C: Vector,
    gravity: Vector,
    lever: Vector,
    age: float | None,
) -> Model:
    """The errors' model over ``pieces`` (K, SIZE), of which ``rows`` are the joins, from ``C`` (3, 3) on.

    ``gravity`` (3,) m/s^2. ``lever`` (K, 3): what R(t) turns in the measurement, of position where ``age`` is
    None, else of a velocity that is ``age`` s old.
    """
    by_velocity = age is not None
    moving = 6 if by_velocity else 9
    own_g, own_a, _ = own_errors(config)
    k, n = len(pieces), moving + 6 + len(own_g) + len(own_a)
    C_end = C @ rows[:, R].reshape(-1, 3, 3)
    C_begin = np.concatenate([C_end[:1], C_end[:-1]])
    dt = pieces[:, DT]
    dV = np.diff(rows[:, V] @ C.T, axis=0, prepend=0.0)
    pull = -skew(dV)
    bg, ba = slice(moving, moving + 3), slice(moving + 3, moving + 6)
    mg, ma = np.arange(len(own_g)) + moving + 6, np.arange(len(own_a)) + moving + 6 + len(own_g)

    F = np.zeros((k, moving, n))
    i = np.arange(moving)
    F[:, i, i] = 1.0
    F[:, 0:3, bg] = C_end @ pieces[:, R_GYRO].reshape(-1, 3, 3)
    F[:, 3:6, 0:3] = pull
    F[:, 3:6, bg] = C_begin @ pieces[:, V_GYRO].reshape(-1, 3, 3)
    F[:, 3:6, ba] = C_begin @ pieces[:, V_ACCEL].reshape(-1, 3, 3)
    if len(mg):
        turn = pieces[:, R].reshape(-1, 3, 3)
        # the angle of an interval, of which a sine is good enough
        theta = 0.5 * np.stack([turn[:, a, b] - turn[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], axis=1)
        F[:, 0:3, mg] = C_end[:, :, own_g // 3] * theta[:, None, own_g % 3]
        F[:, 3:6, mg] = 0.5 * pull @ F[:, 0:3, mg]
    if len(ma):
        push = np.einsum("kji,kj->ki", C_begin, dV + dt[:, None] * gravity)
        F[:, 3:6, ma] = C_begin[:, :, own_a // 3] * push[:, None, own_a % 3]

    Q = np.zeros((k, moving, moving))
    three = np.arange(3)
    walk, push2 = config.angle_random_walk**2 * dt, config.velocity_random_walk**2 * dt
    Q[:, three, three] = walk[:, None]
    Q[:, 3:6, 0:3] = 0.5 * walk[:, None, None] * pull
    Q[:, 0:3, 3:6] = np.swapaxes(Q[:, 3:6, 0:3], 1, 2)
    Q[:, 3:6, 3:6] = walk[:, None, None] / 3.0 * pull @ np.swapaxes(pull, 1, 2)
    Q[:, 3 + three, 3 + three] += push2[:, None]

    H = np.zeros((k, 3, n))
    turned = np.einsum("kij,kj->ki", C_end, lever)
    if age is not None:
        H[:, :, 3:6] = np.eye(3)
        if age > 0.0:
            mean = dV[1:] / dt[1:, None]
            turned = turned - age * np.concatenate([mean[:1], mean])
            H[:, :, ba] = age * C_end
    else:
        H[:, :, 6:9] = np.eye(3)
        F[:, 6 + three, 3 + three] = dt[:, None]
        F[:, 6:9, 0:3] = -skew(np.einsum("kij,kj->ki", C_begin, pieces[:, P]))
        F[:, 6:9, bg] = C_begin @ pieces[:, P_GYRO].reshape(-1, 3, 3)
        F[:, 6:9, ba] = C_begin @ pieces[:, P_ACCEL].reshape(-1, 3, 3)
        F[:, 6:9, ma] = 0.5 * dt[:, None, None] * F[:, 3:6, ma]
        Q[:, 6 + three, 6 + three] = (push2 * dt**2 / 3.0)[:, None]
        Q[:, 6 + three, 3 + three] = Q[:, 3 + three, 6 + three] = 0.5 * (push2 * dt)[:, None]
    H[:, :, 0:3] = -skew(turned)
    wander = np.zeros((k, n))
    wander[:, bg] = config.gyro_walk**2 * dt[:, None]
    wander[:, ba] = config.accel_walk**2 * dt[:, None]
    return Model(F, Q, H, wander)


@kernel
def through(
    x: Vector,
    P: Vector,
    F: Vector,
    Q: Vector,
    H: Vector,
    walk: Vector,
    z: Vector,
    var: Vector,
    normed: Vector,
    total: Vector,
) -> None:
    """From the errors ``x`` (n,), ``P`` (n, n) at the first fix to those at the last, in place.

    ``F``, ``Q``, ``H``, ``walk`` as `Model` has them; ``z`` (K, 3) are measured minus computed, ``var`` their
    variances. Out: ``normed`` (K, 3), innovations over their sigmas; ``total`` (d, n), what the errors at the
    first fix become.
    """
    d, n = F.shape[1], F.shape[2]
    T, G, h = np.empty((d, n)), np.empty((d, n)), np.empty(n)
    total[:] = 0.0
    for i in range(d):
        total[i, i] = 1.0
    for k in range(F.shape[0]):
        if k > 0:
            for i in range(d):
                for j in range(n):
                    s, r = 0.0, 0.0
                    for m in range(n):
                        s += F[k, i, m] * P[m, j]
                    for m in range(d):
                        r += F[k, i, m] * total[m, j]
                    T[i, j] = s
                    G[i, j] = r + F[k, i, j] if j >= d else r
                h[i] = 0.0
                for m in range(n):
                    h[i] += F[k, i, m] * x[m]
            for i in range(d):
                x[i] = h[i]
                for j in range(n):
                    total[i, j] = G[i, j]
                    if j >= d:
                        P[i, j] = P[j, i] = T[i, j]
                for j in range(d):
                    s = Q[k, i, j]
                    for m in range(n):
                        s += T[i, m] * F[k, j, m]
                    P[i, j] = s
            for i in range(d, n):
                P[i, i] += walk[k, i]
        for a in range(3):
            innovation, S = z[k, a], var[k, a]
            for i in range(n):
                s = 0.0
                for m in range(n):
                    s += P[i, m] * H[k, a, m]
                h[i] = s
            for m in range(n):
                innovation -= H[k, a, m] * x[m]
                S += H[k, a, m] * h[m]
            normed[k, a] = innovation / math.sqrt(S)
            for i in range(n):
                x[i] += h[i] * innovation / S
                for j in range(n):
                    P[i, j] -= h[i] * h[j] / S


@kernel
def turned_by(q: Vector, dtheta: Vector, rate: Vector, dt: float) -> Vector:
    """Quaternion (4,) after a sample of ``dtheta`` (3,) rad, of which ``rate`` (3,) rad/s is none of it."""
    out = np.empty(4)
    w, x, y, z = exponential(dtheta[0] - rate[0] * dt, dtheta[1] - rate[1] * dt, dtheta[2] - rate[2] * dt)
    out[0], out[1], out[2], out[3] = multiply(q[0], q[1], q[2], q[3], w, x, y, z)
    return out
