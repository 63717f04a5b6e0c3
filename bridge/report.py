"""What a run tells the person at the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TextIO

from bridge.live import Outcome
from bridge.outputs import Health, ModeChange, Output, Progress, Reject, Text, Transmit
from nav import jit

_UNKNOWN_DEG: Final = 90.0
_BEGUN: Final = 0.05


class Printer:
    """A sink that prints mode changes, texts and each quarter of an alignment, and sends nothing."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._last: dict[str, Progress] = {}

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Print what is for people among ``outputs``."""
        for output in outputs:
            if isinstance(output, ModeChange):
                change = f"{output.navigator}: {output.old.name} to {output.new.name}: {output.reason}"
                print(change, file=self._stream, flush=True)
            elif isinstance(output, Text):
                print(f"{output.severity.name.lower()}: {output.text}", file=self._stream, flush=True)
            elif isinstance(output, Progress):
                self._progress(output)
        return []

    def _progress(self, progress: Progress) -> None:
        """What begins, and how far it has come: whoever asks for another alignment is to see it begin."""
        last = self._last.get(progress.navigator)
        self._last[progress.navigator] = progress
        if last is not None and last.method == progress.method:
            # one that begins anew because it refused is told of by its refusal
            anew = progress.fraction < min(last.fraction, _BEGUN) and progress.restarts <= last.restarts
            if not anew and int(4.0 * progress.fraction) <= int(4.0 * last.fraction):
                return
        sigma = math.degrees(progress.sigma[2])
        heading = f", heading to {sigma:.2g} deg" if sigma < _UNKNOWN_DEG else ""
        done = f"{100.0 * progress.fraction:.0f} %{heading}"
        print(f"{progress.navigator}: alignment {progress.method} {done}", file=self._stream, flush=True)


class Strangers:
    """A sink that ends a run whose calibration is for another unit than the one on the bus.

    ``stop`` is given the reason; ``device`` is the one it happened to, None while it has not.
    """

    def __init__(self) -> None:
        self.stop: Callable[[str], object] = str
        self.device: str | None = None

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Look at what is counted once a second."""
        for output in outputs:
            if isinstance(output, Health) and self.device is None:
                for name, device in output.devices.items():
                    if Reject.FOREIGN in device.rejects:
                        self.device = name
                        self.stop(f"found the calibration of another unit than {name} on the bus")
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
    yield from outcome.sensors
    total = outcome.latency["received_to_sent"]
    if total["count"]:
        yield (
            f"frame received to solution sent: median {total['p50_us']:.0f} us, "
            f"99 % {total['p99_us']:.0f} us, longest {total['max_us']:.0f} us"
        )
    if unrecorded:
        yield f"not recorded: {unrecorded} frames; the disk was too slow or full"
    yield f"solution sha256: {outcome.digest}"
