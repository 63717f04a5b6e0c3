"""Dithered laser gyros latched at whole cycles: what it costs on a cone, and what each correction leaves.

Yan Gongmin, "On SINS In-movement Initial Alignment and Some Other Problems", 2008, chapter 6: Table 6-1 with
the program's corrections and navigation, beside the exact drift of the two-sample algorithm with gyros that
are read at the instants; and the program's own correction, there and over random dithers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from bridge.plots.style import BLUE, GREEN, GREY, INK, ORANGE, RED, Picture, legend
from bridge.studies.figures.coning import exact_drift
from bridge.studies.figures.coning_exact import PI
from bridge.studies.figures.laser_runs import ARCMIN, SAMPLE_NS, SECONDS, Cone, Run
from bridge.studies.figures.result import Result, Row
from nav.imu.whole_cycle import METHODS
from virtual_bus.dither import CYCLE, Dither

OURS: Final = "sextic+septic"
PRINTED: Final = "linear+parabolic"
CELLS: Final = ("ideal", "whole cycle", "constant", "linear", "parabolic", PRINTED)


class Case(NamedTuple):
    """A line of Table 6-1: dithers (Hz), half angle (deg) and frequency (Hz) of the cone, drifts (arcmin)."""

    dithers: tuple[int, int, int]
    alpha_deg: int
    frequency: int
    printed: tuple[float, ...]


TABLE_6_1: Final = (
    Case((370, 359, 408), 10, 1, (0.1, 18.4, -104.7, -0.3, 0.3, 0.1)),
    Case((370, 359, 408), 1, 3, (0.2, 0.6, -30.6, -0.4, 0.9, 0.3)),
    Case((370, 340, 408), 1, 5, (3.2, 24.2, -115.8, -4.5, 10.0, 2.7)),
    Case((380, 359, 408), 1, 5, (3.2, 17.4, -131.5, -5.2, 11.1, 3.0)),
    Case((370, 340, 400), 1, 3, (0.2, 2.1, -27.7, -0.4, 0.9, 0.2)),
    Case((370, 340, 400), 1, 5, (3.2, 24.3, -115.1, -4.5, 9.9, 2.7)),
)
PICTURED: Final = Case((370, 359, 408), 1, 5, (3.0, 47.0, math.nan, -6.0, math.nan, math.nan))
"""The case of Figures 6-6 and 6-8, drifts as the text reads them off."""

TOLERANCE: Final = 0.1  # of the printed last digit, which is rounded or cut
SETS: Final = 100
SEED: Final = 6
_LOW_MHZ: Final = 300_000
_HIGH_MHZ: Final = 450_000

_OTHER_X: Final = (
    "the printed dither of X, 370 Hz, is a misprint: it gives {:.1f} arcmin whole cycle, {:.1f} constant; "
    "with 380 Hz, taken here, five of the six cells are the printed ones"
)
_LINEAR_1: Final = "with 380 Hz the linear cell rounds to -0.2: what is printed is not of the same run"
_CONSTANT_3: Final = (
    "lines 3 and 6 differ in the dither of Z alone, whose rate is constant: their cells must be equal, as "
    "ours are and as all others printed nearly are; -115.1 of line 6 is right"
)
_PICTURE: Final = (
    "read off a figure; it hangs on the phases of the dithers, which are not told: three others than "
    "together give {:.1f} to {:.1f}"
)


def _cone(case: Case) -> Cone:
    return Cone(math.radians(case.alpha_deg), 2.0 * math.pi * case.frequency)


def _run(case: Case) -> Run:
    return Run(_cone(case), [Dither(1000 * one) for one in case.dithers])


def exact_ideal(case: Case) -> float:
    """Drift of the two-sample algorithm, true minus computed, arcmin, without rounding."""
    lam = 2 * PI * case.frequency * SAMPLE_NS / 10**9
    update = exact_drift(case.alpha_deg * PI / 180, Decimal(lam), 2)
    return -float(update) * (SECONDS * 10**9 // (2 * SAMPLE_NS)) / ARCMIN


def _line(case: Case) -> dict[str, float]:
    """Drifts (arcmin) of a line by the names of its cells, and with our correction."""
    run, ideal = _run(case), Run(_cone(case), None)
    drifts = {"ideal": ideal.drift(ideal.read()), "whole cycle": run.drift(run.read())}
    return drifts | run.drifts(METHODS)


def compute() -> Result:
    """Table 6-1, the figure's case, and the corrections over random dithers."""
    rows, lines = [], []
    other = _line(TABLE_6_1[0])
    for number, case in enumerate(TABLE_6_1, 1):
        taken = case._replace(dithers=(380, *case.dithers[1:])) if number == 1 else case
        drifts = _line(taken)
        lines.append({"case": [*taken.dithers, case.alpha_deg, case.frequency], "drifts": drifts})
        for name, printed in zip(CELLS, case.printed, strict=True):
            why = _OTHER_X.format(other["whole cycle"], other["constant"]) if number == 1 else ""
            rows.append(_cell(number, name, printed, drifts[name], why, taken))
        rows.append(Row(f"{number} {OURS}", None, drifts[OURS], "", None, "arcmin", "", drifts["ideal"]))
    rows += _distances(lines)
    sets = random_sets(SETS)
    rows += _spread(sets)
    rows += _noise()
    rows += _picture_rows()
    notes = [
        "Drift of the azimuth in 600 s, true minus computed, of cones sampled at 100 Hz and navigated by the "
        "two-sample algorithm. Closed form: that algorithm with gyros that are read at the instants, without "
        "rounding; beside our correction, what it gave in double precision. Latch times are computed in "
        "integers: in floating point some cycles are missed, which moves a whole-cycle cell by arc-minutes.",
        f"Random: {SETS} sets of three dithers of {_LOW_MHZ // 1000} to {_HIGH_MHZ // 1000} Hz with random "
        "phases, on the three cones of the table in turn, gyros running before the start; distance from the "
        "drift of gyros that are read at the instants.",
        "Noise: that of the angle at an instant over that of a latch, dithers of line 3.",
    ]
    return Result("Laser gyros latched at whole cycles", rows, notes, {"lines": lines, "random": sets})


