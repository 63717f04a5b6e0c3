"""Faults of the simulated bus and of its sensors, each over an interval of scenario time.

A fault is a table in a scenario file, or an object given to `virtual_bus.bus.Bench.inject`. Those of
frames act when a frame is about to be sent; those of sensors when the sensor computes its next second.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]


class BusFrame(NamedTuple):
    """A frame a device sends: scenario time, name of the channel, identifier, payload, CAN FD or not."""

    t_ns: int
    channel: str
    frame_id: int
    data: bytes
    is_fd: bool


class Fault(msgspec.Struct, forbid_unknown_fields=True, tag_field="kind", kw_only=True):
    """What every fault has: when it starts and how long it lasts."""

    start_s: float
    duration_s: float

    def __post_init__(self) -> None:
        """Reject an interval that cannot be."""
        if not (self.start_s >= 0.0 and self.duration_s > 0.0):
            raise ValueError(
                f"fault at start_s = {self.start_s}, duration_s = {self.duration_s}: "
                "expected a start of 0 or later and a positive duration"
            )

    def at(self, t_ns: int) -> bool:
        """Whether the fault is there at ``t_ns``."""
        return self.start_s * 1e9 <= t_ns < (self.start_s + self.duration_s) * 1e9

    def during(self, t_ns: Times) -> NDArray[np.bool_]:
        """`at` for times (n,)."""
        return np.asarray((t_ns >= self.start_s * 1e9) & (t_ns < (self.start_s + self.duration_s) * 1e9))


class FrameFault(Fault, kw_only=True):
    """A fault of the frames of ``device``; ``frame_id`` picks one identifier of it.

    ``probability`` is per frame.
    """

    device: str
    frame_id: int | None = None
    probability: float = 1.0


class Drop(FrameFault, tag="drop", kw_only=True):
    """Frames are lost; with ``burst`` above 1 that many in a row."""

    burst: int = 1


class Duplicate(FrameFault, tag="duplicate", kw_only=True):
    """Frames are sent twice."""


class Corrupt(FrameFault, tag="corrupt", kw_only=True):
    """One byte of a frame is changed after protection."""


class Truncate(FrameFault, tag="truncate", kw_only=True):
    """The last byte of a frame is missing."""


class Delay(FrameFault, tag="delay", kw_only=True):
    """Frames come ``delay_ms`` late, so that later ones may overtake them."""

    delay_ms: float


class FreezeCounter(FrameFault, tag="freeze_counter", kw_only=True):
    """The alive counter stands still while the frames go on."""


class SkipCounter(FrameFault, tag="skip_counter", kw_only=True):
    """The alive counter jumps by ``step`` more than it should."""

    step: int = 1


class Reset(Fault, tag="reset", kw_only=True):
    """The device is silent, then starts again with counters and device time at zero."""

    device: str


class Flood(Fault, tag="flood", kw_only=True):
    """Foreign frames of identifier ``frame_id`` at ``rate_hz``."""

    frame_id: int
    rate_hz: float


class GnssFault(Fault, kw_only=True):
    """A fault of what the receiver says."""

    device: ClassVar = "gnss"


class GnssOutage(GnssFault, tag="gnss_outage", kw_only=True):
    """The receiver says that it has no fix; with ``silent`` it says nothing."""

    silent: bool = False


class GnssOutlier(GnssFault, tag="gnss_outlier", kw_only=True):
    """Fixes are off by ``size_m`` in a random horizontal direction, each with ``probability``."""

    size_m: float
    probability: float = 1.0


class GnssJump(GnssFault, tag="gnss_jump", kw_only=True):
    """All fixes are displaced by the same vector."""

    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0


class WheelSlip(Fault, tag="wheel_slip", kw_only=True):
    """The wheel turns ``factor`` times as far as the vehicle moves (0: it is locked)."""

    device: ClassVar = "odometer"
    factor: float


class MasterFault(Fault, kw_only=True):
    """A fault of what the master says; its frames are whole, and its counters go on."""

    device: ClassVar = "master"


class MasterOutage(MasterFault, tag="master_outage", kw_only=True):
    """The master says that it is not valid; with ``silent`` it says nothing."""

    silent: bool = False


class MasterFrozen(MasterFault, tag="master_frozen", kw_only=True):
    """It says the same again and again, with new times."""


class MasterTimeJump(MasterFault, tag="master_time_jump", kw_only=True):
    """Its clock is ``ahead_ms`` ahead of what it was, negative: behind."""

    ahead_ms: float


class MasterLatency(MasterFault, tag="master_latency", kw_only=True):
    """What it says is ``late_ms`` older than it tells."""

    late_ms: Annotated[float, Meta(ge=0.0)]


class SensorFault(Fault, kw_only=True):
    """A fault of one gyro or accelerometer; ``number`` is 1 to 3 for right, forward, up, or more."""

    sensor: Literal["gyro", "accel"]
    number: Annotated[int, Meta(ge=1, le=6)]

    def column(self, sensors: int) -> int:
        """Its place among all counts of a unit with so many ``sensors`` of each kind."""
        return self.number - 1 + (sensors if self.sensor == "accel" else 0)


class SensorBias(SensorFault, tag="sensor_bias", kw_only=True):
    """Its bias is another one: at once, or after ``ramp_s`` and on at that pace."""

    bias_deg_per_h: float | None = None
    bias_ug: float | None = None
    ramp_s: Annotated[float, Meta(ge=0.0)] = 0.0

    def __post_init__(self) -> None:
        """Reject an interval that cannot be, and a bias in the unit of the other kind."""
        super().__post_init__()
        given = {"bias_deg_per_h": self.bias_deg_per_h, "bias_ug": self.bias_ug}
        wanted = "bias_deg_per_h" if self.sensor == "gyro" else "bias_ug"
        if [name for name, value in given.items() if value is not None] != [wanted]:
            raise ValueError(f"fault of a {self.sensor}: expected {wanted} and no other bias")

    def share(self, t_ns: Times) -> Array:
        """How much of it there is at ``t_ns`` (n,)."""
        share = np.ones(len(t_ns)) if not self.ramp_s else (t_ns * 1e-9 - self.start_s) / self.ramp_s
        return np.where(self.during(t_ns), share, 0.0)


class SensorStuck(SensorFault, tag="sensor_stuck", kw_only=True):
    """It repeats its last count."""


class SensorDead(SensorFault, tag="sensor_dead", kw_only=True):
    """It counts no pulse any more; with ``told`` the unit (a redundant one) notices and says so."""

    told: bool = False


AnyFault = (
    Drop
    | Duplicate
    | Corrupt
    | Truncate
    | Delay
    | FreezeCounter
    | SkipCounter
    | Reset
    | Flood
    | GnssOutage
    | GnssOutlier
    | GnssJump
    | WheelSlip
    | MasterOutage
    | MasterFrozen
    | MasterTimeJump
    | MasterLatency
    | SensorBias
    | SensorStuck
    | SensorDead
)

F = TypeVar("F", bound=Fault)


class Faults:
    """The faults of a bench; more may be added while it runs."""

    def __init__(self, faults: list[AnyFault]) -> None:
        self.all = list(faults)

    def of(self, kind: type[F], device: str | None = None) -> list[F]:
        """Those of one kind, in the order given; of ``device`` alone where it is named."""
        return [f for f in self.all if isinstance(f, kind) and device in (None, getattr(f, "device", None))]


class AliveCounter:
    """The alive counter of one device's epochs, as faults let it count."""

    def __init__(self, faults: Faults, device: str, modulus: int, rng: np.random.Generator) -> None:
        self._faults = faults
        self._device = device
        self._modulus = modulus
        self._rng = rng
        self._value = modulus - 1

    def restart(self) -> None:
        """Begin at zero again."""
        self._value = self._modulus - 1

    def next(self, t_ns: int) -> int:
        """Counter of the next epoch, at ``t_ns``."""
        step = 1
        if self._faults.all:
            for freeze in self._faults.of(FreezeCounter, self._device):
                if freeze.at(t_ns) and _strikes(freeze.probability, self._rng):
                    step = 0
            for skip in self._faults.of(SkipCounter, self._device):
                if skip.at(t_ns) and _strikes(skip.probability, self._rng):
                    step += skip.step
        self._value = (self._value + step) % self._modulus
        return self._value


