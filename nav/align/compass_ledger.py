"""What a gyrocompass result is worth: everything that went into it, with the weight it has in the end.

The loops are linear in small errors, so the state that they end in is a sum: initial state, constant
sensor errors and every second of noise, each with a matrix in front. A `Ledger` carries these matrices
through the passes by the loops' equations (`nav.align.compass_theory.dynamics`). Noise of one second of
data comes in again with every pass over it: it is booked under its second, not anew, which is why going
over the same data many times does not make the result look better than it is.

The book begins with the first sample. While heading is not known the axes are those of the platform, whose
azimuth nobody knows and whose errors are small none the less; a second book follows the platform that was
let go, and from the two the heading that `Ledger.find_north` enters has its errors, and its correlations.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from nav.align.compass_theory import (
    BASE,
    EPS,
    INPUTS,
    NABLA,
    P_E,
    PHI,
    STATES,
    V_E,
    V_N,
    AzimuthGains,
    LevelGains,
    Place,
    dynamics,
)
from nav.jit import kernel
from nav.types import Vector

TICK_S: Final = 1.0
ROOM: Final = 128  # seconds by which the book grows
FREE: Final = LevelGains(0.0, 0.0, 0.0)
SWAY_S: Final = 1.0  # correlation time of the base's velocity
_KEPT: Final = math.exp(-TICK_S / SWAY_S)
# of its variance, that of its mean over a tick, and the covariance of two such that follow over that
_SAME: Final = 2.0 * SWAY_S / TICK_S * (1.0 - SWAY_S / TICK_S * (1.0 - _KEPT))
_NEXT: Final = (SWAY_S / TICK_S * (1.0 - _KEPT)) ** 2 / _SAME
_UP: Final = PHI.stop - 1
_START, _CONSTANT, _NOISE = slice(0, STATES), slice(STATES, STATES + INPUTS), STATES + INPUTS
_DOUBLINGS: Final = 5


class Noise(NamedTuple):
    """What goes in.

    ``gyro`` rad^2/s and ``accelerometer`` m^2/s^3; ``base`` m^2/s^2, the variance of the motion that the
    loops take for an error of velocity, which stays `SWAY_S`; ``constant`` (8,): gyros rad/s and
    accelerometers m/s^2 in b, reference velocity along and across m/s per m/s.
    """

    gyro: float
    accelerometer: float
    base: float
    constant: Vector


@lru_cache(maxsize=64)
def _transition(
    at: Place, level: LevelGains, azimuth: AzimuthGains | None, seconds: float
) -> tuple[Vector, Vector]:
    """Transition (8, 8) and the integral of the inputs (8, 8) over ``seconds``, negative ones backwards."""
    F, G = dynamics(at, level, azimuth)
    h = seconds / 2**_DOUBLINGS
    phi, gamma = np.eye(STATES), np.zeros((STATES, STATES))
    term = np.eye(STATES)
    for k in range(1, 9):
        gamma += term * (h / k)
        term = term @ F * (h / k)
        phi += term
    for _ in range(_DOUBLINGS):
        gamma = phi @ gamma + gamma
        phi = phi @ phi
    return phi, gamma @ G


@kernel
def _carry(phi: Vector, gamma: Vector, mixed: Vector, book: Vector, used: int, first: int) -> None:
    """One tick, in place: ``book`` (8, n) becomes phi book, and gets the inputs' share of that second.

    ``mixed`` (8, 8) is ``gamma`` of the constant errors, in their own axes.
    """
    old = np.empty(STATES)
    for j in range(used):
        for i in range(STATES):
            old[i] = book[i, j]
        for i in range(STATES):
            total = 0.0
            for k in range(STATES):
                total += phi[i, k] * old[k]
            book[i, j] = total
    for i in range(STATES):
        for j in range(INPUTS):
            book[i, STATES + j] += mixed[i, j]
            book[i, first + j] += gamma[i, j]


@kernel
def _squares(book: Vector, used: int, variance: Vector, P: Vector) -> None:
    """Add to ``P`` (8, 8) what noise of ``variance`` (8,) an input makes, over all seconds in ``book``.

    That of the base is not white: means over neighbouring seconds of what decays in `SWAY_S` are alike.
    """
    for j in range(STATES + INPUTS, used):
        q = variance[(j - STATES) % INPUTS]
        for i in range(STATES):
            a = q * book[i, j]
            for k in range(STATES):
                P[i, k] += a * book[k, j]
    before = np.zeros(STATES)
    for axis in range(BASE.start, INPUTS):
        before[:] = 0.0
        for j in range(STATES + INPUTS + axis, used, INPUTS):
            for i in range(STATES):
                for k in range(STATES):
                    P[i, k] += variance[axis] * _NEXT * (book[i, j] * before[k] + before[i] * book[k, j])
            for i in range(STATES):
                before[i] = _KEPT * before[i] + book[i, j]


class Ledger:
    """See the module. ``start`` (8,) are standard deviations of the first state."""

    def __init__(self, at: Place, start: Vector) -> None:
        self._at = at
        self._start = start
        self._book = np.zeros((STATES, _NOISE + INPUTS * ROOM))
        self._book[:, _START] = np.eye(STATES)
        self._used = _NOISE
        self._free: Vector | None = None
        self._rest = 0.0
        self._of: tuple[Noise, Vector] | None = None  # the last that was asked for

    def advance(
        self,
        level: LevelGains,
        azimuth: AzimuthGains | None,
        begin: float,
        seconds: float,
        ahead: bool,
        mix: Vector,
    ) -> None:
        """The loops went through ``seconds`` of data; ``begin`` (s) is where these lie in the store.

        ``mix`` (8, 8) takes constant errors from their own axes to those of the inputs.
        """
        # where the next tick begins, and in which direction they follow
        at, step = (begin - self._rest, TICK_S) if ahead else (begin + seconds + self._rest - TICK_S, -TICK_S)
        self._rest += seconds
        while self._rest >= TICK_S - 1e-9:
            self._rest -= TICK_S
            self._tick(level, azimuth, max(0, int(at / TICK_S + 0.5)), ahead, mix)
            at += step

    def turn(self) -> None:
        """A pass ends here; less than a second that is left over is dropped."""
        self._rest = 0.0

    def _tick(
        self, level: LevelGains, azimuth: AzimuthGains | None, second: int, ahead: bool, mix: Vector
    ) -> None:
        seconds = TICK_S if ahead else -TICK_S
        first = _NOISE + INPUTS * second
        if first + INPUTS > self._book.shape[1]:
            more = np.zeros((STATES, first + INPUTS * ROOM - self._book.shape[1]))
            self._book = np.hstack([self._book, more])
            if self._free is not None:
                self._free = np.hstack([self._free, more])
        self._used = max(self._used, first + INPUTS)
        self._of = None
        phi, gamma = _transition(self._at, level, azimuth, seconds)
        _carry(phi, gamma, gamma @ mix, self._book, self._used, first)
        if self._free is not None:
            phi, gamma = _transition(self._at, FREE, None, seconds)
            _carry(phi, gamma, gamma @ mix, self._free, self._used, first)

    def let_go(self) -> None:
        """From here on there is a second platform, without control."""
        self._free = self._book.copy()
        self._free[P_E:] = 0.0

    def find_north(self, angle: float, grown: float) -> None:
        """Axes turn by ``angle`` (rad) about up to be east and north, and what is wrong with that.

        ``grown`` (m/s) is what Earth's north rate makes of the free platform's velocity.
        """
        assert self._free is not None
        s, c = math.sin(angle), math.cos(angle)
        apart = self._free[: V_N + 1] - self._book[: V_N + 1]
        for k in (V_E, PHI.start):
            east, north = self._book[k].copy(), self._book[k + 1].copy()
            self._book[k], self._book[k + 1] = c * east - s * north, s * east + c * north
        self._book[_UP] = (s * apart[V_E] + c * apart[V_N]) / grown
        self._book[P_E:] = 0.0
        # how much of an error of heading is still there is asked later
        self._book[:, _UP] = 0.0
        self._book[_UP, _UP] = 1.0
        self._free = None
        self._of = None

    def kept(self) -> float:
        """How much of an error of heading at the start there still is."""
        return abs(float(self._book[_UP, _UP]))

    def constants(self) -> Vector:
        """Weights (3, 8) of the constant errors in phi."""
        return self._book[PHI, _CONSTANT].copy()

    def noise(self, noise: Noise) -> Vector:
        """Covariance (8, 8) of all but the constant errors: noise, motion of the base, the start."""
        if self._of is not None and self._of[0] is noise:
            return self._of[1]
        start = self._book[:, _START] * self._start
        P = np.ascontiguousarray(start @ start.T)
        variance = np.empty(INPUTS)
        variance[EPS], variance[NABLA] = noise.gyro / TICK_S, noise.accelerometer / TICK_S
        variance[BASE] = noise.base * _SAME
        _squares(self._book, self._used, variance, P)
        self._of = noise, P
        return P

    def covariance(self, noise: Noise) -> Vector:
        """Covariance (8, 8) of everything."""
        constant = self._book[:, _CONSTANT] * noise.constant
        return np.asarray(self.noise(noise) + constant @ constant.T)
