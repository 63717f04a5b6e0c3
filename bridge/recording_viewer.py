"""Channels for people: pose, location and transform as viewers of MCAP files know them.

The message and field names are those of Foxglove's published schemas ``foxglove.PoseInFrame``,
``foxglove.LocationFix`` and ``foxglove.FrameTransform`` in their JSON encoding, so that a viewer
shows a map and an attitude without set-up. Positions are metres east, north, up of the first valid
position (frame ``map``); the vehicle is shown with x forward, y left, z up, as viewers expect.
"""

from __future__ import annotations

import math
from typing import Any, Final

import msgspec

from nav.earth import position_quat
from nav.rotation import quat_conjugate, quat_multiply
from nav.types import S, Solution, SolutionFlag

POSE: Final = "foxglove.PoseInFrame"
LOCATION: Final = "foxglove.LocationFix"
TRANSFORM: Final = "foxglove.FrameTransform"

_PERIOD_NS: Final = 100_000_000
_A: Final = 6378137.0  # WGS-84 semi-major axis, m
_E2: Final = 6.694379990141317e-3  # WGS-84 first eccentricity squared
_HALF: Final = math.sqrt(0.5)
_ATTITUDE: Final = SolutionFlag.LEVEL | SolutionFlag.HEADING

Row = tuple[int, int, str, tuple[float, ...]]
"""Time, flags, navigator and state: what the loop hands over, encoded later."""

_NUMBER: Final = {"type": "number"}
_STRING: Final = {"type": "string"}
_TIME: Final = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties, "required": list(properties)}


_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    POSE: _object(
        POSE,
        timestamp=_TIME,
        frame_id=_STRING,
        pose=_object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION),
    ),
    LOCATION: _object(
        LOCATION,
        timestamp=_TIME,
        frame_id=_STRING,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance={"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
        position_covariance_type={
            "title": "foxglove.PositionCovarianceType",
            "oneOf": [
                {"title": title, "const": const}
                for const, title in enumerate(("UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN"))
            ],
        },
    ),
    TRANSFORM: _object(
        TRANSFORM,
        timestamp=_TIME,
        parent_frame_id=_STRING,
        child_frame_id=_STRING,
        translation=_VECTOR,
        rotation=_QUATERNION,
    ),
}


class Decimator:
    """Lets ten solutions a second of each navigator through, as compact rows."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}

    def row(self, navigator: str, solution: Solution) -> Row | None:
        """The row to hand to the writer, or None when the last one is less than 100 ms old."""
        t_ns = solution.t_ns
        if t_ns < self._next.get(navigator, t_ns):
            return None
        self._next[navigator] = t_ns - t_ns % _PERIOD_NS + _PERIOD_NS
        return t_ns, solution.flags, navigator, tuple(solution.state[: S.SIGMA_P.stop].tolist())


class Encoder:
    """Turns rows into messages; runs in the writer's thread."""

    def __init__(self, utc_offset_ns: int) -> None:
        self._utc_offset_ns = utc_offset_ns
        self._origin: tuple[float, float, float] | None = None

    def encode(self, row: Row) -> list[tuple[str, bytes]]:
        """Messages of one row as (schema name, JSON); parts that are not valid yet are left out."""
        t_ns, flags, navigator, state = row
        seconds, nanoseconds = divmod(t_ns + self._utc_offset_ns, 1_000_000_000)
        stamp = {"sec": seconds, "nsec": nanoseconds}
        child = f"vehicle/{navigator}"
        encode = msgspec.json.encode
        messages: list[tuple[str, bytes]] = []
        place = {"x": 0.0, "y": 0.0, "z": 0.0}
        attitude = state[S.Q]
        if flags & SolutionFlag.POSITION:
            lat, lon, height = state[0:3]
            if self._origin is None:
                self._origin = (lat, lon, height)
            place = dict(zip("xyz", east_north_up(self._origin, (lat, lon, height)), strict=True))
            attitude = on_the_map(self._origin, lat, lon, attitude)
            east, north, up = (sigma * sigma for sigma in state[S.SIGMA_P])
            fix = {
                "timestamp": stamp,
                "frame_id": child,
                "latitude": math.degrees(lat),
                "longitude": math.degrees(lon),
                "altitude": height,
                "position_covariance": [east, 0.0, 0.0, 0.0, north, 0.0, 0.0, 0.0, up],
                "position_covariance_type": 2,
            }
            messages.append((LOCATION, encode(fix)))
        if flags & _ATTITUDE == _ATTITUDE:
            turn = dict(zip("wxyz", forward_left_up(attitude), strict=True))
            pose = {"timestamp": stamp, "frame_id": "map", "pose": {"position": place, "orientation": turn}}
            transform = {
                "timestamp": stamp,
                "parent_frame_id": "map",
                "child_frame_id": child,
                "translation": place,
                "rotation": turn,
            }
            messages += [(POSE, encode(pose)), (TRANSFORM, encode(transform))]
        return messages


def on_the_map(
    origin: tuple[float, float, float], lat: float, lon: float, q_gv: tuple[float, ...]
) -> tuple[float, ...]:
    """``q_gv`` (4,) at ``lat``, ``lon`` (rad) against east-north-up of the map's origin, not of the place.

    The two differ by little near the origin, and by anything near a pole.
    """
    q_og = quat_multiply(quat_conjugate(position_quat(origin[0], origin[1])), position_quat(lat, lon))
    return tuple(quat_multiply(q_og, q_gv).tolist())


def forward_left_up(q_gv: tuple[float, ...]) -> tuple[float, float, float, float]:
    """The attitude quaternion (w, x, y, z) for a vehicle drawn with x forward, y left, z up.

    ``q_gv`` (4,) takes right-forward-up to east-north-up; it is multiplied from the right by the
    quarter turn about up that takes forward-left-up to right-forward-up.
    """
    w, x, y, z = q_gv
    return _HALF * (w - z), _HALF * (x + y), _HALF * (y - x), _HALF * (z + w)


def east_north_up(
    origin: tuple[float, float, float], place: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Place (rad, rad, m) in metres east, north, up of the origin, through Earth-fixed coordinates.

    For display only: exact, but with the cancellation of Earth-centred differences, some nanometres.
    """
    lat, lon, _ = origin
    dx, dy, dz = (a - b for a, b in zip(_earth_fixed(*place), _earth_fixed(*origin), strict=True))
    outward = math.cos(lon) * dx + math.sin(lon) * dy
    return (
        math.cos(lon) * dy - math.sin(lon) * dx,
        math.cos(lat) * dz - math.sin(lat) * outward,
        math.cos(lat) * outward + math.sin(lat) * dz,
    )


def _earth_fixed(lat: float, lon: float, height: float) -> tuple[float, float, float]:
    normal = _A / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    ring = (normal + height) * math.cos(lat)
    return ring * math.cos(lon), ring * math.sin(lon), (normal * (1.0 - _E2) + height) * math.sin(lat)
