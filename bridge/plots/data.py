"""What the pictures are made of: a capture run through the engine once more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bridge.evaluate import SolutionTable, TruthTable
from bridge.outputs import Innovation, ModeChange
from nav.types import GnssFix, Mode

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlotData:
    """One navigator's run. Times in the tables are engine time; `seconds_of` gives those of the pictures.

    ``truth`` is that of the navigator's output point. ``samples_ns``: times of each device's samples.
    """

    title: str
    navigator: str
    begin_ns: int
    end_ns: int
    solutions: SolutionTable
    modes: list[ModeChange]
    innovations: list[Innovation]
    fixes: list[GnssFix]
    truth: TruthTable | None
    samples_ns: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Length of the capture, s."""
        return (self.end_ns - self.begin_ns) / 1e9

    def seconds_of(self, t_ns: NDArray[np.int64]) -> Array:
        """Seconds since the start of the capture."""
        return np.asarray((t_ns - self.begin_ns) / 1e9, dtype=np.float64)

    def mode_spans(self) -> list[tuple[float, float, Mode]]:
        """(begin, end, mode) in seconds, from the first mode change on."""
        ends = [change.t_ns for change in self.modes[1:]] + [self.end_ns] * bool(self.modes)
        return [
            ((change.t_ns - self.begin_ns) / 1e9, (end - self.begin_ns) / 1e9, change.new)
            for change, end in zip(self.modes, ends, strict=True)
        ]
