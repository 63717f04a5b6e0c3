"""The kernel of `nav.imu.redundant`: what is done with a sample that `redundant_sample` has refused."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.imu.parity import MOST, Sets
from nav.imu.redundant_sample import (
    BIAS,
    FELT,
    LANES,
    LEFT,
    LIMIT,
    MATRIX,
    MOVED,
    NOW,
    SECONDS,
    SUM,
    WINDOW,
    Z,
)
from nav.jit import in_place
from nav.types import Vector

Whole = NDArray[np.int64]
DETECTED: Final = 1
"""Bits of the status of a sample: a test failed;"""
EXCLUDED: Final = 2
READMITTED: Final = 4

# places in the state's whole numbers; behind them, one for each sensor, of how many of the longest windows in
# turn it has agreed with the others, in how many parts it has been there, and which test it was excluded by
ACTIVE, SUSPECTS, _MISSING, _ALARM, _BACK, _FILLED, _AT, _AGE, _KEPT, _TURN = range(10)
AGREED: Final = 10
PRESENT: Final = AGREED + MOST
_TEST: Final = PRESENT + MOST
WHOLE: Final = _TEST + MOST


class Tables(NamedTuple):
    """What `fuse` goes by: sets of sensors, their axes, variances, and the tests.

    A part is the first window, of ``samples``; ``lengths`` (windows,) are in parts. ``limits`` (1 + windows,
    degrees of freedom + 1); ``margin`` of two sensors' shares of p'p in variances.
    """

    sets: Sets
    axes: Vector
    bias: Vector
    g_sensitivity: Vector
    noise: Vector
    limits: Vector
    samples: int
    lengths: Whole
    margin: float
    agreements: int
    near: float


class State(NamedTuple):
    """What `fuse` keeps: ``whole`` numbers, the last parts' ``sums`` (r, `MOST`) and ``seconds`` (r,).

    There are as many parts as the longest window has; the one that is being filled is among them. ``work``
    (3 + n,) is of no meaning in between. ``hot`` is what `quick` works on.
    """

    whole: Whole
    sums: Vector
    seconds: Vector
    work: Vector
    hot: Vector


@in_place
def _less(tables: Tables, k: int, seconds: float, moved: Vector) -> float:
    """What sensor ``k`` puts out of itself over ``seconds`` in which it was moved (3,) m/s."""
    g = tables.g_sensitivity
    return float(tables.bias[k] * seconds + (g[k, 0] * moved[0] + g[k, 1] * moved[1] + g[k, 2] * moved[2]))


@in_place
def _take(tables: Tables, state: State, tau: float) -> None:
    """What `quick` has summed up, and the increments of the sample it has refused."""
    hot, at = state.hot, state.whole[_AT]
    for k in range(len(tables.axes)):
        state.sums[at, k] += hot[SUM + k] - _less(tables, k, hot[SECONDS], hot[MOVED : MOVED + 3])
        hot[Z + k] -= _less(tables, k, tau, hot[NOW : NOW + 3])
        hot[SUM + k] = 0.0
    state.seconds[at] += hot[SECONDS]
    state.whole[_FILLED] = tables.samples - int(hot[LEFT])
    hot[SECONDS] = hot[MOVED] = hot[MOVED + 1] = hot[MOVED + 2] = 0.0


@in_place
def give(tables: Tables, state: State) -> None:
    """What `quick` needs of the set of sensors in use."""
    sets, m, n, hot = tables.sets, state.whole[ACTIVE], len(tables.axes), state.hot
    hot[LIMIT] = tables.limits[0, sets.freedom[m]] if sets.freedom[m] else 1e300
    for i in range(n):
        hot[BIAS + i] = hot[FELT + i] = hot[FELT + MOST + i] = hot[FELT + 2 * MOST + i] = 0.0
        for k in range(n):
            row = sets.fuse[m, i, k] if i < 3 else sets.parity[m, i - 3, k]
            hot[MATRIX + MOST * k + i] = row
            hot[BIAS + i] += row * tables.bias[k]
            for j in range(3):
                hot[FELT + MOST * j + i] += row * tables.g_sensitivity[k, j]


@in_place
def variance_of(noise: Vector, seconds: float, motion2: float) -> float:
    """Of an increment, by `Noise.parts`; ``motion2`` is the square of the motion."""
    return float(noise[0] * seconds + noise[1] + noise[2] * seconds * seconds + noise[3] * motion2)


@in_place
def _parity(sets: Sets, m: int, z: Vector, p: Vector) -> float:
    """p'p of the sensors in ``m``, whose p is left in ``p``."""
    square = 0.0
    for i in range(sets.freedom[m]):
        p[i] = 0.0
        for k in range(len(z)):
            p[i] += sets.parity[m, i, k] * z[k]
        square += p[i] * p[i]
    return square


@in_place
def _share(sets: Sets, m: int, k: int, p: Vector) -> float:
    """What sensor ``k`` explains of p'p."""
    along = 0.0
    for i in range(sets.freedom[m]):
        along += sets.parity[m, i, k] * p[i]
    return float(along * along * sets.inverse[m, k])


