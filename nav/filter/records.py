"""What the filter's history is made of: entries of the log, and copies of the filter itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from nav.filter.measurements import MEASUREMENTS, Measurement
from nav.filter.states import X_SIZE
from nav.types import Vector

Book = tuple[int, int, int]
"""Of one kind of measurement: time of the last accepted one, how many were refused since, and the time of the
first of those."""
NEVER: Final = -(2**62)


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
        self.refused: list[float] | None = None  # its residual, where the gate was shut


class Filter:
    """One copy of the filter: nominal state, covariance, books, and how far it has come.

    ``books`` holds a `Book` for each kind of measurement, ``path_ns`` is the start of the path integral.
    """

    __slots__ = ("P", "books", "cursor", "path_ns", "u", "x")

    def __init__(self, states: int) -> None:
        self.x = np.zeros(X_SIZE)
        self.P = np.zeros((states, states))
        self.books: dict[str, Book] = {}
        self.path_ns = 0
        self.u = 0
        self.cursor = 0

    def begin(self, t_ns: int, x: Vector, P: Vector) -> None:
        """Start afresh at ``t_ns`` with this state and covariance."""
        self.x[:] = x
        self.P[:] = P
        self.books = dict.fromkeys(MEASUREMENTS, (t_ns, 0, NEVER))
        self.path_ns = t_ns
        self.u = 0
        self.cursor = 0


class Snapshots:
    """Copies of a filter at some of its updates, the latest ``slots`` of them."""

    def __init__(self, slots: int, stride: int, states: int) -> None:
        self._slots, self._stride = slots, stride
        self._x = np.zeros((slots, X_SIZE))
        self._P = np.zeros((slots, states, states))
        self._heads: list[tuple[int, int, dict[str, Book]]] = []
        self.clear()

    def clear(self) -> None:
        """Forget all of them."""
        self._heads = [(-1, 0, {})] * self._slots

    def _slot(self, u: int) -> int:
        return u // self._stride % self._slots

    def holds(self, u: int) -> bool:
        """Whether there is one of update ``u``."""
        return self._heads[self._slot(u)][0] == u

    def take(self, f: Filter) -> None:
        """Keep ``f`` as it is."""
        slot = self._slot(f.u)
        self._heads[slot] = f.u, f.path_ns, f.books.copy()
        self._x[slot] = f.x
        self._P[slot] = f.P

    def restore(self, u: int, f: Filter) -> None:
        """Make ``f`` what was kept at update ``u``, but for its place in the log."""
        slot = self._slot(u)
        f.u, f.path_ns, books = self._heads[slot]
        f.books = books.copy()
        f.x[:] = self._x[slot]
        f.P[:] = self._P[slot]
