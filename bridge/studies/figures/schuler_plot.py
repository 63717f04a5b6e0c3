"""The picture of the errors at rest."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from bridge.plots.style import AXES as COLOURS
from bridge.plots.style import GREY, Picture, legend
from bridge.studies.figures.result import Result
from bridge.studies.figures.schuler_runs import (
    AMOUNT,
    ARCMIN,
    CURVES,
    DAY,
    EVERY,
    LAT,
    MIDDLE,
    NAMES,
    ORDER,
    RUNS,
    Matrix,
    Rest,
    Vector,
    exponential,
)
from nav.errors.response import SOURCES, STATES, responses

STEP: Final = 60.0
PANELS: Final = (
    ("m/s", ("v_east", "v_north")),
    ("km", ("lon", "lat")),
    ("arcmin", ("phi_up", "phi_east", "phi_north")),
)


def draw(result: Result, path: Path) -> None:
    """A day of velocity, position and misalignment for each sensor error; figure 2-26; (2-98)."""
    rest = Rest(LAT)
    t = _minutes()
    F, G = rest.model()
    closed = responses(t, LAT, rest.sphere) * AMOUNT[:, None, None]
    picture = Picture(
        "Errors at rest over a day, 40 deg",
        "lines: matrix exponential with Coriolis terms; dots: the navigation kernel; dashes: closed forms "
        "without Coriolis terms",
        rows=len(SOURCES) + 1,
        columns=3,
    )
    for i, source in enumerate(SOURCES):
        e = np.zeros(6)
        e[i] = -AMOUNT[i] if i < 3 else AMOUNT[i]
        truth = exponential(F, G @ e, STEP, len(t))[:, ORDER].T
        dots = np.array(result.numbers["kernel"][source])
        amount = "0.01 deg/h" if i < 3 else "100 ug"
        for axes, (unit, states) in zip(picture.axes[i], PANELS, strict=True):
            for state in states:
                colour, scale, label = _shown(state, rest)
                axes.plot(
                    t / 3600.0, scale * closed[i, STATES.index(state)], "--", color=colour, lw=0.7, alpha=0.6
                )
                _lines(axes, t, truth, dots, state, colour, scale, label)
            axes.set_ylabel(unit)
            axes.tick_params(labelbottom=axes is picture.axes[-2][-1])
        picture.axes[i][0].set_ylabel(f"{NAMES[source]}, {amount}\nm/s")
        legend(picture.axes[i][2])
    for axes, title in zip(picture.axes[0], ("velocity", "position", "misalignment"), strict=True):
        axes.set_title(title, fontsize=10, loc="left")
    # the panel below it counts minutes
    picture.axes[-2][-1].set_xlabel("hours")
    _draw_last(picture.axes[-1], result)
    picture.save(path)


def _minutes() -> Vector:
    return np.asarray(STEP * np.arange(1, DAY // 60 + 1), dtype=np.float64)


def _shown(state: str, rest: Rest) -> tuple[str, float, str]:
    """Colour, scale and name of the axis of a state."""
    km = rest.sphere.radius / 1e3
    if state.startswith("v_"):
        scale = 1.0
    elif state.startswith("phi_"):
        scale = 1.0 / ARCMIN
    else:
        scale = km if state == "lat" else km * math.cos(rest.lat)
    axis = {"lon": "east", "lat": "north"}.get(state, state.split("_")[-1])
    return dict(zip(("east", "north", "up"), COLOURS, strict=True))[axis], scale, axis


def _lines(
    axes: Axes, t: Vector, truth: Matrix, dots: Matrix, state: str, colour: str, scale: float, label: str
) -> None:
    j = STATES.index(state)
    hours = np.arange(1, dots.shape[1] + 1) * 3.0 * EVERY / 3600.0
    axes.plot(t / 3600.0, scale * truth[j], color=colour, label=label)
    axes.plot(hours, scale * dots[j], "o", ms=2.2, color=colour)
    axes.set_xlim(0.0, 24.0)


def _draw_last(panels: list[Axes], result: Result) -> None:
    """The two curves of figure 2-26, and the growth of a noisy velocity."""
    rest = Rest(MIDDLE)
    t = _minutes()
    F, G = rest.model()
    for axes, (name, mixture), (unit, states) in zip(
        panels, CURVES.items(), (PANELS[1], PANELS[0]), strict=False
    ):
        e, start = mixture.inputs()
        truth = exponential(F, G @ e, STEP, len(t), start)[:, ORDER].T
        for state in states:
            dots = np.array(result.numbers["curves"][name])
            _lines(axes, t, truth, dots, state, *_shown(state, rest))
        axes.set_ylabel(unit)
        axes.set_title(f"as figure 2-26 ({name}), 45 deg", fontsize=10, loc="left")
        axes.set_xlabel("hours")
    noise = result.numbers["noise"]
    minutes = np.array(noise["t"]) / 60.0
    axes = panels[2]
    axes.plot(minutes, 1e3 * np.array(noise["printed"]), "--", color=GREY, label="(2-98) printed")
    axes.plot(minutes, 1e3 * np.array(noise["closed"]), color=COLOURS[0], label="(2-98)")
    axes.plot(minutes, 1e3 * np.array(noise["ours"]), "o", ms=3, color=COLOURS[0], label=f"{RUNS} kernels")
    axes.set_ylabel("mm/s")
    axes.set_title("sigma of v_E, 10 ug/sqrt(Hz)", fontsize=10, loc="left")
    axes.set_xlabel("minutes")
    legend(axes)
