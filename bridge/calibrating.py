"""From a plan and its captures to a calibration, the file that holds it and the report about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, Final

import numpy as np
import tomli_w

from bridge.arms import coefficient_lines, into_file, of_turns
from bridge.calibration import UNITS, Certificate, G, read_calibration
from bridge.calibration_capture import Recorded, same_unit
from bridge.calibration_plan import Plan, Site, as_toml
from bridge.errors import CalibrationError
from bridge.strict import plain
from nav.calibrate.checks import moved
from nav.calibrate.coefficients import KEYS, Coefficients, coefficients
from nav.calibrate.intervals import Interval, Place
from nav.calibrate.model import LETTERS, NUISANCE, Model, sensor
from nav.calibrate.observability import Observability, observe, propose
from nav.calibrate.plan import Position
from nav.calibrate.segments import Disagreement, segment
from nav.calibrate.solve import Fit, Noise, fit
from nav.calibrate.stream import Nominal
from nav.imu.size_fit import Arms
from nav.types import Vector

_ARCSEC: Final = np.pi / 648000.0
_WRITTEN: Final = {
    "gyro": {
        "scale": "arcsec_per_pulse",
        "scale_negative": "arcsec_per_pulse",
        "bias": "deg_per_h",
        "g_sensitivity": "deg_per_h_per_g",
        "misalignment": "arcsec",
        "axes": "",
        "product": "deg_per_h_per_g2",
        "scale_temperature": "ppm_per_deg_c",
        "bias_temperature": "deg_per_h_per_deg_c",
    },
    "accel": {
        "scale": "m_s_per_pulse",
        "scale_negative": "m_s_per_pulse",
        "bias": "ug",
        "misalignment": "arcsec",
        "axes": "",
        "square": "ug_per_g2",
        "product": "ug_per_g2",
        "scale_temperature": "ppm_per_deg_c",
        "bias_temperature": "ug_per_deg_c",
    },
}
"""The unit in which each quantity is written."""
_COLUMNS: Final = {
    "square": ("xx", "yy", "zz"),
    "product": ("yz", "zx", "xy"),
    **dict.fromkeys(("scale_temperature", "bias_temperature"), "123456"),
}
_SOAKED: Final = 15.0
"""So far from the plan's temperature (degC) what a unit says of itself may be: it heats itself."""
_DIGITS: Final = 10
_LEFT: Final = 0.05  # of an encoder's error in a turn that ends three degrees beside its beginning


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration with everything that its file and its report say.

    ``arms`` are where the accelerometers sit, or why that is not known.
    """

    plan: Plan
    site: Site
    fit: Fit
    intervals: tuple[Interval, ...]
    seen: Observability
    recorded: tuple[Recorded, ...]
    serial: int | None
    arms: Arms | str = "not sought"

    def of(self, kind: str) -> Coefficients:
        """Coefficients of the "gyro" or the "accel" sensors."""
        return coefficients(self.fit, kind == "gyro")


def model_of(plan: Plan, place: Place, nominal: Nominal) -> Model:
    """The unknowns of a unit that is about ``nominal``."""
    made = []
    for k, (axis, scale) in enumerate(zip(nominal.axes, nominal.scale, strict=True)):
        gyro = k < nominal.gyros
        number = k if gyro else k - nominal.gyros
        count = nominal.gyros if gyro else len(nominal.scale) - nominal.gyros
        kind = "gyro" if gyro else "accelerometer"
        made.append(sensor(f"{kind} {_called(number, count)}", gyro, axis, float(scale), plan.terms))
    return Model(tuple(made), place, plan.reference)


def _called(number: int, count: int) -> str:
    """A sensor's letter, or its number from 1 where there are more than letters."""
    return LETTERS[number] if count == len(LETTERS) else str(number + 1)


def look(plan: Plan, model: Model, noise: Noise) -> Observability:
    """What a plan will show of a unit.

    Raises:
        CalibrationError: not everything; the text names what, and steps that show it.
    """
    seen = observe(model, plan.steps, noise)
    if not seen.unseen:
        return seen
    hidden = "; ".join(_combination(names) for names in seen.unseen)
    dwells = [step.seconds for step in plan.steps if isinstance(step, Position)]
    more = propose(model, plan.steps, noise, max(dwells, default=60.0))
    advice = f"; add to the plan: {' | '.join(as_toml(more))}" if more else ""
    raise CalibrationError(f"{plan.file}: the plan does not show {hidden}{advice}")


