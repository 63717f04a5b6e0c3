"""Published figures, reproduced with the kernels that the live path runs.

A figure is a module with ``compute() -> Result`` and ``draw(result, path)``, and a line in `FIGURES`. The
command ``navbridge figures NAME`` prints and draws it; a test holds each to its tolerances.
"""

from __future__ import annotations

import importlib
from typing import Final, NamedTuple, Protocol, cast

from bridge.studies.figures.result import Compute, Draw


class Figure(NamedTuple):
    """Where a figure lives, what it reproduces in a line, and of which document.

    ``runs``, where not 0, is how many random runs it makes unless told otherwise.
    """

    module: str
    summary: str
    source: str
    runs: int = 0


class FigureModule(Protocol):
    """What a figure's module holds."""

    compute: Compute
    draw: Draw


FIGURES: Final[dict[str, Figure]] = {
    "alignment": Figure(
        "bridge.studies.figures.alignment",
        "heading after every alignment, at rest, swaying and on the road, against print and theory",
        "Yan Gongmin 2008, chapters 2 to 4",
        200,
    ),
    "coning": Figure(
        "bridge.studies.figures.coning",
        "coefficients and drift of the one- to five-sample coning algorithms; sculling",
        "Yan Gongmin 2008, Tables 7-1 and 7-2",
    ),
    "laser": Figure(
        "bridge.studies.figures.laser",
        "coning drift of dithered laser gyros latched at whole cycles, and after each correction",
        "Yan Gongmin 2008, Table 6-1",
    ),
    "polar": Figure(
        "bridge.studies.figures.polar",
        "24 h of pure inertial navigation across pole, date line and equator, under four azimuth laws",
        "truth in closed form",
    ),
    "redundant": Figure(
        "bridge.studies.figures.redundant",
        "asymmetry of accelerometers on skewed axes: conventional, iterative and joint calibration",
        "Luo Rui et al. 2023",
        100,
    ),
    "schuler": Figure(
        "bridge.studies.figures.schuler",
        "errors at rest over a day: closed forms, matrix exponential and the kernel",
        'textbook chapter "Inertial navigation", Tables 2-9 and 2-10, eqs. (2-93), (2-98), (2-104)',
    ),
    "platform": Figure(
        "bridge.studies.figures.platform",
        "heading error of a gimballed platform at high latitudes: not turned, turned, swung",
        "Zhao Wangyang et al. 2021, Table 1",
    ),
    "size-effect": Figure(
        "bridge.studies.figures.size_effect",
        "velocity that a swing makes of accelerometers that sit apart, and their compensation",
        "Yan Gongmin 2008, chapter 5",
    ),
    "transfer": Figure(
        "bridge.studies.figures.transfer",
        "misalignment after transfer alignment, every matching and flight, against print and bound",
        'textbook chapter "Inertial navigation", Table 2-11 and section 2.5.3.4',
        24,
    ),
}
"""Name on the command line to figure."""


def load(name: str) -> FigureModule:
    """The module of the figure ``name``; raises KeyError where there is none."""
    return cast(FigureModule, importlib.import_module(FIGURES[name].module))
