"""Redundant units with a sensor that fails: truth, counts and what the fusion makes of them, run by run.

Units are drawn and their sheets used as in the calibration campaign; the fault is put on what the sensor
senses, before it is rounded to pulses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.studies.fault_bound import least
from nav.imu.geometry import GEOMETRIES
from nav.imu.many import Sensors
from nav.imu.parity import MOST
from nav.imu.redundant import Monitor, Noise, Redundant
from nav.imu.redundant_kernel import ACTIVE, DETECTED, SUSPECTS, State, Tables, fuse
from nav.imu.redundant_sample import quick
from nav.jit import in_place
from nav.types import Vector
from virtual_bus.ellipsoid import G0
from virtual_bus.grades import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, GRADES, PPM, UG, Grade, Triad, draw_imu

Whole = NDArray[np.int64]

RATE_HZ: Final = 100.0
KINDS: Final = ("gyro", "accel")
FAULTS: Final = ("step", "ramp", "stuck", "noise", "scale")
SECONDS: Final = 150.0
ONSET: Final = (30.0, 40.0)
LASTS: Final = 60.0
RAMP: Final = 20.0
"""A ramp has its size after so many seconds, and goes on."""
UNIT_S: Final = 10.0
"""Sizes are in biases that a window of so many seconds misses once in 1000 times."""
_PERIODS: Final = (41.0, 29.0, 19.0)
_MOVES: Final = {"gyro": np.radians(2.0), "accel": 0.5}


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What became of a run: bits, sensors in use and suspects after every sample, error at whole seconds.

    ``error`` (s, 3) rad or m/s is of all increments since the start, with what was owed.
    """

    status: Whole
    active: Whole
    suspects: Whole
    error: Vector


