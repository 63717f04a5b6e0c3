"""What a standstill says when gyros and accelerometers have to agree over all of it.

A vehicle that hardly moves keeps gravity, whether it stands or rolls: with f the specific force in b, theta
what the gyros have turned and b their bias,

    f(t) = f0 + f0 x (theta(t) - b t) + a(t),

a being sway. So f - f0 x theta is a straight line, of which the slope is the level part of the bias and the
end is the vertical of now, and nothing is taken for a standstill's because a receiver shows little speed: a
second of a slow roll has a steady rate, which only the force, turning as much, tells from a bias. How far the
line may be off is told by the velocity of the sway: as configured, as the velocity increments show it, and as
an IMU that is ``ARM`` from the point about which it turns would have it. It is the velocity that has a bound:
one of s m/s makes a slope over T vary by 72 s^2/T^4, the line's end by 20 s^2/T^2 (least squares, by parts).

What stands does not turn at all, and then the gyros' mean is a better bias than the force's slope. So of the
turning that the force shows only what exceeds its own variance is believed (James and Stein's estimate): none
of a parked car's, nearly all of a boat's.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.types import AlignConfig
from nav.rotation import skew
from nav.types import Vector

ARM: Final = 3.0  # m
FEWEST: Final = 5  # parts before a parabola leaves anything to see
_T, _T2 = 1, 2  # places in a part's row: after the 1 its time and the square of that
_F, _THETA, _W = slice(3, 6), slice(6, 9), slice(9, 12)  # mean force, angle so far, mean rate
_V, _AREA = slice(12, 15), slice(15, 18)  # integrals of force and angle
_SIZE: Final = 18
_ZERO: Final = np.zeros(3)
_NOTHING: Final = np.zeros((_SIZE, _SIZE))


class Steady(NamedTuple):
    """Weighted products of the rows of all parts; forces and rates less those of the first part, SI units."""

    products: Vector = _NOTHING
    parts: int = 0
    t: float = 0.0
    force: Vector = _ZERO  # of the first part, b
    rate: Vector = _ZERO
    theta: Vector = _ZERO  # at the end of the last one
    v: Vector = _ZERO
    area: Vector = _ZERO

    @property
    def seconds(self) -> float:
        """What is remembered."""
        return float(self.products[0, 0])


class Stood(NamedTuple):
    """At the end of the last part: specific force (3,) without sway, bias (3,) with the Earth's rate; b.

    ``tilt`` rad^2 is the variance of the vertical about a level axis, ``drift`` (3,) rad^2/s^2 of the bias.
    """

    force: Vector
    bias: Vector
    tilt: float
    drift: Vector


def follow(steady: Steady, dt: float, dtheta: Vector, dv: Vector, remember: float) -> Steady:
    """Add a part of ``dt`` s with its sums (3,) rad and m/s in b; more than ``remember`` s fade."""
    if steady.parts == 0:
        steady = steady._replace(force=dv / dt, rate=dtheta / dt)
    rate, force = dtheta / dt - steady.rate, dv / dt - steady.force
    t, theta = steady.t + 0.5 * dt, steady.theta + 0.5 * dt * rate
    v, area = steady.v + force * dt, steady.area + theta * dt
    row = np.concatenate([[1.0, t, t * t], force, theta, rate, v, area])
    keep = min(1.0, remember / max(steady.seconds, 1e-9))
    return steady._replace(
        products=keep * steady.products + dt * np.outer(row, row),
        parts=steady.parts + 1,
        t=steady.t + dt,
        theta=steady.theta + rate * dt,
        v=v,
        area=area,
    )


def stood(steady: Steady, config: AlignConfig) -> Stood | None:
    """What the parts so far say, or None while they are too few."""
    if steady.parts < FEWEST:
        return None
    seconds, n = steady.seconds, steady.parts * steady.seconds / steady.t
    mean = steady.products[0] / seconds
    spread = steady.products / seconds - np.outer(mean, mean)
    f0 = steady.force + mean[_F]
    g, up = float(np.linalg.norm(f0)), f0 / float(np.linalg.norm(f0))
    cross = skew(f0)
    # the line, and the bias that makes its slope
    slope = (spread[_T, _F] - cross @ spread[_T, _THETA]) / spread[_T, _T]
    level = np.cross(f0, slope) / g**2
    rate = mean[_W] - up * (up @ mean[_W])
    turned = rate - level
    at_end = slope * (steady.t - mean[_T]) + cross @ (steady.theta - mean[_THETA])

    # the velocity of the sway: what a parabola leaves of the integral, and what turning makes of an arm
    A = np.zeros((3, _SIZE))
    A[:, _V], A[:, _AREA] = np.eye(3), -cross
    both = spread[_T : _T2 + 1, _T : _T2 + 1]
    seen = A @ spread @ A.T - A @ spread[:, _T : _T2 + 1] @ np.linalg.pinv(both) @ spread[_T : _T2 + 1] @ A.T
    turning = float(turned @ turned) + float(np.trace(spread[_W, _W]))
    shaken = config.sway**2 + max(0.0, float(np.trace(seen))) / 3.0 * n / max(1.0, n - 3.0)
    walk, push = config.angle_random_walk**2, config.velocity_random_walk**2
    T = math.sqrt(12.0 * float(spread[_T, _T]))
    # it stands or it turns: what turning is seen beyond what sway without any would show is believed
    standing = (72.0 * shaken / T**4 + 12.0 * push / T**3) / g**2 + 1.2 * walk / T
    seen_turn = float(turned @ turned)
    share = max(0.0, 1.0 - 2.0 * standing / seen_turn) if seen_turn > 0.0 else 0.0
    sway, still = shaken + ARM**2 * turning, walk / seconds
    drift = (1.0 - share) * still + share * (standing + 72.0 * ARM**2 * turning / T**4 / g**2)
    tilt = (20.0 * sway / T**2 + 4.0 * push / T + config.accel_bias**2) / g**2 + 2.0 / 15.0 * walk * T
    # about the vertical nothing tells a turn from a bias: as much as it turned about level axes
    about = still + 0.5 * share * seen_turn
    return Stood(
        force=f0 + at_end,
        bias=steady.rate + rate - share * turned + up * (up @ mean[_W]),
        tilt=tilt,
        # or as rates were seen to scatter, where that is more
        drift=np.maximum(drift + (about - drift) * up**2, np.diag(spread[_W, _W]) / n),
    )
