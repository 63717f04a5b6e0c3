"""Asymmetry of accelerometers on orthogonal and skewed axes: three ways to calibrate it, and what they cost.

Luo Rui, Li Peng, Yu Lingyan 2023: the conventional and the iterative method in twelve positions, beside the
joint solution that ``navbridge calibrate`` runs, on sensors without noise, and the navigation of 5100 s with
flips that the paper judges them by, over many units instead of one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from bridge.calibration_plan import Site, load
from bridge.plots.style import BLUE, GREEN, GREY, ORANGE, Picture, legend
from bridge.studies.figures.redundant_flights import RATE_HZ, TURN_S, Flips, distance
from bridge.studies.figures.result import Result, Row
from bridge.studies.workers import Progress
from nav.calibrate.coefficients import coefficients
from nav.calibrate.intervals import Interval, Place
from nav.calibrate.model import Model, Terms, sensor
from nav.calibrate.observability import observe, propose
from nav.calibrate.plan import Position, Step, planned
from nav.calibrate.sequential import Sequential, conventional, iterate, turned
from nav.calibrate.solve import Noise, fit
from nav.imu.geometry import cone, with_skew
from nav.types import Vector

G: Final = 9.80665
UG: Final = 1e-6 * G
ASYMMETRY: Final = 6e-4
BIAS: Final = 1e-4 * G
PULSE: Final = 2e-5  # m/s
LAW: Final = 0.01
ALONG_X: Final = np.array([1.0, 1e-3, 1e-3]) / math.sqrt(1.0 + 2e-6)
"""Not quite: both methods take a reading to have the sign of the axis' component."""
UNITS: Final = 100
SEED: Final = 1
SECONDS: Final = 5100.0
FLIP_S: Final = 300.0
PASSES: Final = 60
DRIFT: Final = math.radians(0.05) / 3600.0  # rad/s, the paper's gyros
_NEAR: Final = 1e-6 * G
_SITE: Final = Site(39.9, 50.0)
_NOISE: Final = Noise(1e-9, 1e-12, 1e-9, 1e-12, 1000.0)


def _faces(name: str = "positions_12") -> list[Step]:
    return [step for step in load(name).steps if isinstance(step, Position)]


def _place() -> Place:
    """A table that stands perfectly."""
    return replace(load("positions_12").at(_SITE)[1], tilt=1e-12, north=1e-12, gravity_sigma=1e-12)


def _count(steps: Sequence[Step], axes: Vector, plus: Vector, minus: Vector, bias: Vector) -> list[Interval]:
    """What accelerometers along ``axes`` (n, 3) count, plus and minus pulses per m/s, without noise."""
    f_g, found = _place().f_g, []
    for interval in planned(steps):
        out = axes @ (interval.attitude @ f_g) + bias * interval.seconds
        found.append(replace(interval, plus=plus * np.maximum(out, 0.0), minus=minus * np.maximum(-out, 0.0)))
    return found


def _model(axes: Vector) -> Model:
    return Model(
        tuple(sensor(f"accelerometer {k + 1}", False, a, PULSE, Terms()) for k, a in enumerate(axes)),
        _place(),
    )


def _joint(axes: Vector, intervals: Sequence[Interval]) -> tuple[list[Sequential], int]:
    """The joint solution in the words of the others, and its Gauss-Newton steps."""
    found = fit(_model(axes), intervals, _NOISE)
    value = coefficients(found, False).value
    length = np.linalg.norm(value["axes"], axis=1)
    each = zip(value["scale"], value["scale_negative"], value["bias"], value["axes"], length, strict=True)
    said = [Sequential(float(n / p), float(n / m), float(b / n), a / n) for p, m, b, a, n in each]
    return said, found.steps


def _one(axis: Vector, asymmetry: float = ASYMMETRY) -> tuple[Sequential, Vector]:
    """The conventional method on one axis, and the iterative one's error of the bias pass by pass, m/s^2."""
    up, down = (1.0 + 0.5 * asymmetry) / PULSE, (1.0 - 0.5 * asymmetry) / PULSE
    intervals = _count(_faces(), axis[None], np.array([up]), np.array([down]), np.array([BIAS]))
    rates, g = turned(intervals, 0), _place().gravity
    passes = iterate(rates, g, PASSES)
    return conventional(rates, g), np.array([one.bias - BIAS for one in passes])


