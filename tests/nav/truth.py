"""A drive in closed form: a figure of eight in a plane that is fixed to the Earth.

Position and attitude are written down with their derivatives; inertial increments are Gauss-Legendre
integrals of the exact rates. Nothing here is integrated step by step, and of nav only Earth model and
rotations are used.
"""

from __future__ import annotations

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.align.types import NavInit
from nav.types import FixType, GnssFix, ImuSample, S, Solution

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


class Drive:
    """``radius`` m and ``rate`` rad/s of the eight, ``sway`` and ``nod`` rad of roll and pitch."""

    def __init__(
        self, lat=0.8, lon=0.2, height=300.0, radius=150.0, rate=0.08, sway=0.03, nod=0.03, C_vb=None
    ):
        self.C_e0 = earth.position_matrix(lat, lon)
        self.r_e0 = np.array(earth.geodetic_to_xyz(lat, lon, height))
        self.radius, self.rate, self.sway, self.nod = radius, rate, sway, nod
        self.C_vb = np.eye(3) if C_vb is None else C_vb
        self.w_ie_e = np.array([0.0, 0.0, earth.EARTH_RATE])

    def _plane(self, t):
        R, w = self.radius, self.rate
        s1, c1, s2, c2 = np.sin(w * t), np.cos(w * t), np.sin(2 * w * t), np.cos(2 * w * t)
        zero = np.zeros_like(t)
        p = np.stack([R * s1, 0.5 * R * s2, zero], axis=-1)
        v = np.stack([R * w * c1, R * w * c2, zero], axis=-1)
        a = np.stack([-R * w * w * s1, -2 * R * w * w * s2, zero], axis=-1)
        return p, v, a

    def position(self, t):
        return self.r_e0 + self._plane(t)[0] @ self.C_e0.T

    def velocity_e(self, t):
        return self._plane(t)[1] @ self.C_e0.T

    def _angles(self, t):
        """Heading, pitch, roll and their rates."""
        if self.radius == 0.0:
            heading, turn = np.full_like(t, 0.7), np.zeros_like(t)
        else:
            _, v, a = self._plane(t)
            heading = np.arctan2(v[..., 0], v[..., 1])
            turn = (a[..., 0] * v[..., 1] - v[..., 0] * a[..., 1]) / (v[..., 0] ** 2 + v[..., 1] ** 2)
        k, m = self.sway, self.nod
        return (
            (heading, m * np.sin(0.9 * t), k * np.cos(0.7 * t)),
            (turn, 0.9 * m * np.cos(0.9 * t), -0.7 * k * np.sin(0.7 * t)),
        )

    def C_eb(self, t):
        (h, p, r), _ = self._angles(t)
        return self.C_e0 @ rot.dcm_from_euler(h, p, r) @ self.C_vb

    def rate_ib(self, t):
        (_, p, r), (dh, dp, dr) = self._angles(t)
        # C_0v = Rz(-h) Rx(p) Ry(r): rates about down, then right, then forward, brought into v
        zero = np.zeros_like(t)
        down = np.stack([zero, zero, -dh], axis=-1)
        right = np.stack([dp, zero, zero], axis=-1)
        ahead = np.stack([zero, dr, zero], axis=-1)
        Rx, Ry = rot.dcm_from_euler(zero, p, zero), rot.dcm_from_euler(zero, zero, r)
        w_v = np.einsum("...ji,...j", Ry, np.einsum("...ji,...j", Rx, down) + right) + ahead
        return w_v @ self.C_vb + np.einsum("...ji,j", self.C_eb(t), self.w_ie_e)

    def force(self, t):
        p, v, a = self._plane(t)
        r = self.r_e0 + p @ self.C_e0.T
        v_e, a_e = v @ self.C_e0.T, a @ self.C_e0.T
        g_e = np.empty_like(r)
        for i in np.ndindex(t.shape):
            lat, lon, h = earth.xyz_to_geodetic(*r[i])
            g_e[i] = earth.position_matrix(lat, lon) @ earth.gravity_g(lat, h)
        f_e = a_e + 2.0 * np.cross(self.w_ie_e, v_e) - g_e
        return np.einsum("...ji,...j", self.C_eb(t), f_e)

    def increments(self, count, dt, start=0.0):
        """dtheta and dv (count, 3) of ``count`` samples from ``start``."""
        t = start + dt * (np.arange(count)[:, None] + 0.5 * (_NODES + 1.0))
        w = 0.5 * dt * _WEIGHTS
        return np.einsum("k,ikj->ij", w, self.rate_ib(t)), np.einsum("k,ikj->ij", w, self.force(t))

    def geodetic(self, t):
        lat, lon, h = earth.xyz_to_geodetic(*self.position(np.array(t)))
        C_eg = earth.position_matrix(lat, lon)
        return lat, lon, h, C_eg.T @ self.velocity_e(np.array(t)), C_eg.T @ self.C_eb(np.array(t))


