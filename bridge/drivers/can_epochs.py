"""Epochs of several CAN frames with the same ALIVE: put together, and counted where they are not whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bridge.drivers.base import Context
from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.frame import RawFrame
from bridge.outputs import Reject
from dbc.codec import MessageCodec

Parts = list[tuple[float, ...]]


class Epochs:
    """Collects frames of one ALIVE until all that belong to the epoch are there.

    ``messages`` are the names of those that there may be, the one with the device's time first. ``wanted``
    says, from the values of that one, which belong to the epoch: a bit for each, the first the lowest;
    None: all.
    """

    def __init__(
        self,
        messages: Sequence[str],
        id_offset: int,
        context: Context,
        wanted: Callable[[tuple[float, ...]], int] | None = None,
    ) -> None:
        self.counters = Counters()
        self._wanted = wanted
        self._all = (1 << len(messages)) - 1
        self._codecs: dict[int, tuple[int, MessageCodec]] = {}
        for place, name in enumerate(messages):
            codec = context.message(name)
            self._codecs[codec.frame_id + id_offset] = (place, codec)
        self.keys = [(context.source, key) for key in self._codecs]
        self._alive = -1  # of the epoch being collected; -1: none
        self._done_alive = -1
        self._have = 0
        self._parts: Parts = [()] * len(messages)
        self._data: list[bytes] = [b""] * len(messages)
        self.rx_ns = 0
        """When the frame with the time of the last epoch was received."""

    def take(self, frame: RawFrame) -> Parts | None:
        """Values of all messages of the epoch that ``frame`` completes, those that did not belong left empty.

        None: there is more to come, or it was turned away and counted.
        """
        _, rx_ns, _, key, data = frame
        counters = self.counters
        counters.frames += 1
        place, codec = self._codecs[key]
        if not intact(codec, data, counters):
            return None
        alive = codec.alive(data)
        if alive == self._done_alive or (alive == self._alive and self._have >> place & 1):
            repeated(data, self._data[place], counters)
            return None
        if alive != self._alive:
            if self._have:
                counters.reject(Reject.INCOMPLETE)
            if self._done_alive >= 0 or self._alive >= 0:
                last = self._alive if self._alive >= 0 else self._done_alive
                counters.missing += (alive - last) % codec.alive_modulus - 1
            self._alive = alive
            self._done_alive = -1
            self._have = 0
        if place == 0:
            self.rx_ns = rx_ns
        self._data[place] = data
        self._parts[place] = codec.decode(data)
        self._have |= 1 << place
        wanted = self._all
        if self._wanted is not None and self._have & 1:
            wanted = self._wanted(self._parts[0])
        if wanted & ~self._have:
            return None
        self._have = 0
        self._done_alive = alive
        self._alive = -1
        whole: Parts = []
        for place, (part, (_, each)) in enumerate(zip(self._parts, self._codecs.values(), strict=True)):
            if wanted >> place & 1 and not each.in_range(part):
                counters.reject(Reject.RANGE)
                return None
            whole.append(part if wanted >> place & 1 else ())
        return whole