def _laws() -> list[Row]:
    """The first-order laws on every kind of axis of both units."""
    rows = []
    kinds = {"along x": ALONG_X, "S": with_skew()[3], "cone, 1st": cone()[0], "cone, 2nd": cone()[1]}
    for name, axis in kinds.items():
        usual, error = _one(axis)
        S, largest = float(np.abs(axis).sum()), float(np.abs(axis).max())
        law = ASYMMETRY * S / 6.0 * _place().gravity / UG
        ours = (usual.bias - BIAS) / UG
        rows.append(_law(f"{name}: bias error, conventional", ours, law, "ug"))
        share, expected = usual.asymmetry / ASYMMETRY, 1.0 - S / (3.0 * largest)
        # at equal angles nothing of the asymmetry is left, which has no percentage
        small = abs(expected) < LAW
        rows.append(
            Row(
                f"{name}: share of the asymmetry it shows",
                2.0 / 3.0 if name == "along x" else None,
                share,
                f"{LAW:g} of the law" if not small else f"within {LAW:g}",
                abs(share - expected) <= LAW * (1.0 if small else abs(expected)),
                "",
                exact=expected,
            )
        )
        rows.append(_law(f"{name}: error left by a pass", float(error[3] / error[2]), S * S / 3.0, ""))
    return rows


def _law(name: str, ours: float, exact: float, unit: str) -> Row:
    return Row(
        name, None, ours, f"{LAW:g} of the law", abs(ours - exact) <= LAW * abs(exact), unit, exact=exact
    )


def _passes(axis: Vector, asymmetry: float = ASYMMETRY) -> float:
    """Passes until the bias is within 1e-6 g; not a number where `PASSES` are not enough."""
    error = np.abs(_one(axis, asymmetry)[1])
    near = np.flatnonzero(error < _NEAR)
    return float(near[0]) + 1.0 if len(near) else math.nan


def _skewed() -> tuple[list[Row], str]:
    """What twelve face positions do not show of S and T, and what is proposed does."""
    axes, steps = with_skew(), _faces()
    model = _model(axes)
    seen = observe(model, steps, _NOISE)
    more = propose(model, steps, _NOISE, 60.0)
    after = observe(model, [*steps, *more], _NOISE)
    n = len(axes)
    rng = np.random.default_rng(SEED)
    unit = _draw(axes, rng)
    found, _ = _joint(axes, _count([*steps, *more], *unit))
    error = float(max(abs(one.bias - b) for one, b in zip(found, unit[3], strict=True))) / UG
    asymmetry = [float(2.0 * (p - m) / (p + m)) for p, m in zip(*unit[1:3], strict=True)]
    uneven = max(abs(one.asymmetry - known) for one, known in zip(found, asymmetry, strict=True))
    named = "; ".join(", ".join(names) for names in seen.unseen)
    rows = [
        Row(
            "S, T: directions that 12 faces do not show",
            None,
            len(seen.unseen),
            "2",
            len(seen.unseen) == 2,
            "",
            exact=2.0,
        ),
        Row("attitudes proposed", None, len(more), "1 or more", len(more) > 0, ""),
        Row("not shown with these", None, len(after.unseen), "0", not after.unseen, "", exact=0.0),
        Row(
            f"largest bias error of {n}, joint, with these",
            None,
            error,
            "0.001 ug",
            error < 1e-3,
            "ug",
            exact=0.0,
        ),
        Row(
            "largest asymmetry error, likewise",
            None,
            1e6 * uneven,
            "0.001 ppm",
            uneven < 1e-9,
            "ppm",
            exact=0.0,
        ),
    ]
    return rows, named


def _steps() -> list[Row]:
    """How long each takes."""
    rng = np.random.default_rng(SEED)
    axes = cone()
    found, steps = _joint(axes, _count(_faces(), *(unit := _draw(axes, rng))))
    error = float(max(abs(one.bias - b) for one, b in zip(found, unit[3], strict=True))) / UG
    slow = [_passes(axis) for axis in axes]
    many = [one for one in slow if math.isnan(one)]
    return [
        Row("passes to 1e-6 g along x", 7.0, _passes(ALONG_X), "", None, "", _UNSAID),
        Row("the same with 2 % asymmetry", 7.0, _passes(ALONG_X, 0.02), "", None, "", _UNSAID),
        Row(f"cone: sensors not there after {PASSES} passes", None, len(many), "", None, ""),
        Row("cone: Gauss-Newton steps of the joint solution", None, steps, "at most 3", steps <= 3, ""),
        Row("cone: its largest bias error", None, error, "0.001 ug", error < 1e-3, "ug", exact=0.0),
    ]


_UNSAID: Final = "the paper reads 5 to 7 passes off a curve and prints neither the asymmetry nor a limit"


def _draw(axes: Vector, rng: np.random.Generator) -> tuple[Vector, Vector, Vector, Vector]:
    """Axes, pulses per m/s up and down, and biases of one unit."""
    n = len(axes)
    real = axes + 4e-4 * rng.standard_normal((n, 3))
    real /= np.linalg.norm(real, axis=1, keepdims=True)
    scale = (1.0 + 1e-3 * rng.standard_normal(n)) / PULSE
    uneven = ASYMMETRY * rng.standard_normal(n)
    return real, scale * (1.0 + 0.5 * uneven), scale * (1.0 - 0.5 * uneven), 2e-3 * G * rng.standard_normal(n)


