"""The phi-angle error model in geographic axes: what an error of position, velocity or attitude becomes.

States of all functions here, in this order: position (latitude, longitude in rad, height in m), velocity
(m/s east, north, up) and phi (rad about east, north, up), all *computed minus true*; phi is the turn from
the true geographic frame to the one the computed attitude stands for, ``C_pg = I - [phi x]``. Velocity
errors are differences of components: computed ones in the computed frame less true ones in the true frame.

Source: the textbook chapter "Inertial navigation", section 2.4, eqs. (2-80) to (2-88). The chapter leaves
out what a height error does to the radii, how radii and gravity change with latitude, and the plumb line's
bend; they are kept here, so that the model is the derivative of the mechanisation. Like the frame it
describes it is not defined at a pole; `nav.errors.model` is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav import earth
from nav.filter.states import PHI, POSITION, VELOCITY
from nav.rotation import skew

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def phi_dynamics(lat: float, height: float, v_g: ArrayLike, f_g: ArrayLike) -> Matrix:
    """F (9, 9) of ``d(dx)/dt = F dx + G e`` for the states above.

    ``lat`` rad, ``height`` m, ``v_g`` (3,) m/s, ``f_g`` (3,) specific force, m/s^2, east, north, up.
    "Inertial navigation", eqs. (2-83), (2-86), (2-88); written out there as (2-84) and (2-87).
    """
    v = np.asarray(v_g, dtype=np.float64)
    s, c, tan = math.sin(lat), math.cos(lat), math.tan(lat)
    r_m, r_n = earth.radii(s)
    M, N = r_m + height, r_n + height
    # how the radii change with latitude
    steep = earth.E2 * s * c / (1.0 - earth.E2 * s * s)
    dM, dN = 3.0 * r_m * steep, r_n * steep
    east, north = v[0] / N, v[1] / M

    w_ie, w_en = earth.earth_rate_g(lat), earth.transport_rate_g(lat, height, v)
    ie_p = np.zeros((3, 3))
    ie_p[:, 0] = [0.0, -earth.EARTH_RATE * s, earth.EARTH_RATE * c]
    en_v = frame_turn(lat, height)
    en_p = np.zeros((3, 3))
    en_p[:, 0] = [north * dM / M, -east * dN / N, east * (1.0 / (c * c) - tan * dN / N)]
    en_p[:, 2] = [north / M, -east / N, -east * tan / N]

    F = np.zeros((9, 9))
    F[POSITION, POSITION] = [
        [-north * dM / M, 0.0, -north / M],
        [east / c * (tan - dN / N), 0.0, -east / (c * N)],
        [0.0, 0.0, 0.0],
    ]
    F[POSITION, VELOCITY] = metres_to_angles(lat, height)
    F[VELOCITY, POSITION] = skew(v) @ (2.0 * ie_p + en_p) + gravity_change(lat, height)
    F[VELOCITY, VELOCITY] = -skew(2.0 * w_ie + w_en) + skew(v) @ en_v
    F[VELOCITY, PHI] = skew(f_g)
    F[PHI, POSITION] = ie_p + en_p
    F[PHI, VELOCITY] = en_v
    F[PHI, PHI] = -skew(w_ie + w_en)
    return F


def sensor_inputs(C_gb: ArrayLike) -> Matrix:
    """G (9, 6): errors of gyros (rad/s) and accelerometers (m/s^2), output minus truth in b, into the rates.

    The same for phi and psi. An output error of a strapdown gyro turns the computed attitude with the
    opposite sign of a drift of the same size of a platform ("Inertial navigation", (2-82), has the
    platform's; Yan Gongmin 2008, eq. (4-17), this one).
    """
    G = np.zeros((9, 6))
    G[PHI, 0:3] = -np.asarray(C_gb)
    G[VELOCITY, 3:6] = np.asarray(C_gb)
    return G


def gravity_change(lat: float, height: float) -> Matrix:
    """Change (3, 3) of the components of normal gravity in g with latitude, longitude and height.

    The leading element is that of the height channel, 2 g / R: "Inertial navigation", below eq. (2-86).
    """
    s, c = math.sin(lat), math.cos(lat)
    # normal gravity is a parabola in height, which a central difference takes exactly, and nearly one in s
    ds, dh = 1e-4, 100.0
    g_s = (earth.normal_gravity(s + ds, height) - earth.normal_gravity(s - ds, height)) / (2.0 * ds)
    g_h = (earth.normal_gravity(s, height + dh) - earth.normal_gravity(s, height - dh)) / (2.0 * dh)
    bend = earth.gravity_north(1.0, 1.0, 1.0)  # of the plumb line, per sin L, cos L and height
    north = [bend * height * (c * c - s * s), 0.0, bend * s * c]
    return np.array([[0.0, 0.0, 0.0], north, [-g_s * c, 0.0, -g_h]])


def metres_to_angles(lat: float, height: float) -> Matrix:
    """(3, 3): displacement in metres east, north, up to changes of latitude, longitude (rad), height (m)."""
    r_m, r_n = earth.radii(math.sin(lat))
    east = 1.0 / ((r_n + height) * math.cos(lat))
    return np.array([[0.0, 1.0 / (r_m + height), 0.0], [east, 0.0, 0.0], [0.0, 0.0, 1.0]])


def frame_turn(lat: float, height: float) -> Matrix:
    """D (3, 3): ``dtheta = D dr``, the turn (rad) of the geographic frame when its place moves by ``dr`` (m).

    The excerpt on psi-angle and phi-angle models, eq. (2.2.12), in east, north, up:
    ``(-dL, dlon cos L, dlon sin L)``.
    """
    tan = math.tan(lat)
    r_m, r_n = earth.radii(math.sin(lat))
    M, N = r_m + height, r_n + height
    return np.array([[0.0, -1.0 / M, 0.0], [1.0 / N, 0.0, 0.0], [tan / N, 0.0, 0.0]])
