"""Many simulated units on many simulated turntables: whether coefficients are as wrong as their sigmas say.

Truth, sensors and noise are the bench's; the counts go to the estimator as arrays, without a bus. The seeds
are ``seed_base``, ``seed_base + 1``, ... and every one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from scipy import stats

from bridge.calibrating import look, model_of, with_table
from bridge.calibration_plan import Plan, Site
from bridge.studies.turntable import scenario_of
from bridge.studies.workers import Progress, each
from nav.calibrate.checks import moved
from nav.calibrate.encoder import Encoder, attitudes
from nav.calibrate.model import LETTERS, NUISANCE, Model, Sensor
from nav.calibrate.segments import segment
from nav.calibrate.solve import Noise, fit
from nav.calibrate.stream import Nominal, Stream
from nav.imu.geometry import GEOMETRIES
from nav.types import Vector
from virtual_bus.faults import Faults
from virtual_bus.grades import (
    ARCSEC,
    DEG_PER_H,
    DEG_PER_SQRT_H,
    GRADES,
    REFERENCE_DEG_C,
    UG,
    Grade,
    ImuErrors,
    draw_imu,
)
from virtual_bus.sensors import Imu, Warming, generator
from virtual_bus.turntable import Encoder as Circles
from virtual_bus.turntable import TableTruth, Turntable

RATE_HZ: Final = 25.0  # the slowest at which 20 deg/s leave the counters of every grade room
NAMES: Final = tuple(sorted(GRADES))
USUAL: Final = tuple(name for name in NAMES if GRADES[name].plain)
"""Those that a plan without second-order terms is enough for."""
_BETWEEN_S: Final = 1e6
"""From one temperature to the next: long enough for the noise of a unit to forget."""
COVERAGE: Final = (0.93, 0.975)
"""Between these the share of errors within two sigmas must be, all coefficients of all runs together."""
LARGEST: Final = 4.5
_LEAST_RUNS: Final = 100
"""From so many runs on the band is `COVERAGE`; fewer have one of their own."""
_CHANCE: Final = 1e-3
_OFF: Final = np.radians(0.1)


def encoded(plan: Plan) -> Plan:
    """The plan on a table that comes to rest 0.1 deg off and tells where, by its encoders."""
    return replace(plan, position=_OFF, encoded=True)


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One unit calibrated: errors of all coefficients in sigmas (k,), and how well the residuals fit.

    ``table`` (4,) are those of the table's tilt, north and gravity; ``false`` what a check said that is not
    so.
    """

    seed: int
    normalised: Vector
    table: Vector
    chi2: float
    freedom: int
    steps: int
    false: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Rounds:
    """All of them, and the verdict."""

    plan: str
    grade: str
    geometry: str
    names: tuple[str, ...]
    rounds: tuple[Round, ...]

    @property
    def errors(self) -> Vector:
        """Normalised errors (runs, coefficients)."""
        return np.array([one.normalised for one in self.rounds])

    @property
    def coverage(self) -> float:
        """Share of all errors within two sigmas."""
        return float(np.mean(np.abs(self.errors) < 2.0))

    @property
    def band(self) -> tuple[float, float]:
        """Where the coverage must be."""
        return band(len(self.rounds), len(self.names))

    @property
    def largest(self) -> float:
        """The largest error, in sigmas."""
        return float(np.abs(self.errors).max())

    @property
    def chance(self) -> float:
        """Of an error as large as the largest or larger, among so many of a normal law."""
        return float(-np.expm1(self.errors.size * np.log1p(-2.0 * stats.norm.sf(self.largest))))

    @property
    def shape(self) -> tuple[float, float]:
        """How normal the errors are: excess kurtosis, and the largest distance from the normal law."""
        errors = self.errors.ravel()
        return float(stats.kurtosis(errors)), float(stats.kstest(errors, "norm").statistic)

    @property
    def passed(self) -> bool:
        """Whether errors are as large as they are said to be, and no check spoke without a reason."""
        low, high = self.band
        quiet = all(one.false is None for one in self.rounds)
        return low <= self.coverage <= high and self.largest < LARGEST and quiet


def band(runs: int, coefficients: int) -> tuple[float, float]:
    """Band of the pooled coverage: of few runs what chance leaves of a normal law in 999 of 1000 cases.

    Coefficients of one unit are correlated, so that only as many count as independent as a unit has sensors.
    """
    if runs >= _LEAST_RUNS:
        return COVERAGE
    share = float(stats.norm.cdf(2.0) - stats.norm.cdf(-2.0))
    count = runs * min(coefficients, 6)
    low, high = stats.binom.ppf([0.5 * _CHANCE, 1.0 - 0.5 * _CHANCE], count, share) / count
    return float(low), float(high)


