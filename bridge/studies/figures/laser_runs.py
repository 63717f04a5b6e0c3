"""Coning navigations with dithered laser gyros, each latched at the ends of its own cycles.

The cone of Yan Gongmin 2008, eqs. (6-1) to (6-5), about the vertical: counts at any instant have a closed
form, latch times come in integers from the simulated bench, and the navigation is the program's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.imu.whole_cycle import Method, correct, fresh, synchronised
from nav.jit import in_place
from nav.rotation import euler_from_quat, exponential, multiply
from nav.strapdown.kernels import increments
from virtual_bus.dither import Dither

Array = NDArray[np.float64]

SAMPLE_NS: Final = 10_000_000
SECONDS: Final = 600
ARCMIN: Final = math.pi / 10_800.0
_LEAD: Final = 20
"""Samples before the start of a navigation whose gyros have been running: no start is among its errors."""


@dataclass(frozen=True, slots=True)
class Cone:
    """A cone about the vertical of half angle ``alpha`` rad, ``omega`` rad/s."""

    alpha: float
    omega: float

    def counted(self, t: Array) -> Array:
        """Integral of the rate from time zero to ``t`` (n, 3), each gyro at its own time, rad: eq. (6-3)."""
        s, wt = math.sin(self.alpha), self.omega * t
        out = np.empty_like(t)
        out[:, 0] = s * (np.cos(wt[:, 0]) - 1.0)
        out[:, 1] = s * np.sin(wt[:, 1])
        out[:, 2] = -2.0 * math.sin(0.5 * self.alpha) ** 2 * wt[:, 2]
        return out

    def attitude(self, t: float) -> Array:
        """Quaternion (4,) from body axes at ``t`` s: eq. (6-2)."""
        s, wt = math.sin(0.5 * self.alpha), self.omega * t
        return np.array([math.cos(0.5 * self.alpha), s * math.cos(wt), s * math.sin(wt), 0.0])


class Run:
    """Readings of three gyros on a cone at the sampling instants of ten minutes.

    ``dithers`` None: gyros that need none, read at the instants. ``together``: at time zero all are latched
    and begin to count; otherwise they have been running.
    """

    def __init__(self, cone: Cone, dithers: Sequence[Dither] | None, together: bool = True) -> None:
        self.cone = cone
        self._lead = 0 if together else _LEAD
        k = np.arange(-self._lead, SECONDS * 1_000_000_000 // SAMPLE_NS + 1)
        instants = np.repeat((k * (SAMPLE_NS * 1e-9))[:, None], 3, axis=1)
        self.ages = np.zeros_like(instants)
        if dithers is not None:
            self.ages = np.stack([one.age(k * SAMPLE_NS) for one in dithers], axis=1)
        self._counts = np.diff(cone.counted(instants - self.ages), axis=0)
        self._together = together

    def read(self, method: Method | None = None) -> Array:
        """Increments (n, 3), rad, as read, or corrected by a method."""
        return self._corrected(self._counts, method)

    def magnified(self, method: Method, rng: np.random.Generator) -> float:
        """How much larger white noise of the latches (rms) is at the instants, after a correction."""
        noise = rng.standard_normal((len(self.ages), 3))
        angles = np.cumsum(self._corrected(np.diff(noise, axis=0), method), axis=0)
        return float(np.sqrt(np.mean(np.var(angles, axis=0))))

    def _corrected(self, latched: Array, method: Method | None) -> Array:
        counts = latched.copy()
        if method is not None:
            state = synchronised() if self._together else fresh()
            slope, bend, degree = method
            _correct(slope, bend, degree, state, self.ages[1:], SAMPLE_NS * 1e-9, counts)
        return counts[self._lead :]

    def drift(self, counts: Array) -> float:
        """Azimuth after ten minutes, true minus computed, arcmin, of a navigation with these increments."""
        q = self.cone.attitude(0.0)
        _navigate(q, counts, np.zeros(12), np.empty(6))
        true = self.cone.attitude(len(counts) * SAMPLE_NS * 1e-9)
        # the text's azimuth turns to the left, a heading to the right
        excess = float(euler_from_quat(q)[0] - euler_from_quat(true)[0])
        return math.remainder(excess, 2.0 * math.pi) / ARCMIN

    def drifts(self, methods: Mapping[str, Method]) -> dict[str, float]:
        """`drift` by the names of ``methods``."""
        return {name: self.drift(self.read(method)) for name, method in methods.items()}


@in_place
def _correct(
    slope: float, bend: float, degree: int, state: Array, ages: Array, tau: float, counts: Array
) -> None:
    for k in range(len(counts)):
        correct(slope, bend, degree, state, ages[k], tau, counts[k])


@in_place
def _navigate(q: Array, counts: Array, two: Array, inc: Array) -> None:
    """Turn ``q`` (4,) by pairs of increments: the program's two-sample algorithm."""
    for k in range(len(counts) // 2):
        for i in range(3):
            two[i], two[3 + i] = counts[2 * k, i], counts[2 * k + 1, i]
        increments(two, 2, inc)
        rw, rx, ry, rz = exponential(inc[0], inc[1], inc[2])
        w, x, y, z = multiply(q[0], q[1], q[2], q[3], rw, rx, ry, rz)
        # a rounding's worth of length each time; six thousand of them would show
        norm = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        q[0], q[1], q[2], q[3] = w * norm, x * norm, y * norm, z * norm