@in_place
def follow(
    tables: Tables,
    state: State,
    counts: Vector,
    truth: Vector,
    every: int,
    work: Vector,
    found: Whole,
    error: Vector,
) -> None:
    """Fuse ``counts`` (k, `MOST`); ``found`` (3, k) and ``error`` (k // every, 3) as of `Course`.

    ``truth`` (k, 3) increments in b; ``work`` (3, 3), all zero at the start.
    """
    x, owed, off = work[0], work[1], work[2]
    for k in range(len(counts)):
        status = 0
        owed[0] = owed[1] = owed[2] = 0.0
        if not quick(state.hot, counts[k], 0, 1.0 / RATE_HZ, 0.0, 0.0, 0.0, x):
            status = fuse(tables, state, 1.0 / RATE_HZ, x, owed)
        found[0, k], found[1, k], found[2, k] = status, state.whole[ACTIVE], state.whole[SUSPECTS]
        for i in range(3):
            off[i] += x[i] + owed[i] - truth[k, i]
        if k % every == every - 1:
            for i in range(3):
                error[k // every, i] = off[i]


@in_place
def failing(tables: Tables, state: State, counts: Vector, work: Vector, found: Whole) -> int:
    """At which samples of ``counts`` (k, `MOST`) a test fails, in ``found`` (k,), and how many these are."""
    x, owed = work[0], work[1]
    failed = 0
    for k in range(len(counts)):
        if quick(state.hot, counts[k], 0, 1.0 / RATE_HZ, 0.0, 0.0, 0.0, x):
            continue
        if fuse(tables, state, 1.0 / RATE_HZ, x, owed) & DETECTED:
            found[failed] = k
            failed += 1
    return failed


def alarms(failed: Whole, fusion: Redundant) -> int:
    """How many alarms tests are that fail at the samples ``failed`` (k,)."""
    apart = fusion.monitor.windows[-1] * RATE_HZ
    return int(np.count_nonzero(np.diff(failed, prepend=-2.0 * apart) > apart))


def smallest(fusion: Redundant, k: int, motion: float = 0.0) -> float:
    """The unit of size for sensor ``k``, rad/s or m/s^2, with ``motion`` rad/s or m/s^2."""
    window = fusion.seconds.index(UNIT_S)
    return fusion.smallest(k, window=window, motion=motion * UNIT_S)


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """Sensors of one kind, as they are and as the fusion believes they are."""

    true: Triad
    pulse: float
    walk: float
    fusion: Redundant


def unit(geometry: str, kind: str, rng: np.random.Generator, monitor: Monitor, grade: Grade) -> Unit:
    """A unit of a grade, drawn, with its calibration sheet."""
    drawn = draw_imu(grade, rng, GEOMETRIES[geometry])
    if kind == "gyro":
        true, sheet, pulse = drawn.gyro, drawn.calibrated_gyro, grade.gyro_arcsec_per_pulse * ARCSEC
        walk = grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H
        bias = np.hypot(grade.gyro_bias_deg_per_h, grade.gyro_instability_deg_per_h) * DEG_PER_H
        scale = max(grade.gyro_scale_ppm * PPM, grade.gyro_misalignment_arcsec * ARCSEC)
    else:
        true, sheet, pulse = drawn.accel, drawn.calibrated_accel, grade.accel_m_s_per_pulse
        walk = grade.accel_random_walk_ug_per_sqrt_hz * UG
        bias = np.hypot(grade.accel_bias_ug, grade.accel_instability_ug) * UG
        scale = max(grade.accel_scale_ppm * PPM, grade.accel_misalignment_arcsec * ARCSEC)
    sensors = Sensors(sheet.axes, sheet.scale, sheet.scale, sheet.bias, sheet.g_sensitivity)
    return Unit(true, pulse, walk, Redundant(sensors, Noise(walk, pulse, bias, scale), RATE_HZ, monitor))


def motion(kind: str, rng: np.random.Generator) -> Vector:
    """Rate or specific force (k, 3) in the middle of every sample: slow oscillations, and gravity."""
    t = (np.arange(round(SECONDS * RATE_HZ)) + 0.5) / RATE_HZ
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    out = _MOVES[kind] * np.sin(2.0 * np.pi * t[:, None] / _PERIODS + phase)
    return np.asarray(out + (np.array([0.0, 0.0, G0]) if kind == "accel" else 0.0))


@dataclass(frozen=True, slots=True)
class Case:
    """A fault of sensor ``sensor``: its sort, and its size in smallest detectable ones."""

    geometry: str
    kind: str
    fault: str
    sensor: int
    multiple: float


def broken(case: Case, one: Unit, sensed: Vector, noise: Vector, begin: int, end: int) -> Vector:
    """What the sensor puts out, (k,) rad or m/s, from ``begin`` to ``end`` with the fault of ``case``.

    The unit of size is `smallest`, of noise the smallest that the single sample detects as surely. What
    depends on the motion has that size as a root mean square.
    """
    out = sensed.copy()
    t = (np.arange(begin, end) - begin + 1.0) / RATE_HZ
    moved = float(np.sqrt(np.mean(sensed[begin:end] ** 2))) * RATE_HZ
    size = case.multiple * smallest(one.fusion, case.sensor, moved) / RATE_HZ
    part = sensed[begin:end]
    if case.fault == "step":
        out[begin:end] += size
    elif case.fault == "ramp":
        out[begin:end] += size * t / RAMP
    elif case.fault == "stuck":
        out[begin:end] = part[0]
    elif case.fault == "noise":
        out[begin:end] += case.multiple * one.fusion.smallest(case.sensor, window=0) / RATE_HZ * noise
    else:
        out[begin:end] *= 1.0 + size / np.sqrt(np.mean(part**2))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A run with the fault, the same without, and from which sample to which it lasts.

    ``fusion`` is the unit's; ``least`` as of `bridge.studies.fault_bound.least`, at whole seconds of the run
    within the fault.
    """

    fusion: Redundant
    failed: Course
    healthy: Course
    begin: int
    end: int
    least: Vector


def run(case: Case, seed: int) -> Run:
    """The run of a case with that seed."""
    rng = np.random.default_rng(
        [seed, *case.geometry.encode(), *case.kind.encode(), *case.fault.encode(), case.sensor]
    )
    one = unit(case.geometry, case.kind, rng, Monitor(), GRADES["fog"])
    begin = round(rng.uniform(*ONSET) * RATE_HZ)
    end = begin + round(LASTS * RATE_HZ)
    felt = motion(case.kind, rng)
    if case.fault == "stuck":
        # slow motion around what it is stuck at, of the size asked for
        still = felt - felt[begin]
        off = float(np.sqrt(np.mean((still[begin:end] @ one.true.axes[case.sensor]) ** 2)))
        moved = float(np.linalg.norm(felt[begin])) if case.kind == "accel" else 0.0
        felt = felt[begin] * (case.kind == "accel") + still * (
            case.multiple * smallest(one.fusion, case.sensor, moved) / off
        )
    n = len(one.true.scale)
    white = rng.standard_normal((len(felt), n)) * one.walk / np.sqrt(RATE_HZ)
    sensed = (felt @ one.true.axes.T + one.true.bias) / RATE_HZ + white
    burst = rng.standard_normal(end - begin)
    failed = sensed.copy()
    failed[:, case.sensor] = broken(case, one, sensed[:, case.sensor], burst, begin, end)
    courses = []
    for outputs in (failed, sensed):
        pulses = outputs * np.where(
            outputs > 0.0, 1.0 + 0.5 * one.true.asymmetry, 1.0 - 0.5 * one.true.asymmetry
        )
        courses.append(
            course(
                one.fusion,
                np.diff(np.rint(np.cumsum(pulses / one.true.scale, axis=0)), axis=0, prepend=0.0),
                felt / RATE_HZ,
            )
        )
    fault = (failed - sensed)[begin:end, case.sensor]
    first, last = -(-begin // round(RATE_HZ)) + 1, end // round(RATE_HZ) + 1
    since = np.arange(first, last, dtype=np.float64) - begin / RATE_HZ
    bound = least(one.fusion, case.sensor, fault, felt[:end] / RATE_HZ, begin, since, RATE_HZ)
    return Run(one.fusion, courses[0], courses[1], begin, end, bound)


def course(fusion: Redundant, counts: Vector, truth: Vector) -> Course:
    """What the fusion makes of ``counts`` (k, n), from a fresh start."""
    k, n = counts.shape
    every = round(RATE_HZ)
    found, error = np.zeros((3, k), np.int64), np.zeros((k // every, 3))
    padded = np.zeros((k, MOST))
    padded[:, :n] = counts
    follow(fusion.tables, fusion.fresh(), padded, truth, every, np.zeros((3, 3)), found, error)
    return Course(found[0], found[1], found[2], error)
