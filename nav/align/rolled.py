"""What distance rolled does: dead reckoning in b0, and how the vertical and gravity change with it.

And how far roads take wheels off it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.earth import normal_gravity, radii
from nav.types import Vector

SLIP_S: Final = 1.0  # seconds that a slip stays
SIDEWAYS: Final = 0.5  # per m/s^2: of suspension and tyres, in units of the slip
CRAB: Final = 0.25  # per m/s, likewise: camber, side wind, steering
CRAB_WAY: Final = 12.5  # m over which that stays


class Reckoning(NamedTuple):
    """Dead reckoning in b0 since the beginning: distance along the vehicle's axes and what it does."""

    row: Vector  # of the last odometer sample
    t_ns: int
    ahead: Vector  # m, integral of C_b0b forward d(distance)
    right: Vector  # the same of the axis to the right, and of that upwards: what the mounting would add
    up: Vector
    imu: Vector  # m, the IMU's integral of C_b0b v
    area: Vector  # m s, integral of that
    over: Vector  # m, displacement over the Earth, turned on with the Earth
    drop: Vector  # m/s, change of gravity with it, integrated, minus
    fall: Vector  # m, integrated again


def transport(place: tuple[float, float, float], d: Vector) -> Vector:
    """By how much (3,) rad east-north-up turns over a displacement ``d`` (3,) m of its own axes."""
    r_m, r_n = radii(math.sin(place[0]))
    east = float(d[0]) / (r_n + place[2])
    return np.array([-float(d[1]) / (r_m + place[2]), east, east * math.tan(place[0])])


def gravity_change(lat: float, height: float) -> Vector:
    """Change (3, 3) of minus gravity with displacement, both east, north, up of a place, 1/s^2.

    The vertical turns by the curvature of the ellipsoid; gravity falls off with height and grows poleward.
    """
    r_m, r_n = radii(math.sin(lat))
    gravity = normal_gravity(math.sin(lat), height)
    step = 1e-3
    to_pole = normal_gravity(math.sin(lat + step), height) - normal_gravity(math.sin(lat - step), height)
    out = np.diag([gravity / (r_n + height), gravity / (r_m + height), -2.0 * gravity / math.sqrt(r_m * r_n)])
    out[2, 1] = to_pole / (2.0 * step * (r_m + height))
    return out


def road(slip: float, walk: float, speed: float, level: float) -> tuple[float, float]:
    """How far a road takes wheels off their way, across and along: random walks, m per root of a second.

    Across, that is to the right and upwards each, they move at ``slip`` m/s on a straight road, by the
    ``level`` acceleration (m/s^2) more, for about a second; and at a part of the ``speed`` (m/s) for some
    metres of way. Along it they count too much or too little, ``walk`` m per root of a metre.
    """
    crab = CRAB * math.sqrt(abs(speed) * max(abs(speed) * SLIP_S, CRAB_WAY))
    across = slip * math.sqrt(SLIP_S * (1.0 + (SIDEWAYS * level) ** 2) + crab**2)
    return across, walk * math.sqrt(abs(speed))
