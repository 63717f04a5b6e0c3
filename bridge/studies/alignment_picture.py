"""How alignments converge: heading, its sigma and its limit over time, a panel for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from bridge.plots.style import BLUE, GREEN, GREY, ORANGE, RED, Array, Picture, legend, line
from bridge.studies.alignment_table import Found

_LEAST: Final = 1e-4  # deg
_MOST: Final = 200.0
_LINES: Final = 20  # refusals that are drawn over the whole height


def draw(found: Sequence[Found], path: Path, title: str, bound_deg: float) -> Path:
    """Write the picture of all that were run as PNG; returns ``path``."""
    shown = [one for one in found if one.trace is not None]
    picture = Picture(title, _subtitle(shown, bound_deg), rows=max(1, len(shown)))
    panels = picture.column()
    for one, axes in zip(shown, panels, strict=False):
        trace = one.trace
        assert trace is not None
        level, known = (np.isfinite(trace.attitude[:, k]) for k in (0, 2))
        sigma = np.where(known, trace.sigma[:, 2], math.nan)
        tilt = np.where(level, np.max(trace.sigma[:, :2], axis=1), math.nan)
        axes.set_yscale("log")
        axes.set_ylim(_LEAST, _MOST)
        axes.axhline(bound_deg, color=GREY, linewidth=0.8, linestyle=":", label=f"{bound_deg:g} deg")
        line(axes, trace.t_s, _shown(sigma), ORANGE, "sigma of heading")
        line(axes, trace.t_s, _shown(tilt), GREEN, "sigma of level")
        line(axes, trace.t_s, _shown(trace.limit[:, 2]), GREY, "limit of heading", linestyle="--")
        if np.any(np.isfinite(trace.error[:, 2])):
            line(axes, trace.t_s, _shown(np.abs(trace.error[:, 2])), BLUE, "error of heading")
        elif known.any():
            apart = trace.attitude[:, 2] - trace.attitude[known][-1, 2]
            apart = np.abs((apart + 180.0) % 360.0 - 180.0)
            line(axes, trace.t_s, _shown(apart), BLUE, "heading less its end")
        # so many that they would fill the panel become a rug along its top
        low = 0.0 if len(one.refusals) <= _LINES else 0.94
        for k, (t_s, _) in enumerate(one.refusals):
            axes.axvline(t_s, low, color=RED, linewidth=0.9, label="refused" if k == 0 else None)
        if one.ended_s is not None:
            axes.axvline(one.ended_s, color=GREY, linewidth=0.9, label="handed over")
        axes.set_ylabel(f"{one.method}, deg")
        axes.set_xlim(0.0, max(max(other.seconds for other in shown), 1.0))
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


def _shown(values: Array) -> Array:
    """``values`` for a logarithmic axis."""
    return np.where(values > 0.0, np.clip(values, _LEAST, _MOST), math.nan)


def _subtitle(shown: Sequence[Found], bound_deg: float) -> str:
    if len(shown) != 1:
        ended = sum(one.ended_s is not None for one in shown)
        return f"{ended} of {len(shown)} alignments handed over"
    (one,) = shown
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
