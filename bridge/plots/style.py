"""One look for all pictures: colours, axes, legends beside the data, and the shading of modes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from bridge.plots.data import PlotData
from nav.types import Mode

Array = NDArray[np.float64]

BLUE: Final = "#0072B2"
ORANGE: Final = "#D55E00"
GREEN: Final = "#009E73"
GREY: Final = "#8A8F98"
INK: Final = "#20262E"
RED: Final = "#C1121F"
AXES: Final = (BLUE, ORANGE, GREEN)
"""Colours of three axes: east, north, up or right, forward, up."""

DPI: Final = 130
WIDTH: Final = 11.0
_HEAD: Final = 0.66  # inches kept for the title
MODE_COLOURS: Final = {
    Mode.STANDBY: "#EEF0F2",
    Mode.ALIGN: "#FFF3D6",
    Mode.TRANSFER: "#E4F3E6",
    Mode.CATCH_UP: "#E6E0F8",
    Mode.DEGRADED: "#FBE3E0",
    Mode.FAULT: "#F5B7B1",
}
"""Shades behind the data; a mode that is not here (NAVIGATE) has none."""

_RC: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.edgecolor": "#B8BEC6",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": "#E3E6EA",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
    "text.color": INK,
    "xtick.color": "#59616B",
    "ytick.color": "#59616B",
    "legend.frameon": False,
    "legend.fontsize": 9,
    "savefig.facecolor": "white",
}
_POINTS: Final = 20_000


class Picture:
    """A figure of stacked panels over time, or of one panel, with a title and a line below it."""

    def __init__(
        self,
        title: str,
        subtitle: str,
        rows: int = 1,
        columns: int = 1,
        height: float | None = None,
        **options: Any,
    ) -> None:
        inches = height or 1.6 + 2.05 * rows
        with mpl.rc_context(_RC):
            room = 1.0 - _HEAD / inches
            self.figure = Figure(
                figsize=(WIDTH, inches),
                layout=ConstrainedLayoutEngine(rect=(0.004, 0.0, 0.992, room), w_pad=0.08),
            )
            FigureCanvasAgg(self.figure)
            axes = self.figure.subplots(rows, columns, squeeze=False, **options)
        self.axes: list[list[Axes]] = [list(row) for row in axes]
        self.figure.text(
            0.012, 1.0 - 0.14 / inches, title, fontsize=14, fontweight="bold", va="top", color=INK
        )
        self.figure.text(0.012, 1.0 - 0.42 / inches, subtitle, fontsize=9.5, va="top", color="#59616B")

    def column(self, place: int = 0) -> list[Axes]:
        """The panels of one column, from the top."""
        return [row[place] for row in self.axes]

    def save(self, path: Path) -> Path:
        """Write the picture as PNG."""
        with mpl.rc_context(_RC):
            self.figure.align_ylabels()
            try:
                self.figure.savefig(path, dpi=DPI)
            except OSError as error:  # that of a full disk names no file
                raise OSError(error.errno, error.strerror, str(path)) from error
        return path


def thin(*columns: Array) -> tuple[Array, ...]:
    """Every k-th row, so that a line has no more points than a picture can show."""
    step = max(1, math.ceil(len(columns[0]) / _POINTS))
    return tuple(column[::step] for column in columns)


def line(axes: Axes, t: Array, y: Array, colour: str, label: str | None = None, **options: Any) -> None:
    """A line, thinned."""
    t, y = thin(t, y)
    axes.plot(t, y, color=colour, label=label, **options)


def band(
    axes: Axes, t: Array, centre: Array | float, sigma: Array, colour: str, label: str | None = None
) -> None:
    """Three sigma either side of ``centre``, shaded with thin edges."""
    middle = np.broadcast_to(np.asarray(centre, dtype=np.float64), sigma.shape)
    t, middle, sigma = thin(t, middle, sigma)
    low, high = middle - 3.0 * sigma, middle + 3.0 * sigma
    axes.fill_between(t, low, high, color=colour, alpha=0.14, linewidth=0.0, label=label)
    for edge in (low, high):
        axes.plot(t, edge, color=colour, linewidth=0.6, alpha=0.55)


def modes(panels: Iterable[Axes], data: PlotData, begin_s: float = 0.0) -> None:
    """Shade the time from ``begin_s`` on in other modes than NAVIGATE; the first panel names them."""
    for place, axes in enumerate(panels):
        named: set[Mode] = set()
        for begin, end, mode in data.mode_spans():
            colour = MODE_COLOURS.get(mode)
            if colour is None or end <= max(begin, begin_s):
                continue
            label = mode.name.lower().replace("_", " ") if place == 0 and mode not in named else None
            named.add(mode)
            axes.axvspan(begin, end, color=colour, linewidth=0.0, zorder=0, label=label)


def time_axis(panels: Sequence[Axes], data: PlotData, begin: float = 0.0) -> None:
    """Common limits from ``begin`` (s) on, and the label on the lowest panel alone."""
    end = max(data.seconds, 1e-3)
    for axes in panels:
        axes.set_xlim(min(begin, 0.98 * end), end)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time since the start of the capture (s)")


def legend(axes: Axes) -> None:
    """The legend, right of the panel and never over the data."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            handles,
            labels,
            loc="upper left",
            bbox_to_anchor=(1.01, 1.02),
            borderaxespad=0.0,
            frameon=False,
            fontsize=9,
        )


def fit(axes: Axes, *columns: Array, floor: float = 0.0, cover: float = 0.995) -> None:
    """Limits that show the bulk of the values: a first transient must not flatten the rest.

    ``floor`` is the least half-width; ``cover`` is the share of values inside.
    """
    values = np.concatenate([column[np.isfinite(column)] for column in columns]) if columns else np.empty(0)
    if len(values) == 0:
        return
    low, high = np.quantile(values, [1.0 - cover, cover])
    middle, half = 0.5 * (low + high), max(0.5 * (high - low) * 1.15, floor)
    if half > 0.0:
        axes.set_ylim(middle - half, middle + half)


def broken(angle: Array, limit: float) -> Array:
    """``angle`` with a gap where it wraps, so that no line is drawn across the panel."""
    out = angle.astype(np.float64)
    jumps = np.flatnonzero(np.abs(np.diff(out)) > limit) + 1
    out[jumps] = np.nan
    return out
