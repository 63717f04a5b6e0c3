"""What alignments are tried on when something goes wrong: a stand, a sway, and three ways of driving."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from bridge.studies.alignment_truth import (
    HEIGHT,
    LAT,
    LON,
    TICK,
    Base,
    drive,
    fixes,
    merged,
    road,
    sensed,
    ticks,
    times,
)
from nav.align import AlignConfig
from nav.rotation import dcm_from_quat, euler_from_dcm
from nav.types import Sample, Vector
from tests.nav.align import making

DT = 0.1
ALIGN_S = 120.0
ROAD_S = 240.0
IMU = np.array([0.3, 1.2, 0.8])  # m from the rear axle

# navigation grade: 0.007 deg/h, 0.0005 deg/sqrt(h), 50 ug, 10 ug/sqrt(Hz)
GRADE = replace(making.GRADE, fine_s=ALIGN_S - 60.0)


@dataclass(frozen=True)
class Scene:
    """Samples in the order of arrival, the configuration, and true C_gb (3, 3) at a time (s)."""

    samples: list[Sample]
    config: AlignConfig
    C_gb: Callable[[float], Vector]
    begin: float  # s
    align: float  # s that an alignment takes


@cache
def standing(seed: int) -> Scene:
    """A vehicle with its engine running: a third of a millimetre a second at the IMU."""
    return _based(seed, [[1e-5], [3e-5], [3e-5]], 1.437, [0.3, 0.5, 1.0], GRADE)


@cache
def swaying(seed: int) -> Scene:
    """People walk about in it: 0.3 degrees at 0.3 to 1.2 Hz."""
    swing = np.radians([[0.02] * 4, [0.15] * 4, [0.15] * 4])
    return _based(seed, swing, None, [0.3, 0.5, 1.0], replace(GRADE, sway=0.01))


def _based(seed: int, swing, hertz: float | None, lever, config: AlignConfig) -> Scene:
    rng = np.random.default_rng(seed)
    rates = 2.0 * math.pi * (rng.uniform(0.3, 1.2, 4) if hertz is None else np.array([hertz]))
    base = Base(rng, swing, rates, lever)
    dt = DT if hertz else 0.5 * DT
    dtheta, dv = base.increments(round(2.3 * ALIGN_S / dt), dt)
    samples, _, _ = sensed(rng, config, dtheta, dv, dt)
    heading = euler_from_dcm(base.C_gb(0.0))[0] + math.radians(0.5) * rng.standard_normal()
    config = replace(config, heading=(heading, math.radians(0.5)), C_vb=np.eye(3))
    return Scene(samples, config, base.C_gb, 0.0, ALIGN_S)


@cache
def _road(kind: str, number: int):
    trajectory = drive(road(kind, 2.0 * ROAD_S + 42.0), 1.0 + 1.6 * number, LAT, LON, HEIGHT, IMU)
    t_ns = times(20.0, 2.0 * ROAD_S + 20.0, DT)
    return trajectory, t_ns, trajectory.increments(t_ns)


@cache
def rolling(seed: int, kind: str = "winding") -> Scene:
    """A drive at 5 to 8 m/s with an odometer of 8 cm ticks."""
    trajectory, t_ns, (dtheta, dv) = _road(kind, seed % 4)
    rng = np.random.default_rng(seed)
    start = trajectory.state(int(t_ns[0]))
    config = replace(
        GRADE,
        fine_s=ROAD_S - 60.0,
        position=(start.lat, start.lon, start.height),
        C_vb=np.eye(3),
        odometer_scale=0.003,
        odometer_quantum=TICK,
        odometer_lever_arm=-IMU,
        slip=0.002,
        sigma_mounting=math.radians(0.05),
    )
    inertial = _inertial(rng, config, dtheta, dv, int(t_ns[0]))
    wheel = ticks(trajectory, t_ns, 1.0 + 0.002 * rng.standard_normal())
    return Scene(merged(inertial, wheel), config, _truth(trajectory), 20.0, ROAD_S)


@cache
def tracked(seed: int, velocity: float | None = 0.1) -> Scene:
    """The same drive with a fix a second."""
    trajectory, t_ns, (dtheta, dv) = _road("winding", seed % 4)
    rng = np.random.default_rng(seed)
    config = replace(GRADE, fine_s=ROAD_S - 60.0, position=None)
    inertial = _inertial(rng, config, dtheta, dv, int(t_ns[0]))
    fix = fixes(trajectory, times(20.0, 2.0 * ROAD_S + 20.0, 1.0), rng, 0.3, 2.0, 150.0, velocity)
    return Scene(merged(inertial, fix), config, _truth(trajectory), 20.0, ROAD_S)


@cache
def consumer(seed: int) -> Scene:
    """A MEMS IMU in a car from a stand, with RTK fixes: heading from motion."""
    trajectory = drive(road("winding", 100.0), 1.0 + 1.6 * (seed % 4), LAT, LON, HEIGHT, IMU)
    dt = 0.05
    t_ns = times(0.0, 100.0, dt)
    dtheta, dv = trajectory.increments(t_ns)
    rng = np.random.default_rng(seed)
    config = AlignConfig(
        gyro_bias=math.radians(0.1),
        accel_bias=0.05,
        angle_random_walk=math.radians(0.3) / 60.0,
        velocity_random_walk=1e-3,
    )
    inertial = _inertial(rng, config, dtheta, dv, 0, dt)
    fix = fixes(trajectory, times(0.0, 100.0, 0.25), rng, 0.02, 0.02, 100.0, 0.05)
    return Scene(merged(inertial, fix), config, _truth(trajectory), 0.0, 40.0)


def _inertial(rng, config: AlignConfig, dtheta, dv, begin_ns: int, dt: float = DT) -> list[Sample]:
    samples, _, _ = sensed(rng, config, dtheta, dv, dt, start_ns=begin_ns)
    return list(samples)


def _truth(trajectory) -> Callable[[float], Vector]:
    return lambda t: dcm_from_quat(trajectory.state(round(t * 1e9)).q_gb)
