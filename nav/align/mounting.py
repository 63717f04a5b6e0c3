"""The rotation of the IMU in the vehicle, from gravity at rest and the direction it drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from nav.types import Vector

SLOWEST: Final = 3.0  # m/s: below it the course says little about the vehicle's axis
SLIP_LEVER: Final = 2.0  # m: an IMU so far ahead of the rear axle moves sideways in a turn
COURSE_NOISE: Final = 0.015  # rad of side slip and road that average out only slowly


@dataclass(frozen=True, slots=True)
class Mounting:
    """C_vb (3, 3) and its standard deviation about right, forward and up of the vehicle (3,), rad."""

    C_vb: Vector
    sigma: Vector


def find_mounting(
    C_gb: Vector,
    v_g: Vector,
    rate_up: Vector,
    up_b: Vector,
    sigma_up: float,
    sigma_v: float,
    sigma_heading: float,
) -> Mounting | None:
    """Mounting from the attitudes ``C_gb`` (K, 3, 3) and velocities ``v_g`` (K, 3) m/s of one drive.

    Driving is taken to be forward. ``rate_up`` (K,) rad/s is the rate of turn; ``up_b`` (3,) the vehicle's
    vertical axis in b, known to ``sigma_up`` rad (the ground it stood on); ``sigma_v`` m/s,
    ``sigma_heading`` rad: standard deviations of a velocity and of the attitudes' common heading error.
    None while too little of the drive is fast and straight enough.
    """
    speed = np.linalg.norm(v_g, axis=1)
    fast = speed > SLOWEST
    if np.count_nonzero(fast) < 4:
        return None
    speed, v_g, C_gb, rate_up = speed[fast], v_g[fast], C_gb[fast], rate_up[fast]
    forward = np.einsum("kji,kj->ki", C_gb, v_g / speed[:, None])
    var = (SLIP_LEVER * rate_up / speed) ** 2 + (sigma_v / speed) ** 2 + COURSE_NOISE**2
    weight = 1.0 / var
    mean = np.sum(weight[:, None] * forward, axis=0) / np.sum(weight)
    length = float(np.linalg.norm(mean))
    # a mean well inside the unit sphere: it drove forward and backward, or heading is wrong
    if length < 0.95:
        return None
    y = mean / length
    z = up_b - y * (y @ up_b)
    z /= np.linalg.norm(z)
    x = np.cross(y, z)
    across = forward @ x
    scatter = float(np.sum(weight * across**2) / np.sum(weight))
    # neighbouring courses share their error: one in four counts
    own = max(1.0 / float(np.sum(weight)), scatter / len(speed)) * 4.0 + COURSE_NOISE**2 / 4.0
    sigma = np.array([math.sqrt(own), sigma_up, math.sqrt(own + sigma_heading**2)])
    return Mounting(np.stack([x, y, z]), sigma)


def mounting_from_axis(forward: Vector, covariance: Vector, up_b: Vector, sigma_up: float) -> Mounting:
    """Mounting from the forward axis ``forward`` (3,) in b and ``up_b`` (3,), known to ``sigma_up`` rad.

    ``covariance`` (3, 3) rad^2: of the axis' end, in b.
    """
    z = up_b - forward * (forward @ up_b)
    z /= np.linalg.norm(z)
    x = np.cross(forward, z)
    # the axis moves up by a turn about right, and to the left by one about up
    sigma = np.array([math.sqrt(z @ covariance @ z), sigma_up, math.sqrt(x @ covariance @ x)])
    return Mounting(np.stack([x, forward, z]), sigma)
