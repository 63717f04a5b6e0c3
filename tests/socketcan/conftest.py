"""The bus fixture: a missing bus fails in CI and skips, with the remedy, elsewhere."""

from __future__ import annotations

import os

import pytest

from tests.socketcan.uml import Machine, Missing, find_machine


def in_ci() -> bool:
    """Whether this is CI, where nothing here may be skipped."""
    return os.environ.get("CI", "").lower() in ("1", "true")


def absence(reason: str, *, ci: bool) -> None:
    """Fail where what the tests need must be there (CI), skip where it may be missing."""
    if ci:
        pytest.fail(f"{reason} (CI must run these tests)")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def machine() -> Machine:
    """A machine with `uml.CHANNEL`: the host or user-mode Linux."""
    found = find_machine()
    if isinstance(found, Missing):
        absence(found.reason, ci=in_ci())
    assert not isinstance(found, Missing)
    return found
