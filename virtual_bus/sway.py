"""A base that sways about the spot where it stands: a boat at anchor, a car with people in it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LINES: Final = 8
FASTEST_HZ: Final = 1.2
"""Up to which the polynomials of a trajectory (`virtual_bus.truth.PIECE_NS`) follow it to rounding."""
ONSET_S: Final = 18.0
_RISE_S: Final = 1.0  # of a tangent that is smooth to all orders, so that the same polynomials follow it
_TWO_PI: Final = 2.0 * math.pi


class Sway:
    """Heading, pitch and roll over time: sums of `LINES` waves each, their phases and rates drawn by ``rng``.

    ``sigma`` (3,) rad are the root mean squares, the waves go ``slowest`` to ``fastest`` times a second. It
    runs from the first instant on, or begins after ``begins_s`` and has its strength `ONSET_S` later. The
    vehicle turns about its reference point, so whatever is off that point is carried to and fro.
    """

    def __init__(
        self,
        sigma: Array,
        slowest: float,
        fastest: float,
        begins_s: float | None,
        rng: np.random.Generator,
    ) -> None:
        # one wave to each part of the band: no two are so near that they cancel for minutes
        place = (np.arange(LINES) + rng.random((3, LINES))) / LINES
        self._rate = _TWO_PI * (slowest + (fastest - slowest) * place)
        self._phase = _TWO_PI * rng.random((3, LINES))
        self._size = np.asarray(sigma, dtype=np.float64)[:, None] * math.sqrt(2.0 / LINES)
        self._middle = None if begins_s is None else begins_s + 0.5 * ONSET_S

    def angles(self, t: Array) -> tuple[Array, Array, Array]:
        """Heading, pitch and roll (n, 3) rad at ``t`` (n,) s, and two derivatives."""
        wave = self._rate * t[:, None, None] + self._phase
        sine, cosine = self._size * np.sin(wave), self._size * np.cos(wave)
        a, a1 = sine.sum(axis=-1), (cosine * self._rate).sum(axis=-1)
        a2 = -(sine * self._rate**2).sum(axis=-1)
        if self._middle is None:
            return a, a1, a2
        rise = np.tanh((t - self._middle) / _RISE_S)[:, None]
        e, e1 = 0.5 * (1.0 + rise), 0.5 * (1.0 - rise**2) / _RISE_S
        e2 = -2.0 * rise * e1 / _RISE_S
        return e * a, e1 * a + e * a1, e2 * a + 2.0 * e1 * a1 + e * a2
