"""GNSS receivers in somebody else's DBC file: position, velocity and their accuracies to a fix."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.dbc_map_channels import MOST_SPEED, BaseChannel
from bridge.drivers.dbc_map_epochs import Epoch, Needs
from bridge.drivers.dbc_map_options import DbcMapOptions, FixTypes, GnssMap
from bridge.drivers.dbc_map_signals import Book, Values
from bridge.outputs import Reject
from nav.types import FixType, GnssFix, Sample, Vector

_UNIX_TO_GPS_S: Final = 315_964_800  # 6 January 1980
_MOST_HEIGHT: Final = 1e6  # m


class GnssChannel(BaseChannel):
    """Positions, with a velocity where it is mapped and valid."""

    def __init__(
        self, book: Book, options: DbcMapOptions, channel: GnssMap, context: Context, counters: Counters
    ):
        needs = Needs(book, "gnss")
        self._min_p, self._min_v = options.min_sigma_position_m, options.min_sigma_velocity_m_s
        self._lat = needs.reading("lat", channel.lat, "angle")
        self._lon = needs.reading("lon", channel.lon, "angle")
        self._height = needs.reading("height", channel.height, "length")
        both = (channel.sigma_east, channel.sigma_north)
        if (channel.sigma_horizontal is None) == (None in both) or (None in both and any(both)):
            raise book.wrong(
                "gnss", "no such set of sigmas", "either sigma_horizontal, or sigma_east and sigma_north"
            )
        self._sigma_e = needs.reading(
            "sigma_east", channel.sigma_east or channel.sigma_horizontal or "", "length"
        )
        self._sigma_n = needs.reading(
            "sigma_north", channel.sigma_north or channel.sigma_horizontal or "", "length"
        )
        self._sigma_u = needs.reading("sigma_up", channel.sigma_up, "length")
        self._velocity = _velocity(needs, channel)
        self._velocity_valid = needs.condition("velocity_valid", channel.velocity_valid)
        self._fix_source = ""
        self._fix_types: dict[float, FixType] = {}
        self._fix_type = FixType.FIX_3D
        if isinstance(channel.fix_type, FixTypes):
            self._fix_source = needs.source("fix_type.signal", channel.fix_type.signal).name
            for text, name in channel.fix_type.values.items():
                self._fix_types[_number(needs, text)] = _fix_type(needs, f"fix_type.values.{text}", name)
        else:
            self._fix_type = _fix_type(needs, "fix_type", channel.fix_type)
        self._satellites = (
            None if channel.satellites is None else needs.source("satellites", channel.satellites)
        )
        self._utc = needs.maybe("utc", channel.utc, "time")
        self._leap_s = channel.leap_seconds
        super().__init__(needs, channel, options, context, counters)

    def _make(self, epoch: Epoch) -> Sequence[Sample]:
        counters, values = self._counters, epoch.values
        t_ns, elapsed = self._stamps.stamp(epoch)
        if epoch.step is not None:
            counters.missing += epoch.step - 1
        fix_type = self._fix_type
        if self._fix_source:
            fix_type = self._fix_types.get(values[self._fix_source], FixType.NO_FIX)
        if fix_type < FixType.FIX_3D or not self._valid.holds(values):
            return counters.reject(Reject.INVALID)
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        lat, lon = self._lat.of(values), self._lon.of(values)
        height = self._height.of(values)
        if abs(lat) > math.pi / 2.0 + 1e-9 or abs(lon) > 2.0 * math.pi or abs(height) > _MOST_HEIGHT:
            return counters.reject(Reject.RANGE)
        v_g = sigma_v = None
        if self._velocity is not None and self._velocity_valid.holds(values):
            v_g, sigma_v = self._velocity.of(values)
            sigma_v = np.maximum(sigma_v, self._min_v)
            if np.abs(v_g).max() > MOST_SPEED:
                return counters.reject(Reject.RANGE)
        sigmas = [max(r.sigma(values), self._min_p) for r in (self._sigma_e, self._sigma_n, self._sigma_u)]
        fix = GnssFix(
            t_ns,
            lat,
            (lon + math.pi) % (2.0 * math.pi) - math.pi,
            height,
            np.array(sigmas),
            v_g,
            sigma_v,
            fix_type,
            self._name,
            None if self._utc is None else self._gps_ns(self._utc.of(values)),
            None if self._satellites is None else int(values[self._satellites.name]),
        )
        return self._give(t_ns, fix)

    def _gps_ns(self, utc_s: float) -> int:
        # a float of seconds since 1970 holds a quarter of a microsecond
        return round((utc_s - _UNIX_TO_GPS_S + self._leap_s) * 1e6) * 1000


class _Components:
    """A velocity given east, north and, if at all, up."""

    def __init__(self, needs: Needs, channel: GnssMap) -> None:
        self._east = needs.reading("vel_east", channel.vel_east or "", "speed")
        self._north = needs.reading("vel_north", channel.vel_north or "", "speed")
        self._up = needs.maybe("vel_up", channel.vel_up, "speed")
        self._sigma = needs.reading("sigma_speed", channel.sigma_speed or "", "speed")
        self._sigma_up = needs.reading("sigma_vel_up", channel.sigma_vel_up or "", "speed")

    def of(self, values: Values) -> tuple[Vector, Vector]:
        """Velocity and standard deviations (3,), m/s east, north, up."""
        up = 0.0 if self._up is None else self._up.of(values)
        sigma = self._sigma.sigma(values)
        sigma_up = self._sigma_up.sigma(values)
        velocity = np.array([self._east.of(values), self._north.of(values), up])
        return velocity, np.array([sigma, sigma, sigma_up])


class _SpeedCourse:
    """A velocity given as horizontal speed and course over ground."""

    def __init__(self, needs: Needs, channel: GnssMap) -> None:
        self._speed = needs.reading("speed", channel.speed or "", "speed")
        self._course = needs.reading("course", channel.course or "", "angle")
        self._up = needs.maybe("vel_up", channel.vel_up, "speed")
        self._sigma = needs.reading("sigma_speed", channel.sigma_speed or "", "speed")
        self._sigma_course = needs.reading("sigma_course", channel.sigma_course or "", "angle")
        self._sigma_up = needs.reading("sigma_vel_up", channel.sigma_vel_up or "", "speed")

    def of(self, values: Values) -> tuple[Vector, Vector]:
        """Velocity and standard deviations (3,), m/s east, north, up.

        Across the course the error is speed times that of the course, and near standstill, where the
        course means nothing, no less than that of the speed.
        """
        speed, course = self._speed.of(values), self._course.of(values)
        s, c = math.sin(course), math.cos(course)
        along = self._sigma.sigma(values)
        turn = self._sigma_course.sigma(values)
        across = math.hypot(along, speed * turn)
        up = 0.0 if self._up is None else self._up.of(values)
        sigma_up = self._sigma_up.sigma(values)
        sigmas = np.array([math.hypot(along * s, across * c), math.hypot(along * c, across * s), sigma_up])
        return np.array([speed * s, speed * c, up]), sigmas


def _velocity(needs: Needs, channel: GnssMap) -> _Components | _SpeedCourse | None:
    components = ("vel_east", "vel_north", "sigma_speed", "sigma_vel_up")
    polar = ("speed", "course", "sigma_speed", "sigma_course", "sigma_vel_up")
    given = {name for name in {*components, *polar, "vel_up"} if getattr(channel, name) is not None}
    if not given:
        if channel.velocity_valid:
            raise needs.book.wrong("gnss.velocity_valid", "a condition", "a velocity for it, or none")
        return None
    if given - {"vel_up"} == set(components):
        return _Components(needs, channel)
    if given - {"vel_up"} == set(polar):
        return _SpeedCourse(needs, channel)
    raise needs.book.wrong(
        "gnss",
        ", ".join(sorted(given)),
        f"for a velocity {', '.join(components)}; or {', '.join(polar)}; either with or without vel_up",
    )


def _number(needs: Needs, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise needs.book.wrong("gnss.fix_type.values", text, 'a number as key, as "3" = "FIX_3D"') from None


def _fix_type(needs: Needs, key: str, name: str) -> FixType:
    if name not in FixType.__members__:
        raise needs.book.unknown(f"gnss.{key}", name, list(FixType.__members__))
    return FixType[name]
