"""Tables of numbers as a capture of raw CAN frames: the same that the devices would have sent."""

from __future__ import annotations

import argparse
import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from bridge import arguments
from bridge.calibration import read_calibration
from bridge.config import Config
from bridge.drivers.baro_can import BaroCanOptions
from bridge.drivers.gnss_can import GnssCanOptions
from bridge.drivers.imu_can import ImuCanOptions
from bridge.drivers.odometer_can import OdometerCanOptions
from bridge.errors import ConfigError
from bridge.frame import RawFrame
from bridge.importers import frames as wire
from bridge.importers.capture import Imported, write_capture
from bridge.importers.mapping import Baro, Gnss, Imu, Mapping, Odometer
from bridge.importers.mapping import Source as Table
from bridge.importers.tables import CsvTable, kept
from bridge.options import DeviceOptions
from bridge.strict import convert, one_of, parse, unknown, wrong
from nav.types import FixType, Vector

PACKAGED: Final = Path(__file__).parent / "mappings"
HELP: Final = "tables of numbers, by a mapping of columns to devices"

_START_NS: Final = 1_000_000_000
"""Monotonic time of a capture's first frame."""
_GPS_EPOCH_S: Final = 315_964_800
_WEEK_S: Final = 604_800
_GAP: Final = 1.5
"""An interval longer than this many periods means that samples are missing in between."""

Options = TypeVar("Options", bound=DeviceOptions)


@dataclass(frozen=True)
class Withheld:
    """Which fixes are left out: all but every ``every``-th, and those in outages.

    ``outages_s`` are (start, length) in seconds, counted from the first fix of the table.
    """

    every: int = 1
    outages_s: Sequence[tuple[float, float]] = field(default_factory=tuple)


def load_mapping(where: str | Path) -> tuple[Mapping, Path]:
    """A mapping by path, or a packaged one by name, and where it was found.

    Raises:
        ConfigError: it is not there or is wrong.
    """
    path = Path(where)
    for candidate in (path, PACKAGED / path.name, PACKAGED / f"{path.name}.toml"):
        if candidate.is_file() and (candidate == path or path.parent == Path()):
            return convert(parse(candidate.read_bytes(), candidate.name), Mapping, candidate.name), candidate
    names = [item.stem for item in PACKAGED.glob("*.toml") if b"\n[imu." in item.read_bytes()]
    raise ConfigError(
        f"{where}: no such file; expected a path, or {one_of(path.stem, names)} that are packaged"
    )


