"""What a source is: everything between a bus and the recorder, behind one method that never blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from bridge.clock import Clock, WallClock
from bridge.frame import Event
from bridge.outputs import Transmit

Received = tuple[int, int, bytes]
"""Receive time (monotonic ns), key and data, as in `bridge.frame.RawFrame`."""


class Notice(NamedTuple):
    """What the border learned: to be recorded as an event of the bridge."""

    rx_ns: int
    event: Event
    body: dict[str, int | str]


@dataclass(frozen=True, slots=True)
class SourceContext:
    """What a source is built from besides its options.

    ``accept`` holds the keys that somebody subscribed to; None lets everything through. ``key`` is the
    secret of a link with signatures.
    """

    number: int
    name: str
    clock: Clock
    wall: WallClock
    accept: frozenset[int] | None = None
    key: bytes | None = field(default=None, repr=False)


class Source(Protocol):
    """A bus or link. Opened once; after that a fault is a notice and a later attempt, never an exception.

    What is wrong with its options is a ConfigError when it is made, that begins with the key.
    """

    context: SourceContext

    def open(self) -> None:
        """Open it; raises SourceError when it is not there."""
        ...

    def descriptors(self) -> Sequence[int]:
        """File descriptors to wait on for input; none: it has to be polled."""
        ...

    def poll(self, deadline_ns: int) -> list[Received]:
        """What has arrived, in order of arrival; stops at ``deadline_ns`` and never waits."""
        ...

    def notices(self) -> list[Notice]:
        """What was learned since the last call, to be recorded before the frames of the last poll."""
        ...

    def send(self, transmit: Transmit) -> bool:
        """Send one frame or packet; False when the bus did not take it (it is counted)."""
        ...

    def counters(self) -> dict[str, int]:
        """Totals for the operator, by name."""
        ...

    def filters(self) -> str:
        """Which keys are let through, for the record."""
        ...

    def close(self) -> None:
        """Release the bus."""
        ...
