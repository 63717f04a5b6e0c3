"""Whether master and slave agree: the share of messages that pass their gates, and the cause where few do."""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.transfer.model import Rows
from nav.transfer.states import DELAY, LEVER

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

FEWEST: Final = 8  # messages before a share means something
AGREE: Final = 0.8  # share that must, for an answer
_LONGEST: Final = 400  # messages looked at


class Seen(NamedTuple):
    """A group of rows of a message: whitened residual and columns of what may have caused it."""

    t_ns: int
    kind: str
    passed: bool
    r: Vector  # (m,)
    columns: Matrix  # (m, 4): delay, lever arm


class Watch:
    """What was seen of the last messages."""

    def __init__(self, lockout: float) -> None:
        self._lockout_ns = round(lockout * 1e9)
        self._seen: deque[Seen] = deque(maxlen=4 * _LONGEST)
        self._turns = np.zeros((3, 3))
        self.accepted_ns = 0

    def see(
        self, t_ns: int, kind: str, passed: bool, rows: Rows, H: Matrix, S: Matrix, used: list[int]
    ) -> None:
        """Note a group of rows with the innovation covariance ``S`` (m, m) that it was judged by."""
        L = np.linalg.cholesky(S)
        columns = np.linalg.solve(L, np.column_stack([rows.r[used], H[:, DELAY], H[:, LEVER]]))
        self._seen.append(Seen(t_ns, kind, passed, columns[:, 0], columns[:, 1:]))
        if passed:
            self.accepted_ns = t_ns

    def turned(self, by_master: Vector, by_slave: Vector) -> None:
        """Note how both turned (rad) between two messages, in b as built."""
        self._turns += np.outer(by_master, by_slave)

    def share(self, t_ns: int) -> float:
        """Of the groups of the last `lockout` seconds that passed, 0 to 1; 1 while there are few."""
        passed = [one.passed for one in self._seen if t_ns - one.t_ns <= self._lockout_ns]
        return sum(passed) / len(passed) if len(passed) >= FEWEST else 1.0

    def cause(self, t_ns: int) -> str:
        """Why master and slave have not agreed of late, in words."""
        return "master and slave disagree"
