"""What an Allan deviation came to, for people, as lines of a configuration, as JSON and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from bridge.allan import Found, Triad
from bridge.calibration import G
from bridge.plots.style import AXES, INK, Picture, legend
from nav.calibrate.model import LETTERS
from nav.imu.allan import LEVEL, MARKOV, SLOPES, STRANGE, TERMS, Noises, Term

_DEG: Final = np.pi / 180.0
_UG: Final = 1e-6 * G
_UNITS: Final = {
    "gyro": {
        "quantisation": ("arcsec", 3600.0 / _DEG),
        "random walk": ("deg/sqrt(h)", 60.0 / _DEG),
        "instability": ("deg/h", 3600.0 / _DEG),
        "rate random walk": ("deg/h/sqrt(h)", 60.0 * 3600.0 / _DEG),
        "ramp": ("deg/h/h", 3600.0 * 3600.0 / _DEG),
        MARKOV: ("deg/h", 3600.0 / _DEG),
    },
    "accel": {
        "quantisation": ("mm/s", 1e3),
        "random walk": ("ug/sqrt(Hz)", 1.0 / _UG),
        "instability": ("ug", 1.0 / _UG),
        "rate random walk": ("ug/sqrt(h)", 60.0 / _UG),
        "ramp": ("ug/h", 3600.0 / _UG),
        MARKOV: ("ug", 1.0 / _UG),
    },
}
"""In what each coefficient is told, and how many of that are one of SI."""
_KEYS: Final = {
    ("gyro", "random walk"): "gyro_random_walk_deg_per_sqrt_h",
    ("gyro", MARKOV): "gyro_instability_deg_per_h",
    ("accel", "random walk"): "accel_random_walk_ug_per_sqrt_hz",
    ("accel", MARKOV): "accel_instability_ug",
}
_AT_ONE_SECOND: Final = {
    "quantisation": 3.0**0.5,
    "random walk": 1.0,
    "instability": (2.0 * np.log(2.0) / np.pi) ** 0.5,
    "rate random walk": 3.0**-0.5,
    "ramp": 2.0**-0.5,
}
"""Deviation of a noise whose coefficient is 1: IEEE Std 952-1997, annex C."""
_TITLES: Final = {"gyro": "gyros", "accel": "accelerometers"}


def lines_of(found: Found) -> list[str]:
    """The table, and the lines for the configuration."""
    lines = [
        f"{found.capture}: {found.device}, {found.seconds:.0f} s at rest, {1.0 / found.tau0:.6g} Hz",
        f"intervals and bounds hold in {1e2 * LEVEL:g} % of all cases",
    ]
    for triad in found.triads:
        head = "".join(f"{letter:>30}" for letter in LETTERS)
        lines += ["", f"{_TITLES[triad.kind]:<18} {'unit':<14}{head}"]
        for name in TERMS:
            unit, factor = _UNITS[triad.kind][name]
            cells = "".join(f"{_cell(one.terms[name], factor):>30}" for one in triad.noises)
            lines.append(f"{name:<18} {unit:<14}{cells}")
        told = "".join(f"{triad.curve.tau[one.first]:>30.3g}" for one in triad.noises)
        lines.append(f"{'seen from':<18} {'s':<14}{told}")
        lines.append(f"{'chi-square':<33}" + "".join(f"{_fit(one):>30}" for one in triad.noises))
    return [*lines, "", *config_lines(found)]


def _cell(term: Term, factor: float) -> str:
    if term.value is None:
        return f"below {term.high * factor:.3g}"
    return f"{term.value * factor:.4g} [{term.low * factor:.3g}, {term.high * factor:.3g}]"


def _fit(one: Noises) -> str:
    if one.inflation >= STRANGE:
        return f"{one.chi2:.0f} of {one.freedom}: no such sum"
    wider = f", intervals x {one.inflation:.1f}" if one.inflation > 1.0 else ""
    return f"{one.chi2:.1f} of {one.freedom}{wider}"


def config_lines(found: Found) -> list[str]:
    """Lines of a configuration: of each triad the worst axis, because the filter knows one value for three.

    What does not show, or is no such noise, is a comment, so that a value that is there already stays.
    """
    lines = [f"[navigator.{found.navigator or 'NAME'}.imu_errors]"]
    drifts = False
    for triad in found.triads:
        for name in ("random walk", MARKOV):
            key, factor = _KEYS[triad.kind, name], _UNITS[triad.kind][name][1]
            most = max(one.terms[name].high for one in triad.of_filter) * factor
            strange = [x for x, one in zip(LETTERS, triad.noises, strict=True) if one.inflation >= STRANGE]
            values = [one.terms[name].value or 0.0 for one in triad.of_filter]
            worst = int(np.argmax(values))
            if strange or not values[worst]:
                of = f"cannot be told of {', '.join(strange)}" if strange else "does not show"
                lines.append(f"# {key} {of}: below {most:.3g}")
                continue
            drifts = drifts or name == MARKOV
            lines.append(f"{key} = {values[worst] * factor:.4g}  # {LETTERS[worst]}")
    time = f"correlation_s = {found.correlation:g}"
    if found.told:
        return [*lines, time]
    why = "as configured: the capture is as likely with other times" if drifts else "as configured"
    return [*lines, f"{time}  # {why}"]


def document_of(found: Found) -> dict[str, Any]:
    """All of it as plain tables, in the units of the table."""
    document: dict[str, Any] = {
        "capture": found.capture,
        "device": found.device,
        "seconds": found.seconds,
        "rate_hz": 1.0 / found.tau0,
        "correlation_s": found.correlation,
        "correlation_shown": found.told,
    }
    for triad in found.triads:
        units = _UNITS[triad.kind]
        per = units["instability"][1]
        document[triad.kind] = {
            "tau_s": triad.curve.tau.tolist(),
            "deviation": (triad.curve.deviation * per).T.tolist(),
            "unit": units["instability"][0],
            "axes": {
                letter: {
                    name: {
                        "unit": units[name][0],
                        "value": None if term.value is None else term.value * units[name][1],
                        "interval": [term.low * units[name][1], term.high * units[name][1]],
                    }
                    for name, term in {**one.terms, MARKOV: known.terms[MARKOV]}.items()
                }
                for letter, one, known in zip(LETTERS, triad.noises, triad.of_filter, strict=True)
            },
        }
    return document


def draw(found: Found, path: Path) -> Path:
    """Write the curves with their fitted sums and slopes as PNG; returns ``path``."""
    subtitle = (
        f"{found.capture}: {found.device}, {found.seconds:.0f} s at rest; bars: {1e2 * LEVEL:g} %, lines: "
        "fitted sums, dashes: their parts"
    )
    picture = Picture("Allan deviation", subtitle, rows=2, height=10.0, sharex=True)
    for triad, axes in zip(found.triads, picture.column(), strict=True):
        _panel(triad, axes)
    picture.column()[-1].set_xlabel("averaging time (s)")
    return picture.save(path)


def _panel(triad: Triad, axes: Any) -> None:
    unit, factor = _UNITS[triad.kind]["instability"]
    tau = triad.curve.tau
    lowest = factor * triad.curve.deviation.min()
    for letter, colour, one, y in zip(LETTERS, AXES, triad.noises, triad.curve.deviation.T, strict=True):
        low, high = one.band(y)
        bars = np.maximum(0.0, factor * np.stack((y - low, high - y)))
        axes.errorbar(tau, factor * y, bars, fmt="o", ms=3.5, lw=0.9, color=colour, label=letter)
        if one.inflation < STRANGE:
            axes.plot(tau[one.first :], factor * one.fitted[one.first :], color=colour, lw=1.0)
        for name, term in one.terms.items():
            if term.value is None:
                continue
            own, per = _UNITS[triad.kind][name]
            part = factor * term.value * _AT_ONE_SECOND[name] * tau ** SLOPES[name]
            seen = part > 0.5 * lowest
            label = f"{letter} {name} {term.value * per:.3g} {own}, slope {SLOPES[name]:+g}"
            axes.plot(tau[seen], part[seen], "--", color=colour, lw=0.8, alpha=0.7, label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylabel(f"{_TITLES[triad.kind]} ({unit})")
    axes.tick_params(colors=INK)
    legend(axes)
