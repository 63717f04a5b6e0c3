"""Two journeys with every kind of sample, for whatever aligns: at rest, and on the road with stops."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from nav.align import AlignConfig
from nav.rotation import quat_from_dcm
from nav.types import BaroSample, FixType, GnssFix, ImuFlag, ImuSample, OdoSample, Sample, SpeedSample
from virtual_bus.manoeuvres import Accelerate, Brake, Cruise, Manoeuvre, Profile, Static, STurns, Turn
from virtual_bus.truth import Trajectory, Vehicle

DT_NS = 80_000_000
REST_S, DRIVE_S = 200.0, 320.0
HEADING = 0.7
LAT, LON, HEIGHT = 0.8, 0.2, 300.0
_DEG_PER_H = math.radians(1.0) / 3600.0
_KINDS = {"gnss": GnssFix, "odometer": OdoSample, "speed": SpeedSample, "baro": BaroSample, "imu": ImuSample}

# gyros that see Earth's rate in seconds
CONFIG = AlignConfig(
    gyro_bias=0.01 * _DEG_PER_H,
    accel_bias=2e-4,
    angle_random_walk=0.0005 * math.radians(1.0) / 60.0,
    velocity_random_walk=5e-5,
    coarse_s=60.0,
    fine_s=90.0,
    position=(LAT, LON, HEIGHT),
    sigma_position=3.0,
    C_vb=np.eye(3),
    store_s=300.0,
    heading=(HEADING, math.radians(0.5)),
)


def _trajectory(manoeuvres: list[Manoeuvre]) -> Trajectory:
    blends, speed = [], 0.0
    for manoeuvre in manoeuvres:
        new = manoeuvre.blends(speed)
        speed += sum(blend.speed for blend in new)
        blends += new
    vehicle = Vehicle(np.zeros(3), np.eye(3), 0.0, 0.0, None)
    return Trajectory(Profile(blends, HEADING), vehicle, LAT, LON, HEIGHT)


def _road() -> list[Manoeuvre]:
    leg: list[Manoeuvre] = [
        Accelerate(duration_s=8.0, speed_m_s=9.0),
        STurns(duration_s=20.0, angle_deg=30.0, count=2),
        Turn(duration_s=10.0, angle_deg=80.0),
        Cruise(duration_s=24.0),
        Turn(duration_s=10.0, angle_deg=-60.0),
        STurns(duration_s=20.0, angle_deg=-40.0, count=2),
        Brake(duration_s=8.0),
        Static(duration_s=10.0),
    ]
    return [Static(duration_s=12.0), *leg, *leg, *leg]


@cache
def journey(name: str) -> tuple[tuple[Sample, ...], dict[int, np.ndarray]]:
    """Samples of "rest" or "road" in the order of arrival, and the true ``q_gb`` (4,) by inertial time."""
    rest = name == "rest"
    trajectory = _trajectory([Static(duration_s=REST_S + 1.0)] if rest else _road())
    rng = np.random.default_rng(11)
    n = round((REST_S if rest else DRIVE_S) * 1e9) // DT_NS
    t_ns = DT_NS * np.arange(n + 1)
    motion = trajectory.motion(t_ns)
    dtheta, dv = trajectory.increments(t_ns)
    dt, root = DT_NS * 1e-9, math.sqrt(DT_NS * 1e-9)
    bias_g, bias_a = (0.5 * size * rng.standard_normal(3) for size in (CONFIG.gyro_bias, CONFIG.accel_bias))
    dtheta = dtheta + bias_g * dt + CONFIG.angle_random_walk * root * rng.standard_normal((n, 3))
    dv = dv + bias_a * dt + CONFIG.velocity_random_walk * root * rng.standard_normal((n, 3))
    rolled = trajectory.profile.distance(t_ns)
    samples: list[Sample] = []
    for k in range(n):
        t = int(t_ns[k + 1])
        samples.append(ImuSample(t, dt, dtheta[k], dv[k], "imu"))
        distance = float(rolled[k + 1] - rolled[k])
        samples.append(OdoSample(t, dt, distance, distance == 0.0, "odometer"))
        if k % 4 == 3:
            speed = float(np.linalg.norm(motion.v_g[k + 1])) + 0.01 * rng.standard_normal()
            samples.append(SpeedSample(t, speed, 0.01, "speed"))
            samples.append(_fix(motion, k + 1, t, rng))
            samples.append(BaroSample(t, HEIGHT, 1.0, "baro"))
    truth = {int(t): quat_from_dcm(motion.C_gv[k]) for k, t in enumerate(t_ns)}  # b is v here
    return tuple(samples), truth


def _fix(motion, k: int, t_ns: int, rng: np.random.Generator) -> GnssFix:
    error, size = 0.02 * rng.standard_normal(3), np.full(3, 0.02)
    return GnssFix(
        t_ns,
        float(motion.lat[k] + error[1] / 6.37e6),
        float(motion.lon[k] + error[0] / (6.37e6 * math.cos(LAT))),
        float(motion.height[k] + error[2]),
        size,
        motion.v_g[k] + 0.01 * rng.standard_normal(3),
        0.5 * size,
        FixType.RTK_FIXED,
        "gnss",
    )


def only(samples: tuple[Sample, ...], kinds: set[str]) -> tuple[Sample, ...]:
    """Those of some kinds, and the inertial ones."""
    wanted = tuple(_KINDS[kind] for kind in kinds | {"imu"})
    return tuple(sample for sample in samples if isinstance(sample, wanted))


def with_a_gap(samples: tuple[Sample, ...], from_s: float, to_s: float) -> tuple[Sample, ...]:
    """Nothing at all arrives between two times; the next inertial sample says so."""
    kept = [s for s in samples if not from_s * 1e9 < s.t_ns <= to_s * 1e9]
    after = next(k for k, s in enumerate(kept) if isinstance(s, ImuSample) and s.t_ns > to_s * 1e9)
    kept[after] = kept[after]._replace(flags=int(ImuFlag.GAP))
    return tuple(kept)
