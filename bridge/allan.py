"""The Allan deviation of a unit at rest in a capture, and what the filter's configuration makes of it."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.calibration import UNITS
from bridge.config import Config
from bridge.drivers import DRIVERS
from bridge.engine import build_drivers
from bridge.errors import CalibrationError, CaptureError
from bridge.heard import heard
from bridge.options import ImuErrors
from bridge.recording import Capture
from bridge.strict import unknown, wrong
from nav.imu.allan import (
    LEAST,
    OF_FILTER,
    STRANGE,
    Curve,
    Expectation,
    Noises,
    curve,
    noises,
    noises_from,
    unlikely,
)
from nav.types import ImuFlag, ImuSample, Vector

SHORTEST_S: Final = 10.0
"""A second is then an averaging time, at which random walks are told."""
_BLOCK_S: Final = 1.0
_TURNS: Final = np.radians(0.1)  # rad/s, and
_LEANS: Final = 0.05  # m/s^2: the mean of a second of what rests is not further from the median
_NOISY: Final = 10.0  # unless its noise is: in sigmas of a second's mean
_BRIDGED: Final = 1e-3  # share of samples that may be made up
_EVEN: Final = 0.5  # of an interval
_BETTER: Final = 4.0
"""How much likelier (twice the logarithm) another time of correlation has to be than the configured one."""


@dataclass(frozen=True, slots=True, eq=False)
class Triad:
    """Curve, noises and noises as a filter knows them of three sensors, SI; ``kind`` is "gyro" or "accel"."""

    kind: str
    curve: Curve
    noises: tuple[Noises, ...]
    of_filter: tuple[Noises, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a capture says of its unit ``device``, which rested for ``seconds``, sampled every ``tau0`` s.

    ``navigator`` is the first that uses it, None where none does. ``correlation`` s is the time of the
    drift, the configured one unless ``told``: then the capture shows it.
    """

    capture: str
    device: str
    navigator: str | None
    seconds: float
    tau0: float
    triads: tuple[Triad, Triad]
    correlation: float
    told: bool


def find(capture: Capture, device: str | None, start_s: float, seconds: float | None) -> Found:
    """The noises of a capture's inertial unit ``device``, or of its only one.

    The samples are looked at from ``start_s`` on, for ``seconds`` or to the end.

    Raises:
        ConfigError: there is no such unit.
        CaptureError: there are no samples of it.
        CalibrationError: they are too few, with gaps or faults between them, or the unit was moved.
    """
    config = Config.from_attachments(capture.attachments)
    name = _unit(config, device)
    users = [key for key, options in config.navigators.items() if name in options.devices]
    tau0, rates = _rates(capture, config, name, start_s, seconds)
    curves = [curve(part, tau0) for part in (rates[:, :3], rates[:, 3:])]
    expected = Expectation(curves[0])
    try:
        seen = [[noises(y, expected) for y in one.deviation.T] for one in curves]
    except ValueError as error:
        raise CalibrationError(f"{capture.path.name}: {name}: {error}") from error
    plain = [
        (one.first, y)
        for of, many in zip(curves, seen, strict=True)
        for one, y in zip(many, of.deviation.T, strict=True)
        if one.inflation < STRANGE
    ]
    known = config.navigators[users[0]].imu_errors if users else ImuErrors()
    correlation, told = _correlation(curves[0], plain, known.correlation_s)
    of_filter = Expectation(curves[0], OF_FILTER, correlation)
    triads = [
        Triad(
            kind,
            of,
            tuple(many),
            tuple(noises_from(one.first, y, of_filter) for one, y in zip(many, of.deviation.T, strict=True)),
        )
        for kind, of, many in zip(UNITS, curves, seen, strict=True)
    ]
    return Found(
        capture.path.name,
        name,
        users[0] if users else None,
        len(rates) * tau0,
        tau0,
        (triads[0], triads[1]),
        correlation,
        told,
    )


def _unit(config: Config, device: str | None) -> str:
    units = [name for name, one in config.devices.items() if "imu" in DRIVERS[one.driver].provides(one)]
    if device is not None and device not in units:
        raise unknown(config.file, "device", device, units)
    if device is None and len(units) != 1:
        raise wrong(config.file, "device", units, "one inertial unit, or --device to say which")
    return device or units[0]


