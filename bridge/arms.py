"""Where the accelerometers of a unit sit, from a capture in which it was turned about a fixed point.

The fit is one, `nav.imu.size_fit`: of the rotations of a plan, which ``navbridge calibrate`` hands over with
the coefficients that it has just found, or of any swaying of a calibrated unit, by ``navbridge arms``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import tomli_w
from numpy.typing import NDArray
from scipy import stats

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
_FAINT: Final = 1e-9  # eigenvalues below this share of the largest one are none
_EVEN: Final = 0.01  # of an interval: what a clock of microseconds and a bus leave of it
_LETTERS: Final = "xyz"
_ALONG: Final = ("right", "forward", "up")
_CHANCE: Final = 1e-3
"""So seldom arms that are not there look as if they were."""


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
    arms, sigmas = _entries(found.arms)
    sigma = dict(document.get("sigma", {}))
    document["accel"] = {**_without_arms(document["accel"]), **arms}
    document["sigma"] = {**sigma, "accel": {**_without_arms(sigma.get("accel", {})), **sigmas}}
    return tomli_w.dumps(document)


def _entries(arms: Arms) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a file says of arms, and of their sigmas."""
    return _entry(arms.arms), _entry(arms.sigma())


def _entry(values: Vector) -> dict[str, Any]:
    return {_KEY: [[round(1e3 * x, 6) + 0.0 for x in row] for row in values.tolist()]}


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


class _Verdict(NamedTuple):
    """What of arms goes into a calibration and its sigmas, and why."""

    arms: dict[str, Any]
    sigmas: dict[str, Any]
    why: str


def _verdict(found: Arms | str, axes: Vector, known: Vector) -> _Verdict:
    """Arms that chance could have made are not taken off: what was known stays unless they refute it."""
    stays = {"lever_arm_m": known.tolist()} if np.any(known) else {}
    kept = "; those that were known stay" if stays else ""
    if isinstance(found, str):
        return _Verdict(stays, {}, found + kept)
    chi2, freedom, limit = _beyond_chance(found, np.zeros_like(found.arms))
    said = f"chi-square {chi2:.1f} of {freedom} degrees of freedom, by chance up to {limit:.1f}"
    if chi2 > limit:
        return _Verdict(*_entries(found), f"{said}: written")
    if stays:
        from_there = known - meeting_point(axes, known)
        chi2, _, limit = _beyond_chance(found, from_there)
        if chi2 > limit:
            stays, kept = {}, f"; those that were known are not so ({chi2:.1f}) and left out"
    return _Verdict(stays, {}, f"{said}: not significant, not written{kept}")


def _beyond_chance(found: Arms, supposed: Vector) -> tuple[float, int, float]:
    """Chi-square of the difference from ``supposed`` arms, its degrees of freedom, and what chance reaches.

    The covariance of arms from where the axes meet has as many eigenvalues of nothing as there are shifts.
    """
    values, vectors = np.linalg.eigh(found.covariance)
    told = values > _FAINT * values[-1]
    along = vectors[:, told].T @ (found.arms - supposed).ravel()
    freedom = int(told.sum())
    return float(along @ (along / values[told])), freedom, float(stats.chi2.isf(_CHANCE, freedom))


def into_file(found: Arms | str, axes: Vector, known: Vector) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a calibration says of the arms, and of their sigmas.

    ``found`` from where ``axes`` (n, 3) meet, or why not; ``known`` (n, 3) m before.
    """
    verdict = _verdict(found, axes, known)
    return verdict.arms, verdict.sigmas


def coefficient_lines(found: Arms | str, axes: Vector, known: Vector) -> list[str]:
    """The arms among the coefficients of a calibration, and what is made of them; see `into_file`."""
    lines = []
    if isinstance(found, Arms):
        lines = [
            f"{f'accel {letter} lever arm {along}':<44} {value:>14.4f} {sigma:>10.2g}  mm"
            for letter, row, sigmas in zip(_LETTERS, 1e3 * found.arms, 1e3 * found.sigma(), strict=True)
            for along, value, sigma in zip(_ALONG, row, sigmas, strict=True)
        ]
    return [*lines, f"arms of the accelerometers: {_verdict(found, axes, known).why}"]
