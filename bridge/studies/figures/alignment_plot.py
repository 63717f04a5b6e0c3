"""The picture of the alignments: where the runs ended, beside print and beside the limit."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from bridge.plots.style import BLUE, GREEN, GREY, INK, ORANGE, RED, Picture
from bridge.studies.figures.result import Result

_LEAST: Final = 1e-3  # deg, of what a logarithm shows
_SPREAD: Final = 0.28
_MARKS: Final = ((BLUE, "rms"), (ORANGE, "published"), (GREEN, "goal"), (INK, "random walks alone"))


def draw(result: Result, path: Path) -> None:
    """Left every run's difference from a static alignment, right the errors over their limit."""
    cases = result.numbers["cases"]
    runs = result.numbers["runs"]
    picture = Picture(
        "Heading after alignment",
        f"{runs} runs a case. Left: difference from a static alignment of the same IMU, each run a dot. "
        "Right: error against truth over what such sensors allow",
        columns=2,
        height=1.4 + 0.3 * len(cases),
        sharey=True,
        gridspec_kw={"width_ratios": [1.7, 1.0]},
    )
    beside, ratio = picture.axes[0]
    for place, case in enumerate(cases.values()):
        values = np.maximum(np.abs(case["beside_deg"]), _LEAST)
        # dots side by side, in an order that says nothing
        up = place + _SPREAD * np.linspace(-1.0, 1.0, len(values))
        beside.plot(values, up, "o", ms=2.6, mew=0.0, color=BLUE, alpha=0.35)
        if "beside" in case:
            found, between = case["beside"]
            beside.plot([found] * 2, [place - 0.4, place + 0.4], color=BLUE, lw=2.4)
            found, between = case["ratio"]
            colour = BLUE if between[0] <= 1.1 else RED
            ratio.plot(between, [place] * 2, color=colour, lw=1.6)
            ratio.plot(found, place, "o", ms=5.0, color=colour)
        if case["published_deg"] is not None:
            for factor, colour in ((1.0, ORANGE), (0.7, GREEN)):
                x = factor * case["published_deg"]
                beside.plot([x] * 2, [place - 0.4, place + 0.4], color=colour, lw=2.0)
        if case["bound_deg"] is not None:
            beside.plot([case["bound_deg"]] * 2, [place - 0.4, place + 0.4], color=INK, lw=2.0)
        if case["refused"]:
            beside.text(_LEAST, place, f" {case['refused']} refused", color=RED, va="center", fontsize=8)
    beside.set_yticks(range(len(cases)), list(cases))
    beside.set_ylim(len(cases) - 0.4, -0.6)
    beside.set_xscale("log")
    beside.xaxis.set_major_formatter("{x:g}")
    beside.grid(axis="y", visible=False)
    ratio.grid(axis="y", visible=False)
    beside.set_xlabel("heading beside a static alignment (deg)")
    ratio.set_xlabel("rms error over the limit, and 95 % interval")
    ratio.axvline(1.0, color=GREY, lw=1.0)
    ratio.axvline(1.1, color=GREEN, lw=1.2, ls="--")
    ratio.set_xlim(left=0.0)
    for colour, label in _MARKS:
        beside.plot([], [], color=colour, lw=2.2, label=label)
    beside.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.1, frameon=False)
    ratio.text(1.12, -0.55, "goal 1.1", color=INK, fontsize=8, va="bottom")
    picture.save(path)