def _rates(
    capture: Capture, config: Config, name: str, start_s: float, seconds: float | None
) -> tuple[float, Vector]:
    """Interval s and rates (k, 6), rad/s and m/s^2, of a time in which the unit rested without a gap."""
    values, begins = array("d"), array("d")
    flags: list[int] = []
    for _, made in heard(capture, [build_drivers(config)[name]]):
        for sample in made:
            if isinstance(sample, ImuSample):
                values.extend((sample.dt, *sample.dtheta.tolist(), *sample.dv.tolist()))
                begins.append(sample.t_ns * 1e-9 - sample.dt)
                flags.append(sample.flags)
    if not flags:
        raise CaptureError(f"{capture.path}: no samples of {name} in it")
    begin = np.array(begins) - begins[0]
    chosen = (begin >= start_s) & (begin < (np.inf if seconds is None else start_s + seconds))
    rows, at, said = np.array(values).reshape(-1, 7)[chosen], begin[chosen], np.array(flags)[chosen]
    where = f"{capture.path.name}: {name}"
    tau0 = float(rows[:, 0].mean()) if len(rows) else 0.0
    if len(rows) < LEAST or len(rows) * tau0 < SHORTEST_S:
        raise CalibrationError(
            f"{where}: too short: {len(rows)} samples in {len(rows) * tau0:.1f} s, expected at least {LEAST} "
            f"and {SHORTEST_S:g} s"
        )
    _require_whole(where, rows[:, 0], at, said)
    rates = rows[:, 1:] / rows[:, :1]
    _require_rest(where, rates, at, tau0)
    return tau0, rates


def _require_whole(where: str, dt: Vector, at: Vector, flags: NDArray[np.int64]) -> None:
    """Raise CalibrationError where samples are missing, made up or faulty, or come unevenly."""
    uneven = np.abs(dt - np.median(dt)) > _EVEN * np.median(dt)
    for bad, what in (
        (np.append(False, (flags[1:] & int(ImuFlag.GAP)) != 0), "samples are missing before it"),
        ((flags & int(ImuFlag.SATURATED)) != 0, "saturated counts"),
        ((flags & int(ImuFlag.DEVICE_FAULT)) != 0, "a fault said by the device"),
        (uneven, "a sample of another length"),
    ):
        if bad.any():
            raise CalibrationError(
                f"{where}: {what}, {at[bad][0]:.2f} s from its first sample on ({np.count_nonzero(bad)} in "
                "all); expected a time without: see --start and --seconds"
            )
    made_up = float(np.mean((flags & int(ImuFlag.BRIDGED)) != 0))
    if made_up > _BRIDGED:
        raise CalibrationError(
            f"{where}: {1e2 * made_up:.2g} % of the samples were missing and made up, expected at most "
            f"{1e2 * _BRIDGED:g} %"
        )


def _require_rest(where: str, rates: Vector, at: Vector, tau0: float) -> None:
    """Raise CalibrationError where the mean of a second is too far from what it is at most times."""
    size = max(1, round(_BLOCK_S / tau0))
    count = len(rates) // size
    means = rates[: count * size].reshape(count, size, 6).mean(axis=1)
    off = np.abs(means - np.median(means, axis=0))
    noise = 1.4826 * np.median(off, axis=0)
    moving = off > np.maximum(np.repeat((_TURNS, _LEANS), 3), _NOISY * noise)
    if moving.any():
        k = int(np.argmax(moving.any(axis=1)))
        turns, leans = np.degrees(off[k, :3].max()), off[k, 3:].max()
        raise CalibrationError(
            f"{where}: the unit was moved {at[k * size]:.0f} s from its first sample on: a second's mean is "
            f"off by {turns:.2g} deg/s and {leans:.2g} m/s^2; expected a unit that rests: see --start and "
            "--seconds"
        )


def _correlation(of: Curve, plain: list[tuple[int, Vector]], configured: float) -> tuple[float, bool]:
    """The time of correlation s under which all curves are likeliest, and whether they tell it at all.

    ``plain`` are the curves that are sums of noises, each with the number of the time that it is from.
    """

    def against(correlation: float) -> float:
        expected = Expectation(of, OF_FILTER, correlation)
        return sum(unlikely(first, y, expected) for first, y in plain)

    tried = np.geomspace(max(1.0, 4.0 * of.tau0), of.count * of.tau0, 16)
    found = [against(float(one)) for one in tried]
    best = int(np.argmin(found))
    if found[best] < against(configured) - _BETTER:
        return float(f"{tried[best]:.2g}"), True
    return configured, False
