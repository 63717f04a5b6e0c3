"""What every CAN driver checks before it believes a frame."""

from __future__ import annotations

from bridge.drivers.counters import Counters
from bridge.outputs import Reject
from dbc.codec import MessageCodec


def bad_frame(codec: MessageCodec, data: bytes, counters: Counters) -> None:
    """Count a frame whose CRC check (which includes the length) failed."""
    counters.reject(Reject.LENGTH if len(data) != codec.length else Reject.CRC)


class AliveCounter:
    """The alive counter of a message that is whole in one frame."""

    __slots__ = ("_counters", "_data", "_last", "_modulus")

    def __init__(self, codec: MessageCodec, counters: Counters) -> None:
        self._counters = counters
        self._modulus = codec.alive_modulus
        self._last: int | None = None
        self._data = b""

    def fresh(self, alive: int, data: bytes) -> bool:
        """Whether the counter moved on; what it skipped is counted missing, what it repeats turned away."""
        last = self._last
        if last is not None:
            step = (alive - last) % self._modulus
            if step == 0:
                if data == self._data:
                    self._counters.duplicates += 1
                else:
                    self._counters.reject(Reject.COUNTER)
                return False
            self._counters.missing += step - 1
        self._last = alive
        self._data = data
        return True