@in_place
def _likely(sets: Sets, m: int, p: Vector, margin: float) -> int:
    """Bits of the sensors in ``m`` whose share is less than ``margin`` below the largest."""
    most, found = -1.0, 0
    for k in range(sets.inverse.shape[1]):
        most = max(most, _share(sets, m, k, p))
    for k in range(sets.inverse.shape[1]):
        if m >> k & 1 and _share(sets, m, k, p) > most - margin:
            found |= 1 << k
    return found


@in_place
def _fused(sets: Sets, m: int, z: Vector, x: Vector) -> float:
    """Leaves in ``x`` what sensors ``m`` make of ``z``; returns its square."""
    square = 0.0
    for i in range(3):
        x[i] = 0.0
        for k in range(len(z)):
            x[i] += sets.fuse[m, i, k] * z[k]
        square += x[i] * x[i]
    return square


@in_place
def _agrees(tables: Tables, m: int, k: int, z: Vector, x: Vector, variance: float) -> bool:
    """Whether sensor ``k`` is near what the sensors in ``m``, it not among them, made of ``z``: ``x``."""
    off = z[k] - (tables.axes[k, 0] * x[0] + tables.axes[k, 1] * x[1] + tables.axes[k, 2] * x[2])
    return bool(off * off <= tables.near**2 * tables.sets.outside[m, k] * variance)


@in_place
def _wronged(tables: Tables, window: int, z: Vector, variance: float, state: State) -> int:
    """The sensor that has failed instead of one that is excluded, k + 1, which is noted; else 0.

    One fault explains more than two: where a sensor in use alone explains the test with the excluded one, and
    without it that one agrees with the others, it was excluded for nothing. Tests that may be blind to what
    it was excluded for do not acquit it.
    """
    sets, m, whole = tables.sets, state.whole[ACTIVE], state.whole
    x, p = state.work[:3], state.work[3:]
    parts = tables.lengths[window - 1] if window else 0
    for a in range(len(z)):
        gone = m >> a & 1 or whole[_MISSING] >> a & 1
        if gone or whole[PRESENT + a] < parts or whole[_TEST + a] > window:
            continue
        both = m | 1 << a
        square = _parity(sets, both, z, p)
        likely = _likely(sets, both, p, tables.margin * variance)
        for k in range(len(z)):
            rest = m & ~(1 << k)
            if likely != 1 << k or k == a or not sets.spans[rest]:
                continue
            left = square - _share(sets, both, k, p)
            _fused(sets, rest, z, x)
            passes = left <= tables.limits[window, sets.freedom[m]] * variance
            if passes and _agrees(tables, rest, a, z, x, variance):
                whole[_BACK] = 1 << a
                return k + 1
    return 0


@in_place
def _blame(tables: Tables, window: int, z: Vector, seconds: float, state: State) -> int:
    """Of ``z`` (n,) that has failed a test: sensor k is to go, k + 1, or nobody, 0, and suspects are set."""
    sets, m, whole = tables.sets, state.whole[ACTIVE], state.whole
    x, p = state.work[:3], state.work[3:]
    variance = variance_of(tables.noise, seconds, _fused(sets, m, z, x))
    whole[_ALARM] = 1
    found = _wronged(tables, window, z, variance, state)
    if found:
        return found
    _parity(sets, m, z, p)
    likely, known = _likely(sets, m, p, tables.margin * variance), whole[SUSPECTS]
    for k in range(len(z)):
        if likely == 1 << k and sets.spans[m ^ likely] and (known == 0 or known & likely):
            return k + 1
    # a test that tells less does not take back what one before has told; one against it has to be confirmed,
    # since while nobody can be told apart there may be thousands
    whole[SUSPECTS] = likely & known if likely & known else likely | known
    return 0


@in_place
def _exclude(tables: Tables, k: int, window: int, state: State, owed: Vector) -> None:
    """Go on without sensor ``k``, and as if it had not been there in the parts that are kept."""
    whole, sets = state.whole, tables.sets
    m = whole[ACTIVE]
    without = (m | whole[_BACK]) & ~(1 << k)
    whole[ACTIVE], whole[_BACK] = without, 0
    whole[AGREED + k], whole[_TEST + k] = 0, window
    give(tables, state)
    if not (sets.spans[m] and sets.spans[without]):
        return
    parts = len(state.seconds)
    for part in range(whole[_KEPT] + 1):
        row = (whole[_AT] - part) % parts
        for j in range(len(tables.axes)):
            for i in range(3):
                owed[i] += (sets.fuse[without, i, j] - sets.fuse[m, i, j]) * state.sums[row, j]


@in_place
def _fine(tables: Tables, window: int, z: Vector, seconds: float, state: State) -> bool:
    """Whether ``z`` (n,) passes the test, or there is none; leaves it fused in ``state.work[:3]``."""
    sets, m = tables.sets, state.whole[ACTIVE]
    variance = variance_of(tables.noise, seconds, _fused(sets, m, z, state.work[:3]))
    freedom = sets.freedom[m]
    square = _parity(sets, m, z, state.work[3:])
    return bool(freedom == 0 or square <= tables.limits[window, freedom] * variance)