def _cell(number: int, name: str, printed: float, ours: float, why: str, case: Case) -> Row:
    exact = exact_ideal(case) if name == "ideal" else None
    passed: bool | None = abs(ours - printed) <= TOLERANCE
    tolerance = f"{TOLERANCE:g}"
    if (number, name) in ((1, "linear"), (3, "constant")):
        passed, tolerance = None, ""
        why = _LINEAR_1 if number == 1 else _CONSTANT_3
    if exact is not None:
        passed = passed and abs(ours - exact) <= 1e-6
        tolerance += ", 1e-6 of closed form"
    return Row(f"{number} {name}", printed, ours, tolerance, passed, "arcmin", why, exact)


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def _distances(lines: Sequence[dict[str, Any]]) -> list[Row]:
    """Root mean square distance of the columns from the ideal one."""
    ours = {
        name: _rms([line["drifts"][name] - line["drifts"]["ideal"] for line in lines])
        for name in (*CELLS[1:], OURS)
    }
    rows = []
    for place, name in enumerate(CELLS[1:], 1):
        printed = _rms([case.printed[place] - case.printed[0] for case in TABLE_6_1])
        rows.append(Row(f"rms to ideal, {name}", printed, ours[name], "", None, "arcmin"))
    better = ours[OURS] < ours[PRINTED]
    return [*rows, Row(f"rms to ideal, {OURS}", None, ours[OURS], f"< {PRINTED}", better, "arcmin")]


def random_sets(count: int) -> dict[str, list[float]]:
    """Distances (arcmin) from the ideal drift over random dithers, by method; ``count`` sets of one seed."""
    rng = np.random.default_rng(SEED)
    cones = [_cone(case) for case in TABLE_6_1[:3]]
    read = [Run(cone, None) for cone in cones]
    ideal = [run.drift(run.read()) for run in read]
    methods = {name: METHODS[name] for name in (PRINTED, OURS)}
    out: dict[str, list[float]] = {name: [] for name in methods}
    for k in range(count):
        dithers = [
            Dither(int(mhz), int(phase))
            for mhz, phase in zip(
                rng.integers(_LOW_MHZ, _HIGH_MHZ + 1, 3), rng.integers(0, CYCLE, 3), strict=True
            )
        ]
        run = Run(cones[k % 3], dithers, together=False)
        for name, drift in run.drifts(methods).items():
            out[name].append(drift - ideal[k % 3])
    return out


