"""A turntable with a unit on it: positions and rotations as the bench's truth, with the table's own errors.

The table turns about axes of the unit, one at a time, and comes to rest between. It stands on the Earth,
so the sensors feel the Earth's rate and gravity; the unit's sensors are in the axes' point of intersection.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from virtual_bus import ellipsoid
from virtual_bus.ellipsoid import OMEGA
from virtual_bus.manoeuvres import Blend, Profile, Static, smooth, smooth_area
from virtual_bus.scenario import Scenario
from virtual_bus.tables import DeviceTable, EncoderTable, ImuTable, NavigatorTable, Start
from virtual_bus.truth import Motion, Times, Trajectory, Vehicle

Array = NDArray[np.float64]

_RAMP_S: Final = 1.0
_SLEW: Final = math.radians(20.0)  # rad/s, fastest between two positions
_SAME: Final = 1e-9  # rad
_STEP_DEG: Final = 2e-5  # of the angles on the bus
_STEPS: Final = 18_000_000
_NODES, _WEIGHTS = (part.tolist() for part in np.polynomial.legendre.leggauss(4))


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """Rest for ``seconds`` in attitude ``C_gb`` (3, 3), taken up by the shortest turn from the one before."""

    C_gb: Array
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Spin:
    """Turn about ``axis`` (3,), a unit vector of the unit's axes, at ``rate`` rad/s by ``angle`` rad."""

    axis: Array
    rate: float
    angle: float


Move = Hold | Spin


@dataclass(frozen=True, slots=True)
class TableErrors:
    """One sigma of what is wrong with table and place, SI: tilt, north (rad), gravity (m/s^2).

    ``position`` rad is how far it comes to rest from where it should, about each axis of the unit.
    """

    tilt: float = 0.0
    north: float = 0.0
    gravity: float = 0.0
    position: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A time in which the rate about one axis goes smoothly from one value to another."""

    seconds: float
    axis: Array
    begin_rate: float
    end_rate: float

    @property
    def angle(self) -> float:
        return 0.5 * self.seconds * (self.begin_rate + self.end_rate)


def _turn(axis: Array, angle: float, rate: float) -> list[_Piece]:
    """Up to ``rate``, on at it, and down again, ``angle`` in all."""
    speed = math.copysign(min(abs(rate), abs(angle) / _RAMP_S), angle)
    cruise = angle / speed - _RAMP_S
    pieces = [_Piece(_RAMP_S, axis, 0.0, speed), _Piece(_RAMP_S, axis, speed, 0.0)]
    if cruise > 0.0:
        pieces.insert(1, _Piece(cruise, axis, speed, speed))
    return pieces


def _rotvec(C: Array) -> tuple[Array, float]:
    """Axis (3,) and angle (0 to pi) of a rotation matrix."""
    values, vectors = np.linalg.eig(C)
    axis = np.real(vectors[:, int(np.argmin(np.abs(values - 1.0)))])
    axis = axis / np.linalg.norm(axis)
    skew = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    angle = math.atan2(float(axis @ skew), float(np.trace(C)) - 1.0)
    return (axis, angle) if angle >= 0.0 else (-axis, -angle)


def _about(axis: Array, angle: Array) -> Array:
    """Rotations (n, 3, 3) by ``angle`` (n,) about ``axis`` (3,): Rodrigues' formula."""
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    s, c = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + s * K + c * (K @ K))


