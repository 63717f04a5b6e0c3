"""Manoeuvres of a vehicle, and the smooth profile of speed, heading, slope, bank and yaw they add up to.

Every manoeuvre is a sequence of *blends*: over a duration T each channel goes from one value to the
next along the smoothstep of degree nine, whose first four derivatives vanish at both ends. The
channels are therefore four times continuously differentiable, body rates and specific force
at least once, whatever follows what.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def smooth(x: Array) -> Array:
    """Smoothstep of degree nine on [0, 1]."""
    # the upper half by symmetry: the polynomial itself would cancel there and lose three digits
    y = np.minimum(x, 1.0 - x)
    low = y**5 * (126.0 + y * (-420.0 + y * (540.0 + y * (-315.0 + y * 70.0))))
    return np.where(x <= 0.5, low, 1.0 - low)


def smooth_area(x: Array) -> Array:
    """Integral of the smoothstep from 0 to x."""
    y = np.minimum(x, 1.0 - x)
    low = y**6 * (21.0 + y * (-60.0 + y * (67.5 + y * (-35.0 + y * 7.0))))
    return np.where(x <= 0.5, low, x - 0.5 + low)


def _step_derivatives(x: Array) -> tuple[Array, Array, Array]:
    """First three derivatives of the smoothstep; the first is 630 x^4 (1 - x)^4."""
    u, v = x * (1.0 - x), 1.0 - 2.0 * x
    u2 = u * u
    return 630.0 * u2 * u2, 2520.0 * u2 * u * v, 2520.0 * u2 * (3.0 - 14.0 * u)


@dataclass(frozen=True, slots=True)
class Blend:
    """One smooth change: of speed (m/s), heading, slope, bank and yaw (rad) over ``duration`` seconds.

    Heading and slope are the path's; ``bank`` rolls the vehicle, right side down, and ``yaw`` turns its nose
    off the path, clockwise, and neither bends the path.
    """

    duration: float
    speed: float = 0.0
    heading: float = 0.0
    slope: float = 0.0
    bank: float = 0.0
    yaw: float = 0.0


class _Manoeuvre(msgspec.Struct, forbid_unknown_fields=True, tag_field="kind", kw_only=True):
    duration_s: float

    def blends(self, speed: float) -> list[Blend]:
        """Blends of this manoeuvre, entered at ``speed`` m/s. Raises ValueError when it cannot be driven."""
        raise NotImplementedError

    def _positive(self) -> float:
        if not (math.isfinite(self.duration_s) and self.duration_s > 0.0):
            raise ValueError(f"duration_s: found {self.duration_s}, expected a positive number of seconds")
        return self.duration_s


class Static(_Manoeuvre, tag="static"):
    """Stand still; may only follow a stop."""

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        if speed != 0.0:
            raise ValueError(f"static entered at {speed} m/s, expected standstill: brake to 0 first")
        return [Blend(self._positive())]


class Cruise(_Manoeuvre, tag="cruise"):
    """Keep speed, heading and level."""

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        return [Blend(self._positive())]


class Accelerate(_Manoeuvre, tag="accelerate"):
    """Change speed to ``speed_m_s``, negative for reverse; through zero only by way of zero."""

    speed_m_s: float

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        if speed * self.speed_m_s < 0.0:
            raise ValueError(f"speed_m_s: found {self.speed_m_s} at {speed} m/s, expected a stop between")
        return [Blend(self._positive(), speed=self.speed_m_s - speed)]


class Brake(_Manoeuvre, tag="brake"):
    """Slow down to ``speed_m_s``, by default to a stop."""

    speed_m_s: float = 0.0

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        if speed * self.speed_m_s < 0.0 or abs(self.speed_m_s) > abs(speed):
            raise ValueError(f"speed_m_s: found {self.speed_m_s} from {speed} m/s, expected a lower speed")
        return [Blend(self._positive(), speed=self.speed_m_s - speed)]


class Turn(_Manoeuvre, tag="turn"):
    """Change heading by ``angle_deg``, clockwise positive."""

    angle_deg: float

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        return [Blend(self._positive(), heading=math.radians(self.angle_deg))]


def _weave(angle: float, count: int, duration: float) -> list[tuple[float, float]]:
    """Durations and changes (rad) of ``count`` swings to ``angle``, to minus that, and back to nothing.

    Raises ValueError for less than one swing.
    """
    if count < 1:
        raise ValueError(f"count: found {count}, expected 1 or more")
    quarter = duration / (4.0 * count)
    swings = [-2.0 * angle if k % 2 == 0 else 2.0 * angle for k in range(2 * count - 1)]
    return [(quarter, angle), *((2.0 * quarter, swing) for swing in swings), (quarter, angle)]


class STurns(_Manoeuvre, tag="s_turns"):
    """Weave ``count`` times between heading + ``angle_deg`` and heading - ``angle_deg``, and straighten."""

    angle_deg: float
    count: int = 1

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        swings = _weave(math.radians(self.angle_deg), self.count, self._positive())
        return [Blend(duration, heading=angle) for duration, angle in swings]


class Wiggle(_Manoeuvre, tag="wiggle"):
    """Swing the nose ``count`` times by ``angle_deg`` to either side of a path that stays straight."""

    angle_deg: float
    count: int = 1

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        swings = _weave(math.radians(self.angle_deg), self.count, self._positive())
        return [Blend(duration, yaw=angle) for duration, angle in swings]


class WingRock(_Manoeuvre, tag="wing_rock"):
    """Roll to ``angle_deg``, right side down, and back at once; the path stays straight."""

    angle_deg: float

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        half, angle = 0.5 * self._positive(), math.radians(self.angle_deg)
        return [Blend(half, bank=angle), Blend(half, bank=-angle)]


class Climb(_Manoeuvre, tag="climb"):
    """Drive a ramp: tilt to ``slope_deg`` over a quarter of the time, hold, and level out again."""

    slope_deg: float

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        if abs(self.slope_deg) > 80.0:
            raise ValueError(f"slope_deg: found {self.slope_deg}, expected -80 to 80")
        quarter, slope = self._positive() / 4.0, math.radians(self.slope_deg)
        return [Blend(quarter, slope=slope), Blend(2.0 * quarter), Blend(quarter, slope=-slope)]


class Descend(_Manoeuvre, tag="descend"):
    """A ramp downwards of ``slope_deg`` (positive down)."""

    slope_deg: float

    def blends(self, speed: float) -> list[Blend]:
        """See `_Manoeuvre.blends`."""
        return Climb(duration_s=self.duration_s, slope_deg=-self.slope_deg).blends(speed)


Manoeuvre = Static | Cruise | Accelerate | Brake | Turn | STurns | Wiggle | WingRock | Climb | Descend


class Profile:
    """Speed (m/s), heading, slope, bank and yaw (rad) over time, with derivatives, from a list of blends.

    It begins at ``speed`` m/s along ``heading``. Times are nanoseconds since the start. Raises ValueError
    when there is nothing to drive.
    """

    def __init__(self, blends: Sequence[Blend], heading: float = 0.0, speed: float = 0.0) -> None:
        if not blends:
            raise ValueError("a trajectory needs at least one manoeuvre")
        self.duration = np.array([b.duration for b in blends])
        ends = np.rint(np.cumsum(self.duration) * 1e9).astype(np.int64)
        self.start_ns = np.concatenate((np.zeros(1, np.int64), ends[:-1]))
        self.end_ns = int(ends[-1])
        self.duration = (ends - self.start_ns) * 1e-9
        self._delta = np.array([[b.speed, b.heading, b.slope, b.bank, b.yaw] for b in blends])
        total = np.cumsum(self._delta, axis=0)
        begin = np.array([speed, heading, 0.0, 0.0, 0.0])
        self._base = np.concatenate((np.zeros((1, 5)), total[:-1])) + begin
        # sums of radians leave rounding behind; a stop must be exactly a stop
        self._base[np.abs(self._base) < 1e-12] = 0.0
        length = np.abs((self._base[:, 0] + 0.5 * self._delta[:, 0]) * self.duration)
        self._distance = np.concatenate((np.zeros(1), np.cumsum(length)))

    def _place(
        self, t_ns: NDArray[np.int64], since: Array | float = 0.0
    ) -> tuple[NDArray[np.intp], Array, Array]:
        index = np.clip(np.searchsorted(self.start_ns, t_ns, side="right") - 1, 0, None)
        length = self.duration[index]
        x = np.clip(((t_ns - self.start_ns[index]) * 1e-9 + since) / length, 0.0, 1.0)
        return index, x, length

    def channels(
        self, t_ns: NDArray[np.int64], since: Array | float = 0.0
    ) -> tuple[Array, Array, Array, Array]:
        """Value and first three derivatives, each (n, 5): speed, heading, slope, bank, yaw at ``t_ns`` (n,).

        ``since`` (n,) seconds is added to the times, within the blend that holds ``t_ns``.
        """
        index, x, length = self._place(t_ns, since)
        delta = self._delta[index]
        d1, d2, d3 = (
            (d / length**order)[:, None] * delta for order, d in enumerate(_step_derivatives(x), start=1)
        )
        return self._base[index] + smooth(x)[:, None] * delta, d1, d2, d3

    def turns(self) -> NDArray[np.bool_]:
        """Which blends (k, 2) change the heading of the path, and which roll or yaw the vehicle about it."""
        return np.stack((self._delta[:, 1] != 0.0, (self._delta[:, 3:] != 0.0).any(axis=1)), axis=1)

    def speed(self, t_ns: NDArray[np.int64]) -> Array:
        """Speed along the path (n,) m/s, negative in reverse."""
        index, x, _ = self._place(t_ns)
        return np.asarray(self._base[index, 0] + smooth(x) * self._delta[index, 0])

    def distance(self, t_ns: NDArray[np.int64], since: Array | float = 0.0) -> Array:
        """Distance rolled since the start (n,) m, counted up in reverse too; times as in `channels`."""
        index, x, length = self._place(t_ns, since)
        part = self._base[index, 0] * x + smooth_area(x) * self._delta[index, 0]
        return np.asarray(self._distance[index] + np.abs(part) * length)
