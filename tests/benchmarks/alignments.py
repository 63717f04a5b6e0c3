"""What an inertial sample costs each alignment, against the plain strapdown kernel.

``python -m tests.benchmarks.alignments`` prints the table. A minute of samples at 200 Hz goes through each
method with its odometer or GNSS and the watch over the sensors, and takes turns with the kernel of two
samples an update, in one compiled loop. The last column is the dearest second of a method: the processor time
of what arrives in it, of which a live bridge has a second.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby

import numpy as np

from bridge.studies.alignment_campaign import scene_of
from nav.align import ALIGNMENTS, AlignConfig, advance, begin
from nav.types import ImuSample, Sample, Vector
from tests.benchmarks import strapdown
from tests.benchmarks.measure import interleaved, print_table

DT = 0.005  # s, 200 Hz
SECONDS = 62.0
LIVE = {"coarse_s": 20.0, "fine_s": 40.0, "replay_samples": 64}
Minute = tuple[AlignConfig, list[Sample]]


def minute(method: str, seconds: float = SECONDS) -> Minute:
    """Configuration and samples of a method on the base that it is for."""
    scene = scene_of(method, 0, DT)
    end_ns = scene.start_ns + round(seconds * 1e9)
    return replace(scene.config, **LIVE), [s for s in scene.samples if s.t_ns <= end_ns]


def whole(method: str, config: AlignConfig, samples: Sequence[Sample]) -> None:
    """One alignment, from its first sample to its last."""
    run = begin(ALIGNMENTS[method], config)
    for sample in samples:
        run, status = advance(run, sample)
        if status.done:
            run = begin(ALIGNMENTS[method], config)


def dearest(method: str, config: AlignConfig, samples: Sequence[Sample]) -> float:
    """Processor time (s) of the second that takes most."""
    run, most = begin(ALIGNMENTS[method], config), 0.0
    for _, second in groupby(samples, key=lambda s: s.t_ns // 1_000_000_000):
        began = time.process_time_ns()
        for sample in second:
            run, status = advance(run, sample)
            if status.done:
                run = begin(ALIGNMENTS[method], config)
        most = max(most, (time.process_time_ns() - began) * 1e-9)
    return most


def _count(samples: Sequence[Sample]) -> int:
    return sum(isinstance(s, ImuSample) for s in samples)


def measure(
    methods: Sequence[str] = tuple(ALIGNMENTS), rounds: int = 5, seconds: float = SECONDS
) -> tuple[float, dict[str, Vector]]:
    """Seconds of the kernel per sample, and of each method per sample and in its dearest second."""
    minutes = {method: minute(method, seconds) for method in methods}
    rows = strapdown.drive(20_000)
    cases: dict[str, Callable[[], object]] = {
        "": partial(strapdown.timed, strapdown.run_kernel, rows, 2),
        **{method: partial(whole, method, *minutes[method]) for method in methods},
    }
    times = interleaved(cases, rounds)
    found = {}
    for method in methods:
        peak = min(dearest(method, *minutes[method]) for _ in range(min(rounds, 3)))
        found[method] = np.array([times[method] / _count(minutes[method][1]), peak])
    return times[""] / len(rows), found


def main() -> int:
    """Print the table."""
    kernel, found = measure()
    rows = [("strapdown kernel alone", f"{1e6 * kernel:.2f}", "1", "")]
    rows += [
        (name, f"{1e6 * each:.1f}", f"{each / kernel:.0f}", f"{1e3 * peak:.0f}")
        for name, (each, peak) in found.items()
    ]
    header = ("", "us a sample", "ratio", "dearest second, ms")
    print_table("alignments at 200 Hz", header, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
