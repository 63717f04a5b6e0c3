"""The one place where our axes become MAVLink's: east-north-up and right-forward-up to NED and FRD."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bridge.geoid import undulation
from nav.earth import ecef, geodetic, position_quat
from nav.rotation import multiply, quat_conjugate, quat_multiply, rotate
from nav.types import S, Solution, Vector

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Ned:
    """A solution in MAVLink's conventions; NaN where unknown.

    ``lat``, ``lon`` rad, ``height`` m above the ellipsoid, ``altitude`` m above the geoid, ``v`` m/s
    north, east, down; ``q`` w, x, y, z takes front-right-down to north-east-down; ``roll``, ``pitch``,
    ``yaw`` rad, yaw in (-pi, pi]; ``rates`` rad/s about front, right, down; sigmas likewise (``sigma_p``
    and ``sigma_v`` north, east, down; ``sigma_attitude`` rad, as rotations about north, east, down).
    """

    lat: float
    lon: float
    height: float
    altitude: float
    v: Three
    q: Four
    roll: float
    pitch: float
    yaw: float
    rates: Three
    sigma_p: Three
    sigma_v: Three
    sigma_attitude: Three


def to_ned(solution: Solution) -> Ned:
    """``solution`` in MAVLink's conventions.

    Both pairs of axes are related by the same half turn P about the bisector of the first two axes
    (P: x, y, z to y, x, -z), so C_ned_frd = P C_gv P and the vector part of the quaternion turns like
    a vector.
    """
    state = [float(value) for value in solution.state]
    lat, lon, height = state[S.LAT], state[S.LON], state[S.HEIGHT]
    w, x, y, z = state[S.Q]
    yaw = solution.heading
    return Ned(
        lat=lat,
        lon=lon,
        height=height,
        altitude=height - undulation(lat, lon),
        v=_turned(state[S.V]),
        q=(w, y, x, -z) if w >= 0.0 else (-w, -y, -x, z),
        roll=solution.roll,
        pitch=solution.pitch,
        yaw=yaw - 2.0 * math.pi if yaw > math.pi else yaw,
        rates=_turned(state[S.W]),
        sigma_p=_exchanged(state[S.SIGMA_P]),
        sigma_v=_exchanged(state[S.SIGMA_V]),
        sigma_attitude=_exchanged(state[S.SIGMA_PHI]),
    )


def _turned(v: list[float]) -> Three:
    return v[1], v[0], -v[2]


def _exchanged(sigma: list[float]) -> Three:
    return sigma[1], sigma[0], sigma[2]


class LocalFrame:
    """A north-east-down frame fixed to the Earth at a geodetic origin (rad, rad, m)."""

    def __init__(self, lat: float, lon: float, height: float) -> None:
        self.lat, self.lon, self.height = lat, lon, height
        self._origin = ecef(lat, lon, height)
        sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        self._c_ne = np.array([[-sl * co, -sl * so, cl], [-so, co, 0.0], [-cl * co, -cl * so, -sl]])

    def position(self, lat: float, lon: float, height: float) -> Three:
        """A geodetic position (rad, rad, m) in this frame, m.

        Source: Groves 2013, Principles of GNSS, Inertial, and Multisensor Integrated Navigation
        Systems, 2nd ed., eq. (2.150).
        """
        d = ecef(lat, lon, height) - self._origin
        n, e, down = (float(row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) for row in self._c_ne)
        return n, e, down

    def there(self, n: float, e: float, down: float) -> tuple[float, float, float, Vector]:
        """Latitude, longitude (rad), height (m) of a place in this frame (m), and what is turned on the way.

        That is the quaternion (4,) from east-north-up at the origin to east-north-up there.
        """
        lat, lon, height = (float(x) for x in geodetic(self._origin + np.array((n, e, down)) @ self._c_ne))
        q_gl = quat_multiply(quat_conjugate(position_quat(lat, lon)), position_quat(self.lat, self.lon))
        return lat, lon, height, q_gl

    def seen(self, ned: Ned) -> Ned:
        """``ned`` with velocity, attitude and sigmas along this frame's axes; its place stays geodetic.

        North-east-down where the vehicle is differs from that of the origin: by a milliradian ten
        kilometres away in mid latitudes, by anything near a pole. Errors along and about the different axes
        are taken as uncorrelated.
        """
        q_ge = quat_conjugate(position_quat(self.lat, self.lon))
        w, x, y, z = (float(value) for value in quat_multiply(q_ge, position_quat(ned.lat, ned.lon)))
        turn = (w, y, x, -z)  # as in `to_ned`
        q = multiply(*turn, *ned.q)
        if q[0] < 0.0:
            q = (-q[0], -q[1], -q[2], -q[3])
        columns = [rotate(*turn, *axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]

        def spread(sigma: Three) -> Three:
            n, e, d = (math.hypot(*(c[k] * s for c, s in zip(columns, sigma, strict=True))) for k in range(3))
            return n, e, d

        roll, pitch, yaw = _euler(q)
        return replace(
            ned,
            v=rotate(*turn, *ned.v),
            q=q,
            roll=roll,
            pitch=pitch,
            yaw=yaw,
            sigma_p=spread(ned.sigma_p),
            sigma_v=spread(ned.sigma_v),
            sigma_attitude=spread(ned.sigma_attitude),
        )


def _euler(q: Four) -> Three:
    """Roll, pitch and yaw of a quaternion from front-right-down to north-east-down."""
    w, x, y, z = q
    sine = 2.0 * (w * y - x * z)
    return (
        math.atan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z),
        math.asin(max(-1.0, min(1.0, sine))) if math.isfinite(sine) else math.nan,
        math.atan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z),
    )
