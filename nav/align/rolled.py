"""What distance rolled does: dead reckoning in b0, and how the vertical and gravity change with it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav.earth import normal_gravity, radii
from nav.types import Vector


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
