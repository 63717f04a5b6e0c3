"""How alignments converge: heading, its sigma and its limit over time, a panel for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from bridge.plots.style import BLUE, GREEN, GREY, INK, ORANGE, RED, Array, Picture, band, legend, line
from bridge.studies.alignment_report import refusals_of
from bridge.studies.alignment_table import Found, Trace

_LEAST: Final = 1e-5  # deg
_MOST: Final = 200.0
_LINES: Final = 20  # refusals that are drawn over the whole height
_SETTLED: Final = 0.3  # of the time with a heading, from which on the band is to fit its panel


def draw(found: Sequence[Found], path: Path, title: str, bound_deg: float) -> Path:
    """Write the picture of all that were run as PNG; returns ``path``.

    Of one alone the heading with three sigma to either side is above.
    """
    shown = [one for one in found if one.trace is not None]
    closer = int(len(shown) == 1 and bool(_known(shown[0]).any()))
    picture = Picture(title, _subtitle(shown, bound_deg), rows=max(1, len(shown)) + closer)
    panels = picture.column()
    if closer:
        _heading(panels[0], shown[0])
    low = _floor(shown, bound_deg)
    for one, axes in zip(shown, panels[closer:], strict=False):
        _convergence(axes, one, bound_deg)
        axes.set_ylim(low, _MOST)
        axes.set_ylabel("angles (deg)" if closer else f"{one.method}\n(deg)")
    end = 1.02 * max([1.0, *(one.seconds for one in shown)])
    for axes in panels:
        axes.set_xlim(0.0, end)
        legend(axes)
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time since the start of the alignment (s)")
    return picture.save(path)


def draw_each(found: Sequence[Found], folder: Path, title: str, bound_deg: float) -> list[Path]:
    """A picture of its own for every one that was run, by its name, in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        draw([one], folder / f"{one.method}.png", f"{title} · {one.method}", bound_deg)
        for one in found
        if one.trace is not None
    ]


def _heading(axes: Axes, one: Found) -> None:
    """Error of heading, or what it differs by from the last one, in three sigma to either side."""
    trace, known = _trace(one), _known(one)
    apart, label = _apart(trace)
    sigma = np.where(known, np.hypot(trace.sigma[:, 2], one.mounting_sigma_deg), math.nan)
    band(axes, trace.t_s, 0.0, sigma, ORANGE, "3 sigma")
    line(axes, trace.t_s, apart, BLUE, label)
    if one.ended_s is not None:
        axes.plot(trace.t_s[-1], apart[-1], "o", color=BLUE, markersize=4.0)
        axes.axvline(one.ended_s, color=INK, linewidth=0.9)
    settled = np.flatnonzero(known)
    settled = settled[trace.t_s[settled] >= (1 - _SETTLED) * trace.t_s[settled[0]] + _SETTLED * one.seconds]
    rows = settled if len(settled) else np.flatnonzero(known)
    half = 1.15 * float(np.nanmax(np.maximum(3.0 * sigma[rows], np.abs(apart[rows]))))
    axes.set_ylim(-half, half)
    axes.set_ylabel("heading (deg)")


def _convergence(axes: Axes, one: Found, bound_deg: float) -> None:
    """All that is told of it, on a logarithmic axis."""
    trace, known = _trace(one), _known(one)
    level = np.isfinite(trace.attitude[:, 0])
    apart, label = _apart(trace)
    lines = (
        (np.where(known, trace.sigma[:, 2], math.nan), ORANGE, "sigma of heading", "-"),
        (np.where(level, np.max(trace.sigma[:, :2], axis=1), math.nan), GREEN, "sigma of level", "-"),
        (np.where(known, trace.limit[:, 2], math.nan), GREY, "limit of heading", "--"),
        (np.abs(apart), BLUE, label, "-"),
    )
    axes.set_yscale("log")
    axes.axhline(bound_deg, color=INK, linewidth=0.8, linestyle=":", label=f"bound, {bound_deg:g} deg")
    for values, colour, name, style in lines:
        if np.any(values > 0.0):
            drawn = _shown(values)
            line(axes, trace.t_s, drawn, colour, name, linestyle=style)
            if one.ended_s is not None:  # alone after stored samples that hold for earlier times
                axes.plot(trace.t_s[-1], drawn[-1], "o", color=colour, markersize=3.0)
    # so many that they would fill the panel become a rug along its top
    low = 0.0 if len(one.refusals) <= _LINES else 0.94
    for k, (t_s, _) in enumerate(one.refusals):
        axes.axvline(t_s, low, color=RED, linewidth=0.9, label="refused" if k == 0 else None)
    if one.ended_s is not None:
        axes.axvline(one.ended_s, color=INK, linewidth=0.9, label="handed over")


def _trace(one: Found) -> Trace:
    assert one.trace is not None
    return one.trace


def _known(one: Found) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.isfinite(_trace(one).attitude[:, 2])


def _apart(trace: Trace) -> tuple[Array, str]:
    """Error of heading (deg), or without truth what it is off the last one, and what that is called."""
    if np.any(np.isfinite(trace.error[:, 2])):
        return trace.error[:, 2], "error of heading"
    known = np.isfinite(trace.attitude[:, 2])
    last = trace.attitude[known][-1, 2] if known.any() else 0.0
    return (trace.attitude[:, 2] - last + 180.0) % 360.0 - 180.0, "heading less its last"


def _floor(shown: Sequence[Found], bound_deg: float) -> float:
    """The decade below the least sigma, limit and bound."""
    least = bound_deg
    for one in shown:
        trace = _trace(one)
        told = np.isfinite(trace.attitude[:, 0])
        values = np.concatenate([trace.sigma[told].ravel(), trace.limit[told].ravel()])
        least = min([least, *values[values > 0.0]])
    return max(_LEAST, 10.0 ** (math.floor(math.log10(least)) - 1))


def _shown(values: Array) -> Array:
    """``values`` for a logarithmic axis."""
    return np.where(values > 0.0, np.clip(values, _LEAST, _MOST), math.nan)


def _subtitle(shown: Sequence[Found], bound_deg: float) -> str:
    if len(shown) != 1:
        ended = sum(one.ended_s is not None for one in shown)
        return f"{ended} of {len(shown)} alignments handed over"
    (one,) = shown
    if one.ended_s is None and one.refusals:
        first, *others = refusals_of(one)
        return f"{first}; and for {len(others)} other reasons" if others else first
    converged = one.converged_s(bound_deg)
    parts = [
        "did not hand over" if one.ended_s is None else f"handed over after {one.ended_s:.1f} s",
        f"sigma of heading never below {bound_deg:g} deg"
        if converged is None
        else f"sigma of heading below {bound_deg:g} deg after {converged:.1f} s",
    ]
    if one.error_deg is not None and math.isfinite(one.error_deg[2]):
        parts.append(f"error of heading at the end {one.error_deg[2]:+.3f} deg")
    return "; ".join(parts)