def samples(dtheta, dv, dt, start_ns=0, device="imu"):
    """Inertial samples of increments, the first ending one interval after ``start_ns``."""
    step = round(dt * 1e9)
    return [ImuSample(start_ns + step * (i + 1), dt, dtheta[i], dv[i], device) for i in range(len(dtheta))]


def hand_over(drive, t=0.0, error=None, sigmas=None):
    """`NavInit` at ``t`` s with errors (15,) of position, velocity, phi, gyro and accelerometer bias.

    Errors are east, north, up of the true place, computed minus true; ``sigmas`` (15,), the same east and
    north, go into the covariances.
    """
    error = np.zeros(15) if error is None else np.asarray(error)
    s = np.array([0.01] * 3 + [0.01] * 3 + [1e-4] * 3 + [1e-7] * 3 + [1e-5] * 3) if sigmas is None else sigmas
    lat, lon, h, v_g, C_gb = drive.geodetic(t)
    r_e = drive.position(np.array(t)) + earth.position_matrix(lat, lon) @ error[0:3]
    true = lat, lon
    lat, lon, h = earth.xyz_to_geodetic(*r_e)
    # from the true place to the computed one, level stays level; next to a pole east is elsewhere
    turn = rot.dcm_from_quat(rot.quat_from_rotvec([0.0, 0.0, -earth.convergence(*true, lat, lon)]))
    C = turn @ rot.dcm_from_quat(rot.quat_from_rotvec(-error[6:9])) @ C_gb
    return NavInit(
        round(t * 1e9),
        lat,
        lon,
        h,
        turn @ (v_g + error[3:6]),
        rot.quat_from_dcm(C),
        np.diag(s[6:9] ** 2),
        s[3:6],
        s[0:3],
        error[9:12],
        error[12:15],
        s[9:12],
        s[12:15],
    )


def fix(drive, t, lever=(0.0, 0.0, 0.0), sigma=(1.0, 1.0, 2.0), sigma_v=(0.1, 0.1, 0.1), rng=None):
    """GNSS fix of the antenna at ``lever`` (m, in b) at ``t`` s, with noise from ``rng`` where given."""
    t_ = np.array(t)
    C_eb, lever = drive.C_eb(t_), np.asarray(lever)
    r_e = drive.position(t_) + C_eb @ lever
    w = drive.rate_ib(t_) - C_eb.T @ drive.w_ie_e
    v_e = drive.velocity_e(t_) + C_eb @ np.cross(w, lever)
    lat, lon, h = earth.xyz_to_geodetic(*r_e)
    sigma, sigma_v = np.array(sigma), np.array(sigma_v)
    if rng is not None:
        C_eg = earth.position_matrix(lat, lon)
        lat, lon, h = earth.xyz_to_geodetic(*(r_e + C_eg @ (sigma * rng.normal(size=3))))
    # a receiver says its velocity along east and north of where it thinks it is
    v_g = earth.position_matrix(lat, lon).T @ v_e
    if rng is not None:
        v_g = v_g + sigma_v * rng.normal(size=3)
    return GnssFix(round(t * 1e9), lat, lon, h, sigma, v_g, sigma_v, FixType.FIX_3D, "gnss")


def rolled(drive, t0, t1):
    """Distance along v's forward axis between two times, m; the odometer point is the IMU."""
    t = t0 + (t1 - t0) * 0.5 * (_NODES + 1.0)
    v_b = np.einsum("...ji,...j", drive.C_eb(t), drive.velocity_e(t))
    return float(0.5 * (t1 - t0) * _WEIGHTS @ (v_b @ drive.C_vb.T)[:, 1])


def play(navigator, inertial, aids=()):
    """Feed samples; ``aids`` are (arrival in s, sample). Returns solutions and the other events."""
    waiting = sorted(aids, key=lambda a: a[0])
    solutions, events = [], []
    k = 0
    for s in inertial:
        while k < len(waiting) and waiting[k][0] <= s.t_ns * 1e-9:
            events += navigator.step(waiting[k][1])
            k += 1
        for e in navigator.step(s):
            (solutions if isinstance(e, Solution) else events).append(e)
    return solutions, events


def error_of(solution, drive):
    """Errors (9,) east, north, up of position m, velocity m/s, phi rad of a solution of the IMU point."""
    t = solution.t_ns * 1e-9
    lat, lon, _, v_g, C_gb = drive.geodetic(t)
    r_e = np.array(earth.geodetic_to_xyz(*solution.state[:3]))
    dp = earth.position_matrix(lat, lon).T @ (r_e - drive.position(np.array(t)))
    C_gv = rot.dcm_from_quat(solution.state[S.Q])
    phi = -rot.rotvec_from_quat(rot.quat_from_dcm(C_gv @ drive.C_vb @ C_gb.T))
    return np.concatenate([dp, solution.v_g - v_g, phi])
