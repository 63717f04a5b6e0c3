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
from nav.types import Vector

TICK_S: Final = 1.0
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


class Ledger:
    """See the module. ``start`` (8, 8) is the covariance of the first state, ``known`` (8, 8) what of it the
    constant errors are the cause of.
    """

    def __init__(self, at: Place, start: Vector, known: Vector) -> None:
        self._at = at
        self._start = start
        self._book = np.zeros((STATES, _NOISE))
        self._book[:, _START] = np.eye(STATES)
        self._book[:, _CONSTANT] = known
        self._rest = 0.0

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
            more = np.zeros((STATES, first + INPUTS - self._book.shape[1]))
            self._book = np.hstack([self._book, more])
        self._book = phi @ self._book
        self._book[:, _CONSTANT] += gamma
        self._book[:, first : first + INPUTS] += gamma

    def constants(self) -> tuple[Vector, Vector]:
        """Weights of constant errors of gyros (3, 3) and accelerometers (3, 3), g axes, in phi."""
        share = self._book[PHI, _CONSTANT]
        return share[:, EPS].copy(), share[:, NABLA].copy()

    def noise(self, config: AlignConfig) -> Vector:
        """Covariance (8, 8) of all but the constant errors: noise, motion of the base, the start."""
        P = self._book[:, _START] @ self._start @ self._book[:, _START].T
        book = self._book[:, _NOISE:].reshape(STATES, -1, INPUTS)
        for part, sigma in (
            (EPS, config.angle_random_walk),
            (NABLA, config.velocity_random_walk),
            (BASE, config.sway * math.sqrt(2.0 * SWAY_S)),
        ):
            weights = book[:, :, part].reshape(STATES, -1) * (sigma / math.sqrt(TICK_S))
            P += weights @ weights.T
        return np.asarray(P)

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
