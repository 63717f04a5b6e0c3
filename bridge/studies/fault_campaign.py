"""Faults of every sort on every axis of redundant units: missed, wrongly isolated, delays, what they cost.

Two axes along which a fault moves the parity vector in one direction cannot be told apart by any test; they
are pooled apart from the others, since there detection is all that can be asked.

What a fault does before it can be known is in `bridge.studies.fault_bound`; the table has its peak beside
that of the monitor. From one smallest detectable size on the solution's error is to stay below twice the
healthy one at every second of a fault whose sensor can be told from the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import combinations, permutations
from typing import Any, Final

import numpy as np
from scipy import stats

from bridge.studies.fault_runs import (
    FAULTS,
    KINDS,
    RAMP,
    RATE_HZ,
    SECONDS,
    UNIT_S,
    Case,
    alarms,
    course,
    failing,
    motion,
    run,
    smallest,
    unit,
)
from bridge.studies.workers import Progress, each
from nav.imu.geometry import GEOMETRIES
from nav.imu.many import ideal
from nav.imu.parity import MOST, parity_matrix
from nav.imu.redundant import Monitor, Noise, Redundant
from nav.imu.redundant_kernel import DETECTED
from nav.types import Vector
from virtual_bus.grades import GRADES

UNITS: Final = ("cone", "skew")
MULTIPLES: Final = (0.5, 1.0, 2.0, 5.0)
ALARMS: Final = 100
"""Expected false alarms of the run that counts them."""
_HOURLY: Final = 0.3
"""The more there are the more come from windows of two lengths at once: of 3 an hour a tenth."""
_CHANCE: Final = 1e-3
_MISSED: Final = 1e-3
_BLOCK: Final = 100_000
_PARALLEL: Final = 1e-9
TWICE: Final = 2.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """A run: delays (s) until a test failed and until the sensor was out, None where not.

    ``wrong``: another one went, ``left``: it was still out when the fault ended. ``error``, ``healthy`` are
    squares of the error at whole seconds of the fault, with it and without; ``least`` what is added at least.
    """

    case: Case
    detected: float | None
    isolated: float | None
    wrong: bool
    left: bool
    before: int
    error: tuple[float, ...]
    healthy: tuple[float, ...]
    least: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Row:
    """Runs of one sort pooled.

    ``delay`` s until the sensor was out, ``late`` of which 95 % were earlier; ``open`` detected, but nobody
    excluded. ``worst``, ``last``: error over that of the same runs without the fault, the largest of its
    seconds and the last; ``least`` the largest that no monitor is below.
    """

    geometry: str
    kind: str
    axes: str
    fault: str
    multiple: float
    runs: int
    missed: int
    wrong: int
    left: int
    open: int
    delay: float | None
    late: float | None
    worst: float
    least: float
    last: float


@dataclass(frozen=True, slots=True)
class Quiet:
    """A healthy unit for a long time."""

    geometry: str
    hours: float
    expected: float
    found: int

    @property
    def chance(self) -> float:
        """Two-sided, of so many or more extreme by Poisson's law."""
        low, high = (
            stats.poisson.cdf(self.found, self.expected),
            stats.poisson.sf(self.found - 1, self.expected),
        )
        return float(min(1.0, 2.0 * min(low, high)))


@dataclass(frozen=True, slots=True)
class Dead:
    """Units of which two sensors fail: of how many pairs they did as told, and the worst error in sigmas."""

    sort: str
    pairs: int
    done: int
    sigmas: float


@dataclass(frozen=True, slots=True)
class Faults:
    """All of it."""

    rows: tuple[Row, ...]
    quiet: tuple[Quiet, ...]
    dead: tuple[Dead, ...]
    before: int
    hours_before: float

    @property
    def wrong(self) -> tuple[int, float]:
        """In how many runs another sensor was excluded, and in how many that may happen, by `Monitor`."""
        found = sum(row.runs - row.missed for row in self.rows)
        return sum(row.wrong for row in self.rows), Monitor().isolation * found

    def complaints(self) -> list[str]:
        """What is outside of what theory allows by chance in 999 of 1000 cases."""
        found = [f"{one.geometry}: {one.found} false alarms" for one in self.quiet if one.chance < _CHANCE]
        for row in self.rows:
            name = f"{row.geometry} {row.kind} {row.axes}, {row.fault} of {row.multiple:g}"
            if row.multiple >= 1.0 and row.missed > stats.binom.ppf(1.0 - _CHANCE, row.runs, _MISSED):
                found.append(f"{name}: {row.missed} missed")
            if row.axes == "told apart" and row.multiple >= 1.0 and row.worst > TWICE:
                found.append(f"{name}: {row.worst:.2f} times the healthy error")
        wrong, promised = self.wrong
        if stats.poisson.sf(wrong - 1, promised) < _CHANCE:
            found.append(f"{wrong} wrong, {promised:.1f} promised")
        found += [f"{one.sort}: {one.pairs - one.done} not" for one in self.dead if one.done < one.pairs]
        return found


