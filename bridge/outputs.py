"""What the engine hands to its sinks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from nav.types import GnssFix, ImuChange, Mode, Solution


class Reject(IntEnum):
    """Why a frame or a sample was not used; counted per device."""

    LENGTH = 0  # payload too short or too long
    CRC = 1
    COUNTER = 2  # alive counter stuck or repeated
    RANGE = 3  # a value outside its declared range, or not a number
    STALE = 4  # older than the navigator can rewind to, or time ran backwards
    INCOMPLETE = 5  # an epoch of several frames that never came together
    UNKNOWN = 6  # an identifier nobody subscribed to
    GATE = 7  # the innovation failed its chi-square test
    INVALID = 8  # the device itself marks the value as not valid
    SATURATED = 9
    FOREIGN = 10  # from another unit than the calibration is for


class Severity(IntEnum):
    """MAVLink's MAV_SEVERITY."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class SolutionOut(NamedTuple):
    """A navigator's new solution; ``latest_rx_ns`` is the frame that completed it."""

    navigator: str
    solution: Solution
    latest_rx_ns: int


@dataclass(frozen=True, slots=True)
class ModeChange:
    """A navigator changed its mode, and why."""

    t_ns: int
    navigator: str
    old: Mode
    new: Mode
    reason: str


@dataclass(frozen=True, slots=True)
class Progress:
    """How far an alignment has come: ``fraction`` 0 to 1, and what it is doing.

    ``sigma`` and ``limit`` (3,) rad about east, north, up: what its attitude is good for and could be at
    best. ``method`` is the alignment's name, ``restarts`` how often it refused and started again; ``behind``:
    it is going through stored samples.
    """

    t_ns: int
    navigator: str
    stage: str
    fraction: float
    sigma: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    method: str = ""
    limit: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    behind: bool = False
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class Transfer:
    """What a navigator that is aligned from a master knows relative to it; rad.

    ``sigma`` (3,) of phi about east, north, up; ``mounting`` (3,) about right, forward, up, what the slave is
    turned beyond what is configured, to ``sigma_mounting`` (3,). ``observability``: by name of a state, what
    is left of its first sigma. ``hint``: a manoeuvre that would help, or nothing. ``quality`` 0 to 1: share
    of the late messages that agreed.
    """

    t_ns: int
    navigator: str
    matching: str
    sigma: tuple[float, float, float]
    mounting: tuple[float, float, float]
    sigma_mounting: tuple[float, float, float]
    observability: tuple[tuple[str, float], ...]
    hint: str
    quality: float


class FixOut(NamedTuple):
    """A GNSS fix as its driver assembled it, before any gate; for those who show or log it."""

    t_ns: int
    device: str
    fix: GnssFix


class Innovation(NamedTuple):
    """One measurement against its prediction: residuals and their predicted sigmas, SI units."""

    t_ns: int
    navigator: str
    kind: str
    residual: tuple[float, ...]
    sigma: tuple[float, ...]
    nis: float
    accepted: bool


class UnitHealth(NamedTuple):
    """Which sensors of a redundant inertial unit are not trusted, since ``t_ns``.

    Bits are sensors, the first the lowest: those not used (``out``), and those one of which has failed, as
    far as is known (``suspect``).
    """

    t_ns: int
    gyros_out: int
    gyros_suspect: int
    accels_out: int
    accels_suspect: int

    @property
    def masks(self) -> tuple[int, int, int, int]:
        """The four of them."""
        return self[1:]

    def words(self) -> list[str]:
        """What there is to say: "gyro 4 out", "accelerometers 2 or 3 suspect"."""
        said = []
        for name, out, suspect in (("gyro", *self[1:3]), ("accelerometer", *self[3:5])):
            if out:
                said.append(f"{_listed(name, out, 'and')} out")
            if suspect:
                said.append(f"{_listed(name, suspect, 'or')} suspect")
        return said


def _listed(name: str, mask: int, word: str) -> str:
    numbers = [str(k + 1) for k in range(mask.bit_length()) if mask >> k & 1]
    if len(numbers) == 1:
        return f"{name} {numbers[0]}"
    return f"{name}s {', '.join(numbers[:-1])} {word} {numbers[-1]}"


@dataclass(frozen=True, slots=True)
class SensorsOut:
    """A redundant unit is made of other sensors from now on, or others are suspected."""

    t_ns: int
    device: str
    health: UnitHealth


@dataclass(frozen=True, slots=True)
class DeviceHealth:
    """Counters of one device since the start, and ``sensors`` of a redundant unit."""

    frames: int = 0
    samples: int = 0
    missing: int = 0
    bridged: int = 0
    duplicates: int = 0
    rejects: dict[Reject, int] = field(default_factory=dict)
    rate_hz: float = 0.0
    age_ms: float = 0.0
    sensors: UnitHealth | None = None


@dataclass(frozen=True, slots=True)
class Health:
    """Once a second: every device, the bus and the recorder.

    ``refused`` counts by reason the packets that the border turned away; what was no packet, in bytes.
    """

    t_ns: int
    devices: dict[str, DeviceHealth]
    unknown_frames: int
    dropped_frames: int
    unrecorded_frames: int
    refused: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Text:
    """A line for the operator."""

    t_ns: int
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Link ``index`` of a navigator's digest chain: one per second of engine time."""

    t_ns: int
    navigator: str
    index: int
    sha256: str


def sensors_changed(now_ns: int, change: ImuChange) -> tuple[SensorsOut, Text]:
    """What is put out when a redundant unit goes on with other sensors, for programs and for an operator."""
    health = UnitHealth(change.t_ns, *change[2:6])
    words = ", ".join(health.words())
    severity = Severity.WARNING if words else Severity.NOTICE
    text = Text(now_ns, severity, f"{change.device}: {words or 'all sensors in use'}")
    return SensorsOut(now_ns, change.device, health), text


class Transmit(NamedTuple):
    """A frame to send: CAN payload with its identifier, or a whole MAVLink packet."""

    source: int
    key: int
    data: bytes


Output = (
    SolutionOut
    | ModeChange
    | Progress
    | Transfer
    | FixOut
    | Innovation
    | SensorsOut
    | Health
    | Text
    | Checkpoint
    | Transmit
)
