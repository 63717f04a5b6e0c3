"""Pictures of a capture: a function a picture in `pages`, one look in `style`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bridge.plots.data import PlotData
from bridge.plots.pages import PAGES, innovations

__all__ = ["PlotData", "draw"]


def draw(data: PlotData, folder: Path, prefix: str = "") -> Iterator[Path]:
    """Write every picture that there is data for into ``folder``, which must exist; yields their paths."""
    for name, page in PAGES.items():
        picture = page(data)
        if picture is not None:
            yield picture.save(folder / f"{prefix}{name}.png")
    for kind, picture in innovations(data):
        yield picture.save(folder / f"{prefix}innovations_{kind}.png")
