"""What a figure found: rows of a published number beside ours, and whether they agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol


class Row(NamedTuple):
    """One number.

    ``published`` is what is printed in the source (None where nothing is), ``ours`` what the kernels
    give, both in ``unit``. ``tolerance`` says in words what is asked; ``passed`` whether it is met, None
    for a row that is only shown. ``why`` explains a published number that is not reproduced. ``exact`` is a
    closed form, where there is one: a row whose published number is a misprint is judged by it.
    ``interval`` holds, of a number that is itself a spread of random runs, the true one in 95 of 100 cases.
    """

    name: str
    published: float | None
    ours: float
    tolerance: str
    passed: bool | None
    unit: str
    why: str = ""
    exact: float | None = None
    interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """A figure: its rows, remarks, and numbers for who wants to draw or compare (JSON types only)."""

    title: str
    rows: list[Row]
    notes: list[str] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether no row is outside its tolerance."""
        return not any(row.passed is False for row in self.rows)

    def document(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {
            "title": self.title,
            "passed": self.passed,
            "rows": [row._asdict() for row in self.rows],
            "notes": self.notes,
            "numbers": self.numbers,
        }

    def lines(self) -> list[str]:
        """A table for people."""
        reasons: list[str] = []
        cells = [("", "published", "closed form", "ours", "95 %", "unit", "", "asked")]
        for row in self.rows:
            mark = {True: "ok", False: "OUTSIDE", None: ""}[row.passed]
            if row.why:
                if row.why not in reasons:
                    reasons.append(row.why)
                mark = f"{mark} [{reasons.index(row.why) + 1}]".strip()
            # of a number that scatters three digits tell all
            ours = _number(row.ours) if row.interval is None else f"{row.ours:.3g}"
            values = (_number(row.published), _number(row.exact), ours)
            between = "" if row.interval is None else "{:.3g} to {:.3g}".format(*row.interval)
            cells.append((row.name, *values, between, row.unit, mark, row.tolerance))
        keep = [k for k in range(8) if any(row[k] for row in cells[1:])]
        width = [max(len(row[k]) for row in cells) for k in range(8)]
        lines = [self.title, ""]
        for cell in cells:
            # numbers to the right, words to the left
            aligned = (cell[k].rjust(width[k]) if 0 < k < 4 else cell[k].ljust(width[k]) for k in keep)
            lines.append("  ".join(aligned).rstrip())
        lines += [""] if reasons or self.notes else []
        lines += [line for n, why in enumerate(reasons) for line in _wrapped(why, f"[{n + 1}] ")]
        lines += [line for note in self.notes for line in _wrapped(note, "")]
        judged = [row for row in self.rows if row.passed is not None]
        inside = sum(1 for row in judged if row.passed)
        return [*lines, "", f"{inside} of {len(judged)} rows inside their tolerance"]


class Compute(Protocol):
    """Find the numbers of a figure."""

    def __call__(self, **options: Any) -> Result:
        """Take from a second to a minute; random runs are told ``runs``, ``jobs``, ``progress``."""


class Draw(Protocol):
    """Draw what was found."""

    def __call__(self, result: Result, path: Path) -> None:
        """Write ``result`` as PNG at ``path``."""


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.7g}"


def _wrapped(text: str, lead: str, width: int = 110) -> Iterator[str]:
    line, indent = lead, " " * len(lead)
    for word in text.split():
        if len(line) + len(word) > width and line.strip() != lead.strip():
            yield line.rstrip()
            line = indent
        line += word + " "
    yield line.rstrip()
