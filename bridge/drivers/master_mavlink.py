"""A master navigator that speaks MAVLink: attitude and place of one system, to what a slave is aligned from.

ATTITUDE_QUATERNION and GLOBAL_POSITION_INT hold for times of their own: a place is given out with the
attitude of its time, between two messages where none has the same. ODOMETRY holds all that of one time, in a
local frame that GPS_GLOBAL_ORIGIN puts on the Earth; nothing is given out before that has come.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.mavlink_axes import attitude, turned
from bridge.drivers.mavlink_packets import Packets
from bridge.frame import RawFrame
from bridge.geoid import undulation
from bridge.mavlink.ned import LocalFrame
from bridge.options import DeviceOptions, Positive, Sigmas, SystemId
from bridge.outputs import Reject
from nav.rotation import quat_conjugate, quat_from_rotvec, quat_multiply, quat_rotate, rotvec_from_quat
from nav.types import MasterState, Vector

_BOOT_MODULUS_NS: Final = 2**32 * 10**6
_RAD_PER_E7: Final = math.pi / 180.0 * 1e-7
_LONGEST_NS: Final = 250_000_000  # between two attitudes that one is taken from in between
_WAITING: Final = 8
_FASTEST: Final = 1e4  # m/s
_FURTHEST: Final = 1e5  # m of height
_PLACES: Final = (0, 6, 11, 15, 18, 20)  # of variances in the upper triangle of a 6 by 6


class MasterMavlinkOptions(DeviceOptions, kw_only=True):
    """``[device.NAME]`` with ``driver = "master_mavlink"``.

    ``system_id`` is the master's, ``component_id`` 0 any of its components. ``message`` is the one that its
    attitude is taken from. The sigmas, east, north, up, of its lasting errors stand where it does not state
    them.
    """

    system_id: SystemId
    component_id: Annotated[int, Meta(ge=0, le=255)] = 0
    message: Literal["ATTITUDE_QUATERNION", "ODOMETRY"] = "ATTITUDE_QUATERNION"
    sigma_position_m: Sigmas = (10.0, 10.0, 20.0)
    sigma_velocity_m_s: Sigmas = (0.5, 0.5, 0.5)
    sigma_attitude_deg: tuple[Positive, Positive, Positive] = (0.05, 0.05, 0.1)


class _Attitude(NamedTuple):
    t_ns: int
    q_ga: Vector
    rate: Vector


class _Place(NamedTuple):
    t_ns: int
    lat: float
    lon: float
    height: float
    v_g: Vector


class MasterMavlink:
    """Decodes the packets of one master."""

    def __init__(self, options: MasterMavlinkOptions, context: Context) -> None:
        self.counters = Counters()
        self._name = context.name
        self._packets = Packets(options.system_id, options.component_id, self.counters)
        handlers: dict[str, Callable[[Any, int], Sequence[MasterState]]]
        if options.message == "ODOMETRY":
            handlers = {"ODOMETRY": self._odometry, "GPS_GLOBAL_ORIGIN": self._global_origin}
        else:
            handlers = {"ATTITUDE_QUATERNION": self._attitude, "GLOBAL_POSITION_INT": self._global_position}
        self._handlers = {int(getattr(dialect, f"MAVLINK_MSG_ID_{name}")): h for name, h in handlers.items()}
        # all on one clock: what is dated by one message is compared with what another dates
        modulus = None if options.message == "ODOMETRY" else _BOOT_MODULUS_NS
        self._ports = {key: context.port(modulus, options.latency_ms) for key in self._handlers}
        self.keys = [(context.source, key) for key in self._handlers]
        self._sigmas = (
            np.array(options.sigma_position_m, dtype=np.float64),
            np.array(options.sigma_velocity_m_s, dtype=np.float64),
            np.radians(options.sigma_attitude_deg),
        )
        self._origin: LocalFrame | None = None
        self._attitudes: deque[_Attitude] = deque(maxlen=2)
        self._waiting: deque[_Place] = deque(maxlen=_WAITING)
        undulation(0.0, 0.0)  # unpacked now, not in the loop

    def feed(self, frame: RawFrame) -> Sequence[MasterState]:
        """What a packet completes."""
        counters = self.counters
        message = self._packets.message(frame)
        if message is None:
            return ()
        handler = self._handlers.get(message.get_msgId())
        if handler is None:
            return counters.reject(Reject.UNKNOWN)
        try:
            states = handler(message, frame.rx_ns)
        except ValueError:
            return counters.reject(Reject.RANGE)
        if states:
            counters.samples += len(states)
            counters.last_ns = states[-1].t_ns
        return states

    def _stamp(self, message: Any, counter_ns: int, rx_ns: int) -> int | None:
        """Engine time of a message; None, and counted, where its own time has not gone on."""
        port = self._ports[message.get_msgId()]
        t_ns = port.stamp(counter_ns, rx_ns)
        elapsed = port.elapsed_ns
        if elapsed is not None and elapsed <= 0:
            self.counters.reject(Reject.STALE)
            return None
        return t_ns

    # ---- attitude and place in two messages ----------------------------------------------------

    def _attitude(self, message: Any, rx_ns: int) -> Sequence[MasterState]:
        m = message
        q_ga = attitude((m.q1, m.q2, m.q3, m.q4))
        rate = _bounded(turned(m.rollspeed, m.pitchspeed, m.yawspeed), _FASTEST)
        t_ns = self._stamp(m, m.time_boot_ms * 10**6, rx_ns)
        if t_ns is None:
            return ()
        if self._attitudes and t_ns <= self._attitudes[-1].t_ns:
            self._attitudes.clear()  # the clock was set anew
        self._attitudes.append(_Attitude(t_ns, q_ga, rate))
        return self._paired()

    def _global_position(self, message: Any, rx_ns: int) -> Sequence[MasterState]:
        lat, lon, height = _geodetic(message.lat, message.lon, message.alt)
        v_g = 0.01 * turned(message.vx, message.vy, message.vz)
        t_ns = self._stamp(message, message.time_boot_ms * 10**6, rx_ns)
        if t_ns is None:
            return ()
        self._waiting.append(_Place(t_ns, lat, lon, height, v_g))
        return self._paired()

    def _paired(self) -> list[MasterState]:
        """The places that there is an attitude for by now; those older than that are counted and dropped."""
        states = []
        while self._waiting and self._attitudes and self._waiting[0].t_ns <= self._attitudes[-1].t_ns:
            place = self._waiting.popleft()
            found = self._between(place.t_ns)
            if found is None:
                self.counters.reject(Reject.INCOMPLETE)
                continue
            q_ga, rate = found
            states.append(self._state(place, q_ga, rate, self._sigmas))
        return states

    def _between(self, t_ns: int) -> tuple[Vector, Vector] | None:
        new, old = self._attitudes[-1], self._attitudes[0]
        if t_ns == new.t_ns:
            return new.q_ga, new.rate
        span = new.t_ns - old.t_ns
        if not (old.t_ns <= t_ns and 0 < span <= _LONGEST_NS):
            return None
        share = (t_ns - old.t_ns) / span
        turn = rotvec_from_quat(quat_multiply(quat_conjugate(old.q_ga), new.q_ga))
        q_ga = quat_multiply(old.q_ga, quat_from_rotvec(share * turn))
        return q_ga, old.rate + share * (new.rate - old.rate)

    # ---- everything in one message -------------------------------------------------------------

    def _global_origin(self, message: Any, rx_ns: int) -> Sequence[MasterState]:
        self._origin = LocalFrame(*_geodetic(message.latitude, message.longitude, message.altitude))
        return ()

    def _odometry(self, message: Any, rx_ns: int) -> Sequence[MasterState]:
        m = message
        if m.frame_id != dialect.MAV_FRAME_LOCAL_NED or m.child_frame_id != dialect.MAV_FRAME_BODY_FRD:
            return self.counters.reject(Reject.UNKNOWN)
        q_la = attitude(m.q)  # in the axes of the origin
        v_a = _bounded(turned(m.vx, m.vy, m.vz), _FASTEST)
        rate = _bounded(turned(m.rollspeed, m.pitchspeed, m.yawspeed), _FASTEST)
        here = _bounded(np.array((m.x, m.y, m.z)), 2e7)
        t_ns = self._stamp(m, m.time_usec * 1000, rx_ns)
        if t_ns is None:
            return ()
        if self._origin is None:
            return self.counters.reject(Reject.INCOMPLETE)
        lat, lon, height, q_gl = self._origin.there(*here.tolist())
        if not abs(height) < _FURTHEST:
            raise ValueError("a height beyond reason")
        q_ga = quat_multiply(q_gl, q_la)
        place = _Place(t_ns, lat, lon, height, quat_rotate(q_ga, v_a))
        pose, speed = _sigmas(m.pose_covariance), _sigmas(m.velocity_covariance)
        own_p, own_v, own_phi = self._sigmas
        if pose is not None:
            own_p, own_phi = _level(pose[:3]), _level(pose[3:])
        if speed is not None:
            own_v = np.full(3, float(np.max(speed[:3])))  # along the body's axes: the largest stands for all
        return [self._state(place, q_ga, rate, (own_p, own_v, own_phi))]

    def _state(
        self, place: _Place, q_ga: Vector, rate: Vector, sigmas: tuple[Vector, Vector, Vector]
    ) -> MasterState:
        t_ns, lat, lon, height, v_g = place
        return MasterState(t_ns, lat, lon, height, v_g, q_ga, rate, None, *sigmas, True, self._name)


def _geodetic(lat_e7: int, lon_e7: int, altitude_mm: int) -> tuple[float, float, float]:
    """Latitude, longitude (rad) and height above the ellipsoid (m) of a place on the wire."""
    if abs(lat_e7) > 900_000_000 or abs(lon_e7) > 1_800_000_000:
        raise ValueError("a latitude or longitude beyond the globe")
    lat, lon, altitude = lat_e7 * _RAD_PER_E7, lon_e7 * _RAD_PER_E7, altitude_mm * 1e-3
    if not abs(altitude) < _FURTHEST:
        raise ValueError("an altitude beyond reason")
    return lat, lon, altitude + undulation(lat, lon)


def _bounded(v: Vector, most: float) -> Vector:
    # written so that a NaN fails too
    if not np.all(np.abs(v) <= most):
        raise ValueError("a value beyond reason")
    return v


def _sigmas(covariance: Sequence[float]) -> Vector | None:
    """Sigmas (6,) of an upper triangle; None where the sender does not state them."""
    variances = np.array([covariance[place] for place in _PLACES])
    known = np.all(np.isfinite(variances)) and np.all(variances[:3] > 0.0) and np.all(variances[3:] >= 0.0)
    return np.sqrt(variances) if known else None


def _level(sigma: Vector) -> Vector:
    """Of north, east, down, or about front, right, down, east, north, up: the larger for both level ones."""
    level = float(np.max(sigma[:2]))
    return np.array((level, level, float(sigma[2])))
