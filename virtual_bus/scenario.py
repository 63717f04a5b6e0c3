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
from typing import Annotated, Any, Final

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from virtual_bus.crab import Crab
from virtual_bus.faults import AnyFault, SensorDead, SensorFault
from virtual_bus.flexure import Flexed, Markov, Wandering
from virtual_bus.grades import GRADES
from virtual_bus.manoeuvres import Blend, Manoeuvre, Profile, Static
from virtual_bus.redundancy import AXES
from virtual_bus.sway import Sway
from virtual_bus.tables import (
    BaroTable,
    DeviceTable,
    FlexureTable,
    GnssTable,
    ImuTable,
    MasterTable,
    NavigatorTable,
    OdometerTable,
    Positive,
    SpeedTable,
    Start,
    SwayTable,
    Table,
    VehicleOptions,
)
from virtual_bus.truth import Trajectory, Vehicle, mounting_matrix, roll_per_accel

Array = NDArray[np.float64]

PACKAGED: Final = Path(__file__).parent / "scenarios"
_RESONANCE: Final = 0.05  # damping ratio of what vibrates


class ScenarioError(ValueError):
    """A scenario that is not there or is wrong: file, key, what was found, what was expected."""


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
    master: MasterTable | None = None
    flexure: FlexureTable | None = None
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
            "master": self.master,
        }
        return {name: table for name, table in tables.items() if table is not None}

    def profile(self, seconds: float) -> Profile:
        """What is driven in at least ``seconds``. Raises ValueError naming the manoeuvre at fault."""
        blends: list[Blend] = []
        speed = begin = self.start.speed_m_s
        total = 0.0
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
        return Profile(blends, math.radians(self.start.heading_deg), begin)

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
        off = options.mounting_sigma_deg * rng.standard_normal(2 if self.master is None else 3)
        pitch_deg, heading_deg = pitch_deg + float(off[0]), heading_deg + float(off[1])
        vehicle = Vehicle(
            imu=np.array(options.imu_m),
            C_vb=mounting_matrix(pitch_deg, roll_deg + float(off[2:].sum()), heading_deg),
            roll_per_accel=roll_per_accel(options.roll_deg_per_g),
            pitch_per_accel=roll_per_accel(options.pitch_deg_per_g),
            crab=Crab(math.radians(options.crab_deg), rng) if options.crab_deg else None,
            sway=None if self.sway is None else self._sway(self.sway, rng),
            banks=options.banks,
        )
        start = self.start
        place = math.radians(start.lat_deg), math.radians(start.lon_deg), start.height_m
        if self.flexure is None:
            return Trajectory(self.profile(seconds), vehicle, *place)
        arm = self.lever_arm() if self.flexure.arm_m is None else np.array(self.flexure.arm_m)
        return Flexed(self.profile(seconds), vehicle, *place, self._flexure(self.flexure, rng), arm)

    def lever_arm(self) -> Array:
        """From the master, or from the rear axle where there is none, to the IMU (3,) m, vehicle axes."""
        return np.array(self.vehicle.imu_m) - (0.0 if self.master is None else np.array(self.master.at_m))

    @staticmethod
    def _flexure(table: FlexureTable, rng: np.random.Generator) -> Wandering:
        rate = 2.0 * math.pi * table.vibration_hz
        axes = zip(table.sigma_mrad, table.correlation_s, table.vibration_mrad, strict=True)
        processes = [
            (Markov.correlated(1e-3 * bend, seconds), Markov(1e-3 * shake, rate, _RESONANCE))
            for bend, seconds, shake in axes
        ]
        return Wandering(processes, rng)

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
        if device is None or device in devices:
            continue
        if "device" not in fault.__struct_fields__:
            kind = fault.__struct_config__.tag
            raise ScenarioError(f'{file}: fault[{place}].kind: found "{kind}", expected [{device}] with it')
        raise ScenarioError(
            f'{file}: fault[{place}].device: found "{device}", expected one of {", ".join(devices)}'
        )
    _check_sensors(file, scenario)
    if scenario.navigator.whole_cycle is not None and scenario.imu.dither_hz is None:
        found = scenario.navigator.whole_cycle
        raise ScenarioError(f'{file}: navigator.whole_cycle: found "{found}", expected imu.dither_hz with it')
    try:
        # twice through: the repeated part must also follow itself
        scenario.profile(2.0 * sum(m.duration_s for m in scenario.manoeuvre))
    except ValueError as error:
        raise ScenarioError(f"{file}: {error}") from error


def _check_sensors(file: str, scenario: Scenario) -> None:
    """Raise ScenarioError where a redundant unit has what only three can, or there is no such sensor."""
    imu = scenario.imu
    alone = {"fd": imu.fd, "dither_hz": imu.dither_hz, "inner_arms_mm": imu.inner_arms_mm}
    for name, found in alone.items():
        if imu.axes is not None and found:
            raise ScenarioError(f"{file}: imu.{name}: found {found}, expected it without imu.axes")
    count = 3 if imu.axes is None else len(AXES[imu.axes])
    for place, fault in enumerate(scenario.fault):
        if isinstance(fault, SensorFault) and fault.number > count:
            raise ScenarioError(f"{file}: fault[{place}].number: found {fault.number}, expected 1 to {count}")
        if isinstance(fault, SensorDead) and fault.told and imu.axes is None:
            raise ScenarioError(f"{file}: fault[{place}].told: found true, expected imu.axes with it")


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
