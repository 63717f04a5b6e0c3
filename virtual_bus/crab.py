"""How a vehicle's heading wanders about its path: side wind, camber, steering."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CRAB_LINES: Final = 24
CRAB_SHORTEST: Final = 25.0  # m of road: at 20 m/s well within what a piece's polynomial can follow


class Crab:
    """Angle between a vehicle's heading and its path, a smooth random function of the distance rolled.

    Waves of equal strength spread evenly over all wave numbers up to that of `CRAB_SHORTEST`, so it is
    white noise of ``sigma`` rad to whoever looks over longer distances. ``rng`` draws it.
    """

    def __init__(self, sigma: float, rng: np.random.Generator) -> None:
        place = (np.arange(CRAB_LINES) + rng.random(CRAB_LINES)) / CRAB_LINES
        self._number = 2.0 * math.pi / CRAB_SHORTEST * place  # rad/m
        self._phase = 2.0 * math.pi * rng.random(CRAB_LINES)
        self._size = sigma * math.sqrt(2.0 / CRAB_LINES)

    def angle(self, distance: Array, speed: Array, accel: Array) -> tuple[Array, Array, Array]:
        """Angle (rad, clockwise) and two derivatives in time, (n,) each."""
        wave = self._number * distance[:, None] + self._phase
        sine, cosine = self._size * np.sin(wave), self._size * np.cos(wave) * self._number
        slope = cosine.sum(axis=1)
        bend = -(sine * self._number**2).sum(axis=1)
        return sine.sum(axis=1), slope * speed, slope * accel + bend * speed**2
