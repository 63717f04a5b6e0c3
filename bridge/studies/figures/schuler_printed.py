"""Tables 2-9 and 2-10 as printed: the cells that are not solutions of the equations they belong to.

The textbook chapter "Inertial navigation", section 2.4.5, table 2-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from bridge.studies.figures.schuler_runs import Vector
from nav.errors.response import Sphere

Printed = Callable[[Vector, float, Sphere], Vector]


def _words(lat: float, sphere: Sphere) -> tuple[float, ...]:
    ws, w = sphere.schuler, sphere.rate
    return ws, w, ws * ws - w * w, ws * ws - (w * math.cos(lat)) ** 2


def _gyro_east_v_north(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, _ = _words(lat, sphere)
    return sphere.gravity * math.sin(lat) / D * (np.cos(w * t) - np.cos(ws * t))


def _gyro_north_v_east(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, E = _words(lat, sphere)
    slow = (ws * ws - math.sin(lat) ** 2) / D * np.cos(w * t)
    return np.asarray(E / D * np.cos(ws * t) - slow - math.cos(lat) ** 2)


def _gyro_north_lat(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, _ = _words(lat, sphere)
    s = math.sin(lat)
    return ws * ws * w * s / D * (np.cos(ws * t) / ws**2 - np.cos(w * t) / w) + s / w


def _gyro_north_phi_up(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, _ = _words(lat, sphere)
    factor = (w * math.sin(lat) * math.cos(lat) - ws * ws * math.tan(lat)) / D
    return factor * (np.sin(w * t) / w - np.sin(ws * t) / (ws * t))


def _gyro_up_v_north(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, _ = _words(lat, sphere)
    return sphere.gravity * math.cos(lat) / D * (np.sin(w * t) - w / ws * np.sin(ws * t))


def _gyro_up_lat(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, _ = _words(lat, sphere)
    c = math.cos(lat)
    return ws * ws * c / (w * D) * np.cos(w * t) - w * w * c / D * np.cos(ws * t) - c / w


def _gyro_up_phi_east(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, _, _ = _words(lat, sphere)
    return np.asarray(np.cos(ws * t) - np.cos(w * t))


def _gyro_up_phi_up(t: Vector, lat: float, sphere: Sphere) -> Vector:
    ws, w, D, E = _words(lat, sphere)
    return E / (w * D) * np.sin(w * t) - w * math.sin(lat) ** 2 / (ws * D) * np.sin(ws * t)


MISPRINTS: Final[dict[tuple[str, str], tuple[Printed | None, str]]] = {
    ("gyro_east", "v_north"): (_gyro_east_v_north, "printed g sin L where it is g"),
    ("gyro_north", "v_east"): (
        _gyro_north_v_east,
        "printed without the factor R, and w_s^2 - sin^2 L for w_s^2 sin^2 L",
    ),
    ("gyro_north", "lat"): (_gyro_north_lat, "printed cos(w_e t) / w_e for cos(w_e t) / w_e^2"),
    ("gyro_north", "lon"): (None, "this cell cannot be read in the copy at hand"),
    ("gyro_north", "phi_up"): (
        _gyro_north_phi_up,
        "printed w_e sin L cos L for w_e^2 sin L cos L, and sin(w_s t) / (w_s t) for sin(w_s t) / w_s",
    ),
    ("gyro_up", "v_north"): (_gyro_up_v_north, "printed with the opposite sign"),
    ("gyro_up", "lat"): (_gyro_up_lat, "printed w_e^2 cos L for w_e cos L"),
    ("gyro_up", "phi_east"): (_gyro_up_phi_east, "printed without its factor w_e cos L / (w_s^2 - w_e^2)"),
    ("gyro_up", "phi_up"): (_gyro_up_phi_up, "printed w_e sin^2 L for w_e^2 sin^2 L"),
}
"""The nine cells of table 2-9 that are not solutions of (2-90): as printed, and what is wrong."""