class TableTruth(Trajectory):
    """The motion of a unit on a turntable that begins in the attitude of the first move, a `Hold`.

    ``C_gt`` (3, 3) is how the table stands: what it takes for east, north, up into the real ones.
    ``gravity`` m/s^2 pulls along the real up.
    """

    def __init__(
        self, moves: Sequence[Move], lat: float, height: float, gravity: float, C_gt: Array | None = None
    ) -> None:
        first = moves[0]
        assert isinstance(first, Hold)
        stands = np.eye(3) if C_gt is None else C_gt
        self.pieces: list[_Piece] = []
        self.C_gt = stands
        self._C = [stands @ first.C_gb]
        for move in moves:
            if isinstance(move, Spin):
                parts = _turn(move.axis, move.angle, move.rate)
            else:
                axis, angle = _rotvec(self._C[-1].T @ stands @ move.C_gb)
                parts = _turn(axis, angle, _SLEW) if angle > _SAME else []
                parts.append(_Piece(move.seconds, axis, 0.0, 0.0))
            self.pieces += parts
            for piece in parts:
                self._C.append(self._C[-1] @ _about(piece.axis, np.array([piece.angle]))[0])
        seconds = np.cumsum([piece.seconds for piece in self.pieces])
        self._begin_ns = np.rint(1e9 * np.append(0.0, seconds)).astype(np.int64)
        self._lat, self._height = lat, height
        self._w_g = OMEGA * np.array([0.0, math.cos(lat), math.sin(lat)])
        self._f_g = np.array([0.0, 0.0, gravity])
        standing = Profile([Blend(float(self._begin_ns[-1]) * 1e-9)])
        super().__init__(standing, Vehicle(imu=np.zeros(3), C_vb=np.eye(3)), lat, 0.0, height)

    def solve(self, until_ns: int) -> None:
        """Nothing is integrated: every motion is a closed form."""

    def increments(self, t_ns: Times) -> tuple[Array, Array]:
        """Angle and velocity (n-1, 3) between the times ``t_ns`` (n,), by quadrature of the exact rates.

        What the table turns through is taken as the difference of its angle, so that whole turns are whole.
        """
        out = np.zeros((len(t_ns) - 1, 6))
        cuts = np.union1d(t_ns, self._begin_ns[(self._begin_ns > t_ns[0]) & (self._begin_ns < t_ns[-1])])
        owner = np.searchsorted(t_ns, cuts[:-1], side="right") - 1
        half: Array = np.asarray(0.5e-9 * np.diff(cuts), dtype=np.float64)
        index = np.searchsorted(self._begin_ns, cuts[:-1], side="right") - 1
        index = np.minimum(index, len(self.pieces) - 1)
        since: Array = np.asarray(1e-9 * (cuts[:-1] - self._begin_ns[index]), dtype=np.float64)
        for k in np.unique(index).tolist():
            at = np.flatnonzero(index == k)
            piece = self.pieces[k]
            begin, _ = _course(piece, since[at])
            end, _ = _course(piece, since[at] + 2.0 * half[at])
            part = np.zeros((len(at), 6))
            part[:, :3] = (end - begin)[:, None] * piece.axis
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                angle, _ = _course(piece, since[at] + half[at] * (1.0 + node))
                C_gb = self._C[k] @ _about(piece.axis, angle)
                w_and_f = np.concatenate((self._w_g @ C_gb, self._f_g @ C_gb), axis=1)
                part += weight * half[at, None] * w_and_f
            np.add.at(out, owner[at], part)
        return out[:, :3], out[:, 3:]

    def motion(self, t_ns: Times, point: Array | None = None) -> Motion:
        """Where the unit is and what it feels; every ``point`` is the axes' point of intersection."""
        t_ns = np.clip(t_ns, 0, int(self._begin_ns[-1]))
        index = np.minimum(np.searchsorted(self._begin_ns, t_ns, side="right") - 1, len(self.pieces) - 1)
        n = len(t_ns)
        C_gb, w_gb = np.empty((n, 3, 3)), np.empty((n, 3))
        for i, k in enumerate(index.tolist()):
            piece = self.pieces[k]
            angle, rate = _course(piece, np.array([1e-9 * (t_ns[i] - self._begin_ns[k])]))
            C_gb[i] = self._C[k] @ _about(piece.axis, angle)[0]
            w_gb[i] = rate[0] * piece.axis
        lat, lon, height = np.full(n, self._lat), np.zeros(n), np.full(n, self._height)
        still = np.zeros((n, 3))
        return Motion(
            lat=lat,
            lon=lon,
            height=height,
            v_g=still,
            C_gv=C_gb,
            w_iv_v=self._w_g @ C_gb + w_gb,
            f_v=self._f_g @ C_gb,
            r_e=ellipsoid.to_ecef(lat, lon, height),
            v_e=still,
        )


class Encoder:
    """Reads the angles of a table's axes, each off by as much as its circle is from its centre.

    ``rng`` draws where on the circle that is.
    """

    def __init__(self, table: TableTruth, options: EncoderTable, rng: np.random.Generator) -> None:
        self._table = table
        self._axes = options.axes.upper()  # about axes that are carried along
        self._off = math.sqrt(2.0) * options.sigma_arcsec / 3600.0
        self._where = 2.0 * math.pi * rng.random(3)

    def read(self, t_ns: Times) -> Array:
        """Angles (n, 3) deg at times (n,), from 0 to a turn, in steps of the bus."""
        C_tb = self._table.C_gt.T @ self._table.motion(t_ns).C_gv
        with warnings.catch_warnings():
            # with the outer and the inner axis along each other one of their angles is free
            warnings.simplefilter("ignore", UserWarning)
            angles = Rotation.from_matrix(C_tb).as_euler(self._axes)
        read = np.degrees(angles) + self._off * np.sin(angles + self._where)
        return np.asarray(np.rint(read / _STEP_DEG) % _STEPS * _STEP_DEG)


