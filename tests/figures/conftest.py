"""Each figure is computed once for all of its tests."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final

import pytest

from bridge.studies.figures import load, transfer
from bridge.studies.figures.result import Result

SMALL: Final[dict[str, dict[str, Any]]] = {
    "alignment": {"runs": 8, "dt": 0.05},
    "redundant": {"runs": 8},
    "transfer": {"runs": 8, "pairs": transfer.PAIRS[:2], "others": transfer.OTHERS[:1]},
}
"""Of figures of random runs, which widen their bands accordingly: few, 20 samples a second, short flights."""


@pytest.fixture(scope="session")
def computed() -> Callable[[str], Result]:
    """The result of a figure by name."""
    return functools.cache(lambda name: load(name).compute(**SMALL.get(name, {})))
