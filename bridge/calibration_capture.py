"""Raw counts of an inertial unit out of captures, through the driver that the bridge runs.

The driver is given a calibration that does nothing, one unit a pulse, so that what it checks, bridges and
counts is what it does live; what comes out of it are pulses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.calibration import CalibrationFile
from bridge.calibration_sensors import RedundantFile, read_unit
from bridge.config import Config
from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.drivers.table_can import TableCanOptions
from bridge.engine import build_drivers
from bridge.errors import CalibrationError, CaptureError, ConfigError
from bridge.heard import heard
from bridge.navigators import imu_errors
from bridge.recording import Capture
from bridge.strict import one_of
from nav.calibrate.encoder import Encoder, attitudes
from nav.calibrate.solve import Noise
from nav.calibrate.stream import Nominal, Stream
from nav.types import ImuFlag, ImuSample, TableSample, Vector

PULSES: Final = b"""
[gyro]
scale_deg_per_pulse = [57.29577951308232, 57.29577951308232, 57.29577951308232]
[accel]
scale_m_s_per_pulse = [1.0, 1.0, 1.0]
"""
"""A calibration that leaves counts as they are."""
_WORDS: Final = {
    "saturated counts": ImuFlag.SATURATED,
    "samples missing before it": ImuFlag.GAP,
    "a fault said by the device": ImuFlag.DEVICE_FAULT,
}


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What a table told: ``angles`` (k, 3) rad at ``time`` (k,) s of the unit's clock since the beginning."""

    time: Vector
    angles: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What one capture holds of a unit, and of the ``table`` it was on where that told its angles.

    ``ratio`` is how long a second of the unit's clock is by the host's; ``utc`` when it began. ``serial`` is
    None where the unit did not say it; ``temperatures`` (k,) degC as it told them.
    """

    stream: Stream
    table: Told | None
    ratio: float
    utc: datetime
    serial: int | None
    temperatures: Vector
    nominal: Nominal
    arms: Vector
    noise: Noise

    def on_table(self, axes: str) -> Stream:
        """Its samples, with the attitudes of a table about these ``axes`` if that told its angles."""
        if self.table is None:
            return self.stream
        encoder = Encoder(self.table.time, attitudes(self.table.angles, axes))
        return replace(self.stream, encoder=encoder)


def unit_of(config: Config, device: str | None) -> tuple[str, ImuCanOptions]:
    """The pulse-counting unit of a configuration, or ``device`` if that is one.

    Raises:
        ConfigError: there is none, there are several, or ``device`` is none of them.
    """
    units = {name: one for name, one in config.devices.items() if isinstance(one, ImuCanOptions)}
    if device is None and len(units) == 1:
        device = next(iter(units))
    if device is None or device not in units:
        found = f'no unit "{device}"' if device is not None else f"{len(units)} units that count pulses"
        raise ConfigError(f"{config.file}: device: found {found}, expected {one_of(device or '', units)}")
    return device, units[device]


def noise_of(config: Config, device: str) -> Noise:
    """The noise of a unit as the first navigator that uses it is told.

    Raises:
        ConfigError: no navigator does.
    """
    for options in config.navigators.values():
        if device in options.devices:
            known = imu_errors(options)
            return Noise(
                known.angle_random_walk,
                known.gyro_instability,
                known.velocity_random_walk,
                known.accel_instability,
                known.gyro_bias_time,
            )
    raise ConfigError(f"{config.file}: navigator: found none that uses {device}, expected its imu_errors")


def nominal_of(file: CalibrationFile | RedundantFile) -> Nominal:
    """What a unit is about, by the file that it is run with."""
    if isinstance(file, CalibrationFile):
        return Nominal.of(file.calibration)
    g, a = file.gyros, file.accels
    axes, scale = np.vstack((g.axes, a.axes)), np.concatenate((g.scale_plus, a.scale_plus))
    return Nominal(len(g.axes), axes, scale, np.concatenate((g.bias, a.bias)))


def record(capture: Capture, device: str | None) -> Recorded:
    """Read a capture's unit ``device``, or its only one.

    Raises:
        ConfigError: it has no such unit.
        CalibrationError: the unit is not the one that its calibration file is for.
        CaptureError: there are no samples of it.
    """
    config = Config.from_attachments(capture.attachments)
    name, options = unit_of(config, device)
    file = read_unit(config.files[options.calibration], options.calibration)
    if isinstance(file, CalibrationFile):
        config = replace(config, files={**config.files, options.calibration: PULSES})
    drivers = build_drivers(config)
    unit = drivers[name]
    if isinstance(unit, ImuCan) and unit.fusion is not None:
        unit.fusion.in_counts()
    tables = [other for other, one in config.devices.items() if isinstance(one, TableCanOptions)]
    source = config.source_number(options.source)
    status, fd = config.contract["IMU_STATUS"], config.contract["IMU_FD"]
    told = {(source, codec.frame_id + options.id_offset): codec for codec in (status, fd)}
    samples: list[ImuSample] = []
    angles: list[TableSample] = []
    temperatures: list[float] = []
    told_at: list[int] = []
    serials: set[int] = set()
    for frame, made in heard(capture, [drivers[one] for one in (name, *tables)]):
        samples += (sample for sample in made if isinstance(sample, ImuSample))
        angles += (sample for sample in made if isinstance(sample, TableSample))
        codec = told.get((frame.source, frame.key))
        if codec is not None and codec.crc_ok(frame.data):
            values = dict(zip(codec.signals, codec.decode(frame.data), strict=True))
            temperatures.append(float(values["TEMPERATURE_FINE"]))
            told_at.append(len(samples))
            serials.add(int(values["SERIAL"]))
    where = capture.path.name
    if not samples:
        raise CaptureError(f"{capture.path}: no samples of {name} in it")
    if len(serials) > 1:
        raise CalibrationError(f"{where}: {name}: more than one unit: serial numbers {_listed(serials)}")
    serial = next(iter(serials), None)
    if None not in (serial, file.serial) and serial != file.serial:
        raise CalibrationError(
            f"{where}: {name}: the unit has serial number {serial}, but the calibration file that it was run "
            f"with, {options.calibration}, is for {file.serial}"
        )
    flags = np.array([sample.flags for sample in samples])
    dt = np.array([sample.dt for sample in samples])
    t_ns = np.array([sample.t_ns for sample in samples])
    begin_ns = int(t_ns[0]) - round(dt[0] * 1e9)
    ratio = _ratio(dt, t_ns, flags & int(ImuFlag.GAP) != 0)
    counts = np.array([np.concatenate((sample.dtheta, sample.dv)) for sample in samples])
    bad = {word: flags & int(flag) != 0 for word, flag in _WORDS.items()}
    stream = Stream(
        where,
        (begin_ns + capture.utc_offset_ns) * 1e-9,
        dt,
        counts,
        {**bad, "a sensor that gives nothing": np.isnan(counts).any(axis=1)},
        np.interp(np.arange(len(samples)), told_at, temperatures) if temperatures else np.zeros(0),
    )
    utc = datetime.fromtimestamp((begin_ns + capture.utc_offset_ns) // 1_000_000_000, UTC)
    noise = noise_of(config, name)
    table = _told(angles, t_ns, dt)
    arms = file.calibration.accel_arms if isinstance(file, CalibrationFile) else np.zeros(0)
    return Recorded(stream, table, ratio, utc, serial, np.array(temperatures), nominal_of(file), arms, noise)


def _told(angles: Sequence[TableSample], t_ns: NDArray[np.int64], dt: Vector) -> Told | None:
    """What a table told while a unit was heard, the samples of which end at ``t_ns`` after ``dt`` s."""
    at = np.array([one.t_ns for one in angles], dtype=np.int64)
    inside = (at >= t_ns[0]) & (at <= t_ns[-1])
    if not inside.any():
        return None
    own = np.interp(at[inside] - t_ns[0], t_ns - t_ns[0], np.cumsum(dt))
    return Told(own, np.array([one.angles for one in angles])[inside])


def same_unit(recorded: Sequence[Recorded]) -> int | None:
    """The serial number of all captures.

    Raises:
        CalibrationError: they are not of one unit.
    """
    known = {one.stream.name: one.serial for one in recorded if one.serial is not None}
    if len(set(known.values())) > 1:
        which = ", ".join(f"{serial} in {name}" for name, serial in known.items())
        raise CalibrationError(f"captures of different units: serial number {which}")
    return next(iter(known.values()), None)


def _ratio(dt: Vector, t_ns: Vector, gap: Vector) -> float:
    """Slope of the host's time over the unit's, least squares within the runs between gaps."""
    run = np.cumsum(gap)
    own, host = np.cumsum(dt), (t_ns - t_ns[0]) * 1e-9
    count = np.bincount(run)
    own = own - (np.bincount(run, own) / count)[run]
    host = host - (np.bincount(run, host) / count)[run]
    return float(own @ host / (own @ own))


def _listed(numbers: set[int]) -> str:
    return ", ".join(map(str, sorted(numbers)))
