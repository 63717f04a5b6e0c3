"""Calibration files of redundant units: four to six gyros and four to six accelerometers, on any axes.

The file is that of `bridge.calibration` with four to six numbers where there are three else, and with
``axes`` (a row for each sensor) for both kinds. Arms and misalignments are of three alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from bridge.calibration import CalibrationFile, Certificate, calibration_of, read_parts
from bridge.errors import ConfigError
from bridge.strict import wrong
from nav.imu.many import Sensors
from nav.types import Vector

_TAKEN: Final = ("scale", "scale_negative", "bias", "axes", "g_sensitivity")


@dataclass(frozen=True)
class RedundantFile:
    """What the calibration file of a redundant unit says: as `bridge.calibration.CalibrationFile`."""

    gyros: Sensors
    accels: Sensors
    model: str
    serial: int | None
    certificate: Certificate | None = None


def read_unit(data: bytes, file: str) -> CalibrationFile | RedundantFile:
    """Read the calibration file of a unit of three and three sensors, or of a redundant one.

    Raises:
        ConfigError: a key, unit, shape or value is wrong, or one kind is redundant and the other is not.
    """
    parts = read_parts(data, file)
    if len(parts.gyro["scale"]) == len(parts.accel["scale"]) == 3:
        return calibration_of(parts, file)
    if "temperature" in parts.document:
        raise ConfigError(f"{file}: temperature: found a table, expected it of three and three sensors alone")
    gyros, accels = _sensors(parts.gyro, "gyro", file), _sensors(parts.accel, "accel", file)
    return RedundantFile(gyros, accels, parts.model, parts.serial, parts.certificate)


def _sensors(values: dict[str, Vector], kind: str, file: str) -> Sensors:
    n = len(values["scale"])
    if n == 3:
        raise wrong(file, kind, "three sensors", "four to six where there are as many of the other kind")
    for name in values:
        if name not in _TAKEN:
            raise ConfigError(f"{file}: {kind}.{name}: found it of {n} sensors, expected it of three alone")
    if "axes" not in values:
        raise ConfigError(f"{file}: {kind}.axes: found nothing, expected {n} rows, the sensors' axes")
    try:
        return Sensors(
            axes=values["axes"],
            scale_plus=values["scale"],
            scale_minus=values.get("scale_negative", values["scale"]),
            bias=values.get("bias", np.zeros(n)),
            g_sensitivity=values.get("g_sensitivity", np.zeros((n, 3))),
        )
    except ValueError as error:
        raise ConfigError(f"{file}: {kind}: {error}") from error
