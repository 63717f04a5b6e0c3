"""From samples of a barometer to the external height in the rows of the increment ring."""

from __future__ import annotations

from typing import Final

from nav.filter.propagate import ROW_H, ROW_H_AGE, ROW_H_Q
from nav.filter.states import BARO_BIAS, X_BB
from nav.strapdown.kernels import X_H, X_V
from nav.types import Vector

HELD: Final = 2.0
"""How long an external height is good for, s."""


class HeightFeed:
    """The latest external height; a row holds what was known when it was made, so that it replays."""

    __slots__ = ("_density", "_height", "t_ns")

    def __init__(self) -> None:
        self.t_ns: int | None = None
        self._height = 0.0
        self._density = 0.0

    def take(self, t_ns: int, height: float, sigma: float) -> None:
        """Take a height (m, one sigma m)."""
        interval = 0.0 if self.t_ns is None else min((t_ns - self.t_ns) * 1e-9, HELD)
        # white from sample to sample, and each holds for its interval
        self._density = sigma * sigma * interval
        self.t_ns = t_ns
        self._height = height

    def fill(self, row: Vector, t_ns: int, dt: float) -> None:
        """Put it into the row of the update over ``dt`` s that ends at ``t_ns``."""
        row[ROW_H_Q] = -1.0
        if self.t_ns is not None:
            age = (t_ns - self.t_ns) * 1e-9 - 0.5 * dt
            if age < HELD:
                row[ROW_H], row[ROW_H_AGE], row[ROW_H_Q] = self._height, age, self._density


def take_offset(x: Vector, P: Vector, height: float, sigma: float, age: float) -> None:
    """Take the barometer's bias from ``height`` (m, one sigma m), which is ``age`` s old, into state and
    covariance.

    It is then wrong by what the navigated height is wrong by, the other way.
    """
    bias = BARO_BIAS.start
    x[X_BB] = height - (x[X_H] - x[X_V + 2] * age)
    P[bias, :] = -P[2, :]
    P[:, bias] = -P[:, 2]
    P[bias, bias] = P[2, 2] + sigma * sigma
