"""The navigation kernel at rest: with an error of one sensor, with noise, and at an equilibrium of errors."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from nav import earth
from nav import rotation as rot
from nav.errors.geographic import phi_dynamics, sensor_inputs
from nav.errors.response import SOURCES, Sphere
from nav.filter.states import PHI, POSITION, VELOCITY
from nav.strapdown.control import control
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_Q, X_V, integrate

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

GAINS: Final = (2.0 / 30.0, 1.0 / 900.0, 0.0)
"""Height channel, critically damped with 30 s: it keeps the height, as the closed forms want it."""
ORDER: Final = (3, 4, 0, 1, 6, 7, 8)
"""The seven states of `nav.errors.response` among the nine of `nav.errors.geographic`."""
LAT: Final = math.radians(40.0)
MIDDLE: Final = math.radians(45.0)
"""Where the text takes its numbers for eqs. (2-95) and (2-104)."""
DAY: Final = 86_400
EVERY: Final = 600
"""Seconds between the moments compared."""
SHOWN: Final = 5 * 3600
"""The moment whose numbers are printed, s; a row is judged by all of the day."""
DEG_PER_H: Final = math.radians(1.0) / 3600.0
DRIFT: Final = 0.01 * DEG_PER_H
UG: Final = 9.80665e-6
BIAS: Final = 100.0 * UG
AMOUNT: Final = np.array([DRIFT] * 3 + [BIAS] * 2)
ARCMIN: Final = math.radians(1.0) / 60.0
ARCSEC: Final = ARCMIN / 60.0
NOISE: Final = 10.0 * UG
"""Accelerometer noise, m/s^2 / sqrt(Hz), two-sided."""
RUNS: Final = 1000
EIGHTH: Final = 630
"""An eighth of Schuler's period, s, where the misprint of (2-98) shows most."""
NAMES: Final = dict(zip(SOURCES, ("gyro E", "gyro N", "gyro U", "accel E", "accel N"), strict=True))


