"""Views of one solution for polar waters: grid and transverse coordinates, and when to show them.

Nothing here is integrated. A view is how position, heading and velocity are written down; the point and
the directions it stands for are the same in every frame, to rounding, at the poles too.

Geographic: latitude, longitude, heading and velocity against true north.

Grid: grid north lies in the plane through the point that is parallel to the Greenwich meridian plane, so
it is true north on the Greenwich meridian and the same way all over a polar chart. The grid angle sigma is
the true bearing of grid north, clockwise: ``sin sigma = sin L sin lon / d``, ``cos sigma = cos lon / d``,
``d = sqrt(1 - cos^2 L sin^2 lon)``, and grid heading is true heading less sigma (Zhao Wangyang et al. 2021,
eqs. (27) to (29); Greenaway and Gates, "Polar Air Navigation", 2009). Position stays geographic.

Transverse: latitude and longitude of the ellipsoid's normal against an Earth turned over, axes t: the
transverse pole is where the equator meets 90 deg east, the transverse equator is the meridian of 0 and
180 deg, and transverse longitude counts from the north pole towards Greenwich. ``x_t = z_e``,
``y_t = x_e``, ``z_t = y_e``, so ``sin L_t = cos L sin lon`` and ``tan lon_t = cos L cos lon / sin L``.
These are angles of the normal to the WGS-84 ellipsoid, not of a sphere, so the point on the ground is exactly
that of latitude and longitude (transverse output as in Zhao Wangyang et al. 2021, section 6; the ellipsoid
as in Yao, Journal of Navigation 69, 2016, 335-352). Transverse north is grid east.

Grid and transverse directions have no meaning at the transverse poles, on the equator, as true north has none
at the poles; what is returned there is consistent all the same in the transverse frame.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav import earth

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Frame(IntEnum):
    """What position, heading and horizontal velocity refer to; the values are those on the wire."""

    GEOGRAPHIC = 0
    GRID = 1
    TRANSVERSE = 2


class View(NamedTuple):
    """One solution, or n, in a frame.

    ``lat``, ``lon`` (...) rad are transverse ones in the transverse frame, geographic ones otherwise;
    ``heading`` (...) rad is clockwise from the frame's north, [0, 2 pi); ``v`` (..., 3) m/s is along the
    frame's east and north, and up. ``turn`` (...) rad is the bearing of the frame's north, clockwise, from
    the north (the y axis) of the axes that it was seen from.
    """

    frame: Frame
    lat: Vector
    lon: Vector
    heading: Vector
    v: Vector
    turn: Vector


def grid_angle(lat: ArrayLike, lon: ArrayLike) -> Vector:
    """Grid angle sigma (...), rad in (-pi, pi]: true bearing of grid north at ``lat``, ``lon`` (...) rad.

    Zhao Wangyang et al. 2021, section 5, with the sign of eq. (29): grid heading = heading - sigma.
    """
    lat, lon = np.asarray(lat, np.float64), np.asarray(lon, np.float64)
    return np.asarray(np.arctan2(np.sin(lat) * np.sin(lon), np.cos(lon)))


def to_transverse(lat: ArrayLike, lon: ArrayLike) -> tuple[Vector, Vector]:
    """Transverse latitude and longitude (...), rad, of geographic ones."""
    return _angles_t(_normal(lat, lon))


def from_transverse(lat_t: ArrayLike, lon_t: ArrayLike) -> tuple[Vector, Vector]:
    """Geographic latitude and longitude (...), rad, of transverse ones: the inverse of `to_transverse`."""
    x, y, z = np.moveaxis(_normal(lat_t, lon_t), -1, 0)
    return _angles(np.stack((y, z, x), axis=-1))


def view(frame: Frame, lat: ArrayLike, lon: ArrayLike, heading: ArrayLike, v_g: ArrayLike) -> View:
    """A geographic solution as it looks in ``frame``.

    ``lat``, ``lon`` and ``heading`` (...) rad, ``v_g`` (..., 3) m/s east, north, up.
    """
    return _seen(frame, _normal(lat, lon), _axes(lat, lon), heading, v_g, (lat, lon))


def view_n(frame: Frame, C_en: ArrayLike, heading_n: ArrayLike, v_n: ArrayLike) -> View:
    """A solution in the local-level frame n as it looks in ``frame``.

    ``C_en`` (..., 3, 3) is the position matrix, ``heading_n`` (...) rad clockwise from n's y axis, ``v_n``
    (..., 3) m/s along n. Nothing in between is singular: this is how to leave a wander frame at a pole.
    """
    C = np.asarray(C_en, np.float64)
    return _seen(frame, C[..., :, 2], C, heading_n, v_n, None)


def geographic(seen: View) -> View:
    """The same solution in the geographic frame: the inverse of `view`."""
    lat, lon = seen.lat, seen.lon
    if seen.frame is Frame.TRANSVERSE:
        lat, lon = from_transverse(lat, lon)
    C_el = axes_e(seen)
    return _seen(Frame.GEOGRAPHIC, C_el[..., :, 2], C_el, seen.heading, seen.v, (lat, lon))


def axes_e(seen: View) -> Matrix:
    """East, north and up of a view's frame as columns (..., 3, 3) in Earth-fixed axes.

    From ``frame``, ``lat`` and ``lon`` alone: what a reader of the view has.
    """
    if seen.frame is Frame.TRANSVERSE:
        # rows of t: x_t = z_e, y_t = x_e, z_t = y_e
        return np.asarray(_axes(seen.lat, seen.lon)[..., [1, 2, 0], :])
    C_eg = _axes(seen.lat, seen.lon)
    if seen.frame is Frame.GEOGRAPHIC:
        return C_eg
    sigma = grid_angle(seen.lat, seen.lon)
    s, c = np.sin(sigma)[..., None], np.cos(sigma)[..., None]
    east, north, up = np.moveaxis(C_eg, -1, 0)
    return np.stack((c * east - s * north, s * east + c * north, up), axis=-1)


def position_e(seen: View, height: ArrayLike) -> Vector:
    """Earth-fixed position (..., 3), m, of a view at ``height`` (...) m above the ellipsoid."""
    lat, lon = seen.lat, seen.lon
    if seen.frame is Frame.TRANSVERSE:
        lat, lon = from_transverse(lat, lon)
    return earth.ecef(lat, lon, height)


def turn_sigma(east: float, north: float, turn: float) -> tuple[float, float]:
    """Standard deviations along axes whose north is ``turn`` rad clockwise of the ones given for.

    East and north errors are taken as uncorrelated.
    """
    s, c = math.sin(turn), math.cos(turn)
    return math.hypot(c * east, s * north), math.hypot(s * east, c * north)


def switch(lat: float, current: Frame, polar: Frame, enter: float, leave: float) -> Frame:
    """The frame to show next: ``polar`` from latitude ``enter`` on, geographic again below ``leave``.

    Latitudes in rad, of either hemisphere; ``leave`` below ``enter`` keeps a course along the limit from
    switching to and fro. A latitude that is not known changes nothing.
    """
    if current is Frame.GEOGRAPHIC:
        return polar if abs(lat) >= enter else current
    return Frame.GEOGRAPHIC if abs(lat) < leave else current


def _normal(lat: ArrayLike, lon: ArrayLike) -> Vector:
    """Ellipsoid normal (..., 3) in axes e."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, np.float64), np.asarray(lon, np.float64))
    c = np.cos(lat)
    return np.stack((c * np.cos(lon), c * np.sin(lon), np.sin(lat)), axis=-1)


