"""Boats that roll at anchor, with a receiver: what an alignment in motion gets of one."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from bridge.studies.alignment_truth import HEIGHT, LAT, LON, Base, sensed
from nav.align import AlignConfig
from nav.earth import radii
from nav.types import FixType, GnssFix


class Boat(NamedTuple):
    """How far it swings about down, right and forward, how fast, and where the IMU and the antenna are."""

    swing_deg: tuple[float, float, float]
    hertz: tuple[float, float]
    imu: tuple[float, float, float]  # m from the point about which it rolls
    mast: tuple[float, float, float]  # m from the IMU


LAUNCH = Boat((1.5, 2.5, 8.0), (0.4, 1.1), (0.5, 2.0, 1.0), (0.3, -1.0, 2.5))
YACHT = Boat((0.5, 0.7, 3.0), (0.1, 0.25), (0.5, 1.0, 1.0), (0.0, 0.0, 2.0))
BARGE = Boat((0.3, 0.3, 1.0), (0.08, 0.2), (0.2, 0.5, 0.5), (0.0, 0.0, 1.0))
MOORED = Boat((0.0, 0.0, 0.0), (0.1, 0.2), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # stands

MEMS = AlignConfig(
    gyro_bias=math.radians(0.1),
    accel_bias=0.02,
    angle_random_walk=math.radians(0.2) / 60.0,
    velocity_random_walk=5e-4,
    sigma_heading=1e-9,  # it does not end: what it says as it goes on is looked at
)


def at_anchor(boat, seed, config=MEMS, seconds=30.0, dt=0.01, every=0.25, sigma_v=0.03):
    """Inertial samples, fixes (without their delay), the configuration, and the base, which is the truth."""
    config = dataclasses.replace(config, gnss_lever_arm=np.array(boat.mast))
    rng = np.random.default_rng(seed)
    swing = np.radians(boat.swing_deg)[:, None] * [[0.6, 0.4]]
    rates = 2.0 * math.pi * rng.uniform(*boat.hertz, 2)
    base = Base(rng, swing, rates, boat.imu, [rng.uniform(0.0, 2.0 * math.pi), 0.02, -0.03])
    top = Base(rng, swing, rates, np.add(boat.imu, boat.mast), base.mean)
    top.phase = base.phase
    samples, _, _ = sensed(rng, config, *base.increments(round(seconds / dt), dt), dt)
    r_m, r_n = radii(math.sin(LAT))
    sigma, sigma_p = np.full(3, sigma_v), np.full(3, 0.01)
    fixes = []
    for t in np.arange(every, seconds, every) - 0.007:
        v = top.velocity(t) + sigma * rng.standard_normal(3)
        p = base.C_gb(t) @ top.lever + sigma_p * rng.standard_normal(3)
        lat, lon = LAT + p[1] / (r_m + HEIGHT), LON + p[0] / ((r_n + HEIGHT) * math.cos(LAT))
        t_ns = round(t * 1e9)
        fixes.append(GnssFix(t_ns, lat, lon, HEIGHT + p[2], sigma_p, v, sigma, FixType.RTK_FIXED, "gnss"))
    return samples, fixes, config, base
