"""The telemetry messages, each built from a `Picture`; None while there is nothing true to say.

Field meanings are those of MAVLink's common message set. Times since boot are engine time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as dialect

from bridge.geoid import undulation
from bridge.mavlink.ned import LocalFrame, Ned
from bridge.mavlink.picture import Picture
from bridge.outputs import Reject
from nav.types import Mode, SolutionFlag

_UINT16_MAX: Final = 0xFFFF
_UINT32_MAX: Final = 0xFFFF_FFFF
_INT16_MAX: Final = 0x7FFF

CUSTOM_MODE: Final = 1000
STATES: Final = {
    Mode.STANDBY: dialect.MAV_STATE_STANDBY,
    Mode.ALIGN: dialect.MAV_STATE_CALIBRATING,
    Mode.CATCH_UP: dialect.MAV_STATE_CALIBRATING,
    Mode.NAVIGATE: dialect.MAV_STATE_ACTIVE,
    Mode.TRANSFER: dialect.MAV_STATE_ACTIVE,
    Mode.DEGRADED: dialect.MAV_STATE_CRITICAL,
    Mode.FAULT: dialect.MAV_STATE_EMERGENCY,
}


def boot_ms(t_ns: int) -> int:
    """Engine time as MAVLink's wrapping milliseconds since boot."""
    return t_ns // 1_000_000 & _UINT32_MAX


def _clamp(value: float, low: int, high: int) -> int:
    return max(low, min(high, round(value)))


def _speed_cm(value: float) -> int:
    return _clamp(100.0 * value, -_INT16_MAX, _INT16_MAX)


def _deg_e7(angle: float) -> int:
    return round(math.degrees(angle) * 1e7)


def _mm(length: float) -> int:
    return _clamp(1e3 * length, -0x7FFF_FFFF, 0x7FFF_FFFF)


def _unsigned_mm(length: float | None) -> int:
    return 0 if length is None or not math.isfinite(length) else _clamp(1e3 * length, 0, _UINT32_MAX)


def _finite(*values: float) -> bool:
    """Whether all are numbers that single precision can hold."""
    return all(abs(value) < 1e30 for value in values)


def heartbeat(picture: Picture, vehicle: int) -> Any:
    """HEARTBEAT: system state from the mode; the mode itself is the custom mode, counted from 1000.

    Small custom modes are known to ground stations as those of autopilots, and would be named so.
    """
    return dialect.MAVLink_heartbeat_message(
        vehicle,
        dialect.MAV_AUTOPILOT_GENERIC,
        dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
        CUSTOM_MODE + int(picture.mode),
        STATES[picture.mode],
        3,
    )


def sys_status(picture: Picture) -> Any:
    """SYS_STATUS: what is there and works; error counters are wire errors, gate, other rejects, missing.

    Second gyros and accelerometers stand for the redundancy of a unit with more than three: healthy while all
    of them are in use.
    """
    present = dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    present |= dialect.MAV_SYS_STATUS_AHRS | dialect.MAV_SYS_STATUS_LOGGING
    healthy = 0
    if picture.solution is not None and not picture.has(SolutionFlag.IMU_GAP):
        healthy |= dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    if picture.mode in (Mode.NAVIGATE, Mode.TRANSFER, Mode.DEGRADED):
        healthy |= dialect.MAV_SYS_STATUS_AHRS
    if not picture.unrecorded_grew:
        healthy |= dialect.MAV_SYS_STATUS_LOGGING
    if picture.fix is not None:
        present |= dialect.MAV_SYS_STATUS_SENSOR_GPS
        if picture.fix.fix.fix_type >= 2 and picture.now_ns - picture.fix.t_ns < 3_000_000_000:
            healthy |= dialect.MAV_SYS_STATUS_SENSOR_GPS
    if picture.barometer_seen:
        present |= dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
        healthy |= dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    wire = gate = other = missing = frames = dropped = 0
    if picture.health is not None:
        dropped = picture.health.dropped_frames
        for device in picture.health.devices.values():
            if device.sensors is not None:
                gyro, accel = dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO2, dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL2
                present |= gyro | accel
                healthy |= 0 if device.sensors.gyros_out | device.sensors.gyros_suspect else gyro
                healthy |= 0 if device.sensors.accels_out | device.sensors.accels_suspect else accel
            frames += device.frames
            missing += device.missing
            for reason, count in device.rejects.items():
                if reason in (Reject.LENGTH, Reject.CRC, Reject.COUNTER):
                    wire += count
                elif reason is Reject.GATE:
                    gate += count
                else:
                    other += count
    return dialect.MAVLink_sys_status_message(
        present,
        present,
        healthy,
        0,
        _UINT16_MAX,
        -1,
        -1,
        10_000 * dropped // max(frames + dropped, 1),
        min(dropped, _UINT16_MAX),
        *(min(count, _UINT16_MAX) for count in (wire, gate, other, missing)),
    )


