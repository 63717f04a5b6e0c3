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


def radii(sin_lat: Array) -> tuple[Array, Array]:
    """Radii of curvature R_M, R_N (n,) m by the sine of latitude (n,). Groves 2013, eq. (2.105), (2.106)."""
    w2 = 1.0 - E2 * sin_lat * sin_lat
    r_n = A / np.sqrt(w2)
    return r_n * (1.0 - E2) / w2, r_n


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


def axes_eh(lat: Array, lon: Array, pole: Array) -> Array:
    """C_eh (n, 3, 3): level axes whose first points, level, to the Earth-fixed unit vector ``pole`` (3,).

    With ``pole`` on the equator this is a graticule turned over: its own poles are at plus and minus
    ``pole``, and the Earth's are places like others.
    """
    up = np.stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)), axis=-1)
    x = pole - (up @ pole)[..., None] * up
    x = x / np.sqrt((x * x).sum(axis=-1, keepdims=True))
    return np.stack((x, np.cross(up, x), up), axis=-1)


def rate_eh(C_eh: Array, pole: Array, height: Array, v_h: Array, vdot_h: Array) -> tuple[Array, Array]:
    """Rate w_eh_h (n, 3) rad/s of the axes of `axes_eh` under a point that moves, and its derivative.

    ``height`` (n,) m, ``v_h`` (n, 3) m/s over the Earth, ``vdot_h`` (n, 3) the rates of its components. The
    vertical turns by the curvature of the ellipsoid, written with the polar axis ``p`` in h instead of
    latitude so that nothing is divided by its cosine: k v = v / (R_N + h) + p (p . v) (R_N - R_M) /
    (cos^2 L (R_M + h) (R_N + h)), level parts. Differentiating x keeps it pointing to ``pole``.
    """
    p = C_eh[..., 2, :]
    s = p[..., 2]
    w2 = 1.0 - E2 * s * s
    r_m, r_n = radii(s)
    e_n, e_m = 1.0 / (r_n + height), 1.0 / (r_m + height)
    extra = r_n * E2 / w2 * e_n * e_m
    v, vdot, axis = v_h[..., :2], vdot_h[..., :2], p[..., :2]
    along = (axis * v).sum(axis=-1)
    up1 = e_n[..., None] * v + (extra * along)[..., None] * axis
    # tangent of the angle from the graticule's own equator
    sine = C_eh[..., :, 2] @ pole
    tan = sine / np.sqrt(1.0 - sine * sine)
    w_eh = np.stack((-up1[..., 1], up1[..., 0], -tan * up1[..., 1]), axis=-1)

    p1 = np.cross(p, w_eh)
    s1, v_u = p1[..., 2], v_h[..., 2]
    slope = E2 * s * s1 / w2  # of the logarithm of 1/w
    e_n1, e_m1 = -e_n * (r_n * slope + v_u), -e_m * (3.0 * r_m * slope + v_u)  # of the logarithms
    extra1 = extra * (3.0 * slope + e_n1 + e_m1)
    along1 = (p1[..., :2] * v).sum(axis=-1) + (axis * vdot).sum(axis=-1)
    up2 = (e_n * e_n1)[..., None] * v + e_n[..., None] * vdot
    up2 += (extra1 * along + extra * along1)[..., None] * axis + (extra * along)[..., None] * p1[..., :2]
    tan1 = up1[..., 0] * (1.0 + tan * tan)
    wdot = np.stack((-up2[..., 1], up2[..., 0], -tan1 * up1[..., 1] - tan * up2[..., 1]), axis=-1)
    return w_eh, wdot
