"""Heading of a gimballed platform at high latitudes: not turned, turned as printed, and swung.

Zhao Wangyang et al., "Research on High-Latitude Work of Semi-Analytical Inertial Navigation System Based on
Platform Modulation", Dynamical Systems and Control 10(4), 2021, Table 1: largest heading error in 24 h at
four latitudes, conventional and modulated, at rest. The platform is simulated (`platform_bench`); the
computer that torques it is the program's (`nav.platform`, `nav.strapdown.kernels`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bridge.plots.style import BLUE, GREEN, GREY, INK, ORANGE, Picture, legend
from bridge.studies.figures.platform_bench import Bench, cruise
from bridge.studies.figures.result import Result, Row
from nav.earth import EARTH_RATE
from nav.platform import Modulation, heading_drift, heading_limit, swing, uniform, zhao

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DEG_PER_H: Final = math.radians(1.0) / 3600.0
ARCMIN: Final = math.radians(1.0) / 60.0
KNOT: Final = 1852.0 / 3600.0
DAY: Final = 86400.0

GYRO_BIAS: Final = (0.003 * DEG_PER_H, 0.003 * DEG_PER_H, 0.001 * DEG_PER_H)
ACCEL_BIAS: Final = (3e-5 * 9.80665,) * 3
TORQUER: Final = 20e-6
"""Error of the torquers' scale that the laws are compared under; the paper has none."""
RATE: Final = 60.0 * DEG_PER_H
PERIOD: Final = 1800.0
"""Period of the swing, s: a third of Schuler's. Shorter ones gain little more and turn faster."""

TABLE_1: Final = {55: (2.60, 0.55), 65: (3.72, 0.78), 75: (6.31, 1.32), 85: (19.46, 4.10)}
"""Latitude to conventional and modulated heading error in 24 h, arcmin (printed as degrees)."""

CONVENTIONAL: Final = Modulation()
PRINTED: Final = zhao(RATE)
SWING: Final = swing(PERIOD)
LAWS: Final = {"conventional": CONVENTIONAL, "modulated": PRINTED, "swing": SWING}

_UNIT_WHY: Final = "printed in degrees, which 0.003 deg/h cannot make in a day: the unit is arc-minutes"
_LITERAL_WHY: Final = (
    "printed column: gyro errors alone, eq. (19) taken literally (sin L on the rate of 60 deg/h too), "
    "counter-clockwise"
)
_MARGIN: Final = 3.5


def compute() -> Result:
    """Table 1, the other sense and our own law beside it, a voyage to 85 deg, errors by turning rate."""
    table = {lat: {name: _day(lat, law) for name, law in LAWS.items()} for lat in TABLE_1}
    rows: list[Row] = []
    for lat, (conventional, modulated) in TABLE_1.items():
        rows += _latitude(lat, conventional, modulated, table[lat])
    worst = {name: _worst(responses(_bench(85, law), DAY)) for name, law in LAWS.items()}
    rows += _signs(worst)
    rows += _torquer()
    voyage = _voyage()
    rows += _voyage_rows(voyage)
    numbers: dict[str, Any] = {
        "table": {str(lat): cells for lat, cells in table.items()},
        "sweep": _sweep(),
        "day": _histories(),
        "voyage": voyage,
        "rates": _rates(),
    }
    peak = SWING.amplitude * SWING.frequency / DEG_PER_H
    notes = [
        "Largest error of the true heading in 24 h at rest, no errors at the start, gyros reading 0.003, "
        "0.003, 0.001 deg/h and accelerometers 3e-5 g too much along x, y, z of the platform, east-north-up "
        "at the start. Closed form: gyro errors alone, without Schuler's oscillation.",
        f"Modulated: eq. (19), {RATE / DEG_PER_H:.0f} deg/h + w_ie sin L counter-clockwise. "
        f"Swing, our own law: k = A (cos(2 pi t/{PERIOD / 60:.0f} min) - 1), J0(A) = 0, at most "
        f"{peak:.0f} deg/h; it begins at rest, never jumps, and level errors average out in each period.",
        "How much turning one way gains hangs on the signs of the biases and on its sense: at 85 deg with "
        f"the printed signs {table[85]['conventional'] / table[85]['modulated']:.1f} times, worst signs of "
        f"each compared {worst['conventional'] / worst['modulated']:.1f} times.",
        "Why not just one way: a platform that turns slower than Schuler's 255 deg/h leaves the "
        "accelerometers' biases as they are, near 255 deg/h makes them worse, and above it an error of the "
        "torquer's scale drifts. To and fro it stays below 2 A times the error. The price is the rate: gyros "
        "that bear no more than the paper's 60 deg/h cannot be swung so fast, and turning one way at their "
        "limit is then the best in the long run: the integral of a turning level error is a path whose "
        "curvature is the rate, and no path of bounded curvature fits into a smaller circle.",
    ]
    return Result("Heading of a gimballed platform at high latitudes, 24 h", rows, notes, numbers)