def system_time(picture: Picture, utc_minus_engine_ns: int | None) -> Any:
    """SYSTEM_TIME: UTC of the host as it was when the run started, carried on by engine time."""
    unix_us = 0 if utc_minus_engine_ns is None else (picture.now_ns + utc_minus_engine_ns) // 1000
    return dialect.MAVLink_system_time_message(unix_us, boot_ms(picture.now_ns))


def attitude(picture: Picture) -> Any:
    """ATTITUDE."""
    ned = picture.ned
    if picture.solution is None or ned is None or not _finite(ned.roll, ned.pitch, ned.yaw, *ned.rates):
        return None
    t_ms = boot_ms(picture.solution.t_ns)
    return dialect.MAVLink_attitude_message(t_ms, ned.roll, ned.pitch, ned.yaw, *ned.rates)


def attitude_quaternion(picture: Picture) -> Any:
    """ATTITUDE_QUATERNION."""
    ned = picture.ned
    if picture.solution is None or ned is None or not _finite(*ned.q, *ned.rates):
        return None
    return dialect.MAVLink_attitude_quaternion_message(boot_ms(picture.solution.t_ns), *ned.q, *ned.rates)


def global_position_int(picture: Picture) -> Any:
    """GLOBAL_POSITION_INT: altitude above the geoid, relative altitude above the origin."""
    ned = picture.ned
    if picture.solution is None or ned is None or not picture.has(SolutionFlag.POSITION):
        return None
    if not _finite(ned.lat, ned.lon, ned.height, *ned.v):
        return None
    heading = _UINT16_MAX
    if picture.has(SolutionFlag.HEADING) and math.isfinite(ned.yaw):
        heading = round(math.degrees(ned.yaw) * 100.0) % 36000
    above_origin = ned.height - picture.origin.height if picture.origin else 0.0
    return dialect.MAVLink_global_position_int_message(
        boot_ms(picture.solution.t_ns),
        _deg_e7(ned.lat),
        _deg_e7(ned.lon),
        _mm(ned.altitude),
        _mm(above_origin),
        *(_speed_cm(v) for v in ned.v),
        heading,
    )


def _local(picture: Picture) -> tuple[Ned, tuple[float, float, float]] | None:
    """The solution along the axes of the local frame, and its place there."""
    ned = picture.ned
    if ned is None or picture.origin is None or not picture.has(SolutionFlag.POSITION):
        return None
    if not _finite(ned.lat, ned.lon, ned.height, *ned.v):
        return None
    return picture.origin.seen(ned), picture.origin.position(ned.lat, ned.lon, ned.height)


def local_position_ned(picture: Picture) -> Any:
    """LOCAL_POSITION_NED from the place where navigation first began."""
    local = _local(picture)
    if local is None or picture.solution is None:
        return None
    ned, place = local
    return dialect.MAVLink_local_position_ned_message(boot_ms(picture.solution.t_ns), *place, *ned.v)


def gps_raw_int(picture: Picture) -> Any:
    """GPS_RAW_INT: the receiver's own fix as it came in."""
    if picture.fix is None:
        return None
    fix = picture.fix.fix
    known = _finite(fix.lat, fix.lon, fix.height)
    lat, lon, height = (fix.lat, fix.lon, fix.height) if known else (0.0, 0.0, 0.0)
    speed, course = _UINT16_MAX, _UINT16_MAX
    if fix.v_g is not None and _finite(*fix.v_g):
        east, north = float(fix.v_g[0]), float(fix.v_g[1])
        speed = _clamp(100.0 * math.hypot(east, north), 0, _UINT16_MAX - 1)
        course = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
    sigma_v = None
    if fix.sigma_velocity is not None:
        sigma_v = math.sqrt(sum(float(s) ** 2 for s in fix.sigma_velocity))
    from_geoid = undulation(lat, lon)
    return dialect.MAVLink_gps_raw_int_message(
        fix.t_ns // 1000,
        int(fix.fix_type),
        _deg_e7(lat),
        _deg_e7(lon),
        _mm(height - from_geoid),
        _UINT16_MAX,
        _UINT16_MAX,
        speed,
        course,
        255 if fix.satellites is None else min(fix.satellites, 254),
        _mm(height),
        _unsigned_mm(math.hypot(float(fix.sigma_position[0]), float(fix.sigma_position[1]))),
        _unsigned_mm(float(fix.sigma_position[2])),
        _unsigned_mm(sigma_v),
    )


