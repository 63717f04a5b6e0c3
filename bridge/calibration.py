"""Calibration files of inertial units: TOML with the unit in every key, to nav.imu.pulses coefficients.

::

    [device]
    model = "..."                              # for people
    serial = 1234                              # compared with what the device says of itself
    [gyro]
    scale_arcsec_per_pulse = [0.05, 0.05, 0.05]
    bias_deg_per_h = [0.1, -0.2, 0.05]
    g_sensitivity_deg_per_h_per_g = [[...], [...], [...]]   # row: gyro; column: right, forward, up
    misalignment_arcsec = [[0, 10, -5], [...], [...]]       # row: gyro; what it sees of the other axes
    square_deg_per_h_per_g2 = [[...], [...], [...]]         # row: gyro; of fx fx, fy fy, fz fz
    product_deg_per_h_per_g2 = [[...], [...], [...]]        # row: gyro; of fy fz, fz fx, fx fy
    scale_temperature_ppm_per_deg_c = [[3.0, 0.01], [...], [...]]  # row: gyro; per degC, per degC^2, ...
    bias_temperature_deg_per_h_per_deg_c = [[...], [...], [...]]
    [accel]
    scale_ug_s_per_pulse = [50.0, 50.0, 50.0]
    bias_ug = [100.0, -50.0, 30.0]
    misalignment_arcsec = [[...], [...], [...]]
    square_ug_per_g2 = [[...], [...], [...]]
    product_ug_per_g2 = [[...], [...], [...]]
    scale_temperature_ppm_per_deg_c = [[...], [...], [...]]
    bias_temperature_ug_per_deg_c = [[...], [...], [...]]
    lever_arm_mm = [[...], [...], [...]]       # row: accelerometer; where it sits: right, forward, up
    [temperature]                              # where there are polynomials in it
    reference_deg_c = 25.0                     # scales and biases above are those at this temperature
    range_deg_c = [-40.0, 60.0]                # beyond it what holds at its nearer end

A scale for negative counts (``scale_negative_...``) is given where it differs; ``axes`` (3 x 3, no unit)
instead of a misalignment where the sensors are not along the axes at all. Of a redundant unit there are
four to six numbers, and as many rows (`bridge.calibration_sensors`). A file that
``navbridge calibrate`` wrote says in ``[certificate]`` when and how it was measured, and in ``[sigma.gyro]``
and ``[sigma.accel]`` how well every coefficient is known, under the coefficient's own key.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bridge.errors import ConfigError
from bridge.strict import Table, convert, one_of, parse, wrong
from nav.imu.pulses import Calibration, Thermal
from nav.types import Vector

G: Final = 9.80665  # m/s^2, the unit "g"
_DEG: Final = math.pi / 180.0
_ARCSEC: Final = _DEG / 3600.0

_GYRO_SCALE: Final = {"arcsec_per_pulse": _ARCSEC, "deg_per_pulse": _DEG, "urad_per_pulse": 1e-6}
_ACCEL_SCALE: Final = {"ug_s_per_pulse": 1e-6 * G, "m_s_per_pulse": 1.0, "mm_s_per_pulse": 1e-3}
_ANGLE: Final = {"arcsec": _ARCSEC, "mrad": 1e-3, "deg": _DEG}
_DRIFT: Final = {"deg_per_h": _DEG / 3600.0, "deg_per_s": _DEG}
_PUSH: Final = {"ug": 1e-6 * G, "mg": 1e-3 * G, "m_s2": 1.0}
_GYRO_SECOND: Final = {f"{unit}_per_g2": si / G**2 for unit, si in _DRIFT.items()}
_ACCEL_SECOND: Final = {"ug_per_g2": 1e-6 / G, "mg_per_g2": 1e-3 / G}
_SCALE_TEMPERATURE: Final = {"ppm_per_deg_c": 1e-6}

UNITS: Final[dict[str, dict[str, dict[str, float]]]] = {
    "gyro": {
        "scale": _GYRO_SCALE,
        "scale_negative": _GYRO_SCALE,
        "bias": _DRIFT,
        "g_sensitivity": {f"{unit}_per_g": si / G for unit, si in _DRIFT.items()},
        "misalignment": _ANGLE,
        "axes": {"": 1.0},
        "square": _GYRO_SECOND,
        "product": _GYRO_SECOND,
        "scale_temperature": _SCALE_TEMPERATURE,
        "bias_temperature": {f"{unit}_per_deg_c": si for unit, si in _DRIFT.items()},
    },
    "accel": {
        "scale": _ACCEL_SCALE,
        "scale_negative": _ACCEL_SCALE,
        "bias": _PUSH,
        "misalignment": _ANGLE,
        "axes": {"": 1.0},
        "lever_arm": {"m": 1.0, "mm": 1e-3},
        "square": _ACCEL_SECOND,
        "product": _ACCEL_SECOND,
        "scale_temperature": _SCALE_TEMPERATURE,
        "bias_temperature": {f"{unit}_per_deg_c": si for unit, si in _PUSH.items()},
    },
}
"""Per sensor and quantity: the units its key may end in, and what they are in SI."""

_KEYS: Final = {
    sensor: {
        f"{quantity}_{unit}" if unit else quantity: (quantity, factor)
        for quantity, units in quantities.items()
        for unit, factor in units.items()
    }
    for sensor, quantities in UNITS.items()
}
_MATRICES: Final = ("g_sensitivity", "misalignment", "axes", "lever_arm", "square", "product")
_POLYNOMIALS: Final = ("scale_temperature", "bias_temperature")
MOST_POWERS: Final = 6
"""The highest power of temperature in a file."""
_WORDS: Final = {3: "three", 4: "four", 5: "five", 6: "six"}
"""Sensors of one kind that have a place on the bus."""


class _Device(Table):
    model: str = ""
    serial: int | None = None


class _Temperature(Table):
    reference_deg_c: float
    range_deg_c: tuple[float, float]


class Certificate(Table):
    """``[certificate]``: when, where and how a calibration was made, and what was left.

    ``residual_gyro_arcsec`` and ``residual_accel_mm_s`` are root mean squares over the plan's intervals.
    ``chi2`` over ``freedom`` is about 1 where the residuals are those of the unit's noise; the sigmas are for
    noise ``inflation`` times as large.
    """

    date: str
    plan: str
    plan_sha256: str
    captures: list[str]
    lat_deg: float
    height_m: float
    gravity_m_s2: float
    temperature_deg_c: float
    temperature_range_deg_c: tuple[float, float]
    residual_gyro_arcsec: float
    residual_accel_mm_s: float
    chi2: float
    freedom: int
    inflation: float
    made_by: str


@dataclass(frozen=True)
class CalibrationFile:
    """What a calibration file says: which unit it is for, the coefficients, and how they were measured."""

    calibration: Calibration
    model: str
    serial: int | None
    certificate: Certificate | None = None


@dataclass(frozen=True)
class Parts:
    """A calibration file taken apart: quantities of gyros and accelerometers, SI, by name, and the whole."""

    gyro: dict[str, Vector]
    accel: dict[str, Vector]
    model: str
    serial: int | None
    certificate: Certificate | None
    document: dict[str, Any]


def read_calibration(data: bytes, file: str) -> CalibrationFile:
    """Read the calibration file of three gyros and three accelerometers; ``file`` is its name for messages.

    Raises:
        ConfigError: a key, unit, shape or value is wrong, with the key, or it has other than three.
    """
    return calibration_of(read_parts(data, file), file)


def read_parts(data: bytes, file: str) -> Parts:
    """Read any calibration file from its bytes.

    Raises:
        ConfigError: a key, unit, shape or value is wrong, with the key.
    """
    document = parse(data, file)
    known = ("device", "certificate", "sigma", "temperature", *UNITS)
    for name in document:
        if name not in known:
            expected = one_of(name, known)
            raise ConfigError(f"{file}: {name}: found an unknown table, expected {expected}")
    device = convert(document.get("device", {}), _Device, file, "device")
    certificate = None
    if "certificate" in document:
        certificate = convert(document["certificate"], Certificate, file, "certificate")
    gyro = _sensor(document, "gyro", file)
    accel = _sensor(document, "accel", file)
    _check_sigmas(document, file)
    return Parts(gyro, accel, device.model, device.serial, certificate, document)


def calibration_of(parts: Parts, file: str) -> CalibrationFile:
    """The coefficients of three gyros and three accelerometers.

    Raises:
        ConfigError: there are other than three, or their axes do not span space.
    """
    gyro, accel = parts.gyro, parts.accel
    for sensor, values in (("gyro", gyro), ("accel", accel)):
        if len(values["scale"]) != 3:
            raise wrong(file, sensor, f"{len(values['scale'])} sensors", "three here")
    try:
        calibration = Calibration(
            gyro_scale_plus=gyro["scale"],
            gyro_scale_minus=gyro.get("scale_negative"),
            accel_scale_plus=accel["scale"],
            accel_scale_minus=accel.get("scale_negative"),
            gyro_bias=gyro.get("bias", np.zeros(3)),
            accel_bias=accel.get("bias", np.zeros(3)),
            gyro_g=gyro.get("g_sensitivity", np.zeros((3, 3))),
            gyro_axes=gyro.get("axes", np.eye(3)),
            accel_axes=accel.get("axes", np.eye(3)),
            accel_arms=accel.get("lever_arm", np.zeros((3, 3))),
            gyro_square=gyro.get("square", np.zeros((3, 3))),
            gyro_product=gyro.get("product", np.zeros((3, 3))),
            accel_square=accel.get("square", np.zeros((3, 3))),
            accel_product=accel.get("product", np.zeros((3, 3))),
            thermal=_thermal(parts.document, gyro, accel, file),
        )
    except ValueError as error:
        raise ConfigError(f"{file}: {error}") from error
    return CalibrationFile(calibration, parts.model, parts.serial, parts.certificate)


def _thermal(
    document: dict[str, Any], gyro: dict[str, Vector], accel: dict[str, Vector], file: str
) -> Thermal | None:
    """The polynomials in temperature, None where there are none; raises ValueError or ConfigError."""
    parts = [values.get(name) for values in (gyro, accel) for name in _POLYNOMIALS]
    if "temperature" not in document:
        if any(part is not None for part in parts):
            raise ConfigError(f"{file}: temperature: found no table, expected that of the polynomials")
        return None
    table = convert(document["temperature"], _Temperature, file, "temperature")
    if all(part is None for part in parts):
        raise wrong(file, "temperature", table.reference_deg_c, "polynomials, as gyro.bias_temperature_...")
    none = np.zeros((3, 0))
    given = (none if part is None else part for part in parts)
    return Thermal(table.reference_deg_c, *table.range_deg_c, *given)


def _check_sigmas(document: dict[str, Any], file: str) -> None:
    """Raise ConfigError where a sigma is not that of a coefficient of the file, in the same shape."""
    sigmas = document.get("sigma", {})
    if not isinstance(sigmas, dict):
        raise wrong(file, "sigma", sigmas, "tables [sigma.gyro] and [sigma.accel]")
    for sensor, table in sigmas.items():
        if sensor not in UNITS or not isinstance(table, dict):
            raise ConfigError(
                f"{file}: sigma.{sensor}: found {sensor}, expected tables of {', '.join(UNITS)}"
            )
        for name, value in table.items():
            key = f"sigma.{sensor}.{name}"
            if name not in document[sensor]:
                raise ConfigError(
                    f"{file}: {key}: found an unknown key, expected {one_of(name, document[sensor])}"
                )
            sigma = _array(value, _KEYS[sensor][name][0], len(document[sensor][name]), file, key)
            if sigma.shape != np.shape(document[sensor][name]):
                raise wrong(file, key, value, f"as many numbers as in {sensor}.{name}")


def _sensor(document: dict[str, Any], sensor: str, file: str) -> dict[str, Vector]:
    table = document.get(sensor)
    if not isinstance(table, dict):
        raise ConfigError(f"{file}: {sensor}: found no table, expected [{sensor}] with at least its scale")
    keys = _KEYS[sensor]
    values: dict[str, Vector] = {}
    count = next((_sensors(table[name]) for name in table if keys.get(name, ("", 0))[0] == "scale"), 3)
    for name, value in table.items():
        key = f"{sensor}.{name}"
        if name not in keys:
            raise ConfigError(f"{file}: {key}: found an unknown key or unit, expected {one_of(name, keys)}")
        quantity, factor = keys[name]
        if quantity in values:
            raise wrong(file, key, name, f"the {quantity} once, in one unit")
        values[quantity] = _array(value, quantity, count, file, key) * factor
    if "scale" not in values:
        names = [name for name, (quantity, _) in keys.items() if quantity == "scale"]
        raise ConfigError(f"{file}: {sensor}: found no scale, expected one of {', '.join(names)}")
    if np.any(values["scale"] == 0.0):
        raise wrong(file, f"{sensor}.scale", 0.0, "a scale that is not zero")
    if "misalignment" in values:
        if "axes" in values:
            raise wrong(file, f"{sensor}.axes", "both", "either axes or misalignment")
        if count != 3:
            raise wrong(file, f"{sensor}.misalignment", f"{count} sensors", "axes where there are over three")
        if np.any(np.diag(values["misalignment"]) != 0.0):
            raise wrong(
                file, f"{sensor}.misalignment", "a diagonal", "zeros there: scale errors belong in scale"
            )
        values["axes"] = np.eye(3) + values["misalignment"]
    return values


def _sensors(scale: object) -> int:
    """Of how many sensors a table is, by its scale."""
    return len(scale) if isinstance(scale, list) and len(scale) in _WORDS else 3


def _array(value: Any, quantity: str, count: int, file: str, key: str) -> Vector:
    """Numbers of a quantity of ``count`` sensors, (n,), (n, 3) or, of a polynomial, (n, number of powers)."""
    number = _WORDS[count]
    rows, length, expected = value, 3, f"{number} rows of three numbers"
    if quantity in _POLYNOMIALS:
        first = value[0] if isinstance(value, list) and value else None
        length = min(max(len(first), 1), MOST_POWERS) if isinstance(first, list) else 1
        expected = f"{number} rows of equal length, of 1 to {MOST_POWERS} numbers"
    elif quantity not in _MATRICES:
        expected = f"{number} numbers" + (" (right, forward, up)" if count == 3 else "")
        rows, count, length = [value], 1, count
    if not isinstance(rows, list) or len(rows) != count:
        raise wrong(file, key, value, expected)
    for row in rows:
        if not isinstance(row, list) or len(row) != length:
            raise wrong(file, key, row, expected)
        for item in row:
            if isinstance(item, bool) or not isinstance(item, int | float):
                raise wrong(file, key, item, expected)
    return np.array(value, dtype=np.float64)
