"""Dither of laser gyros: when each was last latched, in integers.

A gyro that is shaken about its axis is read when it passes its middle, once in a cycle: then the shaking has
turned it by nothing. In floating point the number of whole cycles till an instant that is one itself comes
out one too small now and then, which alone moves the drift of a coning navigation by arc-minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]
Array = NDArray[np.float64]

CYCLE: Final = 1_000_000_000_000
"""Parts of a cycle: those of a nanosecond at a millihertz."""
_SECOND_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Dither:
    """One gyro's dither: ``frequency_mhz`` in millihertz, ``phase`` in parts of `CYCLE` at time zero."""

    frequency_mhz: int
    phase: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no dither."""
        if not 0 < self.frequency_mhz <= 1_000_000 or not 0 <= self.phase < CYCLE:
            raise ValueError(f"no dither of {self.frequency_mhz} mHz from {self.phase} parts of a cycle on")

    def since(self, t_ns: Times) -> Times:
        """Parts of a cycle that have passed since the last whole one at ``t_ns`` (n,)."""
        seconds, rest = np.divmod(np.asarray(t_ns, np.int64), _SECOND_NS)
        # whole seconds make thousandths of a cycle, of which only the remainder counts
        thousandths = seconds * self.frequency_mhz % 1000
        parts = thousandths * (CYCLE // 1000) + rest * self.frequency_mhz + self.phase
        return np.asarray(parts % CYCLE)

    def age(self, t_ns: Times) -> Array:
        """Seconds from the last latch to ``t_ns`` (n,)."""
        return self.since(t_ns) / (self.frequency_mhz * 1e9)

    def latched(self, t_ns: Times) -> Times:
        """The last latch at or before ``t_ns`` (n,), to the nanosecond."""
        return np.asarray(t_ns - np.rint(self.since(t_ns) / self.frequency_mhz).astype(np.int64))
