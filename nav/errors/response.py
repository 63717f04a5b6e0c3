"""How constant and random sensor errors grow at rest: the closed forms of Schuler and Earth oscillations.

A sphere of radius R, height known, gravity g = w_s^2 R, and (in the closed forms) without the Coriolis terms
of the error: then each of five sensor errors gives seven navigation errors in sines and cosines. The
neglect is not small over hours, as `static_dynamics` with them shows.

Source: the textbook chapter "Inertial navigation", section 2.4.5: eqs. (2-89) to (2-98), tables 2-9 and 2-10.
Nine cells of table 2-9 are misprinted; the forms here are derived and agree with integration.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav.earth import EARTH_RATE

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STATES: Final = ("v_east", "v_north", "lat", "lon", "phi_east", "phi_north", "phi_up")
"""m/s, m/s, rad, rad, rad, rad, rad; computed minus true, ``C_pg = I - [phi x]``."""
SOURCES: Final = ("gyro_east", "gyro_north", "gyro_up", "accel_east", "accel_north")
"""Drifts of a platform (rad/s) and errors of accelerometers (m/s^2). A strapdown gyro's output error has the
opposite sign."""


class Sphere(NamedTuple):
    """The Earth as the closed forms have it: ``gravity`` m/s^2, ``radius`` m, ``rate`` rad/s."""

    gravity: float
    radius: float
    rate: float = EARTH_RATE

    @property
    def schuler(self) -> float:
        """Schuler's frequency w_s, rad/s."""
        return math.sqrt(self.gravity / self.radius)


def static_dynamics(lat: float, sphere: Sphere, coriolis: bool) -> tuple[Matrix, Matrix]:
    """F (7, 7) and G (7, 5) of ``d(dx)/dt = F dx + G e`` for STATES and SOURCES, at rest at ``lat`` (rad).

    "Inertial navigation", eq. (2-90) with longitude; ``coriolis`` keeps the elements +-2 w_ie sin L.
    """
    g, R, w = sphere
    s, c, tan = math.sin(lat), math.cos(lat), math.tan(lat)
    f = 2.0 * w * s if coriolis else 0.0
    F = np.array(
        [
            [0.0, f, 0.0, 0.0, 0.0, -g, 0.0],
            [-f, 0.0, 0.0, 0.0, g, 0.0, 0.0],
            [0.0, 1.0 / R, 0.0, 0.0, 0.0, 0.0, 0.0],
            [1.0 / (R * c), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, -1.0 / R, 0.0, 0.0, 0.0, w * s, -w * c],
            [1.0 / R, 0.0, -w * s, 0.0, -w * s, 0.0, 0.0],
            [tan / R, 0.0, w * c, 0.0, w * c, 0.0, 0.0],
        ]
    )
    G = np.zeros((7, 5))
    G[4:7, 0:3] = np.eye(3)
    G[0:2, 3:5] = np.eye(2)
    return F, G


def responses(t: ArrayLike, lat: float, sphere: Sphere) -> Vector:
    """Errors (5, 7, ...) of STATES after ``t`` (...) seconds of one unit of each of SOURCES, from zero.

    "Inertial navigation", tables 2-9 and 2-10, corrected.
    """
    t = np.asarray(t, dtype=np.float64)
    g, R, w = sphere
    ws = sphere.schuler
    sl, cl, tl = math.sin(lat), math.cos(lat), math.tan(lat)
    D, E = ws * ws - w * w, ws * ws - (w * cl) ** 2
    S, C, s, c = np.sin(ws * t), np.cos(ws * t), np.sin(w * t), np.cos(w * t)
    zero = np.zeros_like(t)
    slow = s - w / ws * S
    rise, turn = (1.0 - C) / g, (1.0 - c) / w
    gyro_east = [
        g * sl / D * slow,
        g / D * (c - C),
        ws * ws / D * (s / w - S / ws),
        tl * turn - w * tl / D * (c - C),
        (ws * S - w * s) / D,
        w * sl / D * (C - c),
        turn / cl + w * sl * tl / D * (C - c),
    ]
    gyro_north = [
        R * (E / D * C - (ws * sl) ** 2 / D * c - cl * cl),
        g * sl / D * slow,
        sl * (w / D * C - ws * ws / (w * D) * c + 1.0 / w),
        E / (cl * ws * D) * S - ws * ws * sl * tl / (w * D) * s - t * cl,
        w * sl / D * (c - C),
        E / (ws * D) * S - w * sl * sl / D * s,
        E * tl / D * (S / ws - s / w),
    ]
    gyro_up = [
        R * sl * cl * ((ws * ws * c - w * w * C) / D - 1.0),
        -g * cl / D * slow,
        cl * (ws * ws / (w * D) * c - w / D * C - 1.0 / w),
        sl * (ws * ws / (w * D) * s - w * w / (ws * D) * S - t),
        w * cl / D * (C - c),
        w * sl * cl / D * slow,
        E / (w * D) * s - (w * sl) ** 2 / (ws * D) * S,
    ]
    accel_east = [S / ws, zero, zero, rise / cl, zero, rise, rise * tl]
    accel_north = [zero, S / ws, rise, zero, -rise, zero, zero]
    return np.array([gyro_east, gyro_north, gyro_up, accel_east, accel_north])


def frequencies(lat: float, sphere: Sphere) -> tuple[float, float, float]:
    """Frequencies (rad/s) of the undisturbed error at rest: Earth, and Schuler's two split by Foucault's.

    The roots of "Inertial navigation", eq. (2-93), are plus and minus j times these, exactly; its eq. (2-95)
    has w_s for the root of the sum of squares.
    """
    foucault = abs(sphere.rate * math.sin(lat))
    mean = math.hypot(sphere.schuler, foucault)
    return sphere.rate, mean + foucault, mean - foucault


def velocity_variance(t: ArrayLike, density: float, schuler: float) -> Vector:
    """Variance (...), (m/s)^2, of a velocity after ``t`` (...) s of white accelerometer noise, one channel.

    ``density`` (m/s^2)^2 s, two-sided (what the chapter writes mu sigma^2), ``schuler`` rad/s. "Inertial
    navigation", eq. (2-98), where the sine is printed over 2 w_s instead of 4 w_s.
    """
    t = np.asarray(t, dtype=np.float64)
    return np.asarray(density * (0.5 * t + np.sin(2.0 * schuler * t) / (4.0 * schuler)))