def _combination(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} one from another"


def with_table(noise: Noise, plan: Plan, told: bool) -> Noise:
    """``noise`` with what is not known of where a table rests and by how much it turns.

    A table that has ``told`` its angles is off by its encoders' error. That belongs to the angle, so that
    whole turns are free of all but the part by which they end a few degrees from where they began.
    """
    if told:
        return replace(noise, attitude=plan.encoder.sigma, turn=_LEFT * plan.encoder.sigma)
    return replace(noise, attitude=plan.position, turn=plan.position)


def calibrate(plan: Plan, site: Site | None, recorded: Sequence[Recorded]) -> Calibrated:
    """The calibration of a unit from captures that hold the plan's steps in their order.

    Raises:
        ConfigError: nobody said where the table stands.
        CalibrationError: the captures are of several units or do not hold what the plan says, the table
            was moved, or the plan does not show every coefficient.
    """
    where, place = plan.at(site)
    serial = same_unit(recorded)
    nominal = recorded[0].nominal
    noise = with_table(recorded[0].noise, plan, all(one.table is not None for one in recorded))
    model = model_of(plan, place, nominal)
    seen = look(plan, model, noise)
    streams = [one.on_table(plan.encoder.axes) for one in recorded]
    try:
        intervals = segment(streams, plan.steps, nominal, [one.ratio for one in recorded])
        _check_temperatures(plan, intervals)
        found = fit(model, intervals, noise)
    except Disagreement as error:
        raise CalibrationError(f"{plan.file} and {_files(recorded)} disagree: {error}") from error
    except ValueError as error:
        raise CalibrationError(f"{plan.file}, {_files(recorded)}: {error}") from error
    wrong = moved(found, intervals, noise)
    if wrong is not None:
        raise CalibrationError(f"{_files(recorded)}: {wrong}")
    made = Calibrated(plan, where, found, tuple(intervals), seen, tuple(recorded), serial)
    return replace(made, arms=_arms(made))


def _arms(result: Calibrated) -> Arms | str:
    """Where the accelerometers sit by the plan's rotations and the coefficients found, or why not."""
    if len(result.fit.model.sensors) != 6:
        return "sought of three accelerometers alone"
    c = read_calibration(file_of(result).encode(), "the calibration").calibration
    try:
        return of_turns([one.stream for one in result.recorded], result.intervals, c)
    except ValueError as error:
        return str(error)


def _of_arms(result: Calibrated) -> tuple[Arms | str, Vector, Vector]:
    """Arms found, the axes that they are of, and arms known before."""
    return result.arms, result.of("accel").value["axes"], result.recorded[0].arms


def _check_temperatures(plan: Plan, intervals: Sequence[Interval]) -> None:
    """Raise Disagreement where a unit was not at the plan's temperature, or did not tell."""
    for step, interval in zip(plan.steps, intervals, strict=True) if plan.soaks else ():
        if not abs(interval.temperature - step.temperature) <= _SOAKED:
            told = (
                f"{interval.temperature:.1f} degC" if np.isfinite(interval.temperature) else "no temperature"
            )
            raise Disagreement(f"{step.name}: the unit told {told}, expected {step.temperature:g} degC")


def _files(recorded: Sequence[Recorded]) -> str:
    return ", ".join(one.stream.name for one in recorded)


# the file