def twins(axes: Vector) -> set[int]:
    """Sensors whose faults look like another's."""
    V = parity_matrix(axes)
    V = V / np.linalg.norm(V, axis=0)
    cosine = np.abs(V.T @ V) - np.eye(len(axes))
    return {int(k) for k in np.flatnonzero(cosine.max(axis=0) > 1.0 - _PARALLEL)}


def look(seed: int, case: Case) -> Outcome:
    """One run."""
    found = run(case, seed)
    failed, healthy, begin, end = found.failed, found.healthy, found.begin, found.end
    bit = 1 << case.sensor
    everybody = (1 << len(GEOMETRIES[case.geometry])) - 1
    tested = np.flatnonzero(failed.status[begin:end] & DETECTED)
    out = np.flatnonzero(~failed.active[begin:end] & bit)
    others = (failed.active[begin:end] | bit) != everybody
    first, last = -(-begin // round(RATE_HZ)), end // round(RATE_HZ)
    squares = [np.sum(one.error[first:last] ** 2, axis=1) for one in (failed, healthy)]
    return Outcome(
        case,
        tested[0] / RATE_HZ if len(tested) else None,
        out[0] / RATE_HZ if len(out) else None,
        bool(others.any()),
        bool(others[-1]),
        alarms(np.flatnonzero(healthy.status & DETECTED), found.fusion),
        *(tuple(one[:59].tolist()) for one in (*squares, found.least)),
    )


def _looks(seeds: Sequence[int], case: Case) -> list[Outcome]:
    return [look(seed, case) for seed in seeds]


def pooled(outcomes: Sequence[Outcome]) -> list[Row]:
    """Rows of equal geometry, kind, fault and size; axes that cannot be told apart by themselves."""
    groups: dict[tuple[str, str, str, str, float], list[Outcome]] = {}
    for one in outcomes:
        c = one.case
        alike = c.sensor in twins(GEOMETRIES[c.geometry])
        axes = "alike" if alike else "told apart"
        groups.setdefault((c.geometry, c.kind, axes, c.fault, c.multiple), []).append(one)
    rows = []
    for key, group in groups.items():
        delays = np.array([one.isolated for one in group if one.isolated is not None])
        healthy = np.mean([one.healthy for one in group], axis=0)
        ratio = np.sqrt(np.mean([one.error for one in group], axis=0) / healthy)
        least = np.sqrt(1.0 + np.mean([one.least for one in group], axis=0) / healthy)
        rows.append(
            Row(
                *key,
                len(group),
                sum(one.detected is None for one in group),
                sum(one.wrong for one in group),
                sum(one.left for one in group),
                sum(one.detected is not None and one.isolated is None for one in group),
                float(np.median(delays)) if len(delays) else None,
                float(np.quantile(delays, 0.95)) if len(delays) else None,
                float(ratio.max()),
                float(least.max()),
                float(ratio[-1]),
            )
        )
    return rows


def quiet(geometry: str, seed: int) -> Quiet:
    """A healthy unit with white noise for as long as `ALARMS` false alarms take."""
    axes = GEOMETRIES[geometry]
    fusion = Redundant(ideal(axes), Noise(1e-6), RATE_HZ, Monitor(false_alarms=_HOURLY))
    rng = np.random.default_rng([seed, *geometry.encode()])
    state, hours = fusion.fresh(), ALARMS / _HOURLY
    whole = round(hours * 3600.0 * RATE_HZ)
    counts, work, places = np.zeros((_BLOCK, MOST)), np.zeros((2, 3)), np.zeros(_BLOCK, np.int64)
    failed = []
    for begin in range(0, whole, _BLOCK):
        size = min(whole - begin, _BLOCK)
        counts[:size, : len(axes)] = rng.standard_normal((size, len(axes))) * 1e-6 / np.sqrt(RATE_HZ)
        found = failing(fusion.tables, state, counts[:size], work, places)
        failed.append(begin + places[:found])
    return Quiet(geometry, hours, float(ALARMS), alarms(np.concatenate(failed), fusion))


def dead(seed: int) -> list[Dead]:
    """Any two of the cone's sensors: silent from the start, silent one after the other, failing in turn."""
    rng = np.random.default_rng([seed, 2])
    n = len(GEOMETRIES["cone"])
    sorts: list[tuple[str, list[tuple[int, int]]]] = [
        ("two silent from the start", list(combinations(range(n), 2))),
        ("one silent after the other", list(permutations(range(n), 2))),
        ("one failing after the other", list(permutations(range(n), 2))),
    ]
    found = []
    for sort, pairs in sorts:
        done, sigmas = 0, 0.0
        for pair in pairs:
            one = unit("cone", "gyro", rng, Monitor(), GRADES["fog"])
            felt = motion("gyro", rng)
            z = (felt @ one.true.axes.T + one.true.bias) / RATE_HZ
            z += rng.standard_normal(z.shape) * one.walk / np.sqrt(RATE_HZ)
            begins = (0, 0) if "start" in sort else (3000, 7000)
            counts = np.diff(np.rint(np.cumsum(z / one.true.scale, axis=0)), axis=0, prepend=0.0)
            for k, begin in zip(pair, begins, strict=True):
                if "failing" in sort:
                    # the second is watched by five sensors, whose parity vectors lie closer together
                    size = 5.0 * smallest(one.fusion, k) / RATE_HZ / one.true.scale[k]
                    counts[begin:, k] += np.diff(np.rint(size * np.arange(len(counts) - begin + 1)))
                else:
                    counts[begin:, k] = np.nan
            seen = course(one.fusion, counts, felt / RATE_HZ)
            left = ((1 << n) - 1) & ~(1 << pair[0]) & ~(1 << pair[1])
            done += int(seen.active[-1] == left and np.isfinite(seen.error).all())
            cofactor = one.fusion.tables.sets.cofactor[left]
            seconds = len(counts) / RATE_HZ
            turned = float(np.linalg.norm(felt.sum(axis=0))) / RATE_HZ
            P = cofactor * one.fusion.noise.variance(seconds, turned)
            sigmas = max(sigmas, float(np.sqrt(seen.error[-1] @ np.linalg.solve(P, seen.error[-1]))))
        found.append(Dead(sort, len(pairs), done, sigmas))
    return found


def run_faults(runs: int, *, seed_base: int = 0, jobs: int = 1, progress: Progress | None = None) -> Faults:
    """``runs`` units for every fault, size and sensor of both geometries."""
    cases = [
        Case(geometry, kind, fault, k, multiple)
        for geometry in UNITS
        for kind in KINDS
        for fault in FAULTS
        for multiple in MULTIPLES
        for k in range(len(GEOMETRIES[geometry]))
    ]
    outcomes: list[Outcome] = []
    seeds = range(seed_base, seed_base + runs)
    for done, part in enumerate(each(partial(_looks, seeds), cases, jobs), 1):
        outcomes += part
        if progress is not None:
            progress(done, len(cases))
    place = {case: k for k, case in enumerate(cases)}
    outcomes.sort(key=lambda one: place[one.case])
    return Faults(
        tuple(pooled(outcomes)),
        tuple(quiet(geometry, seed_base) for geometry in UNITS),
        tuple(dead(seed_base)),
        sum(one.before for one in outcomes),
        len(outcomes) * SECONDS / 3600.0,
    )


def lines(found: Faults) -> list[str]:
    """The table for people."""
    out = [
        f"{'unit':<5} {'':<6} {'axes':<10} {'fault':<6} {'size':>5} {'runs':>5} {'missed':>7} {'wrong':>6} "
        f"{'left':>5} {'open':>5} {'delay':>7} {'95 %':>7} {'worst':>6} {'least':>6} {'last':>6}"
    ]
    for row in found.rows:
        late = "".join(f" {'':>7}" if one is None else f" {one:>5.2f} s" for one in (row.delay, row.late))
        out.append(
            f"{row.geometry:<5} {row.kind:<6} {row.axes:<10} {row.fault:<6} {row.multiple:>5.1f} "
            f"{row.runs:>5} {row.missed:>7} {row.wrong:>6} {row.left:>5} {row.open:>5}{late} "
            f"{row.worst:>6.2f} {row.least:>6.2f} {row.last:>6.2f}"
        )
    out += [
        f"size: in biases that one window of {UNIT_S:g} s misses once in 1000 times; of noise, that one",
        f"sample does; of stuck and scale, rms of what is lacking; of a ramp, after {RAMP:g} s",
        "open: detected, but no sensor excluded; wrong: another one was; left: until the fault's end",
        "worst, last: error with the fault over that without, worst second of it and its last; least: worst",
        "second of whoever knows the fault beforehand and only waits until it is as certain",
        "",
    ]
    out += [
        f"{one.geometry}: {one.found} false alarms in {one.hours:.1f} h, {one.expected:.0f} configured "
        f"(chance of one so far off: {one.chance:.2f})"
        for one in found.quiet
    ]
    asked = Monitor().false_alarms * found.hours_before
    out.append(
        f"healthy runs beside: {found.before} in {found.hours_before:.0f} h, at most {asked:.2f} configured"
    )
    out += [
        f"cone, {one.sort}: {one.done} of {one.pairs} pairs, error at most {one.sigmas:.1f} sigma (3 axes)"
        for one in found.dead
    ]
    out.append("another sensor excluded: {} of faults found, {:.1f} promised".format(*found.wrong))
    wrong = found.complaints()
    return [*out, "", *wrong, "NOT passed" if wrong else "passed"]


def document(found: Faults) -> dict[str, Any]:
    """The same as plain tables."""
    return {
        "passed": not found.complaints(),
        "complaints": found.complaints(),
        "rows": [asdict(row) for row in found.rows],
        "false_alarms": [{**asdict(one), "chance": one.chance} for one in found.quiet],
        "wrong": dict(zip(("found", "promised"), found.wrong, strict=True)),
        "dead": [asdict(one) for one in found.dead],
    }
