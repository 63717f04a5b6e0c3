"""Is the vehicle at rest? From the odometer where there is one, else from a quiet IMU and a low speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from nav.align.types import NavInit
from nav.filter.settings import NavigatorConfig
from nav.types import OdoSample, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """The vehicle stood still from ``start_ns`` to ``end_ns``; ``rate_b`` (3,) rad/s is the raw mean rate."""

    start_ns: int
    end_ns: int
    rate_b: Vector


_AFTER_NS: Final = 750_000_000
"""A wheel that starts stands this long by its own account: it counts no tick, and its speed is too small.

A start that reaches 20 m/s in ten seconds, smoothly, is below 5 mm/s for that long. What it rolls
meanwhile is many times the sigma of a good standstill, and always forward: a bias."""
_FACTOR: Final = 1.25  # of the standard deviation of single samples that the alignment saw at rest
_LEAST_RATE: Final = 1e-3  # rad/s: no axis need be quieter than this,
_LEAST_FORCE: Final = 0.02  # m/s^2, nor this
_USUAL_RATE: Final = 0.01  # rad/s, of all three axes, where nothing was seen or configured
_USUAL_FORCE: Final = 0.15  # m/s^2


def _limits(
    configured: float | None, seen: Vector | None, least: float, usual: float
) -> tuple[float, Vector]:
    """Standard deviation below which a triad is quiet, of the vector and of each axis (3,).

    What the alignment saw counts for every axis alone: an engine shakes one most, and a quiet one tells more.
    """
    if configured is not None or seen is None:
        return usual if configured is None else configured, np.full(3, np.inf)
    return np.inf, np.maximum(_FACTOR * seen, least)


class Standstill:
    """Cuts time into intervals and says which of them were spent at rest."""

    def __init__(self, config: NavigatorConfig, init: NavInit | None = None) -> None:
        self._config = config
        seen_rate = None if init is None else init.rest_rate
        seen_force = None if init is None else init.rest_force
        self._gyro, gyros = _limits(config.rest_gyro, seen_rate, _LEAST_RATE, _USUAL_RATE)
        self._accel, accels = _limits(config.rest_accel, seen_force, _LEAST_FORCE, _USUAL_FORCE)
        self._axes = np.concatenate([gyros, accels])
        self._since_ns: int | None = None  # the odometer has stood since then
        self._odo_ns: int | None = None
        self._waiting: list[Rest] = []
        self._quiet: Rest | None = None  # the last interval, where it seemed to be a rest

    def interval(self, t_ns: int, rest: Vector, v_n: Vector, sigma_v: float) -> Rest | None:
        """Close the interval that ends at ``t_ns``; returns one, this or an earlier, now known to be a rest.

        ``rest`` (REST_SIZE,) are the sums of the propagation kernel, which start again from zero.
        ``v_n`` (3,) m/s and ``sigma_v`` m/s: the estimated velocity and its uncertainty.
        """
        config = self._config
        duration, n = float(rest[0]), float(rest[1])
        start = t_ns - round(duration * 1e9)
        mean = rest[2:8] / duration  # rate and force
        squares = rest[8:14] / n
        rest[:] = 0.0
        found = Rest(start, t_ns, mean[0:3])
        if self._odo_ns is not None and t_ns - self._odo_ns < 1_000_000_000:
            # what the wheel says of the end of the interval, and of the time after it, is still to come
            self._waiting.append(found)
            del self._waiting[:-4]
            return self._confirmed()
        variance = squares - mean**2
        quiet = (
            float(np.sum(variance[0:3])) < self._gyro**2
            and float(np.sum(variance[3:6])) < self._accel**2
            and bool(np.all(variance < self._axes**2))
        )
        # in an outage the speed is known less well than a vehicle at rest deserves
        speed = float(np.sqrt(v_n @ v_n))
        limit = max(config.rest_speed, min(3.0 * sigma_v, 3.0))
        before, self._quiet = self._quiet, found if quiet and speed < limit else None
        # a vehicle that sets off smoothly is quiet for long enough: what lies before another rest was one
        return before if self._quiet is not None else None

    def odometer(self, sample: OdoSample) -> Rest | None:
        """Take an odometer sample; returns an interval that it confirms as a rest."""
        self._odo_ns = sample.t_ns
        if not sample.standstill:
            self._since_ns = None
            self._waiting.clear()
            return None
        if self._since_ns is None:
            self._since_ns = sample.t_ns
        return self._confirmed()

    def _confirmed(self) -> Rest | None:
        while self._waiting:
            rest = self._waiting[0]
            if self._odo_ns is None or rest.end_ns + _AFTER_NS > self._odo_ns:
                return None
            del self._waiting[0]
            if self._since_ns is not None and self._since_ns <= rest.start_ns:
                return rest
        return None
