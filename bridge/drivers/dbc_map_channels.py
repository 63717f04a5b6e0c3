"""Inertial units, speeds and odometers in somebody else's DBC file: epochs of signals in, samples out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.dbc_map_epochs import Epoch, Epochs, Needs, Stamps
from bridge.drivers.dbc_map_options import (
    Axes,
    Channel,
    DbcMapOptions,
    ImuMap,
    OdometerMap,
    SpeedMap,
)
from bridge.drivers.dbc_map_signals import Book, Reading
from bridge.outputs import Reject
from nav.types import ImuFlag, ImuSample, OdoSample, Sample, SpeedSample, Vector

MOST_SPEED: Final = 1e4  # m/s, as for the rates below
_PLAUSIBLE: Final = 5.0  # an interval beyond this many times the nominal one, either way, is not one
_MOST_RATE: Final = 1e3  # rad/s, and
_MOST_FORCE: Final = 1e5  # m/s^2: no vehicle does that, an undeclared range or a wrong unit does
_END: Final = 1e-6  # of a raw step: as near is at the end of the range


class BaseChannel:
    """What the channels share: epochs, stamps, validity."""

    def __init__(
        self, needs: Needs, channel: Channel, options: DbcMapOptions, context: Context, counters: Counters
    ):
        self._name = context.name
        self._counters = counters
        self._valid = needs.condition("valid", channel.valid)
        self._stamps = Stamps(needs, channel, context, options.latency_ms)
        self._epochs = Epochs(needs, channel, counters)  # last: by now all needs are known

    @property
    def keys(self) -> tuple[int, ...]:
        """Keys of the frames it takes."""
        return self._epochs.keys

    def take(self, key: int, rx_ns: int, decoded: Mapping[str, float]) -> Sequence[Sample]:
        """Samples that a frame completes."""
        epoch = self._epochs.take(key, rx_ns, decoded)
        return () if epoch is None else self._make(epoch)

    def _make(self, epoch: Epoch) -> Sequence[Sample]:
        raise NotImplementedError

    def _give(self, t_ns: int, *samples: Sample) -> Sequence[Sample]:
        self._counters.samples += 1
        self._counters.last_ns = t_ns
        return samples


class ImuChannel(BaseChannel):
    """Rates and specific forces, held over the interval that ends at their time, as increments."""

    def __init__(
        self, book: Book, options: DbcMapOptions, channel: ImuMap, context: Context, counters: Counters
    ):
        needs = Needs(book, "imu")
        rates = channel.signals == "rates"
        self._rates = rates
        self._gyro = self._axes(needs, "gyro", channel.gyro, "angular rate" if rates else "angle")
        self._accel = self._axes(needs, "accel", channel.accel, "acceleration" if rates else "speed")
        self._period_ns = 1e9 / channel.rate_hz
        self._bridge = channel.bridge_samples
        self._ends = [
            (s.name, s.ends[0] + _END * s.resolution, s.ends[1] - _END * s.resolution)
            for reading in (*self._gyro, *self._accel)
            if (s := reading.source) is not None and s.ends is not None
        ]
        self._last: ImuSample | None = None
        self._elapsed_ns: int | None = None  # since the last sample given out, over those turned away
        self._steps: int | None = None  # of the counter since then
        super().__init__(needs, channel, options, context, counters)

    @staticmethod
    def _axes(needs: Needs, key: str, axes: Axes, kind: str) -> tuple[Reading, Reading, Reading]:
        x, y, z = (
            needs.reading(f"{key}.{axis}", quantity, kind, axes.unit)
            for axis, quantity in (("x", axes.x), ("y", axes.y), ("z", axes.z))
        )
        return x, y, z

    def _make(self, epoch: Epoch) -> Sequence[Sample]:
        counters, values = self._counters, epoch.values
        t_ns, elapsed = self._stamps.stamp(epoch, self._period_ns)
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        last = self._last
        if last is not None:
            restart = elapsed is None or self._elapsed_ns is None
            self._elapsed_ns = None if restart else (self._elapsed_ns or 0) + (elapsed or 0)
            self._steps = None if epoch.step is None or self._steps is None else self._steps + epoch.step
        if not self._valid.holds(values):
            return counters.reject(Reject.INVALID)

        flags, steps, interval = ImuFlag.OK, 1, self._period_ns
        if last is not None:
            if self._elapsed_ns is None:
                flags |= ImuFlag.GAP
            else:
                steps = max(1, round(self._elapsed_ns / self._period_ns))
                if self._steps and self._elapsed_ns < self._steps * _PLAUSIBLE * self._period_ns:
                    steps = self._steps
                interval = self._elapsed_ns / steps
                if interval * _PLAUSIBLE < self._period_ns:
                    return counters.reject(Reject.COUNTER)
        if any(not low < values[name] < high for name, low, high in self._ends):
            flags |= ImuFlag.SATURATED
            counters.reject(Reject.SATURATED)
        if steps > 1:
            counters.missing += steps - 1
            if steps - 1 > self._bridge:
                flags |= ImuFlag.GAP

        dt = interval * 1e-9
        over = dt if self._rates else 1.0
        dtheta = np.array([r.of(values) * over for r in self._gyro])
        dv = np.array([r.of(values) * over for r in self._accel])
        if np.abs(dtheta).max() > _MOST_RATE * dt or np.abs(dv).max() > _MOST_FORCE * dt:
            return counters.reject(Reject.RANGE)
        samples: list[Sample] = []
        if steps > 1 and last is not None and not flags & ImuFlag.GAP:
            samples += self._between(last, t_ns, dt, dtheta, dv, steps)
        new = ImuSample(t_ns, dt, dtheta, dv, self._name, int(flags))
        self._last, self._elapsed_ns, self._steps = new, 0, 0
        return self._give(t_ns, *samples, new)

    def _between(
        self, last: ImuSample, t_ns: int, dt: float, dtheta: Vector, dv: Vector, steps: int
    ) -> list[ImuSample]:
        """Samples on the straight line between the rates before and after a gap."""
        self._counters.bridged += steps - 1
        scale = dt / last.dt if self._rates else 1.0
        theta_0, v_0 = last.dtheta * scale, last.dv * scale
        return [
            ImuSample(
                last.t_ns + (t_ns - last.t_ns) * i // steps,
                dt,
                theta_0 + (dtheta - theta_0) * (i / steps),
                v_0 + (dv - v_0) * (i / steps),
                self._name,
                int(ImuFlag.BRIDGED),
            )
            for i in range(1, steps)
        ]


class SpeedChannel(BaseChannel):
    """Forward speed."""

    def __init__(
        self, book: Book, options: DbcMapOptions, channel: SpeedMap, context: Context, counters: Counters
    ):
        needs = Needs(book, "speed")
        self._speed = needs.reading("speed", channel.speed, "speed")
        self._sigma = needs.reading("sigma", channel.sigma, "speed")
        self._reverse = needs.condition("reverse", channel.reverse)
        self._min_v = options.min_sigma_velocity_m_s
        super().__init__(needs, channel, options, context, counters)

    def _make(self, epoch: Epoch) -> Sequence[Sample]:
        counters, values = self._counters, epoch.values
        t_ns, elapsed = self._stamps.stamp(epoch)
        if epoch.step is not None:
            counters.missing += epoch.step - 1
        if not self._valid.holds(values):
            return counters.reject(Reject.INVALID)
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        speed = self._speed.of(values)
        if abs(speed) > MOST_SPEED:
            return counters.reject(Reject.RANGE)
        if self._reverse and self._reverse.holds(values):
            speed = -speed
        sigma = max(self._sigma.sigma(values), self._min_v)
        return self._give(t_ns, SpeedSample(t_ns, speed, sigma, self._name))


class OdometerChannel(BaseChannel):
    """Distance from a count that wraps at the end of its signal."""

    def __init__(
        self, book: Book, options: DbcMapOptions, channel: OdometerMap, context: Context, counters: Counters
    ):
        needs = Needs(book, "odometer")
        if channel.distance is not None and channel.ticks is None and channel.m_per_tick is None:
            reading = needs.reading("distance", channel.distance, "length")
        elif channel.distance is None and channel.ticks is not None and channel.m_per_tick is not None:
            source = needs.source("ticks", channel.ticks)
            reading = Reading(source, channel.m_per_tick / source.resolution, 0.0)
        else:
            raise book.wrong("odometer", "no such set", "either distance, or ticks and m_per_tick")
        if reading.source is None or reading.source.signal.is_float:
            raise book.wrong(
                "odometer.distance", channel.distance, "an integer signal, which counts and wraps"
            )
        self._source = reading.source
        self._m_per_step = reading.factor * reading.source.resolution
        self._reverse = needs.condition("reverse", channel.reverse)
        self._standstill = needs.condition("standstill", channel.standstill)
        self._max_speed = channel.max_speed_m_s
        self._count: int | None = None
        self._t_ns = 0
        super().__init__(needs, channel, options, context, counters)

    def _make(self, epoch: Epoch) -> Sequence[Sample]:
        counters, values = self._counters, epoch.values
        t_ns, elapsed = self._stamps.stamp(epoch)
        if epoch.step is not None:
            counters.missing += epoch.step - 1
        if not self._valid.holds(values):
            self._count = None
            return counters.reject(Reject.INVALID)
        before, then = self._count, self._t_ns
        conversion = self._source.signal.conversion
        self._count = round((values[self._source.name] - conversion.offset) / conversion.scale)
        self._t_ns = t_ns
        if before is None:
            return ()
        if elapsed is None:
            elapsed = t_ns - then
        if elapsed <= 0:
            return counters.reject(Reject.STALE)
        modulus = self._source.raw_steps
        steps = (self._count - before) % modulus
        if steps > modulus // 2:  # counted down
            steps -= modulus
        distance, dt = steps * self._m_per_step, elapsed * 1e-9
        if self._reverse and self._reverse.holds(values):
            distance = -distance
        if abs(distance) > self._max_speed * dt + abs(self._m_per_step):
            return counters.reject(Reject.RANGE)
        standstill = bool(self._standstill) and self._standstill.holds(values)
        return self._give(t_ns, OdoSample(t_ns, dt, distance, standstill, self._name))