def _angles(n: Vector) -> tuple[Vector, Vector]:
    """Latitude and longitude of a normal; at a pole the longitude is as good as any other."""
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    return np.asarray(np.arctan2(z, np.hypot(x, y))), np.asarray(np.arctan2(y, x))


def _angles_t(n_e: Vector) -> tuple[Vector, Vector]:
    return _angles(n_e[..., [2, 0, 1]])


def _axes(lat: ArrayLike, lon: ArrayLike) -> Matrix:
    """East, north, up as columns (..., 3, 3)."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, np.float64), np.asarray(lon, np.float64))
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack((-so, co, np.zeros_like(so)), axis=-1)
    north = np.stack((-sl * co, -sl * so, cl), axis=-1)
    return np.stack((east, north, np.stack((cl * co, cl * so, sl), axis=-1)), axis=-1)


def _seen(
    frame: Frame,
    normal: Vector,
    C_el: Matrix,
    heading: ArrayLike,
    v_l: ArrayLike,
    place: tuple[ArrayLike, ArrayLike] | None,
) -> View:
    """From level axes l (C_el, its third column the normal) to ``frame``; ``place`` is geographic, if known.

    The frame's east is made from the very angles that are handed out, so that at a pole, where longitude
    may be anything, heading and velocity belong to the longitude that stands beside them.
    """
    if frame is Frame.TRANSVERSE:
        lat, lon = _angles_t(normal)
        east_e = np.stack((np.cos(lon), np.zeros_like(lon), -np.sin(lon)), axis=-1)
    else:
        lat, lon = _angles(normal) if place is None else (np.asarray(a, np.float64) for a in place)
        if frame is Frame.GRID:
            # the level part of the normal to the Greenwich plane
            east_e = np.broadcast_to(np.array([0.0, 1.0, 0.0]), normal.shape)
        else:
            east_e = np.stack((-np.sin(lon), np.cos(lon), np.zeros_like(lon)), axis=-1)
            east_e = np.broadcast_to(east_e, normal.shape)
    east_l = np.einsum("...ij,...i->...j", C_el, east_e)
    # north is a quarter turn to the left of east
    turn = np.arctan2(-east_l[..., 1], east_l[..., 0])
    s, c = np.sin(turn), np.cos(turn)
    v = np.asarray(v_l, np.float64)
    v_f = np.stack((c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1], v[..., 2]), axis=-1)
    angle = np.mod(np.asarray(heading, np.float64) - turn, 2.0 * np.pi)
    # the remainder of a tiny negative angle rounds up to a whole turn
    angle = np.where(angle >= 2.0 * np.pi, 0.0, angle)
    return View(frame, lat, lon, angle, v_f, turn)
