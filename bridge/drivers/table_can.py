"""Encoders of a turntable on CAN: the angles of its axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.frame import RawFrame
from bridge.options import DeviceOptions
from bridge.outputs import Reject
from nav.types import TableSample

_MODULUS_NS: Final = 2**27 * 1000  # where TIME wraps


class TableCanOptions(DeviceOptions):
    """``[device.NAME]`` with ``driver = "table_can"``: a turntable that a unit is calibrated on.

    No navigator needs it: a bridge that has one hears and records its angles.
    """

    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


class TableCan:
    """Two frames, tied by ALIVE, one sample."""

    def __init__(self, options: TableCanOptions, context: Context) -> None:
        self.counters = Counters()
        self._name = context.name
        self._first, self._last = context.message("TABLE_ANGLES"), context.message("TABLE_INNER")
        self._first_key = self._first.frame_id + options.id_offset
        self.keys = [
            (context.source, key) for key in (self._first_key, self._last.frame_id + options.id_offset)
        ]
        self._port = context.port(_MODULUS_NS, options.latency_ms)
        self._angles: tuple[float, ...] = ()
        self._alive = self._done = -1
        self._first_data = self._last_data = b""

    def feed(self, frame: RawFrame) -> Sequence[TableSample]:
        """The angles that ``frame`` completes."""
        _, rx_ns, _, key, data = frame
        counters = self.counters
        counters.frames += 1
        codec = self._first if key == self._first_key else self._last
        if not intact(codec, data, counters):
            return ()
        alive = codec.alive(data)
        if key == self._first_key:
            if alive == self._alive:
                return repeated(data, self._first_data, counters)
            self._alive, self._first_data = alive, data
            self._angles = codec.decode(data)
            return ()
        if alive == self._done:
            return repeated(data, self._last_data, counters)
        if self._done >= 0:
            counters.missing += (alive - self._done) % codec.alive_modulus - 1
        self._done, self._last_data = alive, data
        if alive != self._alive:
            return counters.reject(Reject.INCOMPLETE)
        inner, time_us = codec.decode(data)
        t_ns = self._port.stamp(int(time_us) * 1000, rx_ns)
        elapsed = self._port.elapsed_ns
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        valid, outer, middle = self._angles
        if not valid:
            return counters.reject(Reject.INVALID)
        counters.samples += 1
        counters.last_ns = t_ns
        return (TableSample(t_ns, np.radians((outer, middle, inner)), self._name),)
