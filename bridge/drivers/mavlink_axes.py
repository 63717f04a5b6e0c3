"""MAVLink's world into ours: axes, units and heights of sensor messages, and their plausibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.gnss_can import WEEK_NS
from bridge.geoid import undulation
from nav.types import Vector

_RAD_PER_E7: Final = math.pi / 180.0 * 1e-7
_G: Final = 9.80665
_MOST_FORCE: Final = 1000.0  # m/s^2
_MOST_RATE: Final = 200.0  # rad/s
_UNKNOWN_16: Final = 65535
_UNKNOWN_UP: Final = 10.0  # m/s, of a receiver that gives speed over ground alone
_ACCEL_AND_GYRO: Final = 0b111111
_ABS_PRESSURE: Final = 1 << 9


def turned(x: float, y: float, z: float) -> Vector:
    """Front-right-down to right-forward-up, and north-east-down to east-north-up: the same half turn."""
    return np.array((y, x, -z), dtype=np.float64)


def attitude(q: Sequence[float]) -> Vector:
    """Quaternion (4,) from right-forward-up to east-north-up of one from front-right-down to north-east-down.

    Both pairs of axes differ by the same half turn, so the vector part turns as a vector does. Raises
    ValueError for what is no rotation.
    """
    w, x, y, z = q
    found = np.array((w, *turned(x, y, z)))
    length = float(np.linalg.norm(found))
    # single precision is good to 1e-7; written so that a NaN fails too
    if not abs(length - 1.0) < 1e-3:
        raise ValueError("a quaternion that is no rotation")
    return np.asarray(found / length)


class Inertial(NamedTuple):
    """Rate (3,) rad/s and specific force (3,) m/s^2 in b, pressure (Pa) where the message has it."""

    rate: Vector
    force: Vector
    pressure_pa: float | None


class Position(NamedTuple):
    """What a GNSS message says; None where it does not."""

    lat: float
    lon: float
    height: float
    sigma_h: float | None
    sigma_up: float | None
    velocity: Vector | None
    sigma_v: float | None
    sigma_v_up: float | None
    fix_type: int
    satellites: int | None
    gps_ns: int | None


def inertial(message: Any, raw_accel_m_s2: float, raw_gyro_rad_s: float) -> Inertial | None:
    """An IMU message in our axes and units; None where it says that it has no new values.

    Raises ValueError for a value that is not a number or beyond any sensor. The ``raw_`` factors are
    those of RAW_IMU's counts.
    """
    kind = message.get_type()
    pressure = None
    if kind in ("HIGHRES_IMU", "HIL_SENSOR"):
        updated = message.fields_updated
        if updated & _ACCEL_AND_GYRO != _ACCEL_AND_GYRO:
            return None
        force_unit = rate_unit = 1.0
        if updated & _ABS_PRESSURE:
            pressure = message.abs_pressure * 100.0
    elif kind == "SCALED_IMU":
        force_unit, rate_unit = 1e-3 * _G, 1e-3
    else:
        force_unit, rate_unit = raw_accel_m_s2, raw_gyro_rad_s
    force = turned(message.xacc * force_unit, message.yacc * force_unit, message.zacc * force_unit)
    rate = turned(message.xgyro * rate_unit, message.ygyro * rate_unit, message.zgyro * rate_unit)
    # written so that a NaN fails too
    if not (np.all(np.abs(force) <= _MOST_FORCE) and np.all(np.abs(rate) <= _MOST_RATE)):
        raise ValueError("a rate or force beyond any sensor")
    return Inertial(rate, force, pressure)


def position(message: Any) -> Position | None:
    """A GNSS message in our axes and units, height above the ellipsoid; None where it has no position.

    Raises ValueError for a value that is not a number or outside its range.
    """
    kind = message.get_type()
    if message.fix_type < dialect.GPS_FIX_TYPE_3D_FIX:
        return None
    if abs(message.lat) > 900_000_000 or abs(message.lon) > 1_800_000_000:
        raise ValueError("a latitude or longitude beyond the globe")
    lat, lon = message.lat * _RAD_PER_E7, message.lon * _RAD_PER_E7
    if kind == "GPS_INPUT":
        found = _gps_input(message, lat, lon)
    elif kind == "GPS_RAW_INT":
        found = _gps_raw_int(message, lat, lon)
    else:
        found = _hil_gps(message, lat, lon)
    if found is None:
        return None
    sigmas = (found.sigma_h, found.sigma_up, found.sigma_v, found.sigma_v_up)
    if not abs(found.height) < 1e5 or not all(s is None or 0.0 <= s < 1e6 for s in sigmas):
        raise ValueError("a height or accuracy beyond reason")
    if found.velocity is not None and not np.all(np.abs(found.velocity) < 1e4):
        raise ValueError("a velocity beyond reason")
    return found


def _gps_input(message: Any, lat: float, lon: float) -> Position | None:
    ignored = message.ignore_flags
    if ignored & dialect.GPS_INPUT_IGNORE_FLAG_ALT:
        return None
    velocity = None
    if not ignored & (dialect.GPS_INPUT_IGNORE_FLAG_VEL_HORIZ | dialect.GPS_INPUT_IGNORE_FLAG_VEL_VERT):
        velocity = turned(message.vn, message.ve, message.vd)

    def stated(flag: int, value: float) -> float | None:
        return None if ignored & flag or value == 0.0 else float(value)

    speed = stated(dialect.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY, message.speed_accuracy)
    return Position(
        lat=lat,
        lon=lon,
        height=message.alt + undulation(lat, lon),
        sigma_h=stated(dialect.GPS_INPUT_IGNORE_FLAG_HORIZONTAL_ACCURACY, message.horiz_accuracy),
        sigma_up=stated(dialect.GPS_INPUT_IGNORE_FLAG_VERTICAL_ACCURACY, message.vert_accuracy),
        velocity=velocity,
        sigma_v=speed,
        sigma_v_up=speed,
        fix_type=message.fix_type,
        satellites=_satellites(message),
        gps_ns=message.time_week * WEEK_NS + message.time_week_ms * 10**6 if message.time_week else None,
    )


def _gps_raw_int(message: Any, lat: float, lon: float) -> Position:
    velocity = None
    if message.vel != _UNKNOWN_16 and message.cog != _UNKNOWN_16:
        course = math.radians(message.cog * 0.01)
        speed = message.vel * 0.01
        velocity = np.array((speed * math.sin(course), speed * math.cos(course), 0.0))
    extended = message.h_acc > 0  # the fields after the first ten are 0 from a sender that lacks them
    height = message.alt * 1e-3 + undulation(lat, lon)
    if extended and message.alt_ellipsoid:
        height = message.alt_ellipsoid * 1e-3
    return Position(
        lat=lat,
        lon=lon,
        height=height,
        sigma_h=message.h_acc * 1e-3 if extended else None,
        sigma_up=message.v_acc * 1e-3 if message.v_acc else None,
        velocity=velocity,
        sigma_v=message.vel_acc * 1e-3 if message.vel_acc else None,
        sigma_v_up=_UNKNOWN_UP,
        fix_type=message.fix_type,
        satellites=_satellites(message),
        gps_ns=None,
    )


def _hil_gps(message: Any, lat: float, lon: float) -> Position:
    return Position(
        lat=lat,
        lon=lon,
        height=message.alt * 1e-3 + undulation(lat, lon),
        sigma_h=None,
        sigma_up=None,
        velocity=turned(message.vn, message.ve, message.vd) * 0.01,
        sigma_v=None,
        sigma_v_up=None,
        fix_type=message.fix_type,
        satellites=_satellites(message),
        gps_ns=None,
    )


def _satellites(message: Any) -> int | None:
    return None if message.satellites_visible == 255 else int(message.satellites_visible)
