"""Where the accelerometers of a unit sit, from a capture in which it was turned about a fixed point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import tomli_w

from bridge.calibration import CalibrationFile, read_calibration
from bridge.calibration_capture import Recorded, record, unit_of
from bridge.config import Config
from bridge.errors import CalibrationError
from bridge.recording import Capture
from bridge.strict import parse
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
    tau, dtheta, read = _samples(recorded, c)
    try:
        arms = fit_arms(c.accel_axes, dtheta, read, tau)
    except ValueError as error:
        raise CalibrationError(f"{capture.path}: {error}") from error
    point = np.zeros(3)
    if origin == "axes":
        point = meeting_point(c.accel_axes, arms.arms)
        arms = arms.from_meeting_point(c.accel_axes)
    return Found(arms, point, len(dtheta) * tau, name, parse(data, name))


def _samples(recorded: Recorded, c: Calibration) -> tuple[float, Vector, Vector]:
    """Interval, angles (k, 3) and what each accelerometer says (k, 3), of the longest faultless time."""
    stream = recorded.stream
    tau = float(np.median(stream.dt))
    good = np.abs(stream.dt - tau) < _EVEN * tau
    for bad in stream.bad.values():
        good &= np.logical_not(bad)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
    begin, end = max(
        zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0], default=(0, 0)
    )
    table = c.table()
    dtheta, dv = np.empty((end - begin, 3)), np.empty((end - begin, 3))
    for k, counts in enumerate(stream.counts[begin:end]):
        compensate(table, counts, tau, dtheta[k], dv[k])
    return tau, dtheta, dv @ c.accel_axes.T


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
