"""A drive in closed form: a figure of eight in a plane that is fixed to the Earth.

Position and attitude are written down with their derivatives; inertial increments are Gauss-Legendre
integrals of the exact rates. Nothing here is integrated step by step, and of nav only Earth model and
rotations are used.
"""

from __future__ import annotations

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.types import ImuSample

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
