"""Transfer alignment: random flights beside the textbook's numbers and beside the Cramér-Rao bound.

A slave of 1 deg/h on a wing that bends, a master of 0.8 nmi/h. Every pair of `PAIRS` is judged: relative to
the master, which is what is published, and against truth, where the master's own error comes in. The other
pairs of a matching and a flight are shown beside their bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.studies.consistency import AXES, SHARE, band, nees
from bridge.studies.figures.alignment import rms
from bridge.studies.figures.result import Result, Row
from bridge.studies.figures.transfer_plot import draw as draw
from bridge.studies.transfer_runs import Outcome, Trial, flight, follow, least
from bridge.studies.workers import Progress, each
from nav.transfer import MATCHINGS, matching
from nav.transfer.matching import Matching
from virtual_bus.flights import FLIGHTS

Array = NDArray[np.float64]
Three = tuple[float, float, float]

GOAL: Final = 0.5
"""Of the published number."""
TO_BOUND: Final = 1.1
"""Of the bound, where that is more."""
EPOCHS: Final = 10
OTHER_RUNS: Final = 12
"""At most, of pairs that are not judged."""

SELECTIONS: Final = {one.name: one for one in vars(matching).values() if isinstance(one, Matching)}


class Pair(NamedTuple):
    """A matching on a flight, and what is published for it: mrad about east, north, up; None: nothing.

    ``why`` explains what falls short of the goal. ``short``: its states are too few for that, and what a
    filter of these states can know is enough.
    """

    name: str
    trial: Trial
    matching: str
    published: Three | None = None
    why: str = ""
    short: bool = False


_MRAD: Final = (1.0, 1.0, 1.0)
_LEVEL: Final = (1.0, 1.0, math.inf)
_TEN_ARCMIN: Final = (math.radians(1.0 / 6.0) * 1e3,) * 3
_ROCK: Final = Trial("wing-rock", 5.0)
_STEADY: Final = Trial("straight", 5.0)
_WIGGLE: Final = Trial("heading-wiggle", 10.0)
_QUICK: Final = Trial("quick-s-turn", 10.0)
_LONG: Final = Trial("s-turn", 600.0, 100.0, 1.0)
_STRAIGHT: Final = Trial("straight", 600.0, 100.0, 1.0)
_LONGEST: Final = Trial("s-turn", 1800.0, 100.0, 1.0)

_CONSIDERED: Final = (
    "the filter has the states that the document gives it. What it leaves out, the constant errors of the "
    "sensors above all (1 mg is 1 mrad of level), it takes into account but does not estimate; the bound is "
    "of an estimator of all states by the same messages"
)

_FIVE: Final = (
    "1 mg of the level accelerometers is 1 mrad of level, and five states have no place for it: they take it "
    "into account, and know no more. The document adds sensors' errors to the states, which is the matching "
    "of 11 below; asked of these five is what a filter of them can know, its sigma"
)

PAIRS: Final = (
    Pair("wing rock, attitude", _ROCK, "velocity_attitude", _MRAD),
    Pair("straight, attitude", _STEADY, "velocity_attitude"),
    Pair("quick S-turn, rate", _QUICK, "velocity_rate", (1.0, 1.0, 1.5)),
    Pair("wing rock, rate", _ROCK, "velocity_rate", (1.0, 1.0, 1.5)),
    Pair("heading wiggle, rate", _WIGGLE, "velocity_rate"),
    Pair("S-turns, velocity 5", _LONG, "velocity", _MRAD, _FIVE, True),
    Pair("straight, velocity 5", _STRAIGHT, "velocity", _LEVEL, _CONSIDERED),
    Pair("S-turns, velocity 11", _LONG, "velocity_11", _MRAD),
    Pair("straight, velocity 11", _STRAIGHT, "velocity_11", _LEVEL),
    Pair("S-turns, heading 19", _LONG, "velocity_heading", _TEN_ARCMIN, _CONSIDERED),
    Pair("S-turns, heading 13", _LONG, "velocity_heading_13", _TEN_ARCMIN, _CONSIDERED),
    Pair("S-turns, heading 7", _LONG, "velocity_heading_7", _TEN_ARCMIN, _CONSIDERED),
    Pair("S-turns, position", _LONGEST, "position", _TEN_ARCMIN, _CONSIDERED),
)
"""What the document has numbers for, in its words the best that the method is known to give."""

_SHOWN: Final = {"wing-rock": _ROCK, "heading-wiggle": _WIGGLE, "quick-s-turn": _QUICK}
OTHERS: Final = tuple(
    Pair(f"{name}, {key}", _SHOWN.get(name, Trial(name, 30.0, 100.0, 10.0)), key)
    for name in FLIGHTS
    for key in MATCHINGS
    if not any(pair.trial == _SHOWN.get(name) and pair.matching == key for pair in PAIRS)
)
"""Every other matching on every flight, shown beside its bound."""

Item = tuple[Trial, tuple[str, ...], int | None]


def compute(
    runs: int = 24,
    jobs: int = 1,
    progress: Progress | None = None,
    pairs: Sequence[Pair] = PAIRS,
    others: Sequence[Pair] = OTHERS,
) -> Result:
    """``runs`` flights of each of ``pairs``, which are judged, fewer of ``others``; seeds 0 and on."""
    todo: list[Item] = []
    for some, n in ((pairs, runs), (others, min(runs, OTHER_RUNS))):
        for trial in dict.fromkeys(pair.trial for pair in some):
            names = tuple(pair.matching for pair in some if pair.trial == trial)
            todo += [(trial, names, seed) for seed in (None, *range(n))]
    # the longest first, so that no process is left with one at the end
    todo.sort(key=lambda item: -item[0].seconds * item[0].imu_hz * len(item[1]))
    outcomes: dict[tuple[Trial, str], dict[int, Outcome]] = {}
    bounds: dict[tuple[Trial, str], Array] = {}
    for done, ((trial, names, seed), found) in enumerate(each(_one, todo, jobs), 1):
        for name, one in zip(names, found, strict=True):
            if isinstance(one, Outcome):
                assert seed is not None
                outcomes.setdefault((trial, name), {})[seed] = one
            else:
                bounds[trial, name] = one
        if progress is not None:
            progress(done, len(todo))
    rows: list[Row] = []
    notes = list(_NOTES)
    cells: dict[str, Any] = {}
    for pair in (*pairs, *others):
        mine = [one for _, one in sorted(outcomes[pair.trial, pair.matching].items())]
        cells[pair.name] = numbers = _numbers(pair, mine, bounds[pair.trial, pair.matching])
        rows += _judged(pair, numbers) if pair in pairs else _shown(pair, numbers)
        notes += _refusals(pair, mine)
    return Result(f"Transfer alignment, {runs} flights a pair", rows, notes, {"runs": runs, "cells": cells})


_NOTES: Final = (
    "Errors of phi about east, north, up at the end of the flight, root mean square, every seed counts. A "
    f"goal is {GOAL:g} of the published or {TO_BOUND:g} of the Cramér-Rao bound, whichever is more, and is "
    "missed when the lower end of the 95 % interval is above it. Against truth the master's own error is "
    "added to the bound. Where a matching has too few states for that, what a filter of these states can "
    "know is enough, if the row NEES says that it is right about it; both stand beside the bound.",
    "Velocity shows heading where the path turns. In straight flight heading is no better known than the "
    "mounting, 5.2 mrad, and less and less as gyros drift, with five states or eleven. The document says so.",
    "Slave 1 deg/h, 0.1 deg/sqrt(h), 1 mg, mounted to 0.3 deg about each axis, lever arm known to 2 cm, "
    "messages dated to 10 ms; master 0.1 mrad level, 1 mrad heading, 0.5 m/s, 0.02 m/s and 0.3 mrad of noise "
    "a message, 25 messages a second in flights of seconds, 1 in long ones; the wing bends by 0.3 mrad "
    "within 0.5 s and vibrates by 0.02 mrad at 12 Hz.",
    "An independent simulation of the wing rock has 0.70, 0.97, 0.19 mrad about east, north, up after 5 s, "
    "and 4.5 mrad about up without it.",
    "The document's heading manoeuvre turns the path: a level acceleration shows heading by velocity. Where "
    "the nose alone swings, path straight, a turn about the vertical cannot tell a mounting about it "
    "from a heading error: heading stays as it was, whatever the matching.",
)


def _one(item: Item) -> tuple[Item, list[Outcome | Array]]:
    """All matchings on one flight of a trial; without a seed their bounds."""
    trial, names, seed = item
    epochs = epochs_of(trial)
    if seed is None:
        return item, [least(SELECTIONS[name], trial, epochs) for name in names]
    made = flight(trial, seed)
    return item, [follow(name, made, epochs) for name in names]


def epochs_of(trial: Trial) -> list[float]:
    """When a trial is looked at, s; the last is its end."""
    return [trial.seconds * (k + 1) / EPOCHS for k in range(EPOCHS)]


# ---- numbers ------------------------------------------------------------------------------------


def _numbers(pair: Pair, runs: Sequence[Outcome], bound: Array) -> dict[str, Any]:
    ended = [run for run in runs if not run.refusal]
    out: dict[str, Any] = {
        "seconds": pair.trial.seconds,
        "matching": pair.matching,
        "published_mrad": None if pair.published is None else [_finite(x) for x in pair.published],
        "runs": len(runs),
        "refused": len(runs) - len(ended),
        "bound_mrad": (1e3 * bound[-1]).tolist(),
        "cpu_s": float(np.mean([run.cpu_s for run in runs])),
    }
    if len(ended) < 2:
        return out
    for what, error, P in (
        ("relative", [run.relative for run in ended], [run.P_relative for run in ended]),
        ("truth", [run.phi for run in ended], [run.P for run in ended]),
    ):
        phi, covariance = np.array(error), np.array(P)
        normalised = nees(phi, covariance)
        out[what] = {
            "mrad": (1e3 * phi[:, -1]).tolist(),
            "rms": [rms(1e3 * phi[:, -1, k]) for k in range(3)],
            "sigma": (1e3 * np.sqrt(np.einsum("nkii->ki", covariance)[-1] / len(ended))).tolist(),
            "nees": normalised.mean(axis=0).tolist(),
        }
    own = np.array(ended[0].P[-1]) - ended[0].P_relative[-1]
    out["own_mrad"] = (1e3 * np.sqrt(np.diag(own))).tolist()
    return out


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _judged(pair: Pair, numbers: dict[str, Any]) -> list[Row]:
    out = []
    for what in ("relative", "truth"):
        if what not in numbers:
            continue
        for k, axis in enumerate(AXES):
            found, between = numbers[what]["rms"][k]
            least_ = numbers["bound_mrad"][k]
            if what == "truth":
                least_ = math.hypot(least_, numbers["own_mrad"][k])
            published = None if pair.published is None else _finite(pair.published[k])
            asked = f"{TO_BOUND:g} of {least_:.2f}"
            goal = TO_BOUND * least_
            if published is not None:
                goal = max(goal, GOAL * published)
                asked = f"{GOAL * published:.2g} or {asked}"
            why = "" if between[0] <= goal else pair.why
            if pair.short:
                claimed = numbers[what]["sigma"][k]
                goal = max(goal, TO_BOUND * claimed)
                asked += f", {TO_BOUND:g} of {claimed:.2f} by its states"
            passed = between[0] <= goal
            name = f"{pair.name}: {axis}" if what == "relative" else f"{pair.name}: {axis}, truth"
            out.append(Row(name, published, found, asked, passed, "mrad", why, interval=between))
    refused = 100.0 * numbers["refused"] / numbers["runs"]
    out.append(Row(f"{pair.name}: refused", None, refused, "none", not refused, "% of flights"))
    if "relative" in numbers:
        # all epochs at once (Bonferroni), however they hang together
        low, high = band(3, numbers["runs"] - numbers["refused"], 1.0 - (1.0 - SHARE) / EPOCHS)
        values = np.array(numbers["relative"]["nees"])
        out.append(
            Row(
                f"{pair.name}: NEES",
                None,
                float(values.mean()) / 3.0,
                f"{low / 3.0:.2f} to {high / 3.0:.2f} at all {EPOCHS} epochs",
                bool(np.all((values >= low) & (values <= high))),
                "of 1",
            )
        )
    return out


def _shown(pair: Pair, numbers: dict[str, Any]) -> list[Row]:
    """Level (root of the mean of both) and heading beside the bound."""
    if "relative" not in numbers:
        return []
    phi = np.array(numbers["relative"]["mrad"])
    east, north, up = numbers["bound_mrad"]
    seconds, out = f"{pair.trial.seconds:g} s", []
    level = rms(phi[:, 0:2].ravel()), math.hypot(east, north) / math.sqrt(2.0)
    for name, (found, least_) in (("level", level), ("up", (rms(phi[:, 2]), up))):
        of = f"{seconds}, bound {least_:.3g}, sigma {_claimed(numbers, name):.3g}"
        out.append(Row(f"{pair.name}: {name}", None, found[0], of, None, "mrad", interval=found[1]))
    return out


def _claimed(numbers: dict[str, Any], name: str) -> float:
    east, north, up = numbers["relative"]["sigma"]
    return float(up) if name == "up" else math.hypot(east, north) / math.sqrt(2.0)


def _refusals(pair: Pair, runs: Sequence[Outcome]) -> list[str]:
    return [
        f"{pair.name}: one of {len(runs)} refused, its messages dated {abs(run.late):.1f} sigma wrong: "
        f'"{run.refusal}"'
        for run in runs
        if run.refusal
    ]
