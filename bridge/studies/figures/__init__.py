"""Published figures, reproduced with the kernels that the live path runs.

A figure is a module with ``compute() -> Result`` and ``draw(result, path)``, and a line in `FIGURES`. The
command ``navbridge figures NAME`` prints and draws it; a test holds each to its tolerances.
"""

from __future__ import annotations

import importlib
from typing import Final, NamedTuple, Protocol, cast

from bridge.studies.figures.result import Compute, Draw


class Figure(NamedTuple):
    """Where a figure lives, what it reproduces in a line, and of which document."""

    module: str
    summary: str
    source: str


class FigureModule(Protocol):
    """What a figure's module holds."""

    compute: Compute
    draw: Draw


FIGURES: Final[dict[str, Figure]] = {
    "coning": Figure(
        "bridge.studies.figures.coning",
        "coefficients and drift of the one- to five-sample coning algorithms",
        "Yan Gongmin 2008, Tables 7-1 and 7-2",
    ),
}
"""Name on the command line to figure."""


def load(name: str) -> FigureModule:
    """The module of the figure ``name``; raises KeyError where there is none."""
    return cast(FigureModule, importlib.import_module(FIGURES[name].module))
