"""What every CAN driver does with a frame before it believes what is in it."""

from __future__ import annotations

from typing import Final

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.frame import RawFrame
from bridge.outputs import Reject
from dbc.codec import MessageCodec, Value

TIME_MODULUS_NS: Final = 2**16 * 100_000
"""Where the TIME of messages that are whole in one frame wraps."""


def intact(codec: MessageCodec, data: bytes, counters: Counters) -> bool:
    """Whether length and CRC are right; counted where they are not."""
    if codec.crc_ok(data):
        return True
    counters.reject(Reject.LENGTH if len(data) != codec.length else Reject.CRC)
    return False


def repeated(data: bytes, before: bytes, counters: Counters) -> tuple[()]:
    """Count a frame whose alive counter stood still: sent again, where it equals ``before``, or stuck."""
    if data == before:
        counters.duplicates += 1
    else:
        counters.reject(Reject.COUNTER)
    return ()


class Intake:
    """Takes in a message that is whole in one frame and ends with TIME: checks, counts, decodes, dates."""

    __slots__ = ("_alive", "_codec", "_data", "_port", "counters", "keys")

    def __init__(self, message: str, id_offset: int, latency_ms: float, context: Context) -> None:
        self.counters = Counters()
        self._codec = context.message(message)
        self.keys = [(context.source, self._codec.frame_id + id_offset)]
        self._port = context.port(TIME_MODULUS_NS, latency_ms)
        self._alive: int | None = None
        self._data = b""

    @property
    def elapsed_ns(self) -> int | None:
        """Device time from the frame before to the last one, None where that is not known."""
        return self._port.elapsed_ns

    @property
    def stale(self) -> bool:
        """Whether the last frame's device time is not later than that of the frame before."""
        elapsed = self._port.elapsed_ns
        return elapsed is not None and elapsed <= 0

    def take(self, frame: RawFrame) -> tuple[int, tuple[Value, ...]] | None:
        """Engine time (ns) and values, in the order of the message's signals; None: turned away, counted."""
        _, rx_ns, _, _, data = frame
        counters, codec = self.counters, self._codec
        counters.frames += 1
        if not intact(codec, data, counters):
            return None
        alive, last = codec.alive(data), self._alive
        if alive == last:
            repeated(data, self._data, counters)
            return None
        if last is not None:
            counters.missing += (alive - last) % codec.alive_modulus - 1
        self._alive = alive
        self._data = data
        values = codec.decode(data)
        return self._port.stamp(int(values[-1]) * 1000, rx_ns), values

    def given(self, t_ns: int) -> None:
        """Count a sample of the time ``t_ns``."""
        self.counters.samples += 1
        self.counters.last_ns = t_ns
