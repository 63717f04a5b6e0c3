"""The picture of the transfer alignments: where the flights ended, beside the bound, print and goal."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from bridge.plots.style import BLUE, INK, ORANGE, RED, Picture, legend
from bridge.studies.consistency import AXES
from bridge.studies.figures.result import Result

_LEAST: Final = 1e-2  # mrad, of what a logarithm shows
_SPREAD: Final = 0.28
_MARKS: Final = ((BLUE, "rms"), (INK, "Cramér-Rao bound"), (ORANGE, "published"))


def draw(result: Result, path: Path) -> None:
    """Errors relative to the master at the end, a panel an axis, a dot a flight."""
    cells = result.numbers["cells"]
    picture = Picture(
        "Transfer alignment",
        "Error of phi relative to the master at the end of the flight, each flight a dot",
        columns=3,
        height=1.4 + 0.22 * len(cells),
        sharex=True,
        sharey=True,
    )
    for k, panel in enumerate(picture.axes[0]):
        for place, cell in enumerate(cells.values()):
            reach = [place - 0.4, place + 0.4]
            if "relative" in cell:
                values = np.maximum(np.abs(np.array(cell["relative"]["mrad"])[:, k]), _LEAST)
                # dots side by side, in an order that says nothing
                up = place + _SPREAD * np.linspace(-1.0, 1.0, len(values))
                panel.plot(values, up, "o", ms=2.4, mew=0.0, color=BLUE, alpha=0.4)
                panel.plot([cell["relative"]["rms"][k][0]] * 2, reach, color=BLUE, lw=2.2)
            panel.plot([cell["bound_mrad"][k]] * 2, reach, color=INK, lw=1.6)
            if cell["published_mrad"] is not None and cell["published_mrad"][k] is not None:
                panel.plot([cell["published_mrad"][k]] * 2, reach, color=ORANGE, lw=1.8)
            if k == 2 and cell["refused"]:
                panel.text(_LEAST, place, f" {cell['refused']} refused", color=RED, va="center", fontsize=8)
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
        panel.set_xlabel(f"{AXES[k]} (mrad)")
        panel.grid(axis="y", visible=False)
    first = picture.axes[0][0]
    first.set_yticks(range(len(cells)), list(cells))
    first.set_ylim(len(cells) - 0.4, -0.6)
    last = picture.axes[0][-1]
    for colour, label in _MARKS:
        last.plot([], [], color=colour, lw=2.2, label=label)
    legend(last)
    picture.save(path)
