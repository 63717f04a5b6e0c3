"""The frames of an inertial sample that come before the one with its time, put together one by one."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.outputs import Reject
from dbc.codec import MessageCodec, Value


class _Part:
    __slots__ = ("alive", "codec", "data", "values")

    def __init__(self, codec: MessageCodec) -> None:
        self.codec = codec
        self.alive = -1  # nothing yet
        self.data = b""
        self.values: tuple[Value, ...] = ()


class Parts:
    """Keeps the frames with the same ALIVE, in whatever order they come, until the one with the time.

    ``codecs`` are their messages, the first of them the one that a sample begins with.
    """

    def __init__(self, codecs: Sequence[MessageCodec], id_offset: int, counters: Counters) -> None:
        self._parts = [_Part(codec) for codec in codecs]
        self._by_key = {part.codec.frame_id + id_offset: part for part in self._parts}
        self._counters = counters
        self.done = -1
        """ALIVE of the last sample."""

    def __contains__(self, key: int) -> bool:
        return key in self._by_key

    @property
    def keys(self) -> Sequence[int]:
        """Their identifiers."""
        return list(self._by_key)

    @property
    def waiting(self) -> bool:
        """Whether there is any."""
        return any(part.alive >= 0 for part in self._parts)

    def take(self, key: int, data: bytes) -> tuple[()]:
        """Keep one."""
        part, counters = self._by_key[key], self._counters
        if not intact(part.codec, data, counters):
            return ()
        alive = part.codec.alive(data)
        if alive == self.done:
            return repeated(data, part.data, counters)
        if part is self._parts[0]:
            if alive == part.alive:
                repeated(data, part.data, counters)
            elif part.alive >= 0:
                counters.reject(Reject.INCOMPLETE)
        part.values = part.codec.decode(data)
        part.alive = alive
        part.data = data
        return ()

    def end(self, alive: int) -> list[tuple[Value, ...]] | None:
        """The values of all, in the order of their messages; None where some are missing."""
        whole = all(part.alive == alive for part in self._parts)
        for part in self._parts:
            part.alive = -1
        self.done = alive
        return [part.values for part in self._parts] if whole else None

    def ended(self, alive: int, *payloads: bytes) -> None:
        """A sample was put together elsewhere, of these."""
        self.done = alive
        for part, data in zip(self._parts, payloads, strict=False):
            part.data = data
