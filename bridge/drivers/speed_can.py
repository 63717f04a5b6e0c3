"""Speed logs on CAN."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import AliveCounter, bad_frame
from bridge.drivers.counters import Counters
from bridge.drivers.odometer_can import TIME_MODULUS_NS
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from nav.types import SpeedSample


class SpeedCanOptions(DeviceOptions):
    """``[device.NAME]`` with ``driver = "speed_can"``.

    ``min_sigma_m_s`` is the least standard deviation believed.
    """

    max_speed_m_s: Positive = 100.0
    min_sigma_m_s: Positive = 0.01
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


class SpeedCan:
    """One frame, one sample."""

    def __init__(self, options: SpeedCanOptions, context: Context) -> None:
        self.counters = Counters()
        self._name = context.name
        self._codec = context.message("SPEED")
        self.keys = [(context.source, self._codec.frame_id + options.id_offset)]
        self._alive = AliveCounter(self._codec, self.counters)
        self._port = context.port(TIME_MODULUS_NS, options.latency_ms)
        self._max_speed = options.max_speed_m_s
        self._min_sigma = options.min_sigma_m_s

    def feed(self, frame: RawFrame) -> Sequence[SpeedSample]:
        """The speed in ``frame``."""
        _, rx_ns, _, _, data = frame
        counters, codec = self.counters, self._codec
        counters.frames += 1
        if not codec.crc_ok(data):
            bad_frame(codec, data, counters)
            return ()
        if not self._alive.fresh(codec.alive(data), data):
            return ()
        valid, speed, accuracy, time_us = codec.decode(data)
        t_ns = self._port.stamp(int(time_us) * 1000, rx_ns)
        elapsed = self._port.elapsed_ns
        if not valid:
            return counters.reject(Reject.INVALID)
        if abs(speed) > self._max_speed:
            return counters.reject(Reject.RANGE)
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        counters.samples += 1
        counters.last_ns = t_ns
        return (SpeedSample(t_ns, float(speed), max(float(accuracy), self._min_sigma), self._name),)