class Rest:
    """A vehicle at rest at ``lat`` (rad), height zero, axes east, north, up, navigated by the kernel.

    An update takes two samples; there are ``rate`` samples a second.
    """

    def __init__(self, lat: float, rate: int = 4) -> None:
        self.lat = lat
        self.rate = rate
        self.lon = 0.2
        self.u = control(height=0.0, height_gains=GAINS)
        self.sample = np.concatenate([earth.earth_rate_g(lat), -earth.gravity_g(lat, 0.0)]) / rate
        r_m, r_n = earth.radii(math.sin(lat))
        g = earth.normal_gravity(math.sin(lat), 0.0)
        self.gravity = g
        self.sphere = Sphere(g, math.sqrt(r_m * r_n))

    def start(self, phi: Vector | None = None) -> Vector:
        """A state at the truth, but for misalignments ``phi`` (3,), rad."""
        x = np.zeros(X_HEAD)
        x[X_Q : X_Q + 4] = rot.quat_from_rotvec(-(np.zeros(3) if phi is None else phi))
        x[X_C : X_C + 9] = earth.position_matrix(self.lat, self.lon).ravel()
        return x

    def navigate(self, error: Vector, seconds: int, every: int, phi: Vector | None = None) -> Matrix:
        """Errors (rows, 9) of `nav.errors.geographic` every ``every`` seconds of navigation.

        ``error`` (6,) is what the gyros (rad/s) and accelerometers (m/s^2) read too much.
        """
        samples = np.tile(self.sample + error / self.rate, (self.rate * seconds, 1))
        out = self.run(samples, every, phi)
        return np.array([self.error_of(x) for x in out])

    def run(self, samples: Matrix, every: int, phi: Vector | None = None) -> Matrix:
        """States (rows, X_HEAD) every ``every`` seconds through ``samples`` (M, 6)."""
        out = np.empty((len(samples) // (every * self.rate), X_HEAD))
        integrate(self.start(phi), samples, 1.0 / self.rate, 2, self.u, every * self.rate // 2, out)
        return out

    def error_of(self, x: Vector) -> Vector:
        """Errors (9,) of a state of the kernel, computed minus true, by definition."""
        lat, lon, _ = earth.position_angles(x[X_C : X_C + 9].reshape(3, 3))
        C_gn = earth.position_matrix(lat, lon).T @ x[X_C : X_C + 9].reshape(3, 3)
        e = np.empty(9)
        e[POSITION] = lat - self.lat, lon - self.lon, x[X_H]
        e[VELOCITY] = C_gn @ x[X_V : X_V + 3]
        C_gb = C_gn @ rot.dcm_from_quat(x[X_Q : X_Q + 4])
        e[PHI] = -rot.rotvec_from_quat(rot.quat_from_dcm(C_gb))
        return e

    def model(self) -> tuple[Matrix, Matrix]:
        """F (9, 9) and G (9, 6) of the errors on the ellipsoid, with the height channel."""
        F = phi_dynamics(self.lat, 0.0, np.zeros(3), -earth.gravity_g(self.lat, 0.0))
        height, climb = POSITION.start + 2, VELOCITY.start + 2
        F[height, height] -= GAINS[0]
        F[climb, height] -= GAINS[1]
        return F, sensor_inputs(np.eye(3))


class Mixture(NamedTuple):
    """Drifts of a platform east, north, up (rad/s), accelerometer errors (m/s^2) and misalignments (rad)."""

    drift: tuple[float, float, float]
    accel: tuple[float, float]
    phi: tuple[float, float, float]

    def inputs(self) -> tuple[Vector, Vector]:
        """What strapdown sensors read too much (6,), and the states (9,) at the start."""
        start = np.zeros(9)
        start[PHI] = self.phi
        return np.array([*(-one for one in self.drift), *self.accel, 0.0]), start


CURVES: Final = {
    "a": Mixture(
        (0.007 * DEG_PER_H, 0.007 * DEG_PER_H, 0.01 * DEG_PER_H),
        (100.0 * UG, 100.0 * UG),
        (5.0 * ARCSEC, 5.0 * ARCSEC, 120.0 * ARCSEC),
    ),
    "b": Mixture(
        (0.02 * DEG_PER_H, 0.02 * DEG_PER_H, 0.05 * DEG_PER_H),
        (0.0, 0.0),
        (10.0 * ARCSEC, 10.0 * ARCSEC, 30.0 * ARCSEC),
    ),
}
"""The errors named below figure 2-26, whose curves have no numbers and no latitude: 45 deg here."""


def exponential(F: Matrix, b: Vector, step: float, rows: int, start: Vector | None = None) -> Matrix:
    """States (rows, n) of ``dx/dt = F x + b`` every ``step`` seconds, from zero or ``start``."""
    n = len(b)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = F, b
    Phi = expm(M * step)
    x, out = np.zeros(n) if start is None else start, np.empty((rows, n))
    for k in range(rows):
        x = Phi[:n, :n] @ x + Phi[:n, n]
        out[k] = x
    return out


def noisy_velocities(rest: Rest, density: float, runs: int, seconds: int, every: int, seed: int) -> Matrix:
    """East velocity errors (runs, rows), m/s, of the kernel with white noise of the east accelerometer.

    ``density`` is two-sided, (m/s^2)^2 s.
    """
    rng = np.random.default_rng(seed)
    count = rest.rate * seconds
    samples = np.tile(rest.sample, (count, 1))
    velocities = np.empty((runs, seconds // every))
    for k in range(runs):
        samples[:, 3] = rest.sample[3] + math.sqrt(density / rest.rate) * rng.standard_normal(count)
        x = rest.run(samples, every)
        # east is the polar axis times up
        px, py = x[:, X_C + 6], x[:, X_C + 7]
        velocities[k] = (py * x[:, X_V] - px * x[:, X_V + 1]) / np.hypot(px, py)
    return velocities