def certificate_of(result: Calibrated) -> Certificate:
    """When, where and how, and what was left."""
    first = min(result.recorded, key=lambda one: one.utc)
    temperatures = np.concatenate([one.temperatures for one in result.recorded])
    if not len(temperatures):
        raise CalibrationError(f"{_files(result.recorded)}: the unit never told its temperature")
    model = result.fit.model
    left = {
        gyro: np.concatenate(
            [r.values for r, s in zip(result.fit.residuals, model.sensors, strict=True) if s.gyro == gyro]
        )
        for gyro in (True, False)
    }
    return Certificate(
        date=first.utc.isoformat(),
        plan=result.plan.title,
        plan_sha256=result.plan.sha256,
        captures=[one.stream.name for one in result.recorded],
        lat_deg=result.site.lat_deg,
        height_m=result.site.height_m,
        gravity_m_s2=model.place.gravity,
        temperature_deg_c=round(float(temperatures.mean()), 3),
        temperature_range_deg_c=(
            round(float(temperatures.min()), 3),
            round(float(temperatures.max()), 3),
        ),
        residual_gyro_arcsec=_significant(_rms(left[True]) / _ARCSEC, 4),
        residual_accel_mm_s=_significant(_rms(left[False]) * 1e3, 4),
        chi2=_significant(result.fit.chi2, 4),
        freedom=result.fit.freedom,
        inflation=_significant(result.fit.inflation, 4),
        made_by=f"navbridge {version('navbridge')}",
    )


def file_of(result: Calibrated) -> str:
    """The calibration file: TOML that `bridge.calibration.read_calibration` reads."""
    return tomli_w.dumps(document_of(result))


def document_of(result: Calibrated) -> dict[str, Any]:
    """The calibration file as plain tables."""
    device: dict[str, Any] = {"model": "calibrated on a turntable"}
    if result.serial is not None:
        device["serial"] = result.serial
    document: dict[str, Any] = {"device": device, "certificate": plain(certificate_of(result))}
    sigmas: dict[str, Any] = {}
    for kind in UNITS:
        found = result.of(kind)
        document[kind], sigmas[kind] = {}, {}
        for name, value, sigma, unit, factor in written(kind, found):
            key = f"{name}_{unit}" if unit else name
            document[kind][key] = _plain(value / factor, _DIGITS)
            sigmas[kind][key] = _plain(sigma / factor, 3)
    for table, entries in zip((document, sigmas), into_file(*_of_arms(result)), strict=True):
        table["accel"] |= entries
    if result.plan.soaks:
        reference, told = result.plan.reference, [one.temperature for one in result.intervals]
        held = [round(min(*told, reference), 2), round(max(*told, reference), 2)]
        document["temperature"] = {"reference_deg_c": reference, "range_deg_c": held}
    document["sigma"] = sigmas
    return document


def written(kind: str, found: Coefficients) -> list[tuple[str, Vector, Vector, str, float]]:
    """Name, value and sigma (SI), unit and what it is in SI, of what is written of "gyro" or "accel"."""
    rows: list[tuple[str, Vector, Vector, str, float]] = []
    for key in KEYS:
        if key not in found.value:
            continue
        value, sigma = found.value[key], found.sigma[key]
        name: str = key
        if key == "axes" and value.shape == (3, 3) and np.array_equal(np.diag(value), np.ones(3)):
            name, value = "misalignment", value - np.eye(3)
        unit = _WRITTEN[kind][name]
        rows.append((name, value, sigma, unit, UNITS[kind][name][unit]))
    return rows


def _plain(values: Vector, digits: int) -> Any:
    if values.ndim == 2:
        return [_plain(row, digits) for row in values]
    return [_significant(float(value), digits) for value in values]


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}") + 0.0


def _rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))


# the report


def lines_of(result: Calibrated) -> list[str]:
    """The report for people: coefficients with sigmas, the table, residuals, what is weakly seen."""
    first, c = result.recorded[0], certificate_of(result)
    unit = "serial number not told" if result.serial is None else f"serial number {result.serial}"
    low, high = c.temperature_range_deg_c
    lines = [
        f"{result.plan.title}: {_files(result.recorded)}",
        f"{unit}, {c.date}, {c.temperature_deg_c:.1f} degC ({low:.1f} to {high:.1f}), "
        f"gravity {c.gravity_m_s2:.5f} m/s^2, clock {1e6 * (first.ratio - 1.0):+.2f} ppm",
        "",
        f"{'coefficient':<44} {'value':>14} {'sigma':>10}  unit",
    ]
    for kind in UNITS:
        for name, value, sigma, unit, factor in written(kind, result.of(kind)):
            rows = value.reshape(len(value), -1) / factor
            sigmas = sigma.reshape(len(sigma), -1) / factor
            for i, j in np.ndindex(*rows.shape):
                if sigmas[i, j] == 0.0:
                    continue  # one by definition, or not estimated
                of = f"{kind} {_called(i, len(rows))} {name.replace('_', ' ')}"
                of += f" {_COLUMNS.get(name, LETTERS)[j]}" if value.ndim > 1 else ""
                lines.append(f"{of:<44} {rows[i, j]:>14.7g} {sigmas[i, j]:>10.3g}  {unit.replace('_', ' ')}")
    lines += coefficient_lines(*_of_arms(result))
    lines += ["", *_table_lines(result), "", *residual_lines(result), "", *weak_lines(result.seen)]
    return lines


