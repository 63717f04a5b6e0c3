"""A wing or a hull that bends under the unit it carries: random small rotations of the unit on its mounting.

Each motion is a second-order Markov process, x'' + 2 zeta w x' + w^2 x = white noise: critically damped it
is the flexure of the transfer-alignment literature, with the autocorrelation sigma^2 exp(-w|t|) (1 + w|t|),
lightly damped a vibration. Values and rates are drawn exactly, at the ends of steps of `STEP_NS`; between
these the motion is the cubic that has them, so that it is a smooth function of time, and what the unit feels
follows from it without noise of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from virtual_bus import ellipsoid
from virtual_bus.axes import cross, quaternion, up
from virtual_bus.manoeuvres import Profile
from virtual_bus.truth import Times, Trajectory, TruthState, Vehicle

Array = NDArray[np.float64]

STEP_NS: Final = 2_000_000
_CHUNK: Final = 2048  # steps drawn at a time, at least
_TO_1_E: Final = 2.146193220620583  # (1 + x) exp(-x) = exp(-1)


@dataclass(frozen=True, slots=True)
class Markov:
    """A second-order Markov process: standard deviation, natural rate (rad/s), damping ratio."""

    sigma: float
    rate: float
    damping: float = 1.0

    @classmethod
    def correlated(cls, sigma: float, seconds: float) -> Markov:
        """Critically damped; its autocorrelation has fallen to 1/e after so long."""
        return cls(sigma, _TO_1_E / seconds)

    def transition(self, dt: float) -> tuple[Array, Array]:
        """What ``dt`` seconds make of value and rate (2, 2), and the covariance (2, 2) of what they add."""
        F = np.array([[0.0, 1.0], [-(self.rate**2), -2.0 * self.damping * self.rate]])
        A = np.asarray(expm(F * dt))
        steady = np.diag([self.sigma**2, (self.sigma * self.rate) ** 2])
        return A, steady - A @ steady @ A.T


class _Drawn:
    """One process drawn on from its steady state, step by step."""

    def __init__(self, process: Markov, rng: np.random.Generator, step_ns: int) -> None:
        self._A, Q = process.transition(step_ns * 1e-9)
        values, vectors = np.linalg.eigh(Q)
        self._root = vectors * np.sqrt(np.maximum(values, 0.0))
        self._rng = rng
        self.last = process.sigma * np.array([1.0, process.rate]) * rng.standard_normal(2)
        """Value and rate that it has come to."""

    def more(self, n: int) -> Array:
        """Value and rate (n, 2) at the ends of the next ``n`` steps."""
        (a, b), (c, d) = self._A
        w = self._rng.standard_normal((n, 2)) @ self._root.T
        w[0] += self._A @ self.last
        # the two rows of (1 - A z^-1)^-1, which have their poles in common
        poles = np.array([1.0, -(a + d), a * d - b * c])
        x = lfilter([1.0, -d], poles, w[:, 0]) + lfilter([0.0, b], poles, w[:, 1])
        v = lfilter([0.0, c], poles, w[:, 0]) + lfilter([1.0, -a], poles, w[:, 1])
        self.last = np.array([x[-1], v[-1]])
        return np.stack((x, v), axis=1)


class Wandering:
    """Some random functions of time, each the sum of its ``processes``; ``rng`` draws them."""

    def __init__(
        self, processes: Sequence[Sequence[Markov]], rng: np.random.Generator, step_ns: int = STEP_NS
    ) -> None:
        self._step_ns = step_ns
        self._drawn = [[_Drawn(process, rng, step_ns) for process in axis] for axis in processes]
        # values and rates (n, 2, k) at the ends of steps
        self._known = np.zeros((1, 2, len(processes)))
        for k, axis in enumerate(self._drawn):
            for each in axis:
                self._known[0, :, k] += each.last

    def at(self, t_ns: Times) -> tuple[Array, Array]:
        """Values (n, k) and their rates (n, k) at ``t_ns`` (n,) since the start."""
        t_ns = np.maximum(t_ns, 0)
        step_ns = self._step_ns
        place = t_ns // step_ns
        while len(self._known) < place.max() + 2:
            more = np.zeros((max(_CHUNK, len(self._known)), 2, len(self._drawn)))
            for k, axis in enumerate(self._drawn):
                for each in axis:
                    more[:, :, k] += each.more(len(more))
            self._known = np.concatenate((self._known, more))
        h = step_ns * 1e-9
        s = ((t_ns - place * step_ns) / step_ns)[:, None]
        (x0, v0), (x1, v1) = (self._known[place + k].transpose(1, 0, 2) for k in (0, 1))
        rise, v0, v1 = x1 - x0, h * v0, h * v1
        x = x0 + s * (v0 + s * (3.0 * rise - 2.0 * v0 - v1 + s * (v0 + v1 - 2.0 * rise)))
        slope = v0 + s * (6.0 * rise - 4.0 * v0 - 2.0 * v1 + 3.0 * s * (v0 + v1 - 2.0 * rise))
        return x, slope / h


def turned(angles: Array, v: Array) -> Array:
    """``v`` (n, 3) seen from axes that are turned by ``angles`` (n, 3), rotation vectors of mrad, to 1e-9."""
    once = cross(v, angles)
    return np.asarray(v + once + 0.5 * cross(once, angles))


class Flexed(Trajectory):
    """A trajectory whose IMU turns by ``flexure`` about a point ``arm`` (3,) m before it, in vehicle axes.

    Angles are about the axes of the IMU as it is mounted; so are those of `increments`, while `motion` stays
    that of the rigid vehicle.
    """

    def __init__(
        self,
        profile: Profile,
        vehicle: Vehicle,
        lat: float,
        lon: float,
        height: float,
        flexure: Wandering,
        arm: Array,
    ) -> None:
        super().__init__(profile, vehicle, lat, lon, height)
        self.flexure = flexure
        self._arm_b = vehicle.C_vb.T @ arm

    def _swing(self, angles: Array, rates: Array, w_b: Array) -> tuple[Array, Array]:
        """Displacement (n, 3) m of the IMU in its mounting's axes, and its velocity (n, 3) as these turn."""
        arm = np.broadcast_to(self._arm_b, angles.shape)
        shift = cross(angles, arm)
        return shift, cross(rates, arm) + cross(w_b, shift)

    def increments(self, t_ns: Times) -> tuple[Array, Array]:
        """Dtheta (n-1, 3) rad and dv (n-1, 3) m/s between the times ``t_ns`` (n,), axes of the bent IMU.

        Those of the rigid vehicle are turned at the middle of their intervals, and what the rotation adds in
        the displacement is left to first order; the gravity gradient over it is left out.
        """
        dtheta, dv = super().increments(t_ns)
        angles, rates = self.flexure.at(t_ns)
        middle = self.flexure.at((t_ns[:-1] + t_ns[1:]) // 2)[0]
        w_b = super().motion(t_ns).w_iv_v @ self.vehicle.C_vb
        u = self._swing(angles, rates, w_b)[1]
        dv = dv + np.diff(u, axis=0) + cross(dtheta, 0.5 * (u[1:] + u[:-1]))
        bent = np.diff(angles, axis=0)
        return turned(middle, dtheta) + bent - 0.5 * cross(middle, bent), turned(middle, dv)

    def solve(self, until_ns: int) -> None:
        """See `Trajectory.solve`."""
        super().solve(until_ns)
        self.flexure.at(np.array([until_ns]))

    def state(self, t_ns: int, point: Array | None = None) -> TruthState:
        """Truth at one instant, that of the bent IMU or of ``point`` of the rigid vehicle.

        ``q_gv`` is the rigid vehicle's, ``q_gb`` the bent IMU's. What the IMU feels is taken from increments
        of a millisecond around the instant.
        """
        t = np.array([t_ns], np.int64)
        m = super().motion(t)
        C_gb0 = m.C_gv @ self.vehicle.C_vb
        angles, rates = self.flexure.at(t)
        C_b0b = np.concatenate([turned(angles, axis) for axis in np.eye(3)[:, None, :]])
        around = np.clip(np.array([t_ns - 500_000, t_ns + 500_000]), 0, self.profile.end_ns)
        dtheta, dv = self.increments(around)
        seconds = float(around[1] - around[0]) * 1e-9
        felt = {"q_gb": quaternion(C_gb0[0] @ C_b0b), "w_ib_b": dtheta[0] / seconds, "f_b": dv[0] / seconds}
        rigid = super().state(t_ns, point)
        if point is None:
            shift, u = self._swing(angles, rates, m.w_iv_v @ self.vehicle.C_vb)
            r_e = m.r_e + up(ellipsoid.axes_eg(m.lat, m.lon), up(C_gb0, shift))
            lat, lon, height = (float(x[0]) for x in ellipsoid.to_geodetic(r_e))
            rigid = replace(rigid, lat=lat, lon=lon, height=height, v_g=rigid.v_g + up(C_gb0, u)[0])
        return replace(rigid, **felt)
