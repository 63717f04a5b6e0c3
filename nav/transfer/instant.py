"""How the slave moves at a message's time: kept samples looked at around it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.jit import in_place, kernel
from nav.rotation import exponential, rotate
from nav.strapdown.kernels import X_Q
from nav.transfer.states import ACCEL_AXES, ACCEL_BIAS, GYRO_AXES, GYRO_BIAS, X_REST, place

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Times = NDArray[np.int64]

RATE_S: Final = 0.005
"""Over which the rate at an instant is taken."""
CHANGE_S: Final = 0.02
"""Over which the change of the rate at an instant is taken."""

# Places in what `instant` makes.
I_W: Final = 0  # rate in b against inertial space, corrected, rad/s, 3
I_DW: Final = 3  # its change, rad/s^2, 3
I_TURNS: Final = 6  # turned between it and a way earlier, and as much later, in b, rad, 3 + 3
I_RATES: Final = 12  # rate at these times, less that at the instant, rad/s, 3 + 3
I_GAINED: Final = 18  # v_n at these times, less that at the instant, m/s, 3 + 3
I_SIGMA: Final = 24  # of the noise of the rate, rad/s
I_SPREAD: Final = 25  # sqrt(3) sigma of the delay, s
I_WAY: Final = 26  # so long before and after is looked at: that, or half of what a change is taken over, s
I_SIZE: Final = 27

_BIAS: Final = place(GYRO_BIAS).start
_AXES: Final = place(GYRO_AXES).start
_ACCEL: Final = place(ACCEL_BIAS).start
_ACCEL_AXES: Final = place(ACCEL_AXES).start


@kernel
def find(t_ns: Times, count: int, at_ns: int) -> int:
    """The sample in which a time lies, of ``count`` that end at ``t_ns``: the last for what is later."""
    low, high = 0, count - 1
    while low < high:
        middle = (low + high) // 2
        if t_ns[middle] < at_ns:
            low = middle + 1
        else:
            high = middle
    return low


@in_place
def part_over(t_ns: Times, rows: Matrix, k: int, at_ns: int) -> float:
    """How much of sample ``k`` is over at a time in it."""
    return float(min(1.0, max(0.0, 1.0 - (t_ns[k] - at_ns) * 1e-9 / rows[k, 0])))


@kernel
def _between(
    t_ns: Times, rows: Matrix, count: int, first_ns: int, last_ns: int, column: int
) -> tuple[float, float, float]:
    """Sum of three columns of the samples between two times that are covered."""
    i, k = find(t_ns, count, first_ns), find(t_ns, count, last_ns)
    begin, end = part_over(t_ns, rows, i, first_ns), part_over(t_ns, rows, k, last_ns)
    a, b, c = 0.0, 0.0, 0.0
    for n in range(i, k + 1):
        part = (end if n == k else 1.0) - (begin if n == i else 0.0)
        a, b, c = a + part * rows[n, column], b + part * rows[n, column + 1], c + part * rows[n, column + 2]
    return a, b, c


@kernel
def turned(
    x: Vector, t_ns: Times, rows: Matrix, count: int, first_ns: int, last_ns: int
) -> tuple[float, float, float]:
    """Angle, rad in b, corrected by ``x`` (X_SIZE,), turned between two times that are covered."""
    a, b, c = _between(t_ns, rows, count, first_ns, last_ns, 1)
    seconds, o = (last_ns - first_ns) * 1e-9, _BIAS
    a, b, c = a - x[o] * seconds, b - x[o + 1] * seconds, c - x[o + 2] * seconds
    o = _AXES
    return (
        a - (x[o] * a + x[o + 1] * b + x[o + 2] * c),
        b - (x[o + 3] * a + x[o + 4] * b + x[o + 5] * c),
        c - (x[o + 6] * a + x[o + 7] * b + x[o + 8] * c),
    )


@kernel
def _gained(
    x: Vector, t_ns: Times, rows: Matrix, count: int, first_ns: int, last_ns: int, turn: Vector, pull: Vector
) -> tuple[float, float, float]:
    """Gain of v_n, m/s, corrected, between two such times; ``turn`` (3,) rad in b takes x to their middle."""
    a, b, c = _between(t_ns, rows, count, first_ns, last_ns, 4)
    s, o, r = (last_ns - first_ns) * 1e-9, _ACCEL, X_REST
    a, b, c = a - s * x[o], b - s * x[o + 1], c - s * x[o + 2]
    d, e, f, o = a - s * x[r], b - s * x[r + 1], c - s * x[r + 2], _ACCEL_AXES
    a -= x[o] * d + x[o + 1] * e + x[o + 2] * f
    b -= x[o + 3] * d + x[o + 4] * e + x[o + 5] * f
    c -= x[o + 6] * d + x[o + 7] * e + x[o + 8] * f
    u, i, j, k = exponential(turn[0], turn[1], turn[2])
    a, b, c = rotate(u, i, j, k, a, b, c)
    a, b, c = rotate(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3], a, b, c)
    return a + s * pull[0], b + s * pull[1], c + s * pull[2]


@kernel
def _rate(
    x: Vector, t_ns: Times, rows: Matrix, count: int, middle: int, reach: int
) -> tuple[float, float, float]:
    a, b, c = turned(x, t_ns, rows, count, middle - reach, middle + reach)
    s = 1.0 / (2e-9 * reach)
    return s * a, s * b, s * c


@kernel
def instant(
    x: Vector,
    t_ns: Times,
    rows: Matrix,
    count: int,
    at_ns: int,
    spread: float,
    angle_random_walk: float,
    pull: Vector,
) -> Vector:
    """How the slave moves at ``at_ns`` (I_SIZE,), `CHANGE_S` or the ``spread`` (s) around which is covered.

    ``rows`` as `nav.transfer.kernels.run` takes them, ``count`` of them, end at ``t_ns``; biases by ``x``
    (X_SIZE,). ``angle_random_walk`` rad/sqrt(s); ``pull`` (3,) m/s^2 is what changes v_n besides specific
    force. All are taken over the same times, so that what the arm swings by is in all of them.
    """
    out = np.zeros(I_SIZE)
    half = round(max(0.5 * RATE_S, rows[find(t_ns, count, at_ns), 0]) * 1e9)
    some = round(0.5e9 * CHANGE_S)
    w = _rate(x, t_ns, rows, count, at_ns, half)
    later = _rate(x, t_ns, rows, count, at_ns + some, some)
    sooner = _rate(x, t_ns, rows, count, at_ns - some, some)
    for k in range(3):
        out[I_W + k] = w[k]
        out[I_DW + k] = (later[k] - sooner[k]) / CHANGE_S
    out[I_SIGMA] = angle_random_walk / math.sqrt(2e-9 * half)
    way = max(some, round(spread * 1e9))
    out[I_SPREAD], out[I_WAY] = spread, way * 1e-9
    newest = t_ns[count - 1]
    middle = np.empty(3)
    for i in range(2):
        sign = 1.0 if i == 1 else -1.0
        there = at_ns - way if i == 0 else at_ns + way
        first, last = min(at_ns, there), max(at_ns, there)
        turn = turned(x, t_ns, rows, count, first, last)
        reach = half if i == 0 else min(half, newest - there)
        if reach > 0:
            u = _rate(x, t_ns, rows, count, there, reach)
            for k in range(3):
                out[I_RATES + 3 * i + k] = u[k] - w[k]
        for k in range(3):
            out[I_TURNS + 3 * i + k] = turn[k]
            middle[k] = 0.5 * sign * turn[k]
        gained = _gained(x, t_ns, rows, count, first, last, middle, pull)
        for k in range(3):
            out[I_GAINED + 3 * i + k] = sign * gained[k]
    return out
