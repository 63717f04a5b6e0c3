"""Sensors that speak MAVLink: inertial, GNSS, wheel and pressure messages of one component."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, field
from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.baro_can import HIGHEST_PA, LOWEST_PA, pressure_altitude
from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.device_clock import ClockPort, DeviceClock
from bridge.drivers.mavlink_axes import Inertial, inertial, position
from bridge.drivers.mavlink_packets import Packets
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive, Sigmas
from bridge.outputs import Reject
from bridge.strict import one_of
from nav.types import BaroSample, FixType, GnssFix, ImuFlag, ImuSample, OdoSample, Sample, Vector

_IMU: Final = ("HIGHRES_IMU", "HIL_SENSOR", "SCALED_IMU", "RAW_IMU")
_GNSS: Final = ("GPS_INPUT", "GPS_RAW_INT", "HIL_GPS")
MESSAGES: Final = (*_IMU, *_GNSS, "WHEEL_DISTANCE", "SCALED_PRESSURE")
_BOOT_MS: Final = ("SCALED_IMU", "SCALED_PRESSURE")  # stamped in a wrapping count of milliseconds
_PRESSURE_INTERVAL_NS: Final = 100_000_000


class SensorsMavlinkOptions(DeviceOptions, kw_only=True):
    """``[device.NAME]`` with ``driver = "sensors_mavlink"``.

    ``messages`` are those to listen to, at most one of a kind; ``system_id`` and ``component_id`` restrict
    the sender (0: any), ``sensor_id`` the instance. Every message has its own clock unless ``clock`` names
    one. ``rate_hz`` is that of the inertial message; ``pressure`` takes the pressure in it too, ten times a
    second. The ``sigma_`` values stand where a message does not state its accuracy.
    """

    messages: Annotated[list[str], Meta(min_length=1)]
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    component_id: Annotated[int, Meta(ge=0, le=255)] = 0
    sensor_id: Annotated[int, Meta(ge=0, le=255)] = 0
    rate_hz: Positive | None = None
    bridge_samples: Annotated[int, Meta(ge=0, le=100)] = 5
    raw_accel_mg_per_count: Positive = 1.0
    raw_gyro_mrad_s_per_count: Positive = 1.0
    pressure: bool = False
    wheels: Annotated[list[Annotated[int, Meta(ge=0, le=15)]], Meta(min_length=1)] = field(
        default_factory=lambda: [0]
    )
    max_speed_m_s: Positive = 100.0
    sigma_position_m: Sigmas = (2.0, 2.0, 4.0)
    sigma_velocity_m_s: Sigmas = (0.3, 0.3, 0.6)
    sigma_pressure_m: Positive = 1.0

    def __post_init__(self) -> None:
        for name in self.messages:
            if name not in MESSAGES:
                raise ValueError(f'messages: found "{name}", expected {one_of(name, MESSAGES)}')
        for kind in (_IMU, _GNSS):
            if len(found := [name for name in self.messages if name in kind]) > 1:
                raise ValueError(f"messages: found {' and '.join(found)}, expected one of a kind")
        if self.rate_hz is None and any(name in _IMU for name in self.messages):
            raise ValueError("rate_hz: found nothing, expected the rate of the inertial message")

    def provides(self) -> frozenset[str]:
        """Kinds of samples in the messages listened to."""
        kinds = {
            **dict.fromkeys(_IMU, "imu"),
            **dict.fromkeys(_GNSS, "gnss"),
            "WHEEL_DISTANCE": "odometer",
            "SCALED_PRESSURE": "baro",
        }
        found = {kinds[name] for name in self.messages}
        return frozenset(found | {"baro"} if self.pressure else found)


class SensorsMavlink:
    """Decodes whole packets; each kind of message has its own port on the clock."""

    def __init__(self, options: SensorsMavlinkOptions, context: Context) -> None:
        self.counters = Counters()
        self._name = context.name
        self._options = options
        self._packets = Packets(options.system_id, options.component_id, self.counters)
        handlers: dict[str, Callable[[Any, int], Sequence[Sample]]] = {
            **dict.fromkeys(_IMU, self._inertial),
            **dict.fromkeys(_GNSS, self._gnss),
            "WHEEL_DISTANCE": self._wheel,
            "SCALED_PRESSURE": self._scaled_pressure,
        }
        self._handlers: dict[int, Callable[[Any, int], Sequence[Sample]]] = {}
        self._ports: dict[int, ClockPort] = {}
        latency_ns = round(options.latency_ms * 1e6)
        for name in options.messages:
            message_id = int(getattr(dialect, f"MAVLINK_MSG_ID_{name}"))
            clock = context.clock if options.clock is not None else DeviceClock()
            self._handlers[message_id] = handlers[name]
            self._ports[message_id] = clock.port(2**32 * 10**6 if name in _BOOT_MS else None, latency_ns)
        self.keys = [(context.source, message_id) for message_id in self._handlers]
        self._period_ns = 1e9 / options.rate_hz if options.rate_hz else 0.0
        self._last: tuple[int, Inertial] | None = None
        self._distance: tuple[int, float] | None = None
        self._pressure_due_ns = 0

    def feed(self, frame: RawFrame) -> Sequence[Sample]:
        """The samples in a packet."""
        counters = self.counters
        message = self._packets.message(frame)
        if message is None:
            return ()
        handler = self._handlers.get(message.get_msgId())
        if handler is None or ("id" in message.fieldnames and message.id != self._options.sensor_id):
            return counters.reject(Reject.UNKNOWN)
        try:
            samples = handler(message, frame.rx_ns)
        except ValueError:
            return counters.reject(Reject.RANGE)
        if samples:
            counters.samples += 1
            counters.last_ns = samples[-1].t_ns
        return samples

    def _stamp(self, message: Any, rx_ns: int) -> tuple[int, int | None]:
        """Engine time of a message, and the device time since the one before."""
        port = self._ports[message.get_msgId()]
        if hasattr(message, "time_boot_ms"):
            counter = message.time_boot_ms * 10**6
        elif message.time_usec:
            counter = message.time_usec * 1000
        else:
            counter = rx_ns  # a sender without a clock leaves it at zero: arrival is all there is
        return port.stamp(counter, rx_ns), port.elapsed_ns

    def _inertial(self, message: Any, rx_ns: int) -> Sequence[Sample]:
        counters, options = self.counters, self._options
        found = inertial(
            message, options.raw_accel_mg_per_count * 9.80665e-3, options.raw_gyro_mrad_s_per_count * 1e-3
        )
        if found is None:
            return counters.reject(Reject.INVALID)
        t_ns, elapsed = self._stamp(message, rx_ns)
        samples: list[Sample] = []
        last = self._last
        if last is not None and elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        self._last = (t_ns, found)
        if last is None or elapsed is None:
            dt = self._period_ns * 1e-9
            flags = ImuFlag.OK if last is None else ImuFlag.GAP
            samples.append(self._increments(t_ns, dt, found.rate, found.force, flags))
        else:
            steps = max(1, round(elapsed / self._period_ns))
            counters.missing += steps - 1
            if steps - 1 > options.bridge_samples:
                dt = self._period_ns * 1e-9
                samples.append(self._increments(t_ns, dt, found.rate, found.force, ImuFlag.GAP))
            else:
                samples += self._trapezia(last, t_ns, elapsed * 1e-9, found, steps)
        if options.pressure and found.pressure_pa is not None and t_ns >= self._pressure_due_ns:
            self._pressure_due_ns = t_ns + _PRESSURE_INTERVAL_NS
            # before the inertial sample: both are of one instant
            samples = [*self._baro(t_ns, found.pressure_pa), *samples]
        return samples

    def _trapezia(
        self, last: tuple[int, Inertial], t_ns: int, elapsed: float, new: Inertial, steps: int
    ) -> list[ImuSample]:
        """Integrals of rates and forces on the straight line between two messages, in equal steps."""
        then_ns, old = last
        self.counters.bridged += steps - 1
        dt = elapsed / steps
        made = []
        for i in range(1, steps + 1):
            weight = (i - 0.5) / steps
            made.append(
                self._increments(
                    then_ns + (t_ns - then_ns) * i // steps,
                    dt,
                    old.rate + (new.rate - old.rate) * weight,
                    old.force + (new.force - old.force) * weight,
                    ImuFlag.BRIDGED if i < steps else ImuFlag.OK,
                )
            )
        return made

    def _increments(self, t_ns: int, dt: float, rate: Vector, force: Vector, flags: ImuFlag) -> ImuSample:
        return ImuSample(t_ns, dt, rate * dt, force * dt, self._name, int(flags))

    def _gnss(self, message: Any, rx_ns: int) -> Sequence[Sample]:
        found = position(message)
        if found is None:
            return self.counters.reject(Reject.INVALID)
        t_ns, elapsed = self._stamp(message, rx_ns)
        if elapsed is not None and elapsed <= 0:
            return self.counters.reject(Reject.STALE)
        options = self._options
        horizontal, up = found.sigma_h, found.sigma_up
        sigma_p = np.array(options.sigma_position_m, dtype=np.float64)
        if horizontal is not None:
            sigma_p[:2] = horizontal / math.sqrt(
                2.0
            )  # an accuracy of the position in the plane, not per axis
        if up is not None:
            sigma_p[2] = up
        sigma_v = None
        if found.velocity is not None:
            sigma_v = np.array(options.sigma_velocity_m_s, dtype=np.float64)
            if found.sigma_v is not None:
                sigma_v[:2] = found.sigma_v
            if found.sigma_v_up is not None:
                sigma_v[2] = found.sigma_v_up
        return (
            GnssFix(
                t_ns,
                found.lat,
                found.lon,
                found.height,
                sigma_p,
                found.velocity,
                sigma_v,
                FixType(min(found.fix_type, FixType.RTK_FIXED)),
                self._name,
                found.gps_ns,
                found.satellites,
            ),
        )

    def _wheel(self, message: Any, rx_ns: int) -> Sequence[Sample]:
        counters, options = self.counters, self._options
        if max(options.wheels) >= message.count:
            return counters.reject(Reject.INVALID)
        distance = sum(message.distance[wheel] for wheel in options.wheels) / len(options.wheels)
        if not math.isfinite(distance):
            return counters.reject(Reject.RANGE)
        t_ns, elapsed = self._stamp(message, rx_ns)
        last, self._distance = self._distance, (t_ns, distance)
        if last is None:
            return ()
        if elapsed is None:
            elapsed = t_ns - last[0]
        if elapsed <= 0:
            return counters.reject(Reject.STALE)
        dt = elapsed * 1e-9
        rolled = distance - last[1]
        if abs(rolled) > options.max_speed_m_s * dt:
            return counters.reject(Reject.RANGE)
        return (OdoSample(t_ns, dt, rolled, False, self._name),)

    def _scaled_pressure(self, message: Any, rx_ns: int) -> Sequence[Sample]:
        t_ns, elapsed = self._stamp(message, rx_ns)
        if elapsed is not None and elapsed <= 0:
            return self.counters.reject(Reject.STALE)
        return self._baro(t_ns, message.press_abs * 100.0)

    def _baro(self, t_ns: int, pressure_pa: float) -> Sequence[Sample]:
        if not LOWEST_PA <= pressure_pa <= HIGHEST_PA:
            return self.counters.reject(Reject.RANGE)
        height = pressure_altitude(pressure_pa)
        return (BaroSample(t_ns, height, self._options.sigma_pressure_m, self._name),)
