"""The WGS-84 Earth of the simulated bench, vectorised and written apart from the navigator's.

A simulator that took its Earth from the code under test could not show that code's mistakes; the
two are compared in the tests.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

A: Final = 6_378_137.0
F: Final = 1.0 / 298.257223563
E2: Final = F * (2.0 - F)
OMEGA: Final = 7.292115e-5
GM: Final = 3.986004418e14
G_EQUATOR: Final = 9.7803253359
SOMIGLIANA_K: Final = 1.931852652458e-3
G0: Final = 9.80665
"""Standard gravity, the unit behind g, mg and ug, m/s^2."""


def radii(lat: Array) -> tuple[Array, Array, Array, Array]:
    """Radii of curvature R_M, R_N (m) at ``lat`` (n,) rad, and their derivatives with latitude.

    Groves 2013, eq. (2.105), (2.106).
    """
    sin_lat = np.sin(lat)
    w2 = 1.0 - E2 * sin_lat * sin_lat
    r_n = A / np.sqrt(w2)
    r_m = r_n * (1.0 - E2) / w2
    slope = E2 * sin_lat * np.cos(lat) / w2
    return r_m, r_n, 3.0 * r_m * slope, r_n * slope


def normal_gravity(lat: Array, height: Array) -> Array:
    """Magnitude of normal gravity (n,) m/s^2 at ``lat`` (n,) rad and ``height`` (n,) m.

    Somigliana's formula and the second-order expansion with height: Groves 2013, eq. (2.134), (2.139).
    """
    s2 = np.sin(lat) ** 2
    surface = G_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / np.sqrt(1.0 - E2 * s2)
    m = OMEGA**2 * A**3 * (1.0 - F) / GM
    x = height / A
    return np.asarray(surface * (1.0 - 2.0 * x * (1.0 + F + m - 2.0 * F * s2) + 3.0 * x * x))


def gravity(lat: Array, height: Array) -> tuple[Array, Array]:
    """North and up components (n,) of normal gravity, m/s^2: above the ellipsoid plumb lines bend.

    Groves 2013, eq. (2.140) for the north component.
    """
    return -8.08e-9 * height * np.sin(2.0 * lat), -normal_gravity(lat, height)


def to_ecef(lat: Array, lon: Array, height: Array) -> Array:
    """Earth-fixed position (n, 3) m of ``lat``, ``lon`` (n,) rad and ``height`` (n,) m."""
    r_n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    p = (r_n + height) * np.cos(lat)
    return np.stack((p * np.cos(lon), p * np.sin(lon), ((1.0 - E2) * r_n + height) * np.sin(lat)), axis=-1)


def to_geodetic(r_e: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude (rad) and height (m) of the Earth-fixed positions ``r_e`` (n, 3) m.

    Bowring's iteration on the reduced latitude; two rounds reach rounding error below 100 km.
    """
    x, y, z = r_e[..., 0], r_e[..., 1], r_e[..., 2]
    p = np.hypot(x, y)
    b = A * (1.0 - F)
    ep2 = E2 / (1.0 - E2)
    beta = np.arctan2(z * A, p * b)
    lat = beta
    for _ in range(2):
        lat = np.arctan2(z + ep2 * b * np.sin(beta) ** 3, p - E2 * A * np.cos(beta) ** 3)
        beta = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    # the projection on the normal is regular at the equator and at the poles alike
    height = p * cos_lat + z * sin_lat - A * np.sqrt(1.0 - E2 * sin_lat * sin_lat)
    return lat, np.arctan2(y, x), height


def axes_eg(lat: Array, lon: Array) -> Array:
    """C_eg (n, 3, 3): columns are east, north and up in Earth-fixed axes."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(sl)
    return np.stack(
        (
            np.stack((-so, -sl * co, cl * co), axis=-1),
            np.stack((co, -sl * so, cl * so), axis=-1),
            np.stack((zero, cl, sl), axis=-1),
        ),
        axis=-2,
    )
