"""Where the accelerometers of a unit sit, from a capture in which it was turned about a fixed point.

The fit is one, `nav.imu.size_fit`: of the rotations of a plan, which ``navbridge calibrate`` hands over with
the coefficients that it has just found, or of any swaying of a calibrated unit, by ``navbridge arms``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import tomli_w
from numpy.typing import NDArray

from bridge.calibration import CalibrationFile, read_calibration
from bridge.calibration_capture import record, unit_of
from bridge.config import Config
from bridge.errors import CalibrationError
from bridge.recording import Capture
from bridge.strict import parse
from nav.calibrate.intervals import Interval
from nav.calibrate.stream import Stream
from nav.imu.pulses import Calibration, compensate
from nav.imu.size_effect import meeting_point
from nav.imu.size_fit import Arms, fit_arms
from nav.types import Vector

ORIGINS: Final = ("axes", "turn")
"""The point nearest to all sensitive axes, or that about which the unit was turned."""

_KEY: Final = "lever_arm_mm"
_EVEN: Final = 0.01  # of an interval: what a clock of microseconds and a bus leave of it
_LETTERS: Final = "xyz"
_ALONG: Final = ("right", "forward", "up")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Arms of a unit with the calibration that they go into.

    ``origin`` (3,) m is where the arms are counted from, seen from the point of the turn; ``seconds`` of the
    capture were used.
    """

    arms: Arms
    origin: Vector
    seconds: float
    name: str
    document: dict[str, Any]


def find(capture: Capture, device: str | None, origin: str, calibration: tuple[str, bytes] | None) -> Found:
    """The arms of a capture's unit ``device``, or its only one, counted from one of `ORIGINS`.

    ``calibration``, its name and its bytes, replaces the one that the capture was made with.

    Raises:
        ConfigError: there is no such unit, or the calibration is wrong.
        CaptureError: there are no samples of it.
        CalibrationError: the turns do not show all arms, which are named, or there are too few samples.
    """
    recorded = record(capture, device)
    if calibration is None:
        config = Config.from_attachments(capture.attachments)
        name = unit_of(config, device)[1].calibration
        calibration = (name, config.files[name])
    name, data = calibration
    file: CalibrationFile = read_calibration(data, name)
    c = file.calibration
    stream = recorded.stream
    tau = float(np.median(stream.dt))
    part = _longest(stream, tau)
    try:
        arms = fit_arms(c.accel_axes, [_compensated(stream, part, c, tau)], tau)
    except ValueError as error:
        raise CalibrationError(f"{capture.path}: {error}") from error
    point = np.zeros(3)
    if origin == "axes":
        point = meeting_point(c.accel_axes, arms.arms)
        arms = arms.from_meeting_point(c.accel_axes)
    return Found(arms, point, (part.stop - part.start) * tau, name, parse(data, name))


def of_turns(streams: Sequence[Stream], intervals: Sequence[Interval], c: Calibration) -> Arms:
    """The arms of a unit, from where its axes meet, from the rotations of a turntable's plan.

    ``intervals`` of ``streams``; ``c`` without arms.

    Raises:
        ValueError: the rotations do not show all arms, which are named, or there are too few samples.
    """
    tau = float(np.median(streams[0].dt))
    turns = []
    for one in intervals:
        if one.rotation:
            # of the last capture that had begun by then
            stream = max((s for s in streams if s.begin <= one.begin), key=lambda s: s.begin)
            first = int(np.searchsorted(np.cumsum(stream.dt), one.begin - stream.begin + 0.5 * tau))
            part = slice(first, first + round(one.seconds / tau))
            if _faultless(stream, tau)[part].all():
                turns.append(_compensated(stream, part, c, tau))
    if not turns:
        raise ValueError("no rotation shows any")
    return fit_arms(c.accel_axes, turns, tau).from_meeting_point(c.accel_axes)


def _faultless(stream: Stream, tau: float) -> NDArray[np.bool_]:
    """Which samples (k,) are good and as long as the others."""
    good = np.abs(stream.dt - tau) < _EVEN * tau
    for bad in stream.bad.values():
        good &= np.logical_not(bad)
    return good


def _longest(stream: Stream, tau: float) -> slice:
    """The longest faultless time."""
    good = _faultless(stream, tau)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
    begin, end = max(
        zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0], default=(0, 0)
    )
    return slice(int(begin), int(end))


def _compensated(stream: Stream, part: slice, c: Calibration, tau: float) -> tuple[Vector, Vector]:
    """Angles (k, 3) and what each accelerometer says (k, 3), at the temperature that the unit told."""
    if c.thermal is not None and len(stream.temperature):
        c = c.at(float(stream.temperature[part].mean()))
    table = c.table()
    counts = stream.counts[part]
    dtheta, dv = np.empty((len(counts), 3)), np.empty((len(counts), 3))
    for k, row in enumerate(counts):
        compensate(table, row, tau, dtheta[k], dv[k])
    return dtheta, dv @ c.accel_axes.T


def file_of(found: Found) -> str:
    """The calibration with these arms in it, as TOML."""
    document = dict(found.document)
    for table, values in (("accel", found.arms.arms), ("sigma", found.arms.sigma())):
        rows = [[round(1e3 * x, 6) for x in row] for row in values.tolist()]
        if table == "sigma":
            sigma = dict(document.get("sigma", {}))
            sigma["accel"] = {**_without_arms(sigma.get("accel", {})), _KEY: rows}
            document["sigma"] = sigma
        else:
            document["accel"] = {**_without_arms(document["accel"]), _KEY: rows}
    return tomli_w.dumps(document)


def _without_arms(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if not key.startswith("lever_arm")}


def document_of(found: Found) -> dict[str, Any]:
    """All of it, in mm, for JSON."""
    return {
        "calibration": found.name,
        "seconds": found.seconds,
        "origin_mm": (1e3 * found.origin).tolist(),
        "lever_arm_mm": (1e3 * found.arms.arms).tolist(),
        "sigma_mm": (1e3 * found.arms.sigma()).tolist(),
        "residual_m_s": found.arms.residual,
    }


def lines_of(found: Found) -> list[str]:
    """A table for people."""
    lines = [f"arms of {found.name}, of {found.seconds:.1f} s, in mm", ""]
    lines.append(f"{'accelerometer':<14}" + "".join(f"{word:>18}" for word in _ALONG))
    for letter, arm, sigma in zip(_LETTERS, 1e3 * found.arms.arms, 1e3 * found.arms.sigma(), strict=True):
        cells = "".join(f"{a:>10.3f} +-{s:6.3f}" for a, s in zip(arm, sigma, strict=True))
        lines.append(f"{letter:<14}{cells}")
    x, y, z = 1e3 * found.origin
    lines += ["", f"origin {x:.3f}, {y:.3f}, {z:.3f} mm from the point of the turn"]
    lines.append(f"residual of a sample {1e3 * found.arms.residual:.4f} mm/s")
    return lines


def coefficient_lines(arms: Arms | str) -> list[str]:
    """The arms among the coefficients of a calibration, or why they are not there."""
    if isinstance(arms, str):
        return [f"arms of the accelerometers: {arms}"]
    rows = zip(_LETTERS, 1e3 * arms.arms, 1e3 * arms.sigma(), strict=True)
    return [
        f"{f'accel {letter} lever arm {along}':<44} {value:>14.4f} {sigma:>10.2g}  mm"
        for letter, row, sigmas in rows
        for along, value, sigma in zip(_ALONG, row, sigmas, strict=True)
    ]
