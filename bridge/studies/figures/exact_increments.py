"""What ideal instruments count along a path that is known in closed form, and that path.

Everything is in Earth-fixed axes, so that nothing is special at a pole, on the date line or on the equator,
and nothing is shared with the navigator: the ellipsoid is that of the simulated bench.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from virtual_bus.ellipsoid import E2, OMEGA, A, normal_gravity

Array = NDArray[np.float64]

_PLUMB: Final = 8.08e-9
"""Bend of plumb lines, 1/s^2: Groves 2013, eq. (2.140)."""
_Z: Final = np.array([0.0, 0.0, 1.0])


def integrals(
    rates: Callable[[Array], Array], dt: float, pieces: int, samples: int, nodes: int = 16, first: int = 0
) -> Iterator[Array]:
    """Integrals of ``rates(t (n,)) -> (n, 6)`` over consecutive samples of ``dt`` seconds.

    Yields ``pieces`` arrays (samples, 6), from the piece numbered ``first`` on. In each the rates are fitted
    by Chebyshev polynomials through ``nodes`` points and these are integrated.
    """
    x = np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    fit = np.linalg.inv(chebyshev.chebvander(x, nodes - 1))
    integral = np.stack([chebyshev.chebint(fit[:, k], lbnd=-1) for k in range(nodes)], axis=1)
    edges = np.linspace(-1.0, 1.0, samples + 1)
    half = 0.5 * samples * dt
    sums = half * chebyshev.chebvander(edges, nodes) @ integral
    for piece in range(first, first + pieces):
        values = rates(half * (2 * piece + 1 + x))
        yield np.diff(sums @ values, axis=0)


class GreatCircle:
    """A path whose vertical turns steadily: the plumb line's foot follows a great circle of directions.

    ``start`` (3,) is the vertical at time zero, ``forward`` (3,) the level direction it turns to, Earth-fixed
    unit vectors; ``rate`` rad/s, ``height`` m. The ground speed is ``rate`` times the radius of curvature
    there, and so constant within 1 %. ``C_tb`` (3, 3) takes body axes to right, forward, up of the path.
    """

    def __init__(self, start: Array, forward: Array, rate: float, height: float, C_tb: Array) -> None:
        self.start, self.forward = np.asarray(start), np.asarray(forward)
        self.right = np.cross(self.forward, self.start)
        self.rate, self.height, self.C_tb = rate, height, C_tb

    def vertical(self, t: Array) -> tuple[Array, Array]:
        """The vertical and the level direction it turns to, (n, 3) each."""
        c, s = np.cos(self.rate * t)[:, None], np.sin(self.rate * t)[:, None]
        return c * self.start + s * self.forward, c * self.forward - s * self.start

    def position(self, t: Array) -> Array:
        """Earth-fixed position (n, 3), m."""
        return place(self.vertical(t)[0], np.full(len(t), self.height))

    def velocity(self, t: Array) -> Array:
        """Velocity over the Earth (n, 3), m/s."""
        return self._motion(t)[0]

    def attitude(self, t: Array) -> Array:
        """C_eb (n, 3, 3)."""
        up, forward = self.vertical(t)
        right = np.broadcast_to(self.right, up.shape)
        return np.stack((right, forward, up), axis=-1) @ self.C_tb

    def rates(self, t: Array) -> Array:
        """Angular rate w_ib_b (rad/s) and specific force f_b (m/s^2), (n, 6)."""
        up, forward = self.vertical(t)
        velocity, acceleration = self._motion(t)
        sin_lat = up[:, 2:]
        gravity = -normal_gravity(np.arcsin(sin_lat), np.full_like(sin_lat, self.height)) * up
        # the north component over cos L times the level part of the polar axis
        gravity -= 2.0 * _PLUMB * self.height * sin_lat * (_Z - sin_lat * up)
        force = acceleration + 2.0 * OMEGA * np.cross(_Z, velocity) - gravity
        rate = OMEGA * _Z - self.rate * self.right
        out = np.empty((len(t), 6))
        for place, vector in ((0, np.broadcast_to(rate, up.shape)), (3, force)):
            in_t = np.stack((vector @ self.right, np.sum(vector * forward, -1), np.sum(vector * up, -1)), -1)
            out[:, place : place + 3] = in_t @ self.C_tb
        return out

    def _motion(self, t: Array) -> tuple[Array, Array]:
        """First and second derivative of the position."""
        u, u1 = self.vertical(t)
        u1 = self.rate * u1
        u2 = -(self.rate**2) * u
        z, z1, z2 = u[:, 2:], u1[:, 2:], u2[:, 2:]
        w2 = 1.0 - E2 * z * z
        n = A / np.sqrt(w2)
        n1 = n * E2 * z * z1 / w2
        n2 = n * E2 * ((z1 * z1 + z * z2) / w2 + 3.0 * E2 * (z * z1 / w2) ** 2)
        flat = np.array([1.0, 1.0, 1.0 - E2])
        velocity = flat * (n1 * u + n * u1) + self.height * u1
        return velocity, flat * (n2 * u + 2.0 * n1 * u1 + n * u2) + self.height * u2


def place(up: Array, height: Array) -> Array:
    """Earth-fixed position (n, 3), m, of verticals ``up`` (n, 3) and ``height`` (n,) m: no angle, no pole."""
    n = A / np.sqrt(1.0 - E2 * up[:, 2:] ** 2)
    return np.asarray(n * up * np.array([1.0, 1.0, 1.0 - E2]) + height[:, None] * up)


def direction(lat_deg: float, lon_deg: float) -> tuple[Array, Array, Array]:
    """East, north and up (3,) at a place given in degrees, exact at multiples of 90."""
    s, c = _exact(lat_deg)
    so, co = _exact(lon_deg)
    return np.array([-so, co, 0.0]), np.array([-s * co, -s * so, c]), np.array([c * co, c * so, s])


def _exact(angle_deg: float) -> tuple[float, float]:
    quarter = round(angle_deg / 90.0)
    rest = math.radians(angle_deg - 90.0 * quarter)
    s, c = math.sin(rest), math.cos(rest)
    return ((s, c), (c, -s), (-s, -c), (-c, s))[quarter % 4]