def responses(bench: Bench, seconds: float, torquer: bool = False) -> Matrix:
    """Heading errors (5 or 6, M), arcmin, of each bias alone, and with ``torquer`` of the torquers' scale.

    The rounding of a run without errors is taken off; errors of this size add.
    """
    none = cruise(bench, seconds).heading_error
    single = [replace(bench, gyro_bias=one) for one in _alone(GYRO_BIAS)]
    single += [replace(bench, accel_bias=one) for one in _alone(ACCEL_BIAS)[:2]]  # the third moves no heading
    single += [replace(bench, torquer=TORQUER)] if torquer else []
    return np.array([cruise(one, seconds).heading_error - none for one in single]) / ARCMIN


def _alone(biases: tuple[float, ...]) -> list[tuple[float, float, float]]:
    rows = np.diag(biases).tolist()
    return [(a, b, c) for a, b, c in rows]


def _worst(each: Matrix) -> float:
    """Largest error under any signs of the biases."""
    return float(np.abs(each).sum(axis=0).max())


def _bench(lat: float, law: Modulation, **changes: Any) -> Bench:
    """Cycles short enough that the platform turns by no more than half a degree in one."""
    fast = max(abs(law.rate), law.amplitude * law.frequency)
    dt = 1.0 if fast > 1000.0 * DEG_PER_H else 4.0 if fast < 200.0 * DEG_PER_H else 2.0
    return replace(Bench(math.radians(lat), law, dt=dt), **changes)


def _biased(lat: float, law: Modulation, **changes: Any) -> Bench:
    return _bench(lat, law, **({"gyro_bias": GYRO_BIAS, "accel_bias": ACCEL_BIAS} | changes))


def _day(lat: float, law: Modulation, **changes: Any) -> float:
    """Largest heading error of a day, arcmin."""
    return float(np.abs(cruise(_biased(lat, law, **changes), DAY).heading_error).max()) / ARCMIN


def _latitude(lat: int, conventional: float, modulated: float, ours: dict[str, float]) -> list[Row]:
    radians = math.radians(lat)
    plain, turned, swung = (ours[name] for name in LAWS)
    literal = Modulation(free=PRINTED.free, rate=RATE * math.sin(radians))
    gyros = _day(lat, literal, accel_bias=(0.0, 0.0, 0.0))
    t = np.arange(0.0, DAY + 1.0, 120.0)
    drift = heading_drift(t, radians, GYRO_BIAS, literal.rate + EARTH_RATE * math.sin(radians))
    return [
        Row(
            f"{lat} deg conventional",
            conventional,
            plain,
            "2 % of the printed",
            abs(plain - conventional) <= 0.02 * conventional,
            "arcmin",
            _UNIT_WHY,
            heading_limit(radians, GYRO_BIAS) / ARCMIN,
        ),
        Row(
            f"{lat} deg modulated",
            modulated,
            turned,
            f"conventional / {_MARGIN:g}",
            turned <= plain / _MARGIN,
            "arcmin",
        ),
        Row(
            f"{lat} deg modulated, gyros alone, literal (19)",
            modulated,
            gyros,
            "7 % of the printed",
            abs(gyros - modulated) <= 0.07 * modulated,
            "arcmin",
            _LITERAL_WHY,
            float(np.abs(drift).max()) / ARCMIN,
        ),
        Row(
            f"{lat} deg modulated, other sense",
            None,
            _day(lat, zhao(-RATE)),
            "",
            None,
            "arcmin",
            "eq. (19) with k as in eq. (4): with these signs of the biases the larger of the two",
        ),
        Row(f"{lat} deg swing", None, swung, "below modulated", swung < turned, "arcmin"),
    ]


