"""True motion of the simulated vehicle, exact to rounding.

The vehicle's reference point (the middle of the rear axle, where a car does not slip sideways) is
integrated in Earth-fixed axes; attitude follows the profile, and body rate and specific force of the
inertial unit, at its lever arm, come from analytic derivatives of both. Increments are integrals of
Chebyshev fits over pieces of at most one second, so any interval costs the same and none is
approximated by its neighbours.

A profile's heading is measured in level axes h that are east-north-up at the start and go on from there as a
graticule of their own, with its poles on the equator 90 degrees to the east and west of the start: true
heading where the drive begins, and nearly a great circle for who drives straight on, over the Earth's poles
too. What is told of the truth (heading, velocity) is geographic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from nav.rotation import dcm_from_quat
from virtual_bus import ellipsoid
from virtual_bus.axes import attitude, cross, down, euler, quaternion, up
from virtual_bus.crab import Crab
from virtual_bus.ellipsoid import G0, OMEGA
from virtual_bus.manoeuvres import Profile
from virtual_bus.sway import Sway

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Channels = tuple[Array, Array, Array, Array]

PIECE_NS: Final = 1_000_000_000
NODES: Final = 18  # degree 17 over a second: truncation of every manoeuvre used is below rounding
CHUNK: Final = 64  # pieces solved at a time
_ROLL_PIECES: Final = 8  # of a blend that rolls or yaws the vehicle, however short
_PICARD: Final = 9  # each round gains a factor of distance / Earth radius per chunk

_X = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)[::-1]
_FIT = np.linalg.inv(chebyshev.chebvander(_X, NODES - 1))
# node values -> coefficients of the integral from the left end, on [-1, 1]
_INTEGRAL = np.stack([chebyshev.chebint(_FIT[:, k], lbnd=-1) for k in range(NODES)], axis=1)
_AT_NODES = chebyshev.chebvander(_X, NODES) @ _INTEGRAL
_AT_END = np.ones(NODES + 1) @ _INTEGRAL


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Where the instruments are, vehicle axes right-forward-up from the rear axle, m.

    ``C_vb`` (3, 3) takes IMU axes to vehicle axes. The body leans ``roll_per_accel`` rad per m/s^2
    outward in a curve and lifts its nose ``pitch_per_accel`` rad per m/s^2 when it accelerates. One that
    ``banks`` rolls into a level curve until next to nothing pulls it to the side. Where a
    ``crab`` is given its heading is off the path's by that much: side wind, camber, steering. A ``sway``
    turns it about the reference point.
    """

    imu: Array
    C_vb: Array
    roll_per_accel: float = 0.0
    pitch_per_accel: float = 0.0
    crab: Crab | None = None
    sway: Sway | None = None
    banks: bool = False


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of one point of the vehicle at n times; arrays (n,), (n, 3), (n, 3, 3)."""

    lat: Array
    lon: Array
    height: Array
    v_g: Array
    C_gv: Array
    w_iv_v: Array
    f_v: Array
    r_e: Array
    v_e: Array


@dataclass(frozen=True, slots=True)
class TruthState:
    """Truth at one instant, at the IMU or at another point: SI units, angles in rad.

    ``v_g`` (3,) east, north, up; ``q_gv`` and ``q_gb`` (4,) w, x, y, z take vehicle and IMU axes to
    east-north-up; ``w_ib_b``, ``f_b`` (3,) are what the IMU feels.
    """

    t_ns: int
    lat: float
    lon: float
    height: float
    v_g: Array
    q_gv: Array
    q_gb: Array
    w_ib_b: Array
    f_b: Array
    roll: float
    pitch: float
    heading: float


def itself(state: TruthState) -> TruthState:
    """The same where the vehicle is the IMU itself."""
    C = dcm_from_quat(state.q_gb)
    heading, pitch, roll = (float(angle[0]) for angle in euler(C[None]))
    return replace(state, q_gv=state.q_gb, roll=roll, pitch=pitch, heading=heading)


def mounting_matrix(pitch_deg: float, roll_deg: float, heading_deg: float) -> Array:
    """C_vb (3, 3) of an IMU mounted at these angles to the vehicle, in the order heading, pitch, roll."""
    angles = np.radians(np.array([[heading_deg, pitch_deg, roll_deg]]))
    return np.asarray(attitude(angles[:, 0], angles[:, 1], angles[:, 2])[0])


class Trajectory:
    """A profile driven over the ellipsoid from a starting point (rad, rad, m).

    Times are nanoseconds since the start of the scenario, ``t_ns`` (n,) int64 within
    [0, ``profile.end_ns``]; what lies outside is taken at the nearest end. ``pole`` (3,) is that of the
    graticule in which headings are measured, in Earth-fixed axes.
    """

    def __init__(self, profile: Profile, vehicle: Vehicle, lat: float, lon: float, height: float) -> None:
        self.profile = profile
        self.vehicle = vehicle
        starts: list[int] = []
        # what sways twice as fast as its waves, as products of them do, is followed over half the time
        piece_ns = PIECE_NS if vehicle.sway is None else PIECE_NS // 2
        ends = [*profile.start_ns[1:].tolist(), profile.end_ns]
        turns = profile.turns()
        quick = turns[:, 1] | (turns[:, 0] & vehicle.banks)
        for t0, t1, rolls in zip(profile.start_ns.tolist(), ends, quick.tolist(), strict=True):
            count = max(-(-(t1 - t0) // piece_ns), _ROLL_PIECES if rolls else 1)
            starts.extend(t0 + (t1 - t0) * k // count for k in range(count))
        self._start_ns = np.array(starts, np.int64)
        self._half = 0.5e-9 * np.diff(np.append(self._start_ns, profile.end_ns))
        self._solved = 0
        n = len(starts)
        self.pole = np.array([-math.sin(lon), math.cos(lon), 0.0])  # east of the start
        self._r0 = np.empty((n + 1, 3))
        self._r0[0] = ellipsoid.to_ecef(np.array(lat), np.array(lon), np.array(height))
        # integrals over a piece, (coefficient, displacement | dtheta | dv)
        self._coef = np.empty((n, NODES + 1, 9))
        self._total = np.empty((n, 6))

    def solve(self, until_ns: int) -> None:
        """Integrate up to ``until_ns`` now; what is not solved yet is solved when it is asked for."""
        self._solve_pieces(int(np.searchsorted(self._start_ns, until_ns, side="right")) - 1)

    def increments(self, t_ns: Times) -> tuple[Array, Array]:
        """Exact dtheta (n-1, 3) rad and dv (n-1, 3) m/s in IMU axes between the times ``t_ns`` (n,).

        They are the integrals of w_ib_b and f_b in body axes, what ideal instruments count.
        """
        index, local = self._local(t_ns)
        inside = local[:, 3:]
        first, last = int(index[0]), int(index[-1])
        # sums of whole pieces count from the first one asked for, so they stay small and exact
        whole = np.zeros((last - first + 1, 6))
        np.cumsum(self._total[first:last], axis=0, out=whole[1:])
        out = np.diff(whole[index - first], axis=0) + np.diff(inside, axis=0)
        return out[:, :3], out[:, 3:]

    def motion(self, t_ns: Times, point: Array | None = None) -> Motion:
        """Motion of the IMU, or of ``point`` (3,) m in vehicle axes from the rear axle."""
        index, local = self._local(t_ns)
        r_axle = self._r0[index] + local[:, :3]
        profile, rolled = self.profile.channels(t_ns), self.profile.distance(t_ns)
        point = self.vehicle.imu if point is None else point
        return self._motion(1e-9 * t_ns.astype(np.float64), profile, rolled, r_axle, point)

    def state(self, t_ns: int, point: Array | None = None) -> TruthState:
        """Truth at one instant; position and velocity are those of ``point`` (vehicle axes) or the IMU."""
        t = np.array([t_ns], np.int64)
        imu = self.motion(t)
        at = imu if point is None else self.motion(t, point)
        C_gv, C_vb = at.C_gv[0], self.vehicle.C_vb
        heading, pitch, roll = (float(angle[0]) for angle in euler(at.C_gv))
        return TruthState(
            t_ns=t_ns,
            lat=float(at.lat[0]),
            lon=float(at.lon[0]),
            height=float(at.height[0]),
            v_g=at.v_g[0],
            q_gv=quaternion(C_gv),
            q_gb=quaternion(C_gv @ C_vb),
            w_ib_b=C_vb.T @ imu.w_iv_v[0],
            f_b=C_vb.T @ imu.f_v[0],
            roll=roll,
            pitch=pitch,
            heading=heading,
        )

    def _local(self, t_ns: Times) -> tuple[NDArray[np.intp], Array]:
        """Piece of each time and the integrals (n, 9) from that piece's start."""
        t_ns = np.clip(t_ns, 0, self.profile.end_ns)
        index = np.searchsorted(self._start_ns, t_ns, side="right") - 1
        self._solve_pieces(int(index.max()))
        half = self._half[index]
        x = (t_ns - self._start_ns[index]) * 1e-9 / half - 1.0
        basis = chebyshev.chebvander(x, NODES)
        # grouped by piece: one small matrix product each
        out = np.empty((len(t_ns), 9))
        cuts = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(t_ns)]
        for a, b in pairwise(cuts):
            out[a:b] = basis[a:b] @ self._coef[index[a]]
        return index, out

    def _solve_pieces(self, last: int) -> None:
        while self._solved <= last:
            self._solve_chunk()

    def _solve_chunk(self) -> None:
        """Integrate the next pieces: Picard's iteration over all their nodes at once."""
        a, b = self._solved, min(self._solved + CHUNK, len(self._start_ns))
        half = self._half[a:b, None, None]
        # nodes lie between nanoseconds, and half of one would already show in the rates
        since = ((_X + 1.0) * self._half[a:b, None]).ravel()
        at = np.repeat(self._start_ns[a:b], NODES)
        profile = self.profile.channels(at, since)
        v_h = self._velocity(profile)[0]
        r = np.broadcast_to(self._r0[a], (b - a, NODES, 3)).copy()
        for _ in range(_PICARD):
            lat, lon, _h = ellipsoid.to_geodetic(r.reshape(-1, 3))
            v_e = up(ellipsoid.axes_eh(lat, lon, self.pole), v_h).reshape(b - a, NODES, 3)
            steps = half[:, 0] * np.einsum("k,pkc->pc", _AT_END, v_e)
            self._r0[a + 1 : b + 1] = self._r0[a] + np.cumsum(steps, axis=0)
            r = self._r0[a:b, None, :] + half * np.einsum("ik,pkc->pic", _AT_NODES, v_e)
        rolled = self.profile.distance(at, since)
        motion = self._motion(1e-9 * at + since, profile, rolled, r.reshape(-1, 3), self.vehicle.imu)
        rates = np.concatenate((motion.w_iv_v @ self.vehicle.C_vb, motion.f_v @ self.vehicle.C_vb), axis=1)
        values = np.concatenate((v_e, rates.reshape(b - a, NODES, 6)), axis=2)
        self._coef[a:b] = half * np.einsum("ik,pkc->pic", _INTEGRAL, values)
        self._total[a:b] = half[:, 0] * np.einsum("k,pkc->pc", _AT_END, values[:, :, 3:])
        self._solved = b

    @staticmethod
    def _velocity(profile: Channels) -> tuple[Array, Array]:
        """Velocity of the axle (n, 3) in h, and the derivatives of its components."""
        c, c1, _c2, _c3 = profile
        s, psi, gam, _, _ = c.T
        s1, psi1, gam1, _, _ = c1.T
        sp, cp, sg, cg = np.sin(psi), np.cos(psi), np.sin(gam), np.cos(gam)
        along = np.stack((cg * sp, cg * cp, sg), axis=-1)
        turn = np.stack((-sg * gam1 * sp + cg * cp * psi1, -sg * gam1 * cp - cg * sp * psi1, cg * gam1), -1)
        return s[:, None] * along, s1[:, None] * along + s[:, None] * turn

    def _motion(self, t: Array, profile: Channels, rolled: Array, r_axle: Array, point: Array) -> Motion:
        """Kinematics of ``point`` from time (s), profile, distance rolled and the axle's place in e."""
        (s, psi, gam, bank, yaw), (s1, psi1, gam1, bank1, yaw1), *higher = (c.T for c in profile)
        (s2, psi2, gam2, bank2, yaw2), (s3, psi3, _, _, _) = higher
        v_h, vdot_h = self._velocity(profile)
        lat, lon, height = ellipsoid.to_geodetic(r_axle)
        C_eh = ellipsoid.axes_eh(lat, lon, self.pole)
        w_eh_h, wdot_eh_h = ellipsoid.rate_eh(C_eh, self.pole, height, v_h, vdot_h)
        w_ie_h = OMEGA * C_eh[:, 2, :]

        # attitude: heading, pitch (slope and squat), roll (lean, bank), and two derivatives
        kp, kr = self.vehicle.pitch_per_accel, -self.vehicle.roll_per_accel
        pitch, pitch1, pitch2 = gam + kp * s1, gam1 + kp * s2, gam2 + kp * s3
        across, across1 = s * psi1, s1 * psi1 + s * psi2
        across2 = s2 * psi1 + 2.0 * s1 * psi2 + s * psi3
        roll, roll1, roll2 = kr * s * psi1 + bank, kr * across1 + bank1, kr * across2 + bank2
        if self.vehicle.banks:
            x, x1, x2 = across / G0, across1 / G0, across2 / G0
            flat = 1.0 / (1.0 + x * x)
            roll, roll1 = roll + np.arctan(x), roll1 + flat * x1
            roll2 = roll2 + flat * (x2 - 2.0 * flat * x * x1 * x1)
        psi, psi1, psi2 = psi + yaw, psi1 + yaw1, psi2 + yaw2
        if self.vehicle.crab is not None:
            crab, crab1, crab2 = self.vehicle.crab.angle(rolled, np.abs(s), np.sign(s) * s1)
            psi, psi1, psi2 = psi + crab, psi1 + crab1, psi2 + crab2
        if self.vehicle.sway is not None:
            now, first, second = (a.T for a in self.vehicle.sway.angles(t))
            psi, pitch, roll = psi + now[0], pitch + now[1], roll + now[2]
            psi1, pitch1, roll1 = psi1 + first[0], pitch1 + first[1], roll1 + first[2]
            psi2, pitch2, roll2 = psi2 + second[0], pitch2 + second[1], roll2 + second[2]
        C_hv = attitude(psi, pitch, roll)
        sp, cp, sr, cr = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
        w_hv = np.stack(
            (pitch1 * cr + psi1 * cp * sr, roll1 - psi1 * sp, pitch1 * sr - psi1 * cp * cr), axis=-1
        )
        mixed = psi2 * cp - psi1 * pitch1 * sp
        wdot_hv = np.stack(
            (
                pitch2 * cr - pitch1 * roll1 * sr + mixed * sr + psi1 * cp * roll1 * cr,
                roll2 - psi2 * sp - psi1 * pitch1 * cp,
                pitch2 * sr + pitch1 * roll1 * cr - mixed * cr + psi1 * cp * roll1 * sr,
            ),
            axis=-1,
        )

        w_eh_v = down(C_hv, w_eh_h)
        w_ev = w_eh_v + w_hv
        wdot_ev = down(C_hv, wdot_eh_h) + cross(w_eh_v, w_hv) + wdot_hv
        w_ie_v = down(C_hv, w_ie_h)
        lever = np.broadcast_to(point, w_ev.shape)
        swing = cross(w_ev, lever)
        v_v = down(C_hv, v_h) + swing
        accel_v = down(C_hv, vdot_h + cross(w_eh_h, v_h)) + cross(wdot_ev, lever) + cross(w_ev, swing)
        r_e = r_axle + up(C_eh, up(C_hv, lever))
        v_point_e = up(C_eh, up(C_hv, v_v))
        lat_p, lon_p, height_p = ellipsoid.to_geodetic(r_e)
        C_ep = ellipsoid.axes_eg(lat_p, lon_p)
        g_north, g_up = ellipsoid.gravity(lat_p, height_p)
        gravity_e = g_north[:, None] * C_ep[:, :, 1] + g_up[:, None] * C_ep[:, :, 2]
        f_v = accel_v + 2.0 * cross(w_ie_v, v_v) - down(C_hv, down(C_eh, gravity_e))
        return Motion(
            lat=lat_p,
            lon=lon_p,
            height=height_p,
            v_g=down(C_ep, v_point_e),
            # against the local axes of the point itself, which differ from the axle's a metre away
            C_gv=np.swapaxes(C_ep, 1, 2) @ C_eh @ C_hv,
            w_iv_v=w_ie_v + w_ev,
            f_v=f_v,
            r_e=r_e,
            v_e=v_point_e,
        )


def roll_per_accel(deg_per_g: float) -> float:
    """Lean in rad per m/s^2 from degrees per g."""
    return math.radians(deg_per_g) / G0
