"""Rules of the house that no linter checks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bridge.frame import Event

ROOT = Path(__file__).parents[2]
ROOMS = ("bridge", "nav", "dbc", "virtual_bus")
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
CEILING = 400


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_stays_small(path: Path) -> None:
    lines = len(path.read_text().splitlines())
    assert lines <= CEILING, f"{lines} lines; split it at a seam, not at a line number"


def test_nav_and_drivers_read_no_clock_and_draw_no_random_number() -> None:
    """Everything behind the recorder is a function of the recorded frames."""
    pure = [
        p for p in MODULES if p.is_relative_to(ROOT / "nav") or p.is_relative_to(ROOT / "bridge" / "drivers")
    ]
    pure += [ROOT / "bridge" / "engine.py", ROOT / "bridge" / "digest.py"]
    forbidden = re.compile(
        r"^\s*(import|from)\s+(time|datetime|random|secrets|socket|threading)\b", re.MULTILINE
    )
    found = [str(p.relative_to(ROOT)) for p in pure if forbidden.search(p.read_text())]
    assert not found


@pytest.mark.parametrize("event", list(Event), ids=lambda event: event.name)
def test_every_kind_of_event_is_written_by_the_border(event: Event) -> None:
    """A kind that nobody writes is a promise that is not kept."""
    border = [ROOT / "bridge" / "live.py", *(ROOT / "bridge" / "sources").glob("*.py")]
    written = re.compile(rf"\bEvent\.{event.name}\b")
    assert any(written.search(path.read_text()) for path in border)
