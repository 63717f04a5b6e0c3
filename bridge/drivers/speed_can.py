"""Speed logs on CAN."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import Intake
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
        self._intake = Intake("SPEED", options.id_offset, options.latency_ms, context)
        self.keys, self.counters = self._intake.keys, self._intake.counters
        self._name = context.name
        self._max_speed = options.max_speed_m_s
        self._min_sigma = options.min_sigma_m_s

    def feed(self, frame: RawFrame) -> Sequence[SpeedSample]:
        """The speed in ``frame``."""
        intake = self._intake
        taken = intake.take(frame)
        if taken is None:
            return ()
        t_ns, (valid, speed, accuracy, _) = taken
        if not valid:
            return self.counters.reject(Reject.INVALID)
        if abs(speed) > self._max_speed:
            return self.counters.reject(Reject.RANGE)
        if intake.stale:
            return self.counters.reject(Reject.STALE)
        intake.given(t_ns)
        return (SpeedSample(t_ns, float(speed), max(float(accuracy), self._min_sigma), self._name),)
