"""Dithered laser gyros that are read at whole cycles of their dither, and what they would have counted.

A laser gyro is shaken about its axis so that slow rates do not lock in. Counts taken over whole cycles of
that dither are free of it, but each gyro ends its cycles at its own times: what is read at a sampling instant
was latched up to a cycle before it, at another age for each axis, and a rotation whose axis moves is
integrated wrongly. With the age of each latch, told by a counter in the gyro's electronics, the count that
the instant itself would have seen can be estimated: Yan Gongmin 2008, chapter 6.

With theta_k the count at the latch, r_k its age, H_k the time since the latch before and W_k the mean rate in
between, the increment between instants is (6-14)

    Delta_k + delta_k - delta_(k-1),    delta_k = what was turned in the last r_k.

The text extrapolates the rate to the middle of r_k, by a polynomial through the mean rates at the middles of
the last intervals: `constant`, `linear` (6-12), (6-13), `parabolic`, and the mean of the last two,
`linear+parabolic`.

Ours, `sextic+septic`, extrapolates the angle itself through the latches, which are points of it and no means,
by a weighted mean of the polynomials of degree 6 and 7. Of an oscillation that turns by phi between latches,
of backward difference D = 1 - exp(-i phi), a polynomial of degree n leaves the sum over m > n of c_m(x) D^m,
where x is the age in intervals and c_m = x (x + 1) ... (x + m - 1) / m!. A part in quadrature is a delay,
whose effect on a coning navigation is of second order; a part in phase makes the cone wider on one axis, and
that drifts. For even n the first two terms have parts in phase of the same order, which cancel when of the
first only 1 - lambda is left: (1 - lambda)(n + 1)/2 = (n + 1 + x)/(n + 2). (The mean of linear and parabolic
has nearly the lambda of n = 2.) It follows motion best and magnifies the noise of latches most: where there
is little but noise, `linear` is quieter.

The latches that carry the polynomial are at least `SPACING` apart, since noise of close ones would be
magnified. All methods are causal: they use latches of the past only and delay nothing.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.jit import in_place
from nav.types import Vector


class Method(NamedTuple):
    """A way to extrapolate: shares of the rate's slope and bend, or the (even) degree of the angle."""

    slope: float
    bend: float
    degree: int = 0


METHODS: Final = {
    "constant": Method(0.0, 0.0),
    "linear": Method(1.0, 0.0),
    "parabolic": Method(1.0, 1.0),
    "linear+parabolic": Method(1.0, 0.5),  # a mean of the two has half the bend
    "sextic+septic": Method(0.0, 0.0, 6),
}
"""By the name in a configuration."""

SPACING: Final = 0.0065
"""Least time between latches that carry the angle's polynomial, s: below 10 ms less a cycle of 300 Hz."""
CYCLE: Final = 1e-4
"""Latches closer than this are one and the same, s: no gyro is shaken faster."""
COAST: Final = 0.03
"""How old a latch may be where the ages of later ones are not known, s."""

_COAST_METHOD: Final = METHODS["linear"]
_RING: Final = 32  # intervals kept: as many latches as seven spacings can hold, and a power of two
_MOST: Final = 8  # nodes of the angle's polynomial

# places in a row of the state; one row for each gyro
_NODES, _HEAD, _AGE, _PENDING, _AHEAD = range(5)
_X: Final = 5
_Y: Final = _X + _MOST
_H: Final = _Y + _MOST
_D: Final = _H + _RING
_SIZE: Final = _D + _RING


@in_place
def _polynomials(state: Vector, i: int, degree: int, age: float) -> float:
    """Count at the instant less that at the newest latch, by Neville's scheme; two degrees, mixed."""
    nodes, x, y = 1, -age, 0.0
    state[i, _X], state[i, _Y] = x, 0.0
    head = int(state[i, _HEAD])
    for j in range(int(state[i, _NODES]) - 1):
        place = head - j & _RING - 1
        x -= state[i, _H + place]
        y -= state[i, _D + place]
        if state[i, _X + nodes - 1] - x >= SPACING:
            state[i, _X + nodes], state[i, _Y + nodes] = x, y
            nodes += 1
            if nodes == degree + 2:
                break
    lower = 0.0
    for m in range(1, nodes):
        lower = state[i, _Y]
        for j in range(nodes - m):
            a, b = state[i, _X + j], state[i, _X + j + m]
            state[i, _Y + j] = (a * state[i, _Y + j + 1] - b * state[i, _Y + j]) / (a - b)
    if nodes < degree + 2:
        return float(state[i, _Y])
    steps = age * (degree + 1) / (state[i, _X] - state[i, _X + degree + 1])
    share = (degree * (degree + 1) - 2.0 * steps) / ((degree + 1) * (degree + 2))
    return float(lower + share * (state[i, _Y] - lower))


@in_place
def _ahead(state: Vector, i: int, slope: float, bend: float, degree: int, age: float) -> float:
    """What was turned since the newest latch, pulses: delta of the text."""
    if degree > 0:
        return _polynomials(state, i, degree, age)
    head, intervals = int(state[i, _HEAD]), int(state[i, _NODES]) - 1
    if intervals < 1:
        return 0.0
    place = head & _RING - 1
    h0 = state[i, _H + place]
    rate = w0 = state[i, _D + place] / h0
    if intervals > 1:
        place = head - 1 & _RING - 1
        h1 = state[i, _H + place]
        w1 = state[i, _D + place] / h1
        # divided differences of the mean rates at the middles, evaluated in the middle of the age
        first = (w0 - w1) / (0.5 * (h0 + h1))
        rate += slope * 0.5 * (age + h0) * first
        if intervals > 2:
            place = head - 2 & _RING - 1
            h2 = state[i, _H + place]
            w2 = state[i, _D + place] / h2
            second = (first - (w1 - w2) / (0.5 * (h1 + h2))) / (0.5 * (h0 + 2.0 * h1 + h2))
            rate += bend * 0.25 * (age + h0) * (age + 2.0 * h0 + h1) * second
    return float(rate * age)