def _spread(sets: dict[str, list[float]]) -> list[Row]:
    rows = []
    for name, distances in sets.items():
        ours = name == OURS
        better = _rms(distances) < _rms(sets[PRINTED]) if ours else None
        asked = f"< {PRINTED}" if ours else ""
        rows.append(Row(f"random rms, {name}", None, _rms(distances), asked, better, "arcmin"))
        largest = max(map(abs, distances))
        rows.append(Row(f"random largest, {name}", None, largest, "", None, "arcmin"))
    return rows


def _noise() -> list[Row]:
    """What each correction makes of white noise at the latches."""
    run = _run(TABLE_6_1[2])
    rng = np.random.default_rng(SEED)
    return [
        Row(f"noise, {name}", None, run.magnified(method, rng), "", None, "of a latch's")
        for name, method in METHODS.items()
    ]


def _picture_rows() -> list[Row]:
    drifts = _line(PICTURED)
    cone = _cone(PICTURED)
    # the same dithers from other phases: X half a cycle, Y half a cycle, both a quarter against each other
    phases = [(CYCLE // 2, 0), (0, CYCLE // 2), (CYCLE // 4, 3 * CYCLE // 4)]
    others = []
    for phase in phases:
        dithers = [Dither(1000 * f, p) for f, p in zip(PICTURED.dithers, (*phase, 0), strict=True)]
        run = Run(cone, dithers)
        others.append({"whole cycle": run.drift(run.read()), **run.drifts({"linear": METHODS["linear"]})})
    rows = []
    for name, printed in zip(CELLS, PICTURED.printed, strict=True):
        if not math.isnan(printed):
            spread = [one[name] for one in others if name in one]
            why = _PICTURE.format(min(spread), max(spread)) if spread else ""
            rows.append(Row(f"Figure 6-8 {name}", printed, drifts[name], "", None, "arcmin", why))
    return rows


def draw(result: Result, path: Path) -> None:
    """Distances from the ideal drift: of the table's columns, and over the random dithers."""
    picture = Picture(
        "What whole-cycle latching leaves after each correction",
        "distance of the azimuth drift in 600 s from that of gyros read at the instants; squares: printed",
        columns=2,
        height=5.4,
        width_ratios=(1.25, 1.0),
    )
    left, right = picture.axes[0]
    colours = dict(zip((*CELLS[1:], OURS), (INK, GREY, ORANGE, RED, BLUE, GREEN), strict=True))
    lines = result.numbers["lines"]
    for place, (name, colour) in enumerate(colours.items()):
        offset = 0.11 * (place - 2.5)
        x = [k + offset for k in range(len(lines))]
        y = [abs(line["drifts"][name] - line["drifts"]["ideal"]) for line in lines]
        left.vlines(x, 1e-4, y, color=colour, lw=2.2, alpha=0.55)
        left.plot(x, y, "o", color=colour, ms=4.5, label=name)
        if name in CELLS:
            cell = CELLS.index(name)
            printed = [abs(case.printed[cell] - case.printed[0]) for case in TABLE_6_1]
            kept = [(a, b) for a, b in zip(x, printed, strict=True) if b > 0.05]
            left.plot(*zip(*kept, strict=True), "s", ms=8, mfc="none", color=colour)
    left.set_yscale("log")
    left.set_ylim(1e-4, 400.0)
    labels = ["{}/{}/{}\n{} deg {} Hz".format(*line["case"]) for line in lines]
    left.set_xticks(range(len(lines)), labels, fontsize=6.8)
    left.set_ylabel("distance from ideal (arcmin)")
    for name in (PRINTED, OURS):
        distances = np.sort(np.abs(result.numbers["random"][name]))
        share = (np.arange(len(distances)) + 1.0) / len(distances)
        right.step(distances, share, where="post", color=colours[name])
    right.set_xscale("log")
    right.set_xlabel("distance from ideal (arcmin)")
    right.set_ylabel(f"share of {len(distances)} random dithers")
    left.plot([], [], "s", ms=8, mfc="none", color=INK, label="Table 6-1")
    for handle, name in zip(*left.get_legend_handles_labels(), strict=True):
        look = {key: handle.properties()[key] for key in ("color", "marker", "markerfacecolor")}
        right.plot([], [], lw=0, label=name, **look)
    legend(right)
    picture.save(path)
