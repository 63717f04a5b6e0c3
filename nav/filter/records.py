"""What the filter's history is made of: entries of the log, and copies of the filter itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from nav.filter.measurements import MEASUREMENTS, Measurement
from nav.filter.states import X_SIZE
from nav.types import Vector

ORDER: Final = {name: place for place, name in enumerate(MEASUREMENTS)}
"""The row of the books of each kind of measurement."""
PATH: Final = len(ORDER)
"""The row of the books that holds the start of the path integral."""


class Record:
    """One entry of the log: a measurement, or something done to the filter at a time."""

    __slots__ = ("action", "key", "measurement", "recovered", "refused", "reported", "t_ns", "z")

    def __init__(
        self,
        t_ns: int,
        rank: int,
        serial: int,
        measurement: Measurement | None,
        z: Vector,
        action: Callable[[Filter], None] | None = None,
    ) -> None:
        self.t_ns = t_ns
        self.key = (t_ns, rank, serial)
        self.measurement = measurement
        self.z = z
        self.action = action
        self.reported = False
        self.recovered = False
        self.refused: Vector | None = None  # its residual, where the gate was shut


class Filter:
    """One copy of the filter: nominal state, covariance, books, and how far it has come.

    ``books`` (kinds + 1, 3) int64: per kind of measurement the time of the last accepted one, how many were
    refused since, and the time of the first of those; last row: start of the path integral.
    """

    __slots__ = ("P", "books", "cursor", "u", "x")

    def __init__(self, states: int) -> None:
        self.x = np.zeros(X_SIZE)
        self.P = np.zeros((states, states))
        self.books = np.zeros((PATH + 1, 3), dtype=np.int64)
        self.u = 0
        self.cursor = 0

    def copy_from(self, x: Vector, P: Vector, books: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> None:
        """Take over state, covariance and books."""
        self.x[:] = x
        self.P[:] = P
        self.books[:] = books