class CsvImport:
    """The frames that the tables of one mapping stand for.

    Raises:
        ConfigError: the mapping, the configuration or a table is wrong; it names file, key and line.
    """

    def __init__(self, mapping: str | Path, data: str | Path, withheld: Withheld | None = None) -> None:
        self._mapping, path = load_mapping(mapping)
        self._file, self._data = path.name, Path(data)
        self._withheld = withheld or Withheld()
        beside = path.parent / self._mapping.config
        self.config = Config.load(beside if beside.is_file() else self._mapping.config)
        self._utc_ns: int | None = None
        self._streams: list[tuple[int, list[wire.Sent]]] = []
        makers: tuple[tuple[str, dict[str, Any], Callable[[str, str, Any], Iterator[wire.Sent]]], ...] = (
            ("imu", self._mapping.imu, self._imu),
            ("gnss", self._mapping.gnss, self._gnss),
            ("odometer", self._mapping.odometer, self._odometer),
            ("baro", self._mapping.baro, self._baro),
        )
        for kind, tables, make in makers:
            for name, table in tables.items():
                key = f"{kind}.{name}"
                source = self._source(key, name)
                try:
                    frames = list(make(key, name, table))
                except ValueError as error:  # of a codec, that names signal, value and range
                    raise ConfigError(f"{self._data / table.file}: {error}") from error
                self._streams.append((source, frames))
        if not self._streams:
            raise ConfigError(
                f"{self._file}: found no table, expected at least one of [imu.NAME], [gnss.NAME], ..."
            )
        self._zero_ns = min(sent[0].t_ns for _, sent in self._streams if sent) - _START_NS

    @property
    def utc_offset_ns(self) -> int:
        """UTC minus the capture's monotonic time; the latter's own zero where no table knows the date."""
        return 0 if self._utc_ns is None else self._utc_ns + self._zero_ns

    def frames(self) -> Iterator[RawFrame]:
        """All frames in the order of their arrival."""
        streams = [
            [(sent.t_ns, order, source, sent) for sent in stream]
            for order, (source, stream) in enumerate(self._streams)
        ]
        merged = heapq.merge(*streams, key=lambda item: item[:2])
        for seq, (t_ns, _, source, sent) in enumerate(merged):
            yield RawFrame(seq, t_ns - self._zero_ns, source, sent.key, sent.data)

    def _imu(self, key: str, name: str, spec: Imu) -> Iterator[wire.Sent]:
        options = self._options(key, name, ImuCanOptions)
        table = self._table(key, spec)
        times = self._times(table, spec)
        if len(times) < 2:
            raise ConfigError(
                f"{self._file}: {key}.file: found one row, expected two or more: rates need an interval"
            )
        # the first row only begins the first interval
        steps: Vector = np.diff(np.array(times, dtype=np.int64)).astype(np.float64) / 1e9
        count = np.where(steps * options.rate_hz < _GAP, 1, np.rint(steps * options.rate_hz)).astype(np.int64)
        dt = steps / count
        file = options.calibration
        scale = read_calibration(self.config.files[file], file).calibration
        minus_g, minus_a = scale.gyro_scale_minus, scale.accel_scale_minus
        assert minus_g is not None
        assert minus_a is not None
        try:
            gyro = wire.pulses(
                table.triples("gyro", spec.gyro, "angular rate")[1:], dt, scale.gyro_scale_plus, minus_g
            )
            accel = wire.pulses(
                table.triples("accel", spec.accel, "acceleration")[1:], dt, scale.accel_scale_plus, minus_a
            )
        except wire.PulseOverflow as error:
            raise ConfigError(
                f"{self._data / spec.file}: line {error.row + 3}: {error}, expected at most 32767; "
                f"the scale in the calibration of device {name} is too fine"
            ) from error
        return wire.imu_frames(
            times[1:],
            gyro,
            accel,
            np.cumsum(count).tolist(),
            delay_ns=round(spec.delay_ms * 1e6),
            id_offset=options.id_offset,
            temperature_deg_c=spec.temperature_deg_c,
        )

    def _gnss(self, key: str, name: str, spec: Gnss) -> Iterator[wire.Sent]:
        options = self._options(key, name, GnssCanOptions)
        table = self._table(key, spec)
        times = self._times(table, spec)
        if (spec.sigma_velocity is None) == (spec.sigma_velocity_m_s is None) and spec.velocity is not None:
            raise ConfigError(
                f"{self._file}: {key}: expected exactly one of sigma_velocity and sigma_velocity_m_s"
            )
        if spec.sigma_velocity is not None:
            sigma_velocity = table.triples("sigma_velocity", spec.sigma_velocity, "speed")
        else:
            sigma_velocity = np.tile(spec.sigma_velocity_m_s or (0.0, 0.0, 0.0), (len(table), 1))
        if isinstance(spec.fix_type, str):
            fixes = [self._fix_type(f"{key}.fix_type", spec.fix_type)] * len(table)
        else:
            kinds = {
                word: self._fix_type(f"{key}.fix_type.values", word) for word in spec.fix_type.values.values()
            }
            fixes = [kinds[word] for word in table.codes("fix_type", spec.fix_type)]
        if self._utc_ns is None:
            self._utc_ns = (_GPS_EPOCH_S - spec.leap_seconds) * 1_000_000_000
        return wire.gnss_frames(
            wire.Fixes(
                times,
                spec.leap_seconds,
                np.degrees(table.numbers("lat", spec.lat, "angle")),
                np.degrees(table.numbers("lon", spec.lon, "angle")),
                table.numbers("height", spec.height, "length"),
                table.triples("sigma", spec.sigma, "length"),
                None if spec.velocity is None else table.triples("velocity", spec.velocity, "speed"),
                sigma_velocity,
                fixes,
                spec.satellites,
            ),
            kept(times, self._withheld.every, self._withheld.outages_s),
            delay_ns=round(spec.delay_ms * 1e6),
            id_offset=options.id_offset,
        )

    def _odometer(self, key: str, name: str, spec: Odometer) -> Iterator[wire.Sent]:
        options = self._options(key, name, OdometerCanOptions)
        table = self._table(key, spec)
        return wire.odometer_frames(
            self._times(table, spec),
            table.numbers("speed", spec.speed, "speed"),
            options.m_per_tick,
            delay_ns=round(spec.delay_ms * 1e6),
            id_offset=options.id_offset,
        )

    def _baro(self, key: str, name: str, spec: Baro) -> Iterator[wire.Sent]:
        options = self._options(key, name, BaroCanOptions)
        table = self._table(key, spec)
        return wire.baro_frames(
            self._times(table, spec),
            table.numbers("pressure", spec.pressure, "pressure"),
            spec.temperature_deg_c,
            delay_ns=round(spec.delay_ms * 1e6),
            id_offset=options.id_offset,
        )

    def _table(self, key: str, spec: Table) -> CsvTable:
        return CsvTable(self._data / spec.file, self._file, key)

    def _times(self, table: CsvTable, spec: Table) -> list[int]:
        """Times of the rows, ns since the beginning of GPS time where the mapping knows the week."""
        begin_ns = self._mapping.gps_week * _WEEK_S * 1_000_000_000
        return [begin_ns + t_ns for t_ns in table.times_ns("time", spec.time)]

    def _source(self, key: str, name: str) -> int:
        if name not in self.config.devices:
            raise unknown(self._file, key, name, self.config.devices)
        return self.config.source_number(self.config.devices[name].source)

    def _options(self, key: str, name: str, kind: type[Options]) -> Options:
        options = self.config.devices[name]
        if not isinstance(options, kind):
            raise wrong(
                self._file,
                key,
                options.driver,
                f"a device of {self.config.file} whose frames this table can be",
            )
        return options

    def _fix_type(self, key: str, word: str) -> FixType:
        if word not in FixType.__members__:
            raise unknown(self._file, key, word, FixType.__members__)
        return FixType[word]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what ``navbridge import csv`` takes."""
    parser.add_argument("mapping", metavar="MAPPING.toml", help="mapping file, or the name of a packaged one")
    parser.add_argument("--data", metavar="DIR", default=".", help="folder of the tables (default: here)")
    parser.add_argument(
        "--gnss-every",
        metavar="N",
        type=arguments.whole(1),
        default=1,
        help="keep only every N-th GNSS fix (default: all)",
    )
    parser.add_argument(
        "--gnss-outage",
        metavar="START,LENGTH",
        type=_outage,
        action="append",
        default=[],
        help="leave out the fixes of LENGTH seconds from START seconds after the first; may be repeated",
    )


def run(args: argparse.Namespace) -> Imported:
    """Do what the arguments say."""
    job = CsvImport(args.mapping, args.data, Withheld(args.gnss_every, args.gnss_outage))
    return write_capture(
        args.out, job.frames(), job.config, job.utc_offset_ns, f"import csv {Path(args.mapping).name}"
    )


def _outage(text: str) -> tuple[float, float]:
    try:
        start, length = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f'"{text}": expected START,LENGTH in seconds, as 85,15') from None
    if not (math.isfinite(start) and 0.0 < length < math.inf):
        raise argparse.ArgumentTypeError(f'"{text}": expected a LENGTH above 0')
    return start, length
