"""A picture of a consistency campaign: errors against sigmas, and NEES against its band."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from bridge.plots.style import AXES as COLOURS
from bridge.plots.style import GREY, Picture
from bridge.studies.consistency import AXES, KINDS, Consistency

_UNITS: Final = {"position": ("m", 1.0), "velocity": ("m/s", 1.0), "attitude": ("deg", 180.0 / math.pi)}


def draw(found: Consistency, path: Path, subtitle: str) -> Path:
    """Write the picture as PNG; returns ``path``."""
    low, high = found.nees_band
    share = f"NEES inside the 95 % band at {100 * found.nees_inside:.0f} % of epochs"
    picture = Picture(
        f"Consistency of {found.runs} runs", f"{subtitle}; {share}", rows=3, columns=2, sharex=True
    )
    for row, (kind, part) in enumerate(KINDS.items()):
        unit, factor = _UNITS[kind]
        left, right = picture.axes[row]
        for axis, place in enumerate(range(part.start, part.stop)):
            colour = COLOURS[axis]
            left.plot(found.t_s, factor * found.rms[:, place], "o-", ms=4, color=colour, label=AXES[axis])
            left.plot(found.t_s, factor * found.sigma[:, place], "--", color=colour)
        left.set_yscale("log")
        left.set_ylabel(f"{kind}, {unit}\nrms (dots), sigma (dashes)")
        right.axhspan(low, high, color=GREY, alpha=0.2, label="95 % band")
        right.plot(found.t_s, found.nees[:, row], "o-", ms=4, color=COLOURS[0])
        right.set_ylim(0.0, max(1.2 * high, 1.1 * float(found.nees[:, row].max())))
        right.set_ylabel("mean NEES of 3")
    picture.axes[0][0].legend(ncols=3)
    picture.axes[0][1].legend()
    for panel in picture.axes[-1]:
        panel.set_xlabel("time, s")
    return picture.save(path)
