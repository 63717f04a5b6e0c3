"""Fusion of four and more gyros or accelerometers, and what to do when one of them fails.

Every sample is fused by weighted least squares and tested in parity space (`nav.imu.parity`), and so are sums
over windows, in which a small fault grows faster than noise does. Where the test fails, the sensor that
explains it best is excluded, if it does so better than all others by odds of `Monitor.isolation`; else those
that may be it are suspects, and later tests decide. Odds that a later test reverses put the sensor that was
excluded for nothing back in the place of the one that has failed. A fault that a sample shows is excluded
before that sample is used. What it brought in before is known for the longest window and is handed back as a
correction.

The test's threshold follows from the noise and from `Monitor.false_alarms`, shared by the windows in equal
parts. All windows move on by the shortest of them, so that no fault waits for a window to begin; that sums
which overlap fail together is in their thresholds. A sensor comes back when it agrees with the others over
several of the longest windows, which for this do not overlap. One that sends NaN is not there: it is out at
once.

What geometry cannot tell, no threshold can: with T the mirror of S in the y-z plane (`with_skew`), faults of
y and of z move the parity vector in the same direction, and stay suspects together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav.imu.many import Sensors
from nav.imu.parity import MOST, noncentrality, sets_of, thresholds
from nav.imu.redundant_kernel import ACTIVE, PRESENT, SUSPECTS, WHOLE, State, Tables, fuse, give, variance_of
from nav.imu.redundant_sample import (
    CONSTANT,
    HOT,
    LANES,
    LEFT,
    MOTION,
    SCALE,
    SQUARED,
    TIMES,
    UNEVEN,
    quick,
    quick_both,
)
from nav.types import Vector


@dataclass(frozen=True, slots=True)
class Noise:
    """What a healthy sensor's increments differ by from its share of the motion, SI, one sigma.

    ``walk`` in rad or m/s per root s, ``pulse`` rad or m/s per count, ``bias`` in rad/s or m/s^2;
    ``scale``, of scale and axis, is a share of the motion. Of the last two what calibration has left.
    """

    walk: float
    pulse: float = 0.0
    bias: float = 0.0
    scale: float = 0.0

    def variance(self, seconds: float, motion: float = 0.0) -> float:
        """Of an increment over ``seconds`` while the unit moved by ``motion`` rad or m/s."""
        return float(variance_of(self.parts(), seconds, motion**2))

    def parts(self) -> Vector:
        """Variances (4,): times seconds, constant, times seconds squared, times motion squared."""
        # sums telescope: what rounding leaves of a window of any length are the fractions at its two ends
        return np.array([self.walk**2, self.pulse**2 / 6.0, self.bias**2, self.scale**2])


@dataclass(frozen=True, slots=True)
class Monitor:
    """How sensors are watched.

    ``false_alarms`` is how many alarms there are in an hour without a fault, tests that fail less than the
    longest window after each other being one; ``isolation`` the chance of excluding another sensor than the
    one that failed; ``windows`` s the lengths of sums beside the single sample, growing multiples of the
    first. A sensor is let in again after ``agreements`` of the longest windows in which it is within ``near``
    sigmas of what the others say.
    """

    false_alarms: float = 0.01
    isolation: float = 1e-3
    windows: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0)
    agreements: int = 2
    near: float = 3.0


class Redundant:
    """Gyros, or accelerometers, of one unit, from sample to sample.

    ``sigma`` (n,) where sensors differ: their noise in units of ``noise``. ``rate_hz`` tells how many samples
    make a window.

    Raises:
        ValueError: axes of less than four sensors or that do not span space, windows that are no multiples.
    """

    def __init__(
        self,
        sensors: Sensors,
        noise: Noise,
        rate_hz: float,
        monitor: Monitor = Monitor(),
        sigma: Vector | None = None,
    ) -> None:
        n = len(sensors.axes)
        self.sensors, self.noise, self.monitor = sensors, noise, monitor
        self.sigma = np.ones(n) if sigma is None else np.array(sigma, dtype=np.float64)
        self.seconds = (1.0 / rate_hz, *monitor.windows)
        first = monitor.windows[0]
        ratios = np.array([first * rate_hz, *(one / first for one in monitor.windows[1:])])
        whole = np.rint(ratios).astype(np.int64)
        growing = whole.min() > 1 and np.all(np.diff(whole[1:]) > 0)
        if not growing or np.abs(ratios / np.maximum(whole, 1) - 1.0).max() > 1e-6:
            raise ValueError(f"windows: expected multiples of the first, it of a sample: {monitor.windows}")
        lengths = np.concatenate(([1], whole[1:]))
        every = np.array([self.seconds[0], *[first] * len(lengths)])
        alarms = monitor.false_alarms / 3600.0 / len(every) * every
        try:
            limits = thresholds(n - 3, alarms, [1, *lengths.tolist()])
        except ValueError as error:
            raise ValueError(f"false_alarms: {error}") from None
        self.tables = Tables(
            sets_of(sensors.axes, self.sigma),
            sensors.axes,
            sensors.bias,
            sensors.g_sensitivity,
            noise.parts(),
            limits,
            int(whole[0]),
            lengths,
            # odds of one sensor against another are exp of half the difference of their shares
            -2.0 * math.log(monitor.isolation),
            monitor.agreements,
            monitor.near,
        )
        self.state = self.fresh()

    def fresh(self) -> State:
        """The state before the first sample: everybody is trusted."""
        n = len(self.sigma)
        whole = np.zeros(WHOLE, np.int64)
        parts = int(self.tables.lengths[-1])
        whole[ACTIVE] = (1 << n) - 1
        whole[PRESENT : PRESENT + n] = parts
        hot = _lanes(HOT)
        hot[LANES], hot[LEFT] = MOST, self.tables.samples
        one = self.sensors
        hot[SCALE : SCALE + n] = 0.5 * (one.scale_plus + one.scale_minus)
        hot[UNEVEN : UNEVEN + n] = 0.5 * (one.scale_plus - one.scale_minus)
        hot[[TIMES, CONSTANT, SQUARED, MOTION]] = self.noise.parts()
        state = State(whole, np.zeros((parts, MOST)), np.zeros(parts), np.zeros(3 + n), hot)
        give(self.tables, state)
        return state

    def sample(self, counts: Vector, tau: float, dv: Vector, x: Vector, owed: Vector) -> int:
        """Fuse ``counts`` (n,); see `quick` and `fuse`."""
        if quick(self.state.hot, counts, 0, tau, dv[0], dv[1], dv[2], x):
            owed[:] = 0.0
            return 0
        return self.after_quick(tau, x, owed)

    def after_quick(self, tau: float, x: Vector, owed: Vector) -> int:
        """Fuse the sample that `quick` has just refused; see `fuse`."""
        return int(fuse(self.tables, self.state, tau, x, owed))

    @property
    def active(self) -> tuple[int, ...]:
        """Sensors in use."""
        return _bits(int(self.state.whole[ACTIVE]))

    @property
    def suspects(self) -> tuple[int, ...]:
        """Sensors one of which has failed, as far as is known; empty where there is no doubt."""
        return _bits(int(self.state.whole[SUSPECTS]))

    def covariance(self, seconds: float, motion: float = 0.0) -> Vector:
        """Covariance (3, 3) of what is fused now over ``seconds``, infinite where nothing can be."""
        return np.asarray(
            self.tables.sets.cofactor[self.state.whole[ACTIVE]] * self.noise.variance(seconds, motion)
        )

    def smallest(self, k: int, missed: float = 1e-3, window: int = -1, motion: float = 0.0) -> float:
        """Bias of sensor ``k``, rad/s or m/s^2, that a test of ``window`` misses with the chance ``missed``.

        ``window`` 0 is the sample, then `Monitor.windows`; ``motion`` rad or m/s in it. With lambda the
        noncentrality that the test of the sensors in use needs and s^2 the variance of the window's sums,
        the bias is sqrt(lambda) s / (T |v_k|). Infinite of a sensor that is not watched.
        """
        m = int(self.state.whole[ACTIVE])
        inverse, freedom = self.tables.sets.inverse[m, k], int(self.tables.sets.freedom[m])
        if inverse == 0.0:
            return math.inf
        needed = noncentrality(float(self.tables.limits[window, freedom]), freedom, missed)
        seconds = self.seconds[window]
        return math.sqrt(needed * self.noise.variance(seconds, motion) * inverse) / seconds


def _lanes(size: int) -> Vector:
    """Zeros (size,) that begin where a row of `MOST` numbers is one line of the cache."""
    line = 8 * MOST
    raw = np.zeros(size + MOST)
    skip = -raw.ctypes.data % line // 8
    return raw[skip : skip + size]


def _bits(number: int) -> tuple[int, ...]:
    return tuple(k for k in range(number.bit_length()) if number >> k & 1)


class RedundantUnit:
    """Gyros and accelerometers of one unit: from counts to increments in b."""

    def __init__(self, gyros: Redundant, accels: Redundant) -> None:
        self.gyros, self.accels = gyros, accels
        self.owed = np.zeros((2, 3))
        """What the samples before lack, rad and m/s, after `sample` has returned other than (0, 0)."""

    def sample(self, counts: Vector, tau: float, dtheta: Vector, dv: Vector) -> tuple[int, int]:
        """Write increments (3,) of ``counts`` (2 `MOST`,), gyros from 0 and accelerometers from `MOST` on.

        Returns the status of each kind, of `nav.imu.redundant_kernel.fuse`.
        """
        done = quick_both(self.gyros.state.hot, self.accels.state.hot, counts, tau, dtheta, dv)
        if done == 0:
            return 0, 0
        status = [0, 0]
        self.owed[:] = 0.0
        if done == 1:
            status[1] = self.accels.after_quick(tau, dv, self.owed[1])
            felt = np.nan_to_num(dv)  # accelerometers that are lost do not take gyros with them
            status[0] = self.gyros.sample(counts, tau, felt, dtheta, self.owed[0])
        else:
            status[0] = self.gyros.after_quick(tau, dtheta, self.owed[0])
        return status[0], status[1]
