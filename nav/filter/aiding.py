"""From samples of aids to measurements on the timeline."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.earth import geodetic_to_xyz
from nav.filter.history import Timeline
from nav.filter.settings import NavigatorConfig
from nav.jit import kernel
from nav.types import BaroSample, GnssFix, OdoSample, SpeedSample, Vector

_JOIN_NS: Final = 20_000_000  # samples of the odometer that are this far apart do not follow each other
_ZERO: Final = np.zeros(3)
_UNIFORM: Final = 1.0 / math.sqrt(12.0)  # sigma of a part of one that may be any


@kernel
def earth_fixed(lat: float, lon: float, vector: Vector, sigmas: Vector) -> Vector:
    """Components (9,) in Earth-fixed axes of what a receiver at ``lat``, ``lon`` (rad) says of itself.

    First ``vector`` (3,) east, north, up of that place, then xx, xy, xz, yy, yz, zz of the covariance of
    independent errors with ``sigmas`` (3,) along these axes. Next to a pole east and north of the receiver's
    place are not those of the place where the filter believes to be.
    """
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    C_eg = ((-so, -sl * co, cl * co), (co, -sl * so, cl * so), (0.0, cl, sl))
    e, n, u = sigmas[0] * sigmas[0], sigmas[1] * sigmas[1], sigmas[2] * sigmas[2]
    out = np.empty(9)
    place = 3
    for i in range(3):
        x, y, z = C_eg[i]
        out[i] = x * vector[0] + y * vector[1] + z * vector[2]
        for j in range(i, 3):
            out[place] = x * e * C_eg[j][0] + y * n * C_eg[j][1] + z * u * C_eg[j][2]
            place += 1
    return out


class Aiding:
    """Enters what aids say; owns the odometer's open interval and the path that it is compared with.

    The functions that take a sample return whether it was still in time. ``mounted``: whether it is known
    how the IMU sits in the vehicle; before that nothing that speaks of vehicle axes is used.
    """

    def __init__(self, config: NavigatorConfig, timeline: Timeline) -> None:
        self._config = config
        self._timeline = timeline
        horizontal, vertical = config.gnss_correlated
        self._slow = np.square([horizontal, horizontal, vertical])  # m^2, of each axis
        self.mounted = False
        self._path_ns = 0
        self._start_ns = 0
        self._end_ns: int | None = None
        self._fresh = 1.0  # 0: the open interval begins with the part of a tick that the last one ended with
        self._distance = 0.0
        self._duration = 0.0

    def begin(self, t_ns: int, mounted: bool) -> None:
        """Start afresh with the navigation at ``t_ns``."""
        self.mounted = mounted
        self._path_ns = t_ns
        self._end_ns = None

    def settled(self, t_ns: int) -> None:
        """The mounting is known from ``t_ns`` on."""
        self.mounted = True
        self._path_ns = t_ns

    def gnss(self, s: GnssFix) -> bool:
        """Enter the position of a fix, and its velocity when it has one."""
        config = self._config
        white = np.sqrt(np.maximum(np.square(s.sigma_position) - self._slow, 0.0))
        white = np.maximum(white, config.gnss_position_floor)
        z = np.zeros(10)
        z[1:10] = earth_fixed(s.lat, s.lon, _ZERO, white)
        z[1:4] = geodetic_to_xyz(s.lat, s.lon, s.height)
        used = self._timeline.measure("gnss_position", s.t_ns, z)
        if used and s.v_g is not None and s.sigma_velocity is not None:
            sigma = np.maximum(s.sigma_velocity, config.gnss_velocity_floor)
            z = np.zeros(10)
            z[1:10] = earth_fixed(s.lat, s.lon, np.asarray(s.v_g), sigma)
            self._timeline.measure("gnss_velocity", s.t_ns - round(config.gnss_velocity_age * 1e9), z)
        return used

    def speed(self, s: SpeedSample) -> bool:
        """Enter a speed."""
        if not self.mounted:
            return True
        sigma = max(s.sigma, self._config.odometer_sigma)
        return self._timeline.measure("speed", s.t_ns, np.array([0.0, s.speed, sigma]))

    def barometer(self, s: BaroSample) -> bool:
        """Enter a height, or feed it to the height channel where there is one."""
        if self._config.height_channel is not None:
            return self._timeline.external_height(s.t_ns, s.height, s.sigma)
        return self._timeline.measure("barometer", s.t_ns, np.array([0.0, s.height, s.sigma]))

    def odometer(self, s: OdoSample) -> None:
        """Gather a distance; at the end of an interval enter it, and that the wheels did not slide."""
        if not self.mounted:
            return
        config = self._config
        start = s.t_ns - round(s.dt * 1e9)
        if self._end_ns is None or abs(start - self._end_ns) > _JOIN_NS:
            # the first, or after missing ones: begin an interval where this sample begins
            self._fresh = 1.0
            self._start_ns = start
            self._distance = self._duration = 0.0
            self._restart_path(start)
        self._end_ns = s.t_ns
        self._distance += s.distance
        self._duration += s.dt
        duration = (s.t_ns - self._start_ns) * 1e-9
        if duration < config.odometer_interval - 1e-3:
            return
        distance = self._distance * duration / self._duration
        walk = config.odometer_walk * math.sqrt(abs(distance))
        sigma = math.hypot(config.odometer_sigma * duration, walk)
        # one that counts no tick tells nothing of the part of a tick at either end: a wheel that stands may
        # do so anywhere between two
        rolled = distance != 0.0
        fresh = self._fresh if rolled else 1.0
        z = np.array([0.0, duration, distance, sigma, _UNIFORM * config.odometer_quantum, fresh])
        self._timeline.measure("odometer", s.t_ns, z)
        self._fresh = 0.0 if rolled else 1.0
        self._sideways(s.t_ns, duration)
        self._start_ns = s.t_ns
        self._distance = self._duration = 0.0
        self._restart_path(s.t_ns)

    def check(self, t_ns: int) -> None:
        """Enter that the wheels did not slide when no odometer has closed an interval for long."""
        config = self._config
        if not self.mounted or config.non_holonomic is None:
            return
        without = t_ns - self._path_ns
        patience = 3.0 * config.odometer_interval if config.odometer else config.non_holonomic_interval
        if without >= (patience - 0.01) * 1e9:
            self._sideways(t_ns, without * 1e-9)
            self._restart_path(t_ns)

    def _sideways(self, t_ns: int, duration: float) -> None:
        sigma = self._config.non_holonomic
        if sigma is not None:
            z = np.array([0.0, duration, sigma, self._config.sideways_walk])
            self._timeline.measure("non_holonomic", t_ns, z)

    def _restart_path(self, t_ns: int) -> None:
        self._timeline.restart_path(t_ns)
        self._path_ns = t_ns
