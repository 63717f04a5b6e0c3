"""Scenarios: what is driven, with which instruments, and what goes wrong; read strictly from TOML.

Packaged scenarios (virtual_bus/scenarios/) are found by name, others by path. A scenario lasts for its
``duration_s`` or as long as its manoeuvres; a shorter time cuts it, a longer one repeats the manoeuvres
from ``repeat_from`` on.
"""

from __future__ import annotations

import math
import re
import tomllib
import typing
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from virtual_bus.faults import AnyFault
from virtual_bus.grades import GRADES
from virtual_bus.manoeuvres import Blend, Manoeuvre, Profile, Static
from virtual_bus.sway import FASTEST_HZ, Sway
from virtual_bus.truth import Crab, Trajectory, Vehicle, mounting_matrix, roll_per_accel

PACKAGED: Final = Path(__file__).parent / "scenarios"

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Rate = Annotated[float, Meta(ge=0.1, le=2000.0)]
DitherHz = Annotated[float, Meta(ge=160.0, le=1000.0)]
Three = tuple[float, float, float]
Two = tuple[NotNegative, NotNegative]


class ScenarioError(ValueError):
    """A scenario that is not there or is wrong: file, key, what was found, what was expected."""


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Base of the tables of a scenario: no unknown key."""


class Start(Table):
    """``[start]``: where and when; GPS time of the first instant.

    ``heading_deg`` is true heading there (at a pole, along the meridian ``lon_deg``).
    """

    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    height_m: Annotated[float, Meta(ge=-1000.0, le=10_000.0)] = 0.0
    heading_deg: float = 0.0
    gps_week: Annotated[int, Meta(ge=0, le=4095)] = 2300
    gps_tow_s: Annotated[int, Meta(ge=0, lt=604_800)] = 216_000
    leap_seconds: Annotated[int, Meta(ge=0, le=255)] = 18


class VehicleOptions(Table):
    """``[vehicle]``: places in vehicle axes (right, forward, up) from the middle of the rear axle.

    Its heading wanders ``crab_deg`` about its path (camber, side wind, steering).

    ``mounting_deg`` is pitch, roll, heading of the IMU in the vehicle as its maker wrote down; pitch and
    heading really differ from it by ``mounting_sigma_deg``. ``output_m`` is the point that the solution is
    for and truth is told at; by default the IMU.
    """

    imu_m: Three = (0.3, 1.2, 0.5)
    antenna_m: Three = (-0.2, 0.7, 1.6)
    output_m: Three | None = None
    mounting_deg: Three = (0.0, 0.0, 0.0)
    mounting_sigma_deg: NotNegative = 0.0
    roll_deg_per_g: float = 3.0
    pitch_deg_per_g: float = 0.0
    crab_deg: NotNegative = 0.0


class DeviceTable(Table):
    """What the table of every device holds: its bus and how late its frames come.

    ``latency_ms`` is the shortest time from the instant measured to the first frame, ``jitter_ms`` what
    may be added (the mean of an exponential law for GNSS, the end of a uniform one for the others).
    ``clock_ppm`` by default is drawn; ``clock_offset_s`` is the device's clock at the start.
    """

    channel: str = "can0"
    latency_ms: NotNegative = 0.4
    jitter_ms: NotNegative = 0.1
    clock_ppm: Annotated[float, Meta(ge=-1000.0, le=1000.0)] | None = None
    clock_offset_s: NotNegative = 0.0


class ImuTable(DeviceTable):
    """``[imu]``. Its clock starts 100 s before its 32-bit microseconds wrap.

    ``dither_hz`` of laser gyros: each is latched at whole cycles of its own. ``inner_arms_mm`` is where
    each accelerometer sits, right, forward and up of the unit's origin.
    """

    rate_hz: Rate = 200.0
    fd: bool = False
    dither_hz: tuple[DitherHz, DitherHz, DitherHz] | None = None
    inner_arms_mm: tuple[Three, Three, Three] | None = None
    clock_offset_s: NotNegative = 4194.967296


class OdometerTable(DeviceTable):
    """``[odometer]``. Tyre and road make the distance walk off by ``walk_m_per_sqrt_m``.

    ``ticks`` is what its counter shows at the start: shortly before it wraps.
    """

    rate_hz: Rate = 50.0
    m_per_tick: Positive = 0.02
    scale_error_ppm: NotNegative = 2000.0
    walk_m_per_sqrt_m: NotNegative = 0.0035
    ticks: Annotated[int, Meta(ge=0, lt=1 << 32)] = (1 << 32) - 20_000


class SpeedTable(DeviceTable):
    """``[speed]``: a Doppler log."""

    rate_hz: Rate = 10.0
    sigma_m_s: Positive = 0.05
    scale_error_ppm: NotNegative = 1000.0


class BaroTable(DeviceTable):
    """``[baro]``: sigmas of the datum, its drift, and the noise, in metres of height."""

    rate_hz: Rate = 25.0
    offset_m: NotNegative = 5.0
    drift_m: NotNegative = 0.5
    correlation_s: Positive = 1000.0
    noise_m: NotNegative = 0.3


class GnssTable(DeviceTable):
    """``[gnss]``: sigmas are [horizontal per axis, vertical]."""

    rate_hz: Rate = 5.0
    latency_ms: NotNegative = 60.0
    jitter_ms: NotNegative = 4.0
    white_m: Two = (0.5, 0.8)
    correlated_m: Two = (0.0, 0.0)
    correlation_s: Positive = 120.0
    velocity_m_s: Two = (0.03, 0.05)
    fix_type: Annotated[int, Meta(ge=2, le=6)] = 3
    satellites: Annotated[int, Meta(ge=4, le=60)] = 14


class SwayTable(Table):
    """``[sway]``: it sways about the place of its rear axle, rms angles, between two frequencies.

    From the first instant on, or from rest: then it begins after ``begins_s``.
    """

    heading_deg: NotNegative = 0.0
    pitch_deg: NotNegative = 0.0
    roll_deg: NotNegative = 0.0
    slowest_hz: Positive = 0.1
    fastest_hz: Annotated[float, Meta(gt=0.0, le=FASTEST_HZ)] = 0.5
    begins_s: NotNegative | None = None

    def speed_m_s(self, lever_m: Three) -> float:
        """Velocity of a point so far off that place, root mean square of an axis."""
        x, y, z = (part * part for part in lever_m)
        low, high = self.slowest_hz, self.fastest_hz
        rate = 2.0 * math.pi * math.sqrt((low * low + low * high + high * high) / 3.0)
        swept = self.heading_deg**2 * (x + y) + self.pitch_deg**2 * (y + z) + self.roll_deg**2 * (x + z)
        return rate * math.radians(math.sqrt(swept / 3.0))


class NavigatorTable(Table):
    """``[navigator]``: what the bridge is told about this vehicle, and the frame it shows in polar waters.

    ``alignment`` is one that the bridge knows by that name; without ``autostart`` it waits for a command.
    It may take ``alignment_s``, by default nearly as long as the vehicle rests at the start. Counts of gyros
    that dither are corrected by its method ``whole_cycle``, or taken as they are.
    """

    alignment: str = "static"
    alignment_s: Annotated[float, Meta(ge=2.0)] | None = None
    autostart: bool = True
    find_mounting: bool = False
    non_holonomic: bool = True
    whole_cycle: str | None = None
    polar: Literal["geographic", "grid", "transverse"] = "geographic"


class Scenario(Table):
    """A whole scenario; `load` reads and checks one."""

    title: str
    grade: str
    start: Start
    manoeuvre: Annotated[list[Manoeuvre], Meta(min_length=1)]
    vehicle: VehicleOptions = msgspec.field(default_factory=VehicleOptions)
    imu: ImuTable = msgspec.field(default_factory=ImuTable)
    odometer: OdometerTable | None = None
    speed: SpeedTable | None = None
    baro: BaroTable | None = None
    gnss: GnssTable | None = None
    sway: SwayTable | None = None
    navigator: NavigatorTable = msgspec.field(default_factory=NavigatorTable)
    fault: list[AnyFault] = msgspec.field(default_factory=list)
    repeat_from: int = -1
    duration_s: Positive | None = None

    def seconds(self) -> float:
        """How long it lasts unless told otherwise: ``duration_s``, or the manoeuvres once."""
        return self.duration_s if self.duration_s is not None else sum(m.duration_s for m in self.manoeuvre)

    def devices(self) -> dict[str, DeviceTable]:
        """The tables of the devices that are there, by name."""
        tables = {
            "imu": self.imu,
            "odometer": self.odometer,
            "speed": self.speed,
            "baro": self.baro,
            "gnss": self.gnss,
        }
        return {name: table for name, table in tables.items() if table is not None}

    def profile(self, seconds: float) -> Profile:
        """What is driven in at least ``seconds``. Raises ValueError naming the manoeuvre at fault."""
        blends: list[Blend] = []
        speed = total = 0.0
        tail = range(len(self.manoeuvre))[self.repeat_from :]
        places = list(range(len(self.manoeuvre)))
        while places:
            for place in places:
                manoeuvre = self.manoeuvre[place]
                try:
                    part = manoeuvre.blends(speed)
                except ValueError as error:
                    raise ValueError(f"manoeuvre[{place}]: {error}") from error
                blends += part
                # steps are differences of speeds: rounding must not become a creep
                speed = round(speed + sum(blend.speed for blend in part), 9)
                total += manoeuvre.duration_s
            places = list(tail) if total < seconds else []
        return Profile(blends, math.radians(self.start.heading_deg))

    def rest_s(self) -> float:
        """How long it stands still at the start."""
        total = 0.0
        for manoeuvre in self.manoeuvre:
            if not isinstance(manoeuvre, Static):
                break
            total += manoeuvre.duration_s
        return total

    def trajectory(self, seconds: float, rng: np.random.Generator) -> Trajectory:
        """True motion over at least ``seconds``; ``rng`` draws how well the IMU was mounted."""
        options = self.vehicle
        pitch_deg, roll_deg, heading_deg = options.mounting_deg
        off = options.mounting_sigma_deg * rng.standard_normal(2)
        vehicle = Vehicle(
            imu=np.array(options.imu_m),
            C_vb=mounting_matrix(pitch_deg + float(off[0]), roll_deg, heading_deg + float(off[1])),
            roll_per_accel=roll_per_accel(options.roll_deg_per_g),
            pitch_per_accel=roll_per_accel(options.pitch_deg_per_g),
            crab=Crab(math.radians(options.crab_deg), rng) if options.crab_deg else None,
            sway=None if self.sway is None else self._sway(self.sway, rng),
        )
        return Trajectory(
            self.profile(seconds),
            vehicle,
            math.radians(self.start.lat_deg),
            math.radians(self.start.lon_deg),
            self.start.height_m,
        )

    @staticmethod
    def _sway(table: SwayTable, rng: np.random.Generator) -> Sway:
        sigma = np.radians([table.heading_deg, table.pitch_deg, table.roll_deg])
        return Sway(sigma, table.slowest_hz, table.fastest_hz, table.begins_s, rng)


def packaged() -> dict[str, str]:
    """Title of every packaged scenario by its name."""
    paths = sorted(PACKAGED.glob("*.toml"))
    return {path.stem: str(tomllib.loads(path.read_text("utf-8"))["title"]) for path in paths}


def load(where: str | Path) -> Scenario:
    """Read a scenario by path, or a packaged one by name.

    Raises ScenarioError when there is none, or something in it is unknown, missing or impossible.
    """
    path = Path(where)
    names = sorted(p.stem for p in PACKAGED.glob("*.toml"))
    if str(where).removesuffix(".toml") in names:
        path = PACKAGED / f"{str(where).removesuffix('.toml')}.toml"
    elif not path.is_file():
        raise ScenarioError(f"{where}: no such scenario; expected a file or one of {', '.join(names)}")
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path.name}: not valid TOML: {error}") from error
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    _require_finite(path.name, document, "")
    try:
        scenario = msgspec.convert(document, Scenario)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{path.name}: {_explain(document, str(error))}") from error
    _check(path.name, scenario)
    return scenario


def _require_finite(file: str, value: object, key: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ScenarioError(f"{file}: {key}: found {value}, expected a finite number")
    items: list[tuple[str, object]] = []
    if isinstance(value, dict):
        items = [(f"{key}.{name}" if key else str(name), item) for name, item in value.items()]
    elif isinstance(value, list):
        items = [(f"{key}[{place}]", item) for place, item in enumerate(value)]
    for name, item in items:
        _require_finite(file, item, name)


def _check(file: str, scenario: Scenario) -> None:
    if scenario.grade not in GRADES:
        raise ScenarioError(
            f'{file}: grade: found "{scenario.grade}", expected one of {", ".join(sorted(GRADES))}'
        )
    count = len(scenario.manoeuvre)
    if not -count <= scenario.repeat_from < count:
        raise ScenarioError(
            f"{file}: repeat_from: found {scenario.repeat_from}, expected {-count} to {count - 1}"
        )
    sway = scenario.sway
    if sway is not None and sway.fastest_hz < sway.slowest_hz:
        raise ScenarioError(
            f"{file}: sway.fastest_hz: found {sway.fastest_hz:g}, expected at least {sway.slowest_hz:g}, its "
            "slowest_hz"
        )
    devices = scenario.devices()
    for place, fault in enumerate(scenario.fault):
        device = getattr(fault, "device", None)
        if device is not None and device not in devices:
            raise ScenarioError(
                f'{file}: fault[{place}].device: found "{device}", expected one of {", ".join(devices)}'
            )
    if scenario.navigator.whole_cycle is not None and scenario.imu.dither_hz is None:
        found = scenario.navigator.whole_cycle
        raise ScenarioError(f'{file}: navigator.whole_cycle: found "{found}", expected imu.dither_hz with it')
    try:
        # twice through: the repeated part must also follow itself
        scenario.profile(2.0 * sum(m.duration_s for m in scenario.manoeuvre))
    except ValueError as error:
        raise ScenarioError(f"{file}: {error}") from error


def _explain(document: dict[str, Any], message: str) -> str:
    """A message of msgspec as key, found, expected."""
    text, _, where = message.partition(" - at `$")
    parts = re.findall(r"[^.\[\]`]+", where)
    found: Any = document
    key = ""
    for part in parts:
        found = found[int(part)] if isinstance(found, list) else found.get(part)
        key = f"{key}[{part}]" if part.isdigit() else f"{key}.{part}" if key else part
    if match := re.match(r"Object contains unknown field `(.*)`", text):
        fields = ", ".join(_struct(parts, found).__struct_fields__)
        return f"{key + '.' if key else ''}{match[1]}: found an unknown key, expected one of {fields}"
    if match := re.match(r"Object missing required field `(.*)`", text):
        return f"{key + '.' if key else ''}{match[1]}: found nothing, expected this key"
    if key.endswith(".kind"):
        return f'{key}: found "{found}", expected one of {", ".join(sorted(_kinds(parts[0])))}'
    shown = "a table" if isinstance(found, dict) else repr(found)
    if match := re.match(r"Expected (.*?)(?:, got .*)?$", text):
        return f"{key}: found {shown}, expected {match[1].replace('`', '')}"
    return f"{key}: {text}"


def _kinds(name: str) -> dict[str, type[msgspec.Struct]]:
    """The structs of a list of manoeuvres or faults by their kind."""
    members = typing.get_args(AnyFault if name == "fault" else Manoeuvre)
    return {str(member.__struct_config__.tag): member for member in members}


def _struct(parts: list[str], found: Any) -> type[msgspec.Struct]:
    """What the table at ``parts`` was read as."""
    if not parts:
        return Scenario
    if parts[0] in ("manoeuvre", "fault"):
        return _kinds(parts[0])[found["kind"]]
    hint: Any = typing.get_type_hints(Scenario)[parts[0]]
    return next(m for m in (*typing.get_args(hint), hint) if isinstance(m, type) and issubclass(m, Table))