def estimator_status(picture: Picture) -> Any:
    """ESTIMATOR_STATUS: ratios are residuals over 3 sigma, below 1 in order."""
    ned = picture.ned
    if picture.solution is None or ned is None:
        return None
    flags = 0
    if picture.has(SolutionFlag.LEVEL):
        flags |= dialect.ESTIMATOR_ATTITUDE
    if picture.has(SolutionFlag.VELOCITY):
        flags |= dialect.ESTIMATOR_VELOCITY_HORIZ | dialect.ESTIMATOR_VELOCITY_VERT
    if picture.has(SolutionFlag.POSITION):
        flags |= dialect.ESTIMATOR_POS_HORIZ_REL | dialect.ESTIMATOR_POS_HORIZ_ABS
        flags |= dialect.ESTIMATOR_POS_VERT_ABS | dialect.ESTIMATOR_PRED_POS_HORIZ_ABS
        flags |= dialect.ESTIMATOR_PRED_POS_HORIZ_REL
    if picture.has(SolutionFlag.STANDSTILL):
        flags |= dialect.ESTIMATOR_CONST_POS_MODE
    return dialect.MAVLink_estimator_status_message(
        picture.solution.t_ns // 1000,
        flags,
        picture.ratio("velocity"),
        picture.ratio("position"),
        picture.ratio("height"),
        0.0,
        0.0,
        0.0,
        math.hypot(ned.sigma_p[0], ned.sigma_p[1]) if _finite(*ned.sigma_p) else math.nan,
        ned.sigma_p[2] if _finite(*ned.sigma_p) else math.nan,
    )


def odometry(picture: Picture) -> Any:
    """ODOMETRY: pose in the local frame, velocity along front, right, down, with covariances.

    Of the covariances the standard deviations are known; errors about and along different axes of
    north-east-down are taken as uncorrelated.
    """
    local = _local(picture)
    if local is None or picture.solution is None or not _finite(*local[0].q, *local[0].rates):
        return None
    ned, place = local
    c = _matrix(ned.q)
    v_body = tuple(sum(c[row][column] * ned.v[row] for row in range(3)) for column in range(3))
    pose = [0.0] * 21
    roll_var, pitch_var, yaw_var = _euler_variances(ned)
    diagonal = (*(s * s for s in ned.sigma_p), roll_var, pitch_var, yaw_var)
    for place_in_row, value in zip((0, 6, 11, 15, 18, 20), diagonal, strict=True):
        pose[place_in_row] = value
    velocity = [math.nan] + [0.0] * 20
    entry = 0
    for row in range(3):
        for column in range(row, 3):
            velocity[entry + column - row] = sum(
                c[k][row] * c[k][column] * ned.sigma_v[k] ** 2 for k in range(3)
            )
        entry += 6 - row
    if not _finite(*pose):
        pose = [math.nan] + [0.0] * 20
    if not _finite(*velocity):
        velocity = [math.nan] + [0.0] * 20
    return dialect.MAVLink_odometry_message(
        picture.solution.t_ns // 1000,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *place,
        list(ned.q),
        *v_body,
        *ned.rates,
        pose,
        velocity,
        max(picture.alignments - 1, 0) & 0xFF,
        dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
        0,
    )


def _matrix(q: tuple[float, float, float, float]) -> tuple[tuple[float, ...], ...]:
    w, x, y, z = q
    return (
        (w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def _euler_variances(ned: Ned) -> tuple[float, float, float]:
    north, east, down = ned.sigma_attitude
    s, c = math.sin(ned.yaw), math.cos(ned.yaw)
    return (c * north) ** 2 + (s * east) ** 2, (s * north) ** 2 + (c * east) ** 2, down**2


def home_position(picture: Picture) -> Any:
    """HOME_POSITION: the origin of the local frame."""
    if picture.origin is None:
        return None
    lat, lon, altitude = _wire_place(picture.origin)
    level = (1.0, 0.0, 0.0, 0.0)
    return dialect.MAVLink_home_position_message(lat, lon, altitude, 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0)


def gps_global_origin(picture: Picture) -> Any:
    """GPS_GLOBAL_ORIGIN: the origin of the local frame."""
    if picture.origin is None:
        return None
    return dialect.MAVLink_gps_global_origin_message(*_wire_place(picture.origin))


def _wire_place(origin: LocalFrame) -> tuple[int, int, int]:
    altitude = origin.height - undulation(origin.lat, origin.lon)
    return _deg_e7(origin.lat), _deg_e7(origin.lon), _mm(altitude)


def statustexts(severity: int, text: str, identifier: int) -> list[Any]:
    """``text`` as STATUSTEXT messages: chunks of 50 bytes under one identifier when it is longer."""
    data = text.encode("ascii", "replace")
    if len(data) <= 50:
        return [dialect.MAVLink_statustext_message(severity, data)]
    chunks = [data[start : start + 50] for start in range(0, len(data), 50)]
    if len(chunks[-1]) == 50:
        chunks.append(b"")  # a chunk that is not full ends the text
    return [
        dialect.MAVLink_statustext_message(severity, chunk, identifier, place)
        for place, chunk in enumerate(chunks)
    ]


Builder = Callable[[Picture], Any]

FROM_PICTURE: Final[dict[int, Builder]] = {
    dialect.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    dialect.MAVLINK_MSG_ID_ATTITUDE: attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw_int,
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    dialect.MAVLINK_MSG_ID_ODOMETRY: odometry,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
}
"""What can be built from the picture alone; HEARTBEAT and SYSTEM_TIME need a little more."""
