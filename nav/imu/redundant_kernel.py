"""The kernel of `nav.imu.redundant`: what a sample costs where nothing is wrong, and what is done else."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.imu.parity import MOST, Sets
from nav.jit import in_place
from nav.types import Vector

Whole = NDArray[np.int64]
DETECTED: Final = 1
"""Bits of the status of a sample: a test failed;"""
EXCLUDED: Final = 2
READMITTED: Final = 4

# places in the state's whole numbers, behind which are windows' fillings, then agreements of each sensor
ACTIVE, SUSPECTS, _MISSING, _ALARM, FILLED = range(5)

# places in what `quick` works on: rows of `MOST` lanes, one for each sensor; then single numbers
SCALE, UNEVEN, BIAS, G, _MATRIX, _Z, _Y, _SUM = (MOST * row for row in (0, 1, 2, 3, 6, 14, 15, 16))
_LIMIT, TIMES, CONSTANT, SQUARED, MOTION, _LEFT, _SECONDS, LANES = range(17 * MOST, 18 * MOST)
HOT: Final = 18 * MOST


class Tables(NamedTuple):
    """What `fuse` goes by: sets of sensors, their axes, variances, and the tests.

    ``limits`` (windows, degrees of freedom + 1); ``lengths`` (windows,): of how many of those before a window
    is made; ``margin`` of two sensors' shares of p'p in variances.
    """

    sets: Sets
    axes: Vector
    noise: Vector
    limits: Vector
    lengths: Whole
    margin: float
    agreements: int
    near: float


class State(NamedTuple):
    """What `fuse` keeps: ``whole`` numbers, ``sums`` (windows, n) and their ``seconds`` (windows,).

    ``before`` (n,) is the sum of the last full longest window; ``work`` (3 + n,) is of no meaning in between.
    ``hot`` is what `quick` works on.
    """

    whole: Whole
    sums: Vector
    seconds: Vector
    before: Vector
    work: Vector
    hot: Vector


@in_place
def quick(hot: Vector, counts: Vector, first: int, tau: float, dv: Vector, x: Vector) -> bool:
    """Fuse a sample that nothing is wrong with and that ends no window; else false: `fuse` is to be called.

    ``counts`` pulses over ``tau`` s, from place ``first`` on `MOST` of them, zero beyond the last sensor;
    ``dv`` (3,) m/s in b for what gyros feel of it; ``x`` (3,) as of `fuse`.

    Raises ValueError where ``counts`` is shorter.
    """
    if first < 0 or len(counts) < first + MOST:
        raise ValueError("counts: expected lanes for the most sensors that there may be")
    lanes = int(hot[LANES])  # not a constant: loops shall become vectors, not be unrolled
    g0, g1, g2 = dv[0], dv[1], dv[2]
    for k in range(lanes):
        # scales of both signs without a branch
        hot[_Z + k] = (
            (counts[first + k] * hot[SCALE + k] + abs(counts[first + k]) * hot[UNEVEN + k])
            - hot[BIAS + k] * tau
            - (hot[G + k] * g0 + hot[G + MOST + k] * g1 + hot[G + 2 * MOST + k] * g2)
        )
    a, b, c, d = hot[_Z], hot[_Z + 1], hot[_Z + 2], hot[_Z + 3]
    e, f, g, h = hot[_Z + 4], hot[_Z + 5], hot[_Z + 6], hot[_Z + 7]
    for k in range(lanes):  # rows side by side, in lanes of the processor
        hot[_Y + k] = (
            (hot[_MATRIX + k] * a + hot[_MATRIX + MOST + k] * b)
            + (hot[_MATRIX + 2 * MOST + k] * c + hot[_MATRIX + 3 * MOST + k] * d)
        ) + (
            (hot[_MATRIX + 4 * MOST + k] * e + hot[_MATRIX + 5 * MOST + k] * f)
            + (hot[_MATRIX + 6 * MOST + k] * g + hot[_MATRIX + 7 * MOST + k] * h)
        )
    u, v, w = hot[_Y], hot[_Y + 1], hot[_Y + 2]
    p, q, r, s, t = hot[_Y + 3], hot[_Y + 4], hot[_Y + 5], hot[_Y + 6], hot[_Y + 7]
    variance = hot[TIMES] * tau + hot[CONSTANT] + hot[SQUARED] * tau * tau
    variance += hot[MOTION] * (u * u + v * v + w * w)
    # a NaN passes no test
    if hot[_LEFT] < 1.5 or not p * p + q * q + (r * r + s * s) + t * t <= hot[_LIMIT] * variance:
        return False
    for k in range(lanes):
        hot[_SUM + k] += hot[_Z + k]
    hot[_SECONDS] += tau
    hot[_LEFT] -= 1.0
    x[0], x[1], x[2] = u, v, w
    return True


@in_place
def _take(tables: Tables, state: State) -> None:
    """What `quick` has summed up."""
    hot = state.hot
    for k in range(len(state.before)):
        state.sums[0, k] += hot[_SUM + k]
        hot[_SUM + k] = 0.0
    state.seconds[0] += hot[_SECONDS]
    state.whole[FILLED] = tables.lengths[0] - int(hot[_LEFT])
    hot[_SECONDS] = 0.0


@in_place
def give(tables: Tables, state: State) -> None:
    """What `quick` needs of the set of sensors in use."""
    sets, m, n, hot = tables.sets, state.whole[ACTIVE], len(state.before), state.hot
    hot[_LEFT] = tables.lengths[0] - state.whole[FILLED]
    hot[_LIMIT] = tables.limits[0, sets.freedom[m]] if sets.freedom[m] else 1e300
    for k in range(n):
        for i in range(3):
            hot[_MATRIX + MOST * k + i] = sets.fuse[m, i, k]
        for i in range(n - 3):
            hot[_MATRIX + MOST * k + 3 + i] = sets.parity[m, i, k]


@in_place
def variance_of(noise: Vector, seconds: float, motion2: float) -> float:
    """Of an increment, by `Noise.parts`; ``motion2`` is the square of the motion."""
    return float(noise[0] * seconds + noise[1] + noise[2] * seconds * seconds + noise[3] * motion2)


@in_place
def _test(tables: Tables, window: int, z: Vector, seconds: float, state: State) -> int:
    """Test ``z`` (n,): 0 passed, k + 1 sensor k is to go, -1 failed but nobody is to go (suspects are set).

    Leaves the fused z in ``state.work[:3]``.
    """
    sets, m, n = tables.sets, state.whole[ACTIVE], len(z)
    x, p = state.work[:3], state.work[3:]
    motion2 = 0.0
    for i in range(3):
        x[i] = 0.0
        for k in range(n):
            x[i] += sets.fuse[m, i, k] * z[k]
        motion2 += x[i] * x[i]
    freedom = sets.freedom[m]
    square = 0.0
    for i in range(freedom):
        p[i] = 0.0
        for k in range(n):
            p[i] += sets.parity[m, i, k] * z[k]
        square += p[i] * p[i]
    variance = variance_of(tables.noise, seconds, motion2)
    if freedom == 0 or square <= tables.limits[window, freedom] * variance:
        return 0
    state.whole[_ALARM] = 1
    best, most = -1, -1.0
    for turn in range(2):
        suspects = 0
        for k in range(n):
            along = 0.0
            for i in range(freedom):
                along += sets.parity[m, i, k] * p[i]
            share = along * along * sets.inverse[m, k]
            if turn == 0 and share > most:
                best, most = k, share
            if turn == 1 and m >> k & 1 and share > most - tables.margin * variance:
                suspects |= 1 << k
    known = state.whole[SUSPECTS]
    if suspects == 1 << best and sets.spans[m ^ suspects] and (known == 0 or known & suspects):
        return best + 1
    # a test that tells less does not take back what one before has told; one against it has to be confirmed,
    # since while nobody can be told apart there may be thousands
    state.whole[SUSPECTS] = suspects & known if suspects & known else suspects | known
    return -1


@in_place
def _exclude(tables: Tables, k: int, state: State, owed: Vector) -> None:
    """Go on without sensor ``k``, and as if it had not been there in the last windows."""
    m = state.whole[ACTIVE]
    without = m & ~(1 << k)
    state.whole[ACTIVE] = without
    state.whole[FILLED + len(state.seconds) + k] = 0
    if not (tables.sets.spans[m] and tables.sets.spans[without]):
        return
    for j in range(len(state.before)):
        total = state.before[j]
        for window in range(len(state.seconds)):
            total += state.sums[window, j]
        for i in range(3):
            owed[i] += (tables.sets.fuse[without, i, j] - tables.sets.fuse[m, i, j]) * total


@in_place
def _settle(tables: Tables, window: int, z: Vector, seconds: float, state: State, owed: Vector) -> int:
    """Test ``z`` until it passes or nobody is to go; bits of the status."""
    status = 0
    while True:
        found = _test(tables, window, z, seconds, state)
        if found == 0:
            return status
        status |= DETECTED
        if found < 0:
            return status
        status |= EXCLUDED
        state.whole[SUSPECTS] = 0
        _exclude(tables, found - 1, state, owed)


@in_place
def _readmit(tables: Tables, state: State) -> int:
    """At the end of a longest window: who agrees with the others comes back."""
    sets, whole, m, n = tables.sets, state.whole, state.whole[ACTIVE], len(state.before)
    top = len(state.seconds) - 1
    z, x = state.sums[top], state.work[:3]
    motion2, back = 0.0, 0
    for i in range(3):
        x[i] = 0.0
        for k in range(n):
            x[i] += sets.fuse[m, i, k] * z[k]
        motion2 += x[i] * x[i]
    variance = variance_of(tables.noise, state.seconds[top], motion2)
    for k in range(n):
        if m >> k & 1:
            continue
        place = FILLED + top + 1 + k
        off = z[k] - (tables.axes[k, 0] * x[0] + tables.axes[k, 1] * x[1] + tables.axes[k, 2] * x[2])
        here = not whole[_MISSING] >> k & 1
        near = off * off <= tables.near**2 * sets.outside[m, k] * variance
        whole[place] = whole[place] + 1 if here and near else 0
        # where too few are left to judge by, all that are there come back and are tested
        if whole[place] >= tables.agreements or (here and not sets.spans[m]):
            back |= 1 << k
    whole[ACTIVE] |= back
    return back


@in_place
def fuse(tables: Tables, state: State, tau: float, x: Vector, owed: Vector) -> int:
    """Fuse the sample over ``tau`` s that `quick` has refused into ``x`` (3,); its status.

    ``owed`` (3,) is what has to be added to the sum of the samples before, in b: zero unless a sensor was
    excluded; who turns meanwhile has to turn it with him. ``x`` is NaN where the sensors that are left do not
    span space. A sensor whose count is NaN is not there. The twin of the two is `Readable` of
    `nav.imu.redundant_readable`.
    """
    _take(tables, state)
    status = _fuse(tables, state, tau, x, owed)
    give(tables, state)
    return status


@in_place
def _fuse(tables: Tables, state: State, tau: float, x: Vector, owed: Vector) -> int:
    whole, n, top = state.whole, len(state.before), len(state.seconds) - 1
    z = state.hot[_Z : _Z + n]
    status = 0
    owed[0] = owed[1] = owed[2] = 0.0
    gone = 0
    for k in range(n):
        if math.isnan(z[k]):
            gone |= 1 << k
    whole[_MISSING] |= gone
    if whole[ACTIVE] & gone:
        for k in range(n):
            if whole[ACTIVE] & gone & 1 << k:
                status |= EXCLUDED
                _exclude(tables, k, state, owed)
    if gone:
        for k in range(n):
            if gone >> k & 1:
                z[k] = 0.0
    status |= _settle(tables, 0, z, tau, state, owed)
    x[0], x[1], x[2] = state.work[0], state.work[1], state.work[2]
    sums, seconds = state.sums, state.seconds
    for k in range(n):
        sums[0, k] += z[k]
    seconds[0] += tau
    whole[FILLED] += 1
    for window in range(top + 1):
        if whole[FILLED + window] < tables.lengths[window]:
            return status
        status |= _settle(tables, window + 1, sums[window], seconds[window], state, owed)
        whole[FILLED + window] = 0
        if window < top:
            for k in range(n):
                sums[window + 1, k] += sums[window, k]
                sums[window, k] = 0.0
            seconds[window + 1] += seconds[window]
            seconds[window] = 0.0
            whole[FILLED + window + 1] += 1
    back = _readmit(tables, state)
    if back:
        status |= READMITTED
    for k in range(n):
        # what was fused without those who came back is not exchanged again
        state.before[k] = 0.0 if back else sums[top, k]
        sums[top, k] = 0.0
    seconds[top] = 0.0
    if not whole[_ALARM]:
        whole[SUSPECTS] = 0
    whole[_ALARM] = whole[_MISSING] = 0
    return status


@in_place
def quick_both(gyro: Vector, accel: Vector, counts: Vector, tau: float, dtheta: Vector, dv: Vector) -> int:
    """`quick` for a unit: 0 both are done, 1 neither is, 2 the gyros are not.

    ``gyro``, ``accel`` are their ``hot``, ``counts`` those of the gyros, then of the accelerometers, as many.
    """
    if not quick(accel, counts, MOST, tau, dv, dv):
        return 1
    return 0 if quick(gyro, counts, 0, tau, dv, dtheta) else 2