def _signs(worst: dict[str, float]) -> list[Row]:
    limits = {"conventional": math.inf, "modulated": worst["conventional"], "swing": worst["modulated"] / 3.0}
    asked = {"conventional": "", "modulated": "below conventional", "swing": "modulated / 3"}
    return [
        Row(
            f"85 deg {name}, worst signs of the biases",
            None,
            value,
            asked[name],
            value < limits[name] if asked[name] else None,
            "arcmin",
        )
        for name, value in worst.items()
    ]


def _torquer() -> list[Row]:
    """The day at 85 degrees with torquers that are a little wrong; one way as fast as the swing too."""
    one_way = uniform(SWING.amplitude * SWING.frequency)
    cells = {
        name: _day(85, law, torquer=TORQUER)
        for name, law in {**LAWS, "one way, swing's rate": one_way}.items()
    }
    limit = cells["modulated"] / 3.0
    return [
        Row(
            f"85 deg {name}, torquers {TORQUER * 1e6:.0f} ppm",
            None,
            value,
            "modulated / 3" if name == "swing" else "",
            value < limit if name == "swing" else None,
            "arcmin",
        )
        for name, value in cells.items()
    ]


def _voyage() -> dict[str, list[float]]:
    """From 45 degrees northwards at 5 kn for 20 days: largest error of each day, arcmin.

    Its smallest, median and largest value over all signs of the biases (sixteen: the others turn the error's
    sign alone), and its value with all of them positive.
    """
    days = 20
    signs = np.array([[1.0, *(1.0 - 2.0 * (n >> k & 1) for k in range(4))] for n in range(16)])
    out: dict[str, list[float]] = {}
    for name, law in LAWS.items():
        bench = _bench(45, law, speed=5.0 * KNOT)
        bench = replace(bench, dt=3.0 if law is SWING else 6.0)
        if not out:
            lat = cruise(bench, days * DAY).lat.reshape(days, -1)
            out["lat_deg"] = np.degrees(lat.mean(axis=1)).tolist()
        each = signs @ responses(bench, days * DAY)
        largest = np.abs(each).reshape(len(signs), days, -1).max(axis=2)
        for label, value in zip(
            ("least", "median", "most"), np.quantile(largest, [0.0, 0.5, 1.0], axis=0), strict=True
        ):
            out[f"{name} {label}"] = value.tolist()
        out[f"{name} positive"] = largest[0].tolist()
    return out


def _voyage_rows(voyage: dict[str, list[float]]) -> list[Row]:
    last = f"voyage, day at {voyage['lat_deg'][-1]:.0f} deg"
    rows = [
        Row(f"{last}, {name}, median", None, voyage[f"{name} median"][-1], "", None, "arcmin")
        for name in LAWS
    ]
    pairs = (("modulated", "conventional"), ("swing", "modulated"))
    for better, than in pairs:
        ratio = np.divide(voyage[f"{better} most"], voyage[f"{than} most"])
        share = float(ratio.max())
        name = f"voyage, {better} / {than}, worst signs, worst day"
        rows.append(Row(name, None, share, "below 1", share < 1.0, ""))
    return rows


def _sweep() -> dict[str, list[float]]:
    """Largest error of a day at rest, arcmin, by latitude."""
    lats = [45.0 + 2.5 * k for k in range(17)]
    out = {"lat_deg": lats}
    for name, law in LAWS.items():
        out[name] = [_day(lat, law) for lat in lats]
    out["closed form"] = [heading_limit(math.radians(lat), GYRO_BIAS) / ARCMIN for lat in lats]
    return out


