"""How long frames take through the bridge, stage by stage, in constant memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

STAGES: Final = ("received_to_read", "read_to_fed", "fed_to_sent", "received_to_sent")
"""Kernel stamp to the loop, through recorder and engine, through sinks and onto the bus, all of it."""

_FINE: Final = 5  # 32 steps an octave: 2 per cent


class Histogram:
    """Counts of durations in logarithmic steps of 2 per cent."""

    def __init__(self) -> None:
        self.count = 0
        self.worst_ns = 0
        self._bins = [0] * (64 << _FINE)

    def add(self, ns: int) -> None:
        """Count one duration; a negative one counts as zero."""
        ns = max(0, ns)
        self.count += 1
        if ns > self.worst_ns:
            self.worst_ns = ns
        octave = max(0, ns.bit_length() - 1 - _FINE)
        self._bins[(octave << _FINE) + (ns >> octave)] += 1

    def percentile_ns(self, percent: float) -> int:
        """The duration, to the upper edge of its step, that ``percent`` of them do not exceed; 0 for none."""
        wanted = self.count * percent / 100.0
        seen = 0
        for place, count in enumerate(self._bins):
            seen += count
            if count and seen >= wanted:
                octave = max(0, (place >> _FINE) - 1)
                return min(self.worst_ns, ((place - (octave << _FINE) + 1) << octave) - 1)
        return 0


class Latency:
    """A histogram for each stage, over the frames that led to something being sent."""

    def __init__(self) -> None:
        self._stages = tuple(Histogram() for _ in STAGES)

    def add(self, rx_ns: int, read_ns: int, fed_ns: int, sent_ns: int) -> None:
        """Count one frame by its four instants, monotonic ns."""
        stages = self._stages
        stages[0].add(read_ns - rx_ns)
        stages[1].add(fed_ns - read_ns)
        stages[2].add(sent_ns - fed_ns)
        stages[3].add(sent_ns - rx_ns)

    def summary(self, percents: Sequence[float] = (50.0, 99.0)) -> dict[str, dict[str, float]]:
        """For each stage: count, the percentiles and the worst, in microseconds."""
        return {
            stage: {
                "count": histogram.count,
                **{f"p{percent:g}_us": histogram.percentile_ns(percent) / 1e3 for percent in percents},
                "max_us": histogram.worst_ns / 1e3,
            }
            for stage, histogram in zip(STAGES, self._stages, strict=True)
        }
