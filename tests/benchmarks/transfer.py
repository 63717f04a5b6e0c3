"""What transfer alignment costs: a sample and a message of each matching, against the plain strapdown kernel.

``python -m tests.benchmarks.transfer`` prints the table. Ten seconds of a wing rock go through each matching,
with every message and with one in five, and take turns
with the kernel of two samples an update, in one compiled loop. Then the hardest case: a slave of 1 kHz that
hears its master 100 times a second, with the longest time that one sample or message took.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from bridge.realtime import no_collections
from bridge.studies.transfer_runs import Arriving, Flight, Trial, flight
from nav.align import advance, begin
from nav.transfer import MATCHINGS, PREFIX, alignment
from nav.types import ImuSample, MasterState, Vector
from tests.benchmarks import strapdown
from tests.benchmarks.measure import interleaved, print_table

SECONDS = 10.0
USUAL = Trial("wing-rock", SECONDS, 200.0, 25.0)
HARDEST = Trial("wing-rock", SECONDS, 1000.0, 100.0)
HEAVY = "velocity_heading"
"""The filter of 19 states."""
FEW = 5


def whole(matching: str, what: Flight, samples: Sequence[Arriving]) -> None:
    """One alignment, from its first sample to its last; where it starts again, it goes on."""
    run = begin(alignment(PREFIX + matching), what.config)
    for sample in samples:
        run, _ = advance(run, sample)


def rarely(what: Flight, every: int) -> list[Arriving]:
    """All inertial samples, and of the messages one in so many."""
    kept: list[Arriving] = []
    heard = 0
    for sample in what.samples:
        if isinstance(sample, MasterState):
            heard += 1
            if heard % every != 1:
                continue
        kept.append(sample)
    return kept


def measure(
    matchings: Sequence[str] = tuple(MATCHINGS), rounds: int = 5, trial: Trial = USUAL
) -> tuple[float, dict[str, Vector]]:
    """Seconds of the kernel per sample; of each matching per sample, messages and all, and per message.

    A message costs what a flight takes longer with all of them than with one in five.
    """
    what = flight(trial, 0)
    few = rarely(what, FEW)
    rows = strapdown.drive(20_000)
    cases: dict[str, Callable[[], object]] = {"": partial(strapdown.timed, strapdown.run_kernel, rows, 2)}
    for name in matchings:
        cases[name] = partial(whole, name, what, what.samples)
        cases[f"{name}, few"] = partial(whole, name, what, few)
    times = interleaved(cases, rounds)
    samples = sum(isinstance(s, ImuSample) for s in what.samples)
    left_out = len(what.samples) - len(few)
    found = {
        name: np.array([times[name] / samples, (times[name] - times[f"{name}, few"]) / left_out])
        for name in matchings
    }
    return times[""] / len(rows), found


def frames(matching: str = HEAVY, trial: Trial = HARDEST) -> Vector:
    """Processor time (s) of each sample and message of a flight, in their order."""
    what = flight(trial, 0)
    whole(matching, what, what.samples)  # compiled, cached, paged in
    run = begin(alignment(PREFIX + matching), what.config)
    spent = []
    with no_collections():
        for sample in what.samples:
            began = time.process_time_ns()
            run, _ = advance(run, sample)
            spent.append(time.process_time_ns() - began)
    return np.array(spent) * 1e-9


def main() -> int:
    """Print the tables."""
    kernel, found = measure()
    rows = [("strapdown kernel alone", f"{1e6 * kernel:.2f}", "1", "", "")]
    rows += [
        (name, f"{1e6 * each:.1f}", f"{each / kernel:.0f}", f"{1e6 * message:.0f}", f"{message / kernel:.0f}")
        for name, (each, message) in found.items()
    ]
    header = ("", "us a sample, all in", "ratio", "us a message", "ratio")
    print_table(f"matchings, slave {USUAL.imu_hz:g} Hz, master {USUAL.master_hz:g} Hz", header, rows)
    spent = frames()
    load = float(np.sum(spent)) / SECONDS
    cells = [
        (name, f"{1e3 * value:.2f}")
        for name, value in (
            ("median", np.median(spent)),
            ("99.9 %", np.quantile(spent, 0.999)),
            ("longest", np.max(spent)),
        )
    ]
    cells.append(("a second of flight", f"{1e3 * load:.0f}"))
    title = f"{HEAVY}, slave {HARDEST.imu_hz:g} Hz, master {HARDEST.master_hz:g} Hz"
    print_table(title, ("processor time of a sample or message", "ms"), cells)
    return 0


if __name__ == "__main__":
    sys.exit(main())
