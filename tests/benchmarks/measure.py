"""Timing of alternatives side by side, and tables of the results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np


def interleaved(cases: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median processor time (s) of each case; they take turns, so that what the machine does hits all."""
    times: dict[str, list[int]] = {name: [] for name in cases}
    for case in cases.values():
        case()  # compiled, cached, paged in
    for _ in range(rounds):
        for name, case in cases.items():
            began = time.process_time_ns()
            case()
            times[name].append(time.process_time_ns() - began)
    return {name: float(np.median(values)) * 1e-9 for name, values in times.items()}


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in plain text, the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]
    print(title)
    for row in (header, *rows):
        cells = [
            row[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
        ]
        print("  ".join(cells))
    print()