def _course(piece: _Piece, t: Array) -> tuple[Array, Array]:
    """Angle and rate (n,) of a piece ``t`` (n,) s after its beginning."""
    x = np.clip(t / piece.seconds, 0.0, 1.0)
    more = piece.end_rate - piece.begin_rate
    area = smooth_area(x)
    return piece.seconds * (piece.begin_rate * x + more * area), piece.begin_rate + more * smooth(x)


class Turntable(Scenario, kw_only=True):
    """A scenario of a table that makes ``moves`` at ``start``; ``errors`` are drawn with every seed.

    ``gravity`` m/s^2 is what is taken for it there; the real one differs by its error.
    """

    moves: tuple[Move, ...]
    errors: TableErrors
    gravity: float
    encoder: EncoderTable | None = None

    def devices(self) -> dict[str, DeviceTable]:
        """The unit, and the table's encoders where it has some."""
        tables = super().devices()
        return tables if self.encoder is None else {**tables, "table": self.encoder}

    def trajectory(self, seconds: float, rng: np.random.Generator) -> Trajectory:
        """The table's motion; ``rng`` draws its errors, the last rest going on as long as is asked for."""
        delta, g = self.drawn(rng)
        angle = float(np.linalg.norm(delta))
        C_gt = _about(delta / angle, np.array([angle]))[0] if angle else None
        more = max(seconds - self.seconds(), 1.0)
        moves = self._carried_out(rng)
        moves.append(Hold(next(move.C_gb for move in reversed(moves) if isinstance(move, Hold)), more))
        return TableTruth(moves, math.radians(self.start.lat_deg), self.start.height_m, g, C_gt)

    def drawn(self, rng: np.random.Generator) -> tuple[Array, float]:
        """Tilt about east and north and north error (3,) rad, and gravity m/s^2, of one table."""
        e, z = self.errors, rng.standard_normal(4)
        return z[:3] * np.array([e.tilt, e.tilt, e.north]), self.gravity + e.gravity * float(z[3])

    def _carried_out(self, rng: np.random.Generator) -> list[Move]:
        """The moves with the errors of where they end, in every new attitude and of every spin's angle.

        An attitude that is wrong leaves the axis wrong about which a spin turns the unit.
        """
        sigma = self.errors.position
        if not sigma:
            return list(self.moves)
        made: list[Move] = []
        wanted: Array | None = None
        at = C_off = np.eye(3)
        for move in self.moves:
            if isinstance(move, Spin):
                angle = move.angle + sigma * float(rng.standard_normal())
                axis = C_off.T @ move.axis
                at = at @ _about(axis, np.array([angle]))[0]
                made.append(Spin(axis, move.rate, angle))
                continue
            if wanted is None or not np.array_equal(wanted, move.C_gb):
                off = sigma * rng.standard_normal(3)
                size = float(np.linalg.norm(off))
                C_off = _about(off / size, np.array([size]))[0]
                wanted, at = move.C_gb, move.C_gb @ C_off
            made.append(Hold(at, move.seconds))
        return made


def turntable(
    title: str,
    grade: str,
    moves: Sequence[Move],
    lat_deg: float,
    height_m: float,
    gravity: float,
    errors: TableErrors,
    rate_hz: float,
    encoder: EncoderTable | None = None,
) -> Turntable:
    """The scenario of a table that makes ``moves``, the first of them a `Hold`; ``rate_hz`` is the unit's."""
    seconds = float(sum(piece.seconds for piece in TableTruth(moves, 0.0, 0.0, gravity).pieces))
    return Turntable(
        title=title,
        grade=grade,
        start=Start(lat_deg=lat_deg, lon_deg=0.0, height_m=height_m),
        manoeuvre=[Static(duration_s=seconds)],
        imu=ImuTable(rate_hz=rate_hz),
        navigator=NavigatorTable(autostart=False),
        moves=tuple(moves),
        errors=errors,
        gravity=gravity,
        encoder=encoder,
    )