def _histories() -> dict[str, list[float]]:
    """Heading errors over a day at 85 degrees, arcmin."""
    runs = {name: cruise(_biased(85, law), DAY, every=300.0) for name, law in LAWS.items()}
    out = {name: (run.heading_error / ARCMIN).tolist() for name, run in runs.items()}
    return {"hours": (runs["swing"].t / 3600.0).tolist(), **out}


def _rates() -> dict[str, list[dict[str, float]]]:
    """Worst error of a day at 85 degrees over signs, with and without the torquers' error, by rate."""
    one_way = (15.0, 30.0, 60.0, 90.0, 120.0, 160.0, 200.0, 300.0, 400.0, 600.0, 900.0, 1300.0, 1800.0)
    minutes = (300.0, 200.0, 150.0, 120.0, 70.0, 60.0, 50.0, 40.0, 30.0)
    laws = {
        "one way": [(rate, uniform(rate * DEG_PER_H)) for rate in one_way],
        "swing": [
            (law.amplitude * law.frequency / DEG_PER_H, law) for law in (swing(60.0 * one) for one in minutes)
        ],
    }
    out: dict[str, list[dict[str, float]]] = {}
    for name, entries in laws.items():
        out[name] = []
        for rate, law in entries:
            each = responses(_bench(85, law, dt=3.0), DAY, torquer=True)
            point = {"deg_per_h": rate, "biases": _worst(each[:5]), "with torquer": _worst(each)}
            out[name].append(point)
    return out


def draw(result: Result, path: Path) -> None:
    """A day at 85 degrees, days by latitude, the voyage, and the worst day by turning rate."""
    colours = dict(zip(LAWS, (ORANGE, BLUE, GREEN), strict=True))
    picture = Picture(
        "Heading error of a gimballed platform at high latitudes",
        "conventional; turned one way as printed (60 deg/h); swung to and fro in "
        f"{PERIOD / 60:.0f} min. Squares: Table 1 in arc-minutes",
        rows=2,
        columns=2,
        height=7.4,
    )
    (day, sweep), (voyage, rates) = picture.axes
    numbers = result.numbers
    for name, colour in colours.items():
        day.plot(numbers["day"]["hours"], numbers["day"][name], color=colour, label=name)
        sweep.plot(numbers["sweep"]["lat_deg"], numbers["sweep"][name], color=colour, label=name)
        lat = numbers["voyage"]["lat_deg"]
        low, high = numbers["voyage"][f"{name} least"], numbers["voyage"][f"{name} most"]
        voyage.fill_between(lat, low, high, color=colour, alpha=0.18, linewidth=0.0)
        voyage.plot(lat, numbers["voyage"][f"{name} median"], color=colour, label=name)
    sweep.plot(
        numbers["sweep"]["lat_deg"],
        numbers["sweep"]["closed form"],
        "--",
        color=INK,
        lw=0.8,
        label="closed form",
    )
    for k, colour in enumerate((ORANGE, BLUE)):
        printed = [cells[k] for cells in TABLE_1.values()]
        sweep.plot(list(TABLE_1), printed, "s", ms=7, mfc="none", color=colour)
    for name, colour in (("one way", BLUE), ("swing", GREEN)):
        points = numbers["rates"][name]
        x = [point["deg_per_h"] for point in points]
        rates.plot(x, [point["biases"] for point in points], "o-", ms=3.5, color=colour, label=name)
        label = f"{name}, torquers {TORQUER * 1e6:.0f} ppm"
        rates.plot(x, [point["with torquer"] for point in points], "o--", ms=3.5, color=colour, label=label)
    rates.axvline(255.0, color=GREY, lw=0.8)
    rates.set_xscale("log")
    for axes in (sweep, voyage, rates):
        axes.set_yscale("log")
    day.set_xlabel("hours at rest at 85 deg")
    sweep.set_xlabel("latitude at rest (deg)")
    voyage.set_xlabel("latitude of a day at 5 kn north (deg); bands: signs")
    rates.set_xlabel("largest rate (deg/h), 85 deg, worst signs; grey: Schuler")
    day.set_ylabel("heading error (arcmin)")
    for axes in (sweep, voyage, rates):
        axes.set_ylabel("largest error in 24 h (arcmin)")
    legend(sweep)
    legend(rates)
    picture.save(path)
