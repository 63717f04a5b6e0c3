"""Transfer alignment: a slave takes its attitude from a master that is already good.

`MATCHINGS` names the ways. Each is an alignment like those of `nav.align.ALIGNMENTS`, of one stage, and is
called ``transfer_`` and its key wherever an alignment is asked for by name; `alignment` knows both tables. To
align in the air by GNSS alone take the alignments ``motion`` or ``gnss``: they need no master.
"""

from __future__ import annotations

from typing import Final

from nav.align import ALIGNMENTS, Alignment
from nav.transfer import matching
from nav.transfer.matching import Matching
from nav.transfer.stage import stage

PREFIX: Final = "transfer_"


def _alignment(one: Matching) -> Alignment:
    return Alignment(needs=frozenset({"master"}), stages=(stage(one),))


MATCHINGS: Final[dict[str, Alignment]] = {
    one.name: _alignment(one)
    for one in (
        matching.ONE_SHOT,
        matching.VELOCITY_5,
        matching.VELOCITY_11,
        matching.POSITION_10,
        matching.HEADING_19,
        matching.HEADING_13,
        matching.HEADING_7,
        matching.ATTITUDE_16,
        matching.RATE,
    )
}


def methods() -> tuple[str, ...]:
    """Names of all alignments, of both tables."""
    return (*ALIGNMENTS, *(PREFIX + name for name in MATCHINGS))


def alignment(name: str) -> Alignment:
    """The alignment called ``name`` in either table. Raises KeyError where there is none."""
    if name in ALIGNMENTS:
        return ALIGNMENTS[name]
    if name.startswith(PREFIX):
        return MATCHINGS[name.removeprefix(PREFIX)]
    raise KeyError(name)


__all__ = ["MATCHINGS", "PREFIX", "alignment", "methods"]
