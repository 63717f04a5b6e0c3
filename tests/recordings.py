"""Where tests find real recordings."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("NAVBRIDGE_DATA") or Path(__file__).parents[2] / "shared" / "data")


def needs_recording(name: str) -> pytest.MarkDecorator:
    """Skip, and say so, where the folder of that recording is absent."""
    folder = DATA / name
    return pytest.mark.skipif(
        not folder.is_dir(), reason=f"no recording in {folder}; NAVBRIDGE_DATA names the folder of recordings"
    )
