"""Each figure is computed once for all of its tests."""

from __future__ import annotations

import functools
from collections.abc import Callable

import pytest

from bridge.studies.figures import load
from bridge.studies.figures.result import Result


@pytest.fixture(scope="session")
def computed() -> Callable[[str], Result]:
    """The result of a figure by name."""
    return functools.cache(lambda name: load(name).compute())
