"""Each figure is computed once for all of its tests."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final

import pytest

from bridge.studies.figures import FIGURES, load
from bridge.studies.figures.result import Result

SMALL: Final = {"runs": 8, "dt": 0.05}
"""Of figures of random runs, which widen their bands accordingly, at 20 samples a second."""


@pytest.fixture(scope="session")
def computed() -> Callable[[str], Result]:
    """The result of a figure by name."""
    return functools.cache(lambda name: load(name).compute(**(SMALL if FIGURES[name].runs else {})))
