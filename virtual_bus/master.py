"""A master navigator: inertial, good, and wrong in the way inertial navigators are.

Its level errors obey the linear error equations of a free inertial navigator along the true motion
("Inertial navigation" textbook, eqs. (2-84), (2-87), (2-88), strapdown sign): they swing with Schuler's
period, and a curve flown with a wrong heading makes a wrong velocity, as in a real one. Its height is
held by a barometer: a slow second-order process.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from virtual_bus import ellipsoid
from virtual_bus.axes import cross, up
from virtual_bus.ellipsoid import OMEGA
from virtual_bus.flexure import Markov, Wandering, turned
from virtual_bus.grades import DEG_PER_H, UG
from virtual_bus.tables import MasterTable
from virtual_bus.truth import Times, Trajectory

Array = NDArray[np.float64]

STEP_NS: Final = 100_000_000
HEIGHT_S: Final = 200.0  # over which its height's error stays
_CHUNK: Final = 256  # steps solved at a time
# Simpson's rule over a step
_PLACES: Final = np.array([0, STEP_NS // 2, STEP_NS])
_WEIGHTS: Final = np.array([1.0, 4.0, 1.0]) / 6.0
_PHI, _V, _P = slice(0, 3), slice(3, 5), slice(5, 7)


@dataclass(frozen=True, slots=True)
class MasterErrors:
    """One sigma of a master's lasting errors when the scenario begins, SI.

    ``tilt``, ``heading`` rad, ``velocity`` m/s and ``position`` m an axis, ``height`` m; ``gyro`` rad/s and
    ``accel`` m/s^2 stay.
    """

    tilt: float
    heading: float
    velocity: float
    position: float
    height: float
    gyro: float
    accel: float


@dataclass(frozen=True, slots=True)
class MasterNoise:
    """One sigma of the noise of one message: m, m/s, rad, rad/s, m/s^2."""

    position: float
    velocity: float
    attitude: float
    rate: float
    force: float


@dataclass(frozen=True, slots=True)
class MasterBlock:
    """What a master says at n times: (n,), (n, 3), ``C_ga`` (n, 3, 3); a is the vehicle's axes."""

    lat: Array
    lon: Array
    height: Array
    v_g: Array
    C_ga: Array
    w_ia_a: Array
    f_a: Array