def _table_lines(result: Calibrated) -> list[str]:
    prior = result.fit.model.prior
    factors = (1.0 / _ARCSEC, 1.0 / _ARCSEC, 1.0 / _ARCSEC, result.fit.model.place.gravity / G * 1e6)
    told = all(one.table is not None for one in result.recorded)
    lines = [f"attitudes and turns: as {'the table told them' if told else 'planned'}"]
    for k, (name, factor) in enumerate(zip(NUISANCE, factors, strict=True)):
        value, sigma = (float(part[k - 4]) * factor for part in (result.fit.theta, result.fit.sigma))
        unit = "ug" if k == 3 else "arcsec"
        lines.append(
            f"table: {name:<18} {value:>9.2f} +- {sigma:.2f} {unit} (before: +- {prior[k] * factor:.2f})"
        )
    return lines


def residual_lines(result: Calibrated) -> list[str]:
    """Root mean square of what is left, sensor by sensor, and in which step it is largest."""
    found = result.fit
    lines = [
        f"residuals: chi-square {found.chi2:.1f} with {found.freedom} degrees of freedom, "
        f"{found.steps} Gauss-Newton steps"
    ]
    if found.inflation > 1.0:
        lines.append(
            f"the residuals are {found.inflation:.2f} times what the unit's noise explains; all sigmas are "
            "multiplied by that"
        )
    for one, left in zip(found.model.sensors, found.residuals, strict=True):
        worst = int(np.argmax(np.abs(left.white)))
        factor, unit = (_ARCSEC, "arcsec") if one.gyro else (1e-3, "mm/s")
        lines.append(
            f"  {one.name:<18} rms {_rms(left.values) / factor:>8.3g} {unit:<7} {_rms(left.white):>5.2f} "
            f"sigma, largest {np.abs(left.white[worst]):.1f} sigma: {result.intervals[left.used[worst]].name}"
        )
    return lines


def weak_lines(seen: Observability) -> list[str]:
    """What a plan shows mostly in combination with something else."""
    if not seen.weak:
        return ["every coefficient is seen by itself: none has ten times the sigma it would have alone"]
    return [
        "seen mostly in combination with others:",
        *(f"  {name}: {factor:.0f} times the sigma it would have alone" for name, factor in seen.weak),
    ]


def promise_lines(model: Model, seen: Observability) -> list[str]:
    """What a plan promises before it is carried out: the sigma of every unknown."""
    lines = [f"{'coefficient':<44} {'sigma':>10}  unit"]
    for k, name in enumerate(model.names):
        unit, factor = _unit_of(name)
        lines.append(f"{name:<44} {seen.sigma[k] / factor:>10.3g}  {unit}")
    return [*lines, "", *weak_lines(seen)]


def _unit_of(name: str) -> tuple[str, float]:
    gyro = name.startswith("gyro")
    if "g sensitivity" in name:
        return "deg/h/g", UNITS["gyro"]["g_sensitivity"]["deg_per_h_per_g"]
    if "square" in name or "product" in name:
        kind, unit = ("gyro", "deg_per_h_per_g2") if gyro else ("accel", "ug_per_g2")
        return unit.replace("_per_", "/"), UNITS[kind]["product"][unit]
    if " temperature " in name:
        power = f"/degC^{name[-1]}" if name[-1] != "1" else "/degC"
        unit, factor = _unit_of(name.split(" temperature ")[0])
        return unit + power, factor
    if name.endswith("bias"):
        return ("deg/h", UNITS["gyro"]["bias"]["deg_per_h"]) if gyro else ("ug", UNITS["accel"]["bias"]["ug"])
    if name.endswith(("scale", "asymmetry", "gravity")):
        return "ppm", 1e-6
    return "arcsec", _ARCSEC
