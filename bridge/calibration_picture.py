"""A picture of what a calibration leaves: residuals of every sensor over the steps of the plan."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from bridge.calibrating import Calibrated
from bridge.plots.style import AXES, GREY, Picture, legend

_PANELS: Final = (
    (True, False, "gyros, arcsec", np.pi / 648000.0),
    (False, False, "accelerometers, mm/s", 1e-3),
    (True, True, "gyros, sigma", 1.0),
    (False, True, "accelerometers, sigma", 1.0),
)


def draw(result: Calibrated, path: Path) -> Path:
    """Write the picture as PNG; returns ``path``."""
    found = result.fit
    subtitle = f"chi-square {found.chi2:.1f} with {found.freedom} degrees of freedom; dashes: 3 sigma"
    picture = Picture(f"Residuals: {result.plan.title}", subtitle, rows=len(_PANELS), sharex=True)
    for (gyro, white, label, unit), axes in zip(_PANELS, picture.column(), strict=True):
        shown = [
            (one.name, left)
            for one, left in zip(found.model.sensors, found.residuals, strict=True)
            if one.gyro == gyro
        ]
        for k, (name, left) in enumerate(shown):
            values = left.white if white else left.values / unit
            place = np.array(left.used) + 1.0
            axes.plot(place, values, "o-", ms=4, lw=0.8, color=AXES[k % len(AXES)], label=name)
        if white:
            for edge in (-3.0, 3.0):
                axes.axhline(edge, color=GREY, linewidth=0.8, linestyle="--")
        axes.set_ylabel(label)
        legend(axes)
    picture.column()[-1].set_xlabel("step of the plan")
    return picture.save(path)
