"""What a run tells the person at the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from bridge.live import Outcome
from bridge.outputs import ModeChange, Output, Text, Transmit
from nav import jit


class Printer:
    """A sink that prints mode changes and texts as they come and sends nothing."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Print what is for people among ``outputs``."""
        for output in outputs:
            if isinstance(output, ModeChange):
                change = f"{output.navigator}: {output.old.name} to {output.new.name}: {output.reason}"
                print(change, file=self._stream, flush=True)
            elif isinstance(output, Text):
                print(f"{output.severity.name.lower()}: {output.text}", file=self._stream, flush=True)
        return []


def explain_wait(stream: TextIO) -> None:
    """Say why nothing will happen for a while, where kernels have to be compiled first."""
    if jit.is_cold():
        print("compiling, this once: about half a minute ...", file=stream, flush=True)


def outcome_lines(outcome: Outcome, unrecorded: int) -> Iterator[str]:
    """How a run ended, in lines; the last is the digest."""
    yield f"{outcome.frames} frames in {outcome.seconds:.1f} s: {outcome.reason}"
    for name, counters in outcome.counters.items():
        yield f"{name}: " + ", ".join(f"{key} {value}" for key, value in counters.items())
    total = outcome.latency["received_to_sent"]
    if total["count"]:
        yield (
            f"frame received to solution sent: median {total['p50_us']:.0f} us, "
            f"99 % {total['p99_us']:.0f} us, longest {total['max_us']:.0f} us"
        )
    if unrecorded:
        yield f"not recorded: {unrecorded} frames; the disk was too slow or full"
    yield f"solution sha256: {outcome.digest}"
