"""The Earth: WGS-84 ellipsoid, normal gravity, rotation, and where the local-level frame stands on it.

Scalar kernels (usable inside other kernels and from Python) come first, array functions after them.

Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., tables 3.1 to 3.4
and chapter 4; Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
2nd ed., section 2.4.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav.jit import kernel

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SEMI_MAJOR: Final = 6378137.0
"""Equatorial radius a, m."""
FLATTENING: Final = 1.0 / 298.257223563
"""Flattening f."""
SEMI_MINOR: Final = SEMI_MAJOR * (1.0 - FLATTENING)
"""Polar radius b, m."""
E2: Final = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity squared."""
GM: Final = 3.986004418e14
"""Gravitational constant of the Earth with its atmosphere, m^3/s^2."""
EARTH_RATE: Final = 7.292115e-5
"""Rate of e with respect to i about the polar axis, rad/s."""
GRAVITY_EQUATOR: Final = 9.7803253359
"""Normal gravity on the ellipsoid at the equator, m/s^2."""
GRAVITY_POLE: Final = 9.8321849378
"""Normal gravity on the ellipsoid at a pole, m/s^2."""
SOMIGLIANA: Final = 0.00193185265241
"""Somigliana's k."""
_M: Final = EARTH_RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM
_DEFLECTION: Final = 8.08e-9
_SECOND_E2: Final = E2 / (1.0 - E2)


@kernel
def radii(sin_lat: float) -> tuple[float, float]:
    """Radii of curvature in the meridian and in the prime vertical, (R_M, R_N), m.

    ``sin_lat`` is the sine of the geodetic latitude. Groves, eqs. (2.105) and (2.106).
    """
    w2 = 1.0 - E2 * sin_lat * sin_lat
    w = math.sqrt(w2)
    return SEMI_MAJOR * (1.0 - E2) / (w2 * w), SEMI_MAJOR / w


@kernel
def normal_gravity(sin_lat: float, height: float) -> float:
    """Magnitude of normal gravity (gravitation and centrifugal together), m/s^2.

    ``sin_lat`` sine of the geodetic latitude, ``height`` m above the ellipsoid: Somigliana's formula,
    continued upwards to second order. NIMA TR8350.2, eqs. (4-1) and (4-3).
    """
    s2 = sin_lat * sin_lat
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - E2 * s2)
    x = height / SEMI_MAJOR
    return surface * (1.0 - 2.0 * (1.0 + FLATTENING + _M - 2.0 * FLATTENING * s2) * x + 3.0 * x * x)


@kernel
def gravity_north(sin_lat: float, cos_lat: float, height: float) -> float:
    """North component of normal gravity at ``height`` (m), m/s^2: plumb lines bend towards the equator.

    Groves, eq. (2.140).
    """
    return -2.0 * _DEFLECTION * height * sin_lat * cos_lat


@kernel
def curvature(c20: float, c21: float, c22: float, height: float) -> tuple[float, float, float]:
    """Elements (k_xx, k_xy, k_yy), 1/m, of the curvature tensor of the ellipsoid in the axes of n.

    ``c20, c21, c22`` is the last row of C_en (the polar axis in n), ``height`` in m. The level
    transport rate is ``w_en_n = up x (k v_n)``. Written with the polar axis instead of latitude and
    wander angle, it is regular at the poles. Savage, "Strapdown Analytics", section 5.3.
    """
    r_m, r_n = radii(c22)
    base = 1.0 / (r_n + height)
    w2 = 1.0 - E2 * c22 * c22
    # 1/(R_M + h) - 1/(R_N + h) without the cancellation, and without the cos^2 L that c20, c21 hold
    extra = SEMI_MAJOR * E2 / (w2 * math.sqrt(w2)) / ((r_m + height) * (r_n + height))
    return base + extra * c20 * c20, extra * c20 * c21, base + extra * c21 * c21


@kernel
def geodetic_to_xyz(lat: float, lon: float, height: float) -> tuple[float, float, float]:
    """Earth-fixed Cartesian coordinates (m) of a geodetic position (rad, rad, m). Groves, eq. (2.112)."""
    s = math.sin(lat)
    c = math.cos(lat)
    r_n = SEMI_MAJOR / math.sqrt(1.0 - E2 * s * s)
    return (
        (r_n + height) * c * math.cos(lon),
        (r_n + height) * c * math.sin(lon),
        ((1.0 - E2) * r_n + height) * s,
    )