def _flights(units: int, progress: Progress | None) -> dict[str, Vector]:
    """Distance from the true place (units,) m after 5100 s with a flip every five minutes, by method."""
    place = _place()
    attitudes = [step.C_gb for step in _faces()]
    count = round(SECONDS / FLIP_S)
    turns = [attitudes[k % len(attitudes)] for k in range(count)]
    flips = Flips(_SITE.lat_deg, _SITE.height_m, turns, FLIP_S)
    sensed = list(flips)
    distances: dict[str, list[float]] = {"conventional": [], "iterative": [], "joint": []}
    rng = np.random.default_rng(SEED)
    axes = with_skew()
    for done in range(units):
        unit = _draw(axes, rng)
        drift = DRIFT * rng.standard_normal(3)
        twelve = _count(_faces(), *unit)
        rates = [turned(twelve, k) for k in range(len(axes))]
        said = {
            "conventional": [conventional(one, place.gravity) for one in rates],
            "iterative": [iterate(one, place.gravity, PASSES)[-1] for one in rates],
            "joint": _joint(axes, _count(_faces("positions_18"), *unit))[0],
        }
        for method, of in said.items():
            distances[method].append(distance(flips, sensed, of, unit, drift))
        if progress is not None:
            progress(done + 1, units)
    return {method: np.array(found) for method, found in distances.items()}


def compute(runs: int = UNITS, progress: Progress | None = None, **_options: Any) -> Result:
    """Laws and steps on single axes, and the navigation of so many units."""
    skewed, named = _skewed()
    rows = [*_laws(), *skewed, *_steps()]
    flights = _flights(runs, progress)
    for better, worse in (("iterative", "conventional"), ("joint", "conventional")):
        gain = flights[worse] - flights[better]
        share = 100.0 * gain / flights[worse]
        for name, values, published, unit in (("gain", gain, 400.0, "m"), ("share", share, 13.3, "%")):
            low, high = (float(one) for one in np.quantile(values, (0.05, 0.95)))
            printed = published if better == "iterative" else None
            text = f"{better} over {worse} after {SECONDS:g} s: median {name}"
            rows.append(Row(text, printed, float(np.median(values)), "", None, unit, _ONE_UNIT))
            rows.append(Row(f"{text}, 5 % of units below", None, low, "", None, unit))
            rows.append(Row(f"{text}, 95 % below", None, high, "", None, unit))
        as_much = 100.0 * float(np.mean(gain >= 400.0))
        text = f"{better}: units that gain the published 400 m or more"
        rows.append(Row(text, None, as_much, "", None, "%"))
    notes = [
        f"Asymmetry {1e6 * ASYMMETRY:g} ppm and bias {1e6 * BIAS / G:g} ug on single axes; one sigma of "
        f"{1e6 * ASYMMETRY:g} ppm and 2000 ug on units. No noise: what is left are the methods' own errors.",
        f"12 face positions do not show of the skewed axes: {named}.",
        f"Navigation: {runs} five-axis units, a flip of {TURN_S:g} s every {FLIP_S:g} s through the twelve "
        f"positions, counts at {RATE_HZ:g} Hz through the strapdown kernel; gyro drifts of 0.05 deg/h that "
        "no method changes, height held, levelled by the unit itself, heading known. A negative gain is a "
        "unit that is worse off.",
    ]
    numbers = {
        "flights": {name: values.tolist() for name, values in flights.items()},
        "passes": {
            name: np.abs(_one(axis)[1] / G).tolist()
            for name, axis in (("along x", ALONG_X), ("cone, 1st", cone()[0]), ("S", with_skew()[3]))
        },
    }
    return Result("Asymmetry of accelerometers on skewed axes", rows, notes, numbers)


_ONE_UNIT: Final = "the paper flies one unit once, and prints neither its asymmetries nor its flips"


def draw(result: Result, path: Path) -> None:
    """Error of the bias over the passes, and what the calibrations are worth to navigation."""
    picture = Picture(result.title, "error of the bias pass by pass; distance after 5100 s", rows=2)
    upper, lower = picture.column()
    for (name, values), colour in zip(result.numbers["passes"].items(), (BLUE, ORANGE, GREEN), strict=True):
        upper.semilogy(np.arange(1, len(values) + 1), values, color=colour, label=f"{name}, iterative")
    upper.axhline(_NEAR / G, color=GREY, linestyle="--", label="1e-6 g")
    upper.set_ylim(1e-12, 1e-2)
    upper.set_xlabel("pass")
    upper.set_ylabel("error of the bias, g")
    legend(upper)
    flights = {name: np.array(values) for name, values in result.numbers["flights"].items()}
    for name, colour in (("iterative", ORANGE), ("joint", BLUE)):
        gain = flights["conventional"] - flights[name]
        lower.hist(gain, bins=30, color=colour, alpha=0.5, label=f"{name}, median {np.median(gain):.0f} m")
    lower.axvline(400.0, color=GREY, linestyle="--", label="published, 400 m")
    lower.set_xlabel("nearer to the true place than the conventional method, m")
    lower.set_ylabel("units")
    legend(lower)
    picture.save(path)
