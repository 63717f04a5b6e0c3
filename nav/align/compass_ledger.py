"""What a gyrocompass result is worth: everything that went into it, with the weight it has in the end.

The loops are linear in small errors, so the state that they end in is a sum: initial state, constant
sensor errors and every second of noise, each with a matrix in front. A `Ledger` carries these matrices
through the passes by the loops' equations (`nav.align.compass_theory.dynamics`). Noise of one second of
data comes in again with every pass over it: it is booked under its second, not anew, which is why going
over the same data many times does not make the result look better than it is.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from nav.align.compass_theory import (
    BASE,
    EPS,
    INPUTS,
    NABLA,
    PHI,
    STATES,
    AzimuthGains,
    LevelGains,
    Place,
    dynamics,
)
from nav.align.types import AlignConfig
from nav.jit import kernel
from nav.types import Vector

TICK_S: Final = 1.0
ROOM: Final = 128  # seconds by which the book grows
SWAY_S: Final = 1.0  # correlation time of the base's motion
_START, _CONSTANT, _NOISE = slice(0, STATES), slice(STATES, STATES + INPUTS), STATES + INPUTS
_DOUBLINGS: Final = 5


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
def _carry(phi: Vector, gamma: Vector, book: Vector, used: int, first: int) -> None:
    """One tick, in place: ``book`` (8, n) becomes phi book, and gets the inputs' share of that second."""
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
            book[i, STATES + j] += gamma[i, j]
            book[i, first + j] += gamma[i, j]


@kernel
def _squares(book: Vector, used: int, variance: Vector, P: Vector) -> None:
    """Add to ``P`` (8, 8) what noise of ``variance`` (8,) an input makes, over all seconds in ``book``."""
    for j in range(STATES + INPUTS, used):
        q = variance[(j - STATES) % INPUTS]
        for i in range(STATES):
            a = q * book[i, j]
            for k in range(STATES):
                P[i, k] += a * book[k, j]


class Ledger:
    """See the module. ``start`` (8, 8) is the covariance of the first state, ``known`` (8, 8) what of it the
    constant errors are the cause of.
    """

    def __init__(self, at: Place, start: Vector, known: Vector) -> None:
        self._at = at
        self._start = start
        self._book = np.zeros((STATES, _NOISE + INPUTS * ROOM))
        self._used = _NOISE
        self._book[:, _START] = np.eye(STATES)
        self._book[:, _CONSTANT] = known
        self._rest = 0.0
        self._noise: Vector | None = None  # of the last tick, once it has been asked for

    def advance(
        self, level: LevelGains, azimuth: AzimuthGains | None, begin: float, seconds: float, ahead: bool
    ) -> None:
        """The loops went through ``seconds`` of data; ``begin`` (s) is where these lie in the store."""
        self._rest += seconds
        while self._rest >= TICK_S:
            self._rest -= TICK_S
            self._tick(level, azimuth, max(0.0, begin), ahead)

    def turn(self) -> None:
        """A pass ends here; less than a second that is left over is dropped."""
        self._rest = 0.0

    def _tick(self, level: LevelGains, azimuth: AzimuthGains | None, begin: float, ahead: bool) -> None:
        phi, gamma = _transition(self._at, level, azimuth, TICK_S if ahead else -TICK_S)
        first = _NOISE + INPUTS * int(begin / TICK_S)
        if first + INPUTS > self._book.shape[1]:
            more = np.zeros((STATES, first + INPUTS * ROOM - self._book.shape[1]))
            self._book = np.hstack([self._book, more])
        self._used = max(self._used, first + INPUTS)
        self._noise = None
        _carry(phi, gamma, self._book, self._used, first)

    def constants(self) -> tuple[Vector, Vector]:
        """Weights of constant errors of gyros (3, 3) and accelerometers (3, 3), g axes, in phi."""
        share = self._book[PHI, _CONSTANT]
        return share[:, EPS].copy(), share[:, NABLA].copy()

    def noise(self, config: AlignConfig) -> Vector:
        """Covariance (8, 8) of all but the constant errors: noise, motion of the base, the start."""
        if self._noise is not None:
            return self._noise
        P = self._book[:, _START] @ self._start @ self._book[:, _START].T
        variance = np.empty(INPUTS)
        variance[EPS] = config.angle_random_walk**2 / TICK_S
        variance[NABLA] = config.velocity_random_walk**2 / TICK_S
        variance[BASE] = 2.0 * SWAY_S * config.sway**2 / TICK_S
        P = np.ascontiguousarray(P)
        _squares(self._book, self._used, variance, P)
        self._noise = np.asarray(P)
        return self._noise

    def from_start(self) -> float:
        """Standard deviation (rad) of what is left in heading of the state at the start."""
        row = self._book[4, _START]
        return math.sqrt(float(row @ self._start @ row))

    def covariance(self, config: AlignConfig) -> Vector:
        """Covariance (8, 8) of everything."""
        scale = np.zeros(INPUTS)
        scale[EPS], scale[NABLA] = config.gyro_bias, config.accel_bias
        constant = self._book[:, _CONSTANT] * scale
        return np.asarray(self.noise(config) + constant @ constant.T)