@in_place
def correct(
    slope: float, bend: float, degree: int, state: Vector, ages: Vector, tau: float, counts: Vector
) -> None:
    """Replace ``counts`` of three gyros by what they would be from one sampling instant to the next.

    ``slope``, ``bend``, ``degree`` from a `Method`; ``state`` from `fresh`; ``ages`` (3,) s of the latches
    at the instant, negative where not known; ``tau`` s since the instant before. ``counts`` (3,) or more,
    pulses between the latches. `ahead_readable` is what
    it does with the latches.
    """
    for i in range(3):
        if state[i, _NODES] == 0.0:
            if ages[i] < 0.0:
                state[i, _AHEAD] = 0.0
            else:  # where the latch before it was nobody knows: the count is taken as it is
                state[i, _NODES], state[i, _AGE] = 1.0, ages[i]
            continue
        old = state[i, _AGE] + tau
        state[i, _PENDING] += counts[i]
        if ages[i] < 0.0:
            state[i, _AGE] = old
            if math.isnan(state[i, _AHEAD]):
                state[i, _AHEAD] = 0.0
            if old <= COAST:
                ahead = _ahead(state, i, _COAST_METHOD.slope, _COAST_METHOD.bend, 0, old)
                counts[i] = ahead - state[i, _AHEAD]
                state[i, _AHEAD] = ahead
            else:  # back to what was counted
                counts[i] = state[i, _PENDING] - state[i, _AHEAD]
                state[i, _NODES] = state[i, _PENDING] = state[i, _AHEAD] = 0.0
            continue
        passed = 0.0
        if old - ages[i] > CYCLE:
            head = int(state[i, _HEAD]) + 1 & _RING - 1
            passed = state[i, _PENDING]
            state[i, _HEAD] = head
            state[i, _H + head], state[i, _D + head] = old - ages[i], passed
            state[i, _NODES] = min(state[i, _NODES] + 1.0, _RING + 1.0)
            state[i, _PENDING] = 0.0
            if math.isnan(state[i, _AHEAD]):  # the first one's, from the rate after it
                state[i, _AHEAD] = passed / (old - ages[i]) * state[i, _AGE]
        state[i, _AGE] = ages[i]
        if math.isnan(state[i, _AHEAD]):
            state[i, _AHEAD] = 0.0
        ahead = _ahead(state, i, slope, bend, degree, ages[i])
        counts[i] = passed + ahead - state[i, _AHEAD]
        state[i, _AHEAD] = ahead


def fresh() -> Vector:
    """The state before anything is known."""
    state = np.zeros((3, _SIZE))
    state[:, _AHEAD] = math.nan
    return state


def synchronised() -> Vector:
    """The state at an instant that all gyros are latched at."""
    state = np.zeros((3, _SIZE))
    state[:, _NODES] = 1.0
    return state


class WholeCycle:
    """The correction of one unit, from sample to sample."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self._state = fresh()

    def restart(self) -> None:
        """Forget: samples before the next one are missing."""
        self._state = fresh()

    def correct(self, ages: Vector, tau: float, counts: Vector) -> None:
        """See `correct`."""
        slope, bend, degree = self._method
        correct(slope, bend, degree, self._state, ages, tau, counts)


def ahead_readable(method: Method, latches: Vector, counted: Vector, now: float) -> float:
    """What was turned between the last of ``latches`` (n,) s and ``now``; ``counted`` (n,) pulses till each.

    Yan Gongmin 2008, eqs. (6-12), (6-13), and the polynomials that the text leaves to the reader.
    """
    age = now - latches[-1]
    if method.degree > 0:
        kept = [len(latches) - 1]
        for j in range(len(latches) - 2, -1, -1):
            if latches[kept[-1]] - latches[j] >= SPACING and len(kept) < method.degree + 2:
                kept.append(j)
        x, y, n = latches[kept], counted[kept], method.degree
        lower, upper = (_lagrange(x[:nodes], y[:nodes], now) for nodes in (n + 1, n + 2))
        if len(kept) == n + 2:
            steps = age * (n + 1) / (x[0] - x[-1])
            share = 1.0 - 2.0 * (n + 1 + steps) / ((n + 1) * (n + 2))
            upper = (1.0 - share) * lower + share * upper
        return upper - float(counted[-1])
    rates = np.diff(counted) / np.diff(latches)
    middles = 0.5 * (latches[1:] + latches[:-1])
    at = now - 0.5 * age
    constant, linear, parabolic = (_lagrange(middles[-n:], rates[-n:], at) for n in (1, 2, 3))
    rate = constant + method.slope * (linear - constant) + method.bend * (parabolic - linear)
    return float(rate * age)


def _lagrange(x: Vector, y: Vector, at: float) -> float:
    total = 0.0
    for j in range(len(x)):
        others = np.delete(x, j)
        total += float(y[j] * np.prod((at - others) / (x[j] - others)))
    return total