def _strikes(probability: float, rng: np.random.Generator) -> bool:
    return probability >= 1.0 or rng.random() < probability


def disturb(
    frames: Iterator[BusFrame], faults: Faults, device: str, rng: np.random.Generator
) -> Iterator[BusFrame]:
    """The frames of ``device`` as the bus carries them, still in time order."""
    late: list[tuple[int, int, BusFrame]] = []
    burst = number = 0
    for frame in frames:
        while late and late[0][0] <= frame.t_ns:
            yield heapq.heappop(late)[2]
        if not faults.all:
            yield frame
            continue
        copies, data, delay_ns = 1, frame.data, 0
        if burst:
            burst -= 1
            continue
        for fault in faults.of(FrameFault, device):
            if not fault.at(frame.t_ns) or fault.frame_id not in (None, frame.frame_id):
                continue
            if isinstance(fault, FreezeCounter | SkipCounter) or not _strikes(fault.probability, rng):
                continue
            if isinstance(fault, Drop):
                copies, burst = 0, fault.burst - 1
            elif isinstance(fault, Duplicate):
                copies *= 2
            elif isinstance(fault, Corrupt):
                place = int(rng.integers(len(data)))
                data = data[:place] + bytes([data[place] ^ int(rng.integers(1, 256))]) + data[place + 1 :]
            elif isinstance(fault, Truncate):
                data = data[:-1]
            elif isinstance(fault, Delay):
                delay_ns += round(fault.delay_ms * 1e6)
        frame = frame._replace(data=data, t_ns=frame.t_ns + delay_ns)
        for _ in range(copies):
            if delay_ns:
                number += 1
                heapq.heappush(late, (frame.t_ns, number, frame))
            else:
                yield frame
    while late:
        yield heapq.heappop(late)[2]