@kernel
def xyz_to_geodetic(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Geodetic latitude, longitude (rad) and height (m) of an Earth-fixed position (m).

    Bowring's iteration on the reduced latitude (Survey Review 23, 1976, 323-327): three rounds reach
    rounding error from the Earth's deep interior to satellites. Not defined near the Earth's centre.
    """
    p = math.hypot(x, y)
    sin_u = z * SEMI_MAJOR
    cos_u = p * SEMI_MINOR
    sin_lat = 0.0
    cos_lat = 1.0
    for _ in range(3):
        norm = math.hypot(sin_u, cos_u)
        sin_u /= norm
        cos_u /= norm
        sin_lat = z + _SECOND_E2 * SEMI_MINOR * sin_u**3
        cos_lat = p - E2 * SEMI_MAJOR * cos_u**3
        sin_u = sin_lat * (1.0 - FLATTENING)
        cos_u = cos_lat
    norm = math.hypot(sin_lat, cos_lat)
    sin_lat /= norm
    cos_lat /= norm
    # this form of the height has no division that fails at the equator or at a pole
    height = p * cos_lat + z * sin_lat - SEMI_MAJOR * math.sqrt(1.0 - E2 * sin_lat * sin_lat)
    return math.atan2(sin_lat, cos_lat), math.atan2(y, x), height


def ecef(lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Vector:
    """Earth-fixed Cartesian positions (..., 3), m, of geodetic positions (...) in rad, rad, m.

    Groves, eq. (2.112).
    """
    lat, lon, height = (np.asarray(a, dtype=np.float64) for a in (lat, lon, height))
    s, c = np.sin(lat), np.cos(lat)
    r_n = SEMI_MAJOR / np.sqrt(1.0 - E2 * s * s)
    return np.stack(
        np.broadcast_arrays(
            (r_n + height) * c * np.cos(lon),
            (r_n + height) * c * np.sin(lon),
            ((1.0 - E2) * r_n + height) * s,
        ),
        axis=-1,
    )


def geodetic(r_e: ArrayLike) -> tuple[Vector, Vector, Vector]:
    """Latitude, longitude (rad) and height (m), each (...), of Earth-fixed positions (..., 3), m."""
    r = np.asarray(r_e, dtype=np.float64)
    flat = np.array([xyz_to_geodetic(*p) for p in r.reshape(-1, 3)]).reshape(*r.shape[:-1], 3)
    return flat[..., 0], flat[..., 1], flat[..., 2]


def gravity_g(lat: float, height: float) -> Vector:
    """Normal gravity (3,), m/s^2 east, north, up, at latitude (rad) and height (m)."""
    s, c = math.sin(lat), math.cos(lat)
    return np.array([0.0, gravity_north(s, c, height), -normal_gravity(s, height)])


def earth_rate_g(lat: float) -> Vector:
    """Earth rate w_ie_g (3,), rad/s east, north, up. Groves, eq. (2.123)."""
    return np.array([0.0, EARTH_RATE * math.cos(lat), EARTH_RATE * math.sin(lat)])


def transport_rate_g(lat: float, height: float, v_g: ArrayLike) -> Vector:
    """Transport rate w_eg_g (3,), rad/s, of the north-pointing frame moving at ``v_g`` (3,), m/s.

    Not defined at a pole. Groves, eq. (5.44).
    """
    v = np.asarray(v_g, dtype=np.float64)
    r_m, r_n = radii(math.sin(lat))
    east = v[0] / (r_n + height)
    return np.array([-v[1] / (r_m + height), east, east * math.tan(lat)])


def position_matrix(lat: float, lon: float, wander: float = 0.0) -> Matrix:
    """C_en (3, 3): local-level n at ``lat``, ``lon`` (rad) to Earth-fixed e.

    n is east-north-up turned by ``wander`` (rad), counter-clockwise seen from above: n's x axis
    points ``wander`` north of east. Groves, eqs. (2.150) and (5.74).
    """
    sl, cl = math.sin(lat), math.cos(lat)
    so, co = math.sin(lon), math.cos(lon)
    sa, ca = math.sin(wander), math.cos(wander)
    C_eg = np.array([[-so, -sl * co, cl * co], [co, -sl * so, cl * so], [0.0, cl, sl]])
    C_gn = np.array([[ca, -sa, 0.0], [sa, ca, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(C_eg @ C_gn)


def position_quat(lat: ArrayLike, lon: ArrayLike) -> Vector:
    """q_eg (..., 4): east-north-up at ``lat``, ``lon`` (...) rad to Earth-fixed e. Groves, eq. (2.150)."""
    # about the polar axis to the meridian's east, then about east until up stands on the ellipsoid
    a = 0.5 * np.asarray(lon, np.float64) + 0.25 * np.pi
    b = 0.25 * np.pi - 0.5 * np.asarray(lat, np.float64)
    sa, ca, sb, cb = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
    return np.stack(np.broadcast_arrays(ca * cb, ca * sb, sa * sb, sa * cb), axis=-1)


def convergence(lat_a: ArrayLike, lon_a: ArrayLike, lat_b: ArrayLike, lon_b: ArrayLike) -> Vector:
    """By how much (...), rad in (-pi, pi], a bearing grows that is carried from place a to place b (rad).

    The turn about the vertical between the two east-north-up frames, without that which keeps each level:
    ``tan(c/2) = tan(dlon/2) sin((L_a + L_b)/2) / cos((L_b - L_a)/2)``, from q_gg' of `position_quat`. Exact
    at and across a pole and the date line.
    """
    lat_a, lat_b = np.asarray(lat_a, np.float64), np.asarray(lat_b, np.float64)
    half = 0.5 * (np.asarray(lon_b, np.float64) - np.asarray(lon_a, np.float64))
    sine = np.sin(half) * np.sin(0.5 * (lat_a + lat_b))
    angle = 2.0 * np.arctan2(sine, np.cos(half) * np.cos(0.5 * (lat_b - lat_a)))
    return np.asarray(angle - 2.0 * np.pi * np.ceil(angle / (2.0 * np.pi) - 0.5))


def position_angles(C_en: ArrayLike) -> tuple[float, float, float]:
    """Latitude, longitude and wander angle (rad) of a position matrix C_en (3, 3).

    At a pole longitude and wander are not separate; what is returned gives C_en back.
    """
    C = np.asarray(C_en, dtype=np.float64)
    lat = math.atan2(C[2, 2], math.hypot(C[0, 2], C[1, 2]))
    if math.hypot(C[2, 0], C[2, 1]) < 1e-14:
        return lat, 0.0, math.atan2(-math.copysign(C[0, 0], C[0, 0] * C[2, 2]), C[1, 0])
    return lat, math.atan2(C[1, 2], C[0, 2]), math.atan2(C[2, 0], C[2, 1])
