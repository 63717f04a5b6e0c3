"""Wheel odometers on CAN: cumulative ticks that wrap, to distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import Intake
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from nav.types import OdoSample

TICK_MODULUS: Final = 2**32
_REVERSE: Final = 2


class OdometerCanOptions(DeviceOptions, kw_only=True):
    """``[device.NAME]`` with ``driver = "odometer_can"``.

    ``max_speed_m_s`` is beyond what the vehicle can do: a count that asks for more is not believed.
    """

    m_per_tick: Positive
    max_speed_m_s: Positive = 100.0
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


class OdometerCan:
    """Distance per frame; ticks of lost frames are in the next one, so no distance is lost with them."""

    def __init__(self, options: OdometerCanOptions, context: Context) -> None:
        self._intake = Intake("ODO", options.id_offset, options.latency_ms, context)
        self.keys, self.counters = self._intake.keys, self._intake.counters
        self._name = context.name
        self._m_per_tick = options.m_per_tick
        self._max_speed = options.max_speed_m_s
        self._sign = 1.0
        self._ticks: int | None = None
        self._t_ns = 0

    def feed(self, frame: RawFrame) -> Sequence[OdoSample]:
        """The distance since the frame before, where both are good."""
        counters, intake = self.counters, self._intake
        taken = intake.take(frame)
        if taken is None:
            return ()
        t_ns, (direction, standstill, valid, ticks, _) = taken
        if not valid:
            self._ticks = None
            return counters.reject(Reject.INVALID)
        if direction > _REVERSE:
            self._ticks = None
            return counters.reject(Reject.RANGE)
        if direction:  # unknown (mostly: standing) keeps the last one
            self._sign = -1.0 if direction == _REVERSE else 1.0
        before, then = self._ticks, self._t_ns
        self._ticks = int(ticks)
        self._t_ns = t_ns
        elapsed = intake.elapsed_ns
        if before is None:
            return ()
        if elapsed is None:
            elapsed = t_ns - then
        if elapsed <= 0:
            return counters.reject(Reject.STALE)
        dt = elapsed * 1e-9
        distance = (int(ticks) - before) % TICK_MODULUS * self._m_per_tick
        if distance > self._max_speed * dt + self._m_per_tick:
            return counters.reject(Reject.RANGE)
        intake.given(t_ns)
        return (OdoSample(t_ns, dt, self._sign * distance, bool(standstill), self._name),)
