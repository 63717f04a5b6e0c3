"""Truth of an IMU on a swaying base: rotations about a point fixed to the Earth, in closed form."""

from __future__ import annotations

import math

import numpy as np

from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_euler, dcm_from_quat, quat_from_dcm, rotvec_from_quat
from nav.types import ImuSample

G = 9.80665
DEG_PER_H = math.pi / 648000.0
LAT, LON, HEIGHT = math.radians(34.18), math.radians(108.9), 400.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class Base:
    """Heading, pitch and roll swing by ``swing`` (3, k) rad at ``rates`` (k,) rad/s; IMU at ``lever`` m.

    Phases are random, so the sway is under way when it is first looked at.
    """

    def __init__(self, rng, swing, rates, lever, attitude=None):
        self.mean = np.append(rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.1, 0.1, 2))
        if attitude is not None:
            self.mean = np.asarray(attitude)
        self.swing, self.rates = np.asarray(swing), np.asarray(rates)
        self.phase = rng.uniform(0.0, 2.0 * math.pi, self.swing.shape)
        self.lever = np.asarray(lever)

    def angles(self, t):
        wave = self.rates * t[..., None, None] + self.phase
        return (
            self.mean + (self.swing * np.sin(wave)).sum(-1),
            (self.swing * self.rates * np.cos(wave)).sum(-1),
            -(self.swing * self.rates**2 * np.sin(wave)).sum(-1),
        )

    def C_gb(self, t):
        a = self.angles(np.asarray(t, float))[0]
        return dcm_from_euler(a[..., 0], a[..., 1], a[..., 2])

    def _rate(self, t):
        """w_gb_b: about down, then right, then forward."""
        a, d, _ = self.angles(t)
        zero = np.zeros(t.shape)
        down = np.stack([zero, zero, -d[..., 0]], -1)
        right = np.stack([d[..., 1], zero, zero], -1)
        ahead = np.stack([zero, d[..., 2], zero], -1)
        Rx, Ry = dcm_from_euler(zero, a[..., 1], zero), dcm_from_euler(zero, zero, a[..., 2])
        return np.einsum("...ji,...j", Ry, np.einsum("...ji,...j", Rx, down) + right) + ahead

    def velocity(self, t):
        """(3,) m/s east, north, up of the IMU."""
        t = np.asarray(t, float)
        return np.einsum("...ij,...j", self.C_gb(t), np.cross(self._rate(t), self.lever))

    def increments(self, n, dt):
        t = dt * (np.arange(n)[:, None] + 0.5 * (_NODES + 1.0))
        C, w = self.C_gb(t), self._rate(t)
        h = 1e-4
        dw = (self._rate(t + h) - self._rate(t - h)) / (2.0 * h)
        v = np.cross(w, self.lever)
        w_ie = np.einsum("...ji,j", C, earth_rate_g(LAT))
        force = (
            np.cross(dw, self.lever)
            + np.cross(w + 2.0 * w_ie, v)
            - np.einsum("...ji,j", C, gravity_g(LAT, HEIGHT))
        )
        k = 0.5 * dt * _WEIGHTS
        return np.einsum("k,nkj->nj", k, w + w_ie), np.einsum("k,nkj->nj", k, force)


def sensed(rng, config, dtheta, dv, dt, eps=None, nabla=None):
    """Inertial samples with the errors of ``config``, and the biases."""
    eps = config.gyro_bias * rng.standard_normal(3) if eps is None else eps
    nabla = config.accel_bias * rng.standard_normal(3) if nabla is None else nabla
    root, step = math.sqrt(dt), round(dt * 1e9)
    dtheta = dtheta + eps * dt + config.angle_random_walk * root * rng.standard_normal(dtheta.shape)
    dv = dv + nabla * dt + config.velocity_random_walk * root * rng.standard_normal(dv.shape)
    samples = [ImuSample((k + 1) * step, dt, dtheta[k], dv[k], "imu") for k in range(len(dtheta))]
    return samples, eps, nabla


def misalignment(C_gb, q_gb):
    """phi (3,) with true C_gb = (I + [phi x]) estimated C_gb."""
    return rotvec_from_quat(quat_from_dcm(C_gb @ dcm_from_quat(q_gb).T))