class Master:
    """The master at ``point`` (3,) m of a vehicle, in vehicle axes."""

    def __init__(
        self,
        trajectory: Trajectory,
        point: Array,
        errors: MasterErrors,
        noise: MasterNoise,
        rng: np.random.Generator,
    ) -> None:
        self._trajectory = trajectory
        self._point = point
        self._noise = noise
        self._rng = rng
        size = [errors.tilt] * 2 + [errors.heading] + [errors.velocity] * 2 + [errors.position] * 2
        # errors (k, 7), true minus what it computes for phi, computed minus true for the others
        self._known = (np.array(size) * rng.standard_normal(7))[None]
        self.gyro = errors.gyro * rng.standard_normal(3)
        self.accel = errors.accel * rng.standard_normal(3)
        slow = Markov.correlated(errors.height, HEIGHT_S)
        self._height = Wandering([[slow]], rng, 10 * STEP_NS)

    def errors(self, t_ns: Times) -> tuple[Array, Array, Array]:
        """Phi (n, 3) rad, errors of velocity (n, 3) m/s and position (n, 3) m, each east, north, up.

        True C_ga = (I + [phi x]) that of the master; the others are the master's minus the true.
        """
        place = np.clip(t_ns, 0, None) / STEP_NS
        while len(self._known) < place.max() + 2:
            self._solve()
        grid = np.arange(len(self._known))
        x = np.stack([np.interp(place, grid, column) for column in self._known.T], axis=1)
        up_m, up_m_s = self._height.at(t_ns)
        return x[:, _PHI], np.concatenate((x[:, _V], up_m_s), 1), np.concatenate((x[:, _P], up_m), 1)

    def block(self, t_ns: Times) -> MasterBlock:
        """What it says of the times ``t_ns`` (n,)."""
        m = self._trajectory.motion(t_ns, self._point)
        phi, dv, dp = self.errors(t_ns)
        size, rng = (len(t_ns), 3), self._rng
        C_eg = ellipsoid.axes_eg(m.lat, m.lon)
        shift = dp + self._noise.position * rng.standard_normal(size)
        lat, lon, height = ellipsoid.to_geodetic(m.r_e + up(C_eg, shift))
        # phi is small: what it computes are the true axes turned by minus that, column by column
        wrong = phi + self._noise.attitude * rng.standard_normal(size)
        C_ga = np.stack([turned(wrong, m.C_gv[:, :, k]) for k in range(3)], axis=2)
        return MasterBlock(
            lat=lat,
            lon=lon,
            height=height,
            v_g=m.v_g + dv + self._noise.velocity * rng.standard_normal(size),
            C_ga=C_ga,
            w_ia_a=m.w_iv_v + self.gyro + self._noise.rate * rng.standard_normal(size),
            f_a=m.f_v + self.accel + self._noise.force * rng.standard_normal(size),
        )

    def _solve(self) -> None:
        """Errors over the next steps: the equations' exponentials, whose coefficients are means of a step."""
        first = len(self._known) - 1
        t = STEP_NS * (first + np.arange(_CHUNK))[:, None] + _PLACES
        m = self._trajectory.motion(t.ravel(), self._point)
        F, u = self._equations(m.lat, m.height, m.v_g, up(m.C_gv, m.f_v))
        u[:, _PHI] -= up(m.C_gv, np.broadcast_to(self.gyro, m.v_g.shape))
        u[:, _V] += up(m.C_gv, np.broadcast_to(self.accel, m.v_g.shape))[:, :2]
        h = STEP_NS * 1e-9
        F = h * np.einsum("k,nkij->nij", _WEIGHTS, F.reshape(-1, 3, 7, 7))
        u = h * np.einsum("k,nki->ni", _WEIGHTS, u.reshape(-1, 3, 7))
        one = np.eye(7)
        # of a tenth of a second: f h is 1 m/s per rad, the rest thousandths, so three terms are all there is
        A = one + F @ (one + F @ (one + F / 3.0) / 2.0)
        B = np.einsum("nij,nj->ni", one + F @ (one + F / 3.0) / 2.0, u)
        x = np.empty((_CHUNK, 7))
        last = self._known[-1]
        for k in range(_CHUNK):
            last = x[k] = A[k] @ last + B[k]
        self._known = np.concatenate((self._known, x))

    @staticmethod
    def _equations(lat: Array, height: Array, v_g: Array, f_g: Array) -> tuple[Array, Array]:
        """Coefficients (n, 7, 7) of phi, level velocity and position (m), and a place (n, 7) for inputs."""
        r_m, r_n = ellipsoid.radii(np.sin(lat))
        r_m, r_n = r_m + height, r_n + height
        tan, sin, cos = np.tan(lat), np.sin(lat), np.cos(lat)
        zero = np.zeros_like(lat)
        w_ie = OMEGA * np.stack((zero, cos, sin), axis=1)
        w_en = np.stack((-v_g[:, 1] / r_m, v_g[:, 0] / r_n, v_g[:, 0] / r_n * tan), axis=1)
        F = np.zeros((len(lat), 7, 7))
        # what errors of latitude and velocity make of both rates, (n, 3)
        ie_north = OMEGA / r_m[:, None] * np.stack((zero, -sin, cos), axis=1)
        en_north = np.stack((zero, zero, v_g[:, 0] / (r_n * r_m * cos**2)), axis=1)
        en_ve = np.stack((zero, 1.0 / r_n, tan / r_n), axis=1)
        en_vn = np.stack((-1.0 / r_m, zero, zero), axis=1)
        axes = np.eye(3)
        for k in range(3):
            e = np.broadcast_to(axes[k], f_g.shape)
            F[:, _PHI, k] = -cross(w_ie + w_en, e)
            F[:, _V, k] = cross(f_g, e)[:, :2]
            if k < 2:
                rate = (en_ve, en_vn)[k]
                F[:, _PHI, 3 + k] = rate
                F[:, _V, 3 + k] = (-cross(2.0 * w_ie + w_en, e) - cross(rate, v_g))[:, :2]
        F[:, _PHI, 6] = ie_north + en_north
        F[:, _V, 6] = -cross(2.0 * ie_north + en_north, v_g)[:, :2]
        F[:, 5, 3] = F[:, 6, 4] = 1.0
        F[:, 5, 5] = -v_g[:, 1] / r_m * tan
        F[:, 5, 6] = v_g[:, 0] / r_n * tan
        return F, np.zeros((len(lat), 7))


def master_of(table: MasterTable, trajectory: Trajectory, rng: np.random.Generator) -> Master:
    """The master that a scenario's table describes, on its way."""
    errors = MasterErrors(
        tilt=1e-3 * table.tilt_mrad,
        heading=1e-3 * table.heading_mrad,
        velocity=table.velocity_m_s,
        position=table.position_m,
        height=table.height_m,
        gyro=table.gyro_deg_per_h * DEG_PER_H,
        accel=table.accel_ug * UG,
    )
    noise = MasterNoise(
        position=table.position_noise_m,
        velocity=table.velocity_noise_m_s,
        attitude=1e-3 * table.attitude_noise_mrad,
        rate=math.radians(table.rate_noise_deg_per_s),
        force=table.force_noise_m_s2,
    )
    return Master(trajectory, np.array(table.at_m), errors, noise, rng)