def run_calibrations(
    plan: Plan,
    site: Site | None,
    grade: str,
    runs: int,
    *,
    geometry: str = "orthogonal",
    seed_base: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Rounds:
    """Calibrate ``runs`` units of a grade and of one of the `GEOMETRIES` by a plan.

    Raises:
        ConfigError: nobody said where the table stands.
        CalibrationError: the plan does not show every coefficient.
    """
    _, place = plan.at(site)
    model = model_of(plan, place, nominal_of(GRADES[grade], GEOMETRIES[geometry]))
    look(plan, model, with_table(noise_of(GRADES[grade]), plan, plan.encoded))
    found: dict[int, Round] = {}
    for one in each(partial(_one, plan, site, grade, geometry), range(seed_base, seed_base + runs), jobs):
        found[one.seed] = one
        if progress is not None:
            progress(len(found), runs)
    rounds = tuple(found[seed] for seed in sorted(found))
    return Rounds(plan.title, grade, geometry, model.names[: -len(NUISANCE)], rounds)


def nominal_of(grade: Grade, axes: Vector | None = None) -> Nominal:
    """A unit as its data sheet has it: nominal pulses, no bias; ``axes`` (n, 3) by default b's."""
    axes = np.eye(3) if axes is None else axes
    pulses = (grade.gyro_arcsec_per_pulse * ARCSEC, grade.accel_m_s_per_pulse)
    n = len(axes)
    return Nominal(n, np.vstack((axes, axes)), np.repeat(pulses, n), np.zeros(2 * n))


def noise_of(grade: Grade) -> Noise:
    """What a unit of a grade is said to be as noisy as."""
    return Noise(
        grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H,
        grade.gyro_instability_deg_per_h * DEG_PER_H,
        grade.accel_random_walk_ug_per_sqrt_hz * UG,
        grade.accel_instability_ug * UG,
        grade.correlation_s,
    )


def counted(
    table: Turntable, grade: Grade, geometry: str, seed: int, soak: float | None = None
) -> tuple[Stream, ImuErrors, Vector]:
    """What a unit counts on the table, the unit, and the table's errors (4,) as the model has them.

    It has a temperature of ``soak`` degC, by default that of its sheet. What encoders of the table read is
    dated by the unit's clock. Units of different grades and geometries share no random numbers, so that each
    is evidence of its own.
    """
    of = f"{grade.name}/{geometry}"
    delta, gravity = table.drawn(generator(seed, f"{of}/table"))
    trajectory = table.trajectory(table.seconds(), generator(seed, f"{of}/table"))
    unit = draw_imu(grade, generator(seed, f"{of}/unit"), GEOMETRIES[geometry])
    at = REFERENCE_DEG_C if soak is None else soak
    noise = generator(seed, f"{of}/imu" if soak is None else f"{of}/imu/{soak:g}")
    imu = Imu(trajectory, grade, unit, noise, Faults([]), warming=Warming(at, at))
    rate = round(table.imu.rate_hz)
    count = int(table.seconds() * rate)
    t_ns = np.rint(np.arange(count + 1) * (1e9 / rate)).astype(np.int64)
    blocks = [imu.block(t_ns[k : k + rate + 1])[0] for k in range(0, count, rate)]
    dt = np.asarray(np.diff(t_ns) * 1e-9, dtype=np.float64)
    counts = np.concatenate(blocks).astype(np.float64)
    told = None
    if table.encoder is not None and isinstance(trajectory, TableTruth):
        circles = Circles(trajectory, table.encoder, generator(seed, f"{of}/circles"))
        time = np.arange(0.0, table.seconds(), 1.0 / table.encoder.rate_hz)
        angles = circles.read(np.rint(1e9 * time).astype(np.int64))
        told = Encoder(time, attitudes(np.radians(angles), table.encoder.axes))
    stream = Stream(f"seed {seed}", 0.0, dt, counts, {}, np.full(len(dt), at), told)
    return stream, unit, np.append(delta, gravity / table.gravity - 1.0)


def truth(model: Model, unit: ImuErrors) -> Vector:
    """The true coefficients of a unit, in the order of ``model``."""
    values = []
    gyros = len(unit.gyro.scale)
    for place, one in enumerate(model.sensors):
        triad, k = (unit.gyro, place) if one.gyro else (unit.accel, place - gyros)
        # a model's axis is as long as makes its part along the nominal one 1, and pulses of positive output
        # are more by half the asymmetry, so each is smaller by that
        along = float(one.axis @ triad.axes[k])
        plus = triad.scale[k] / (1.0 + 0.5 * triad.asymmetry[k]) / along
        minus = triad.scale[k] / (1.0 - 0.5 * triad.asymmetry[k]) / along
        own = {
            "scale": 0.5 * (plus + minus) / one.scale - 1.0,
            "asymmetry": (minus - plus) / one.scale,
            "bias": triad.bias[k] / along,
            **{one.angle_of(side): float(one.across[:, side] @ triad.axes[k]) / along for side in (0, 1)},
            **{f"g sensitivity {x}": g / along for x, g in zip("xyz", triad.g_sensitivity[k], strict=True)},
            **_second_order(one, triad.second[k % len(triad.second)] / along),
            **_powers("scale", triad.scale_temperature[k % len(triad.scale_temperature)]),
            **_powers("bias", triad.bias_temperature[k % len(triad.bias_temperature)] / along),
        }
        values += [float(own[term]) for term in one.terms]
    return np.array(values)


def _powers(what: str, row: Vector) -> dict[str, float]:
    return {f"{what} temperature {j + 1}": float(value) for j, value in enumerate(row)}


def _second_order(one: Sensor, form: Vector) -> dict[str, float]:
    """Coefficients of f . ``form`` @ f as a sensor's model has them."""
    pairs = ((1, 2), (2, 0), (0, 1))
    own = {f"product {LETTERS[i]}{LETTERS[j]}": 2.0 * float(form[i, j]) for i, j in pairs}
    for side, where in enumerate(one.toward):
        own[f"product toward {where}"] = 2.0 * float(one.axis @ form @ one.across[:, side])
    return {**own, "square": float(one.axis @ form @ one.axis)}


def _one(plan: Plan, site: Site | None, grade: str, geometry: str, seed: int) -> Round:
    nominal = nominal_of(GRADES[grade], GEOMETRIES[geometry])
    noise = with_table(noise_of(GRADES[grade]), plan, plan.encoded)
    streams: list[Stream] = []
    for soak in plan.soaks or (None,):
        table = scenario_of(plan, site, grade, RATE_HZ, soak)
        stream, unit, wrong = counted(table, GRADES[grade], geometry, seed, soak)
        streams.append(replace(stream, begin=_BETWEEN_S * len(streams)))
    intervals = segment(streams, plan.steps, nominal, [1.0] * len(streams))
    model = model_of(plan, plan.at(site)[1], nominal)
    found = fit(model, intervals, noise)
    error = (found.theta - np.append(truth(model, unit), wrong)) / found.sigma
    false = moved(found, intervals, noise)
    own = -len(NUISANCE)
    return Round(seed, error[:own], error[own:], found.chi2, found.freedom, found.steps, false)


def lines(every: Sequence[Rounds]) -> list[str]:
    """The table for people."""
    head = f"{'grade':<6} {'axes':<10} {'runs':>5} {'coefficients':>13} {'within 2 sigma':>15} {'band':>16}"
    rows = [every[0].plan, f"{head} {'largest':>8} {'table':>6} {'chi2/dof':>9} {'steps':>6}"]
    for one in every:
        low, high = one.band
        count = len(one.rounds)
        table = np.array([r.table for r in one.rounds])
        chi2 = np.mean([r.chi2 / r.freedom for r in one.rounds])
        steps = max(r.steps for r in one.rounds)
        rows.append(
            f"{one.grade:<6} {one.geometry:<10} {count:>5} {len(one.names):>13} "
            f"{100 * one.coverage:>13.2f} % {100 * low:>6.1f} to {100 * high:>5.1f} % {one.largest:>7.2f} "
            f"{100 * np.mean(np.abs(table) < 2.0):>5.1f} % {chi2:>8.2f} {steps:>6}"
        )
        kurtosis, distance = one.shape
        rows.append(
            f"  a normal law has a largest like this with the chance {one.chance:.2g}; excess kurtosis "
            f"{kurtosis:+.2f}, distance from its distribution {distance:.3f}"
        )
        rows += [f"  seed {r.seed}: {r.false}" for r in one.rounds if r.false is not None]
    rows.append("passed" if all(one.passed for one in every) else "NOT passed")
    return rows


def document(every: Sequence[Rounds]) -> dict[str, Any]:
    """The same as plain tables, with the spread of every coefficient."""
    return {
        "plan": every[0].plan,
        "grades": {
            one.grade: {
                "geometry": one.geometry,
                "runs": len(one.rounds),
                "coverage": one.coverage,
                "band": one.band,
                "largest": one.largest,
                "chance": one.chance,
                "kurtosis": one.shape[0],
                "distance": one.shape[1],
                "passed": one.passed,
                "rms": dict(zip(one.names, np.sqrt(np.mean(one.errors**2, axis=0)).tolist(), strict=True)),
            }
            for one in every
        },
    }