@in_place
def _settle(tables: Tables, window: int, z: Vector, seconds: float, state: State, owed: Vector) -> int:
    """``z`` has failed: go on until it passes or nobody is to go; bits of the status."""
    status = DETECTED
    while True:
        found = _blame(tables, window, z, seconds, state)
        if found == 0:
            return status
        status |= EXCLUDED | (READMITTED if state.whole[_BACK] else 0)
        state.whole[SUSPECTS] = 0
        _exclude(tables, found - 1, window, state, owed)
        if _fine(tables, window, z, seconds, state):
            return status


@in_place
def _readmit(tables: Tables, seconds: float, state: State) -> int:
    """At the end of a longest window: who agrees with the others comes back."""
    sets, whole, m = tables.sets, state.whole, state.whole[ACTIVE]
    z, x, back = state.hot[WINDOW : WINDOW + len(tables.axes)], state.work[:3], 0
    variance = variance_of(tables.noise, seconds, _fused(sets, m, z, x))
    for k in range(len(z)):
        if m >> k & 1:
            continue
        here = whole[PRESENT + k] >= tables.lengths[-1]
        agrees = here and _agrees(tables, m, k, z, x, variance)
        whole[AGREED + k] = whole[AGREED + k] + 1 if agrees else 0
        # where too few are left to judge by, all that are there come back and are tested
        if whole[AGREED + k] >= tables.agreements or (here and not sets.spans[m]):
            back |= 1 << k
    if back:
        whole[ACTIVE] |= back
        give(tables, state)
    return back


@in_place
def fuse(tables: Tables, state: State, tau: float, x: Vector, owed: Vector) -> int:
    """Fuse the sample over ``tau`` s that `quick` has refused into ``x`` (3,); its status.

    ``owed`` (3,) is what has to be added to the sum of the samples before, in b: zero unless a sensor was
    excluded; who turns meanwhile has to turn it with him. ``x`` is NaN where the sensors that are left do not
    span space. A sensor whose count is NaN is not there. The twin of the two is `Readable` of
    `nav.imu.redundant_readable`.
    """
    _take(tables, state, tau)
    whole, n = state.whole, len(tables.axes)
    z, at = state.hot[Z : Z + n], state.whole[_AT]
    status = 0
    owed[0] = owed[1] = owed[2] = 0.0
    for k in range(n):
        if math.isnan(z[k]):
            z[k] = 0.0
            whole[_MISSING] |= 1 << k
            if whole[ACTIVE] >> k & 1:
                status |= EXCLUDED
                _exclude(tables, k, 0, state, owed)
    if not _fine(tables, 0, z, tau, state):
        status |= _settle(tables, 0, z, tau, state, owed)
        _fused(tables.sets, whole[ACTIVE], z, state.work[:3])
    x[0], x[1], x[2] = state.work[0], state.work[1], state.work[2]
    for k in range(n):
        state.sums[at, k] += z[k]
    state.seconds[at] += tau
    whole[_FILLED] += 1
    if whole[_FILLED] == tables.samples:
        status |= _end(tables, state, owed)
    state.hot[LEFT] = tables.samples - whole[_FILLED]
    return status


@in_place
def _end(tables: Tables, state: State, owed: Vector) -> int:
    """At the end of a part: tests of all windows that end with it; bits of the status."""
    whole, n, parts, hot = state.whole, len(tables.axes), len(state.seconds), state.hot
    seconds, taken, status, lanes = 0.0, 0, 0, int(hot[LANES])
    whole[_AGE] = min(whole[_AGE] + 1, parts)
    for k in range(n):
        whole[PRESENT + k] = 0 if whole[_MISSING] >> k & 1 else min(whole[PRESENT + k] + 1, parts)
    whole[_MISSING] = 0
    for k in range(lanes):
        hot[WINDOW + k] = 0.0
    for window in range(len(tables.lengths)):
        if whole[_AGE] < tables.lengths[window]:
            break
        while taken < tables.lengths[window]:
            row = whole[_AT] - taken
            row += parts if row < 0 else 0
            for k in range(lanes):
                hot[WINDOW + k] += state.sums[row, k]
            seconds += state.seconds[row]
            taken += 1
        z = hot[WINDOW : WINDOW + n]
        if not _fine(tables, window + 1, z, seconds, state):
            status |= _settle(tables, window + 1, z, seconds, state, owed)
    whole[_KEPT] = min(whole[_KEPT] + 1, parts - 1)
    whole[_TURN] += 1
    if whole[_TURN] == parts:
        if _readmit(tables, seconds, state):
            status |= READMITTED
            whole[_KEPT] = 0  # what was fused without those who came back is not exchanged again
        if not whole[_ALARM]:
            whole[SUSPECTS] = 0
        whole[_ALARM] = whole[_TURN] = 0
    whole[_FILLED] = 0
    whole[_AT] = (whole[_AT] + 1) % parts
    for k in range(lanes):
        state.sums[whole[_AT], k] = 0.0
    state.seconds[whole[_AT]] = 0.0
    return status
