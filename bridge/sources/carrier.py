"""What carries MAVLink bytes: the interface that UDP, TCP and serial lines share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

READ_BYTES: Final = 4096
"""Largest chunk, so that even one full of noise is gone through in milliseconds."""
BURST: Final = 4
"""Chunks that one `Transport.receive` returns at most; fewer mean that none was left."""
RETRY_NS: Final = 1_000_000_000
"""Time between two attempts to get a lost connection back."""


class Chunk(NamedTuple):
    """Bytes that came together, when (UTC ns by the kernel, 0 unknown) and from whom."""

    utc_ns: int
    peer: str
    data: bytes


class Transport(Protocol):
    """Bytes in and out. ``datagrams`` says that a chunk holds whole packets."""

    datagrams: bool

    def open(self) -> None:
        """Open it; raises OSError where that can never work."""
        ...

    def descriptors(self) -> Sequence[int]:
        """File descriptors to wait on."""
        ...

    def receive(self, now_ns: int) -> list[Chunk]:
        """What has arrived; also the moment to look after lost connections."""
        ...

    def heard(self, peer: str, now_ns: int) -> None:
        """A packet of ``peer``, named as in its chunk, was good: one that listens answers it from now on."""
        ...

    def send(self, data: bytes) -> bool:
        """Send to whoever listens; False when nobody got it."""
        ...

    def news(self) -> list[str]:
        """Connections that came and went since the last call."""
        ...

    def close(self) -> None:
        """Release everything."""
        ...
