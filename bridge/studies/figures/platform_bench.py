"""A real platform on the Earth: what its servos, gyros and accelerometers do with the computer's commands.

The platform's attitude is kept in inertial space. It turns by what the torquers make of the pulses, less what
the gyros read too much, for the servos keep what gyros read equal to what torquers are told. The
accelerometers feel the specific force of a ship on a meridian, along the platform's axes, and their bias.
Nothing here is shared with the navigation computer, which is the program's kernels (`nav.platform`,
`nav.strapdown.kernels`), but the Earth's shape, its gravity and the algebra of rotations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, normal_gravity, position_matrix, radii
from nav.jit import kernel
from nav.platform import Modulation, modulation_turn, torque, true_heading
from nav.rotation import dcm_from_quat, exponential, multiply, quat_from_dcm, rotate
from nav.strapdown.control import U_TURN, control
from nav.strapdown.kernels import M_SIZE, X_C, X_HEAD, X_Q, X_V, increments, strapdown

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

PULSE: Final = math.radians(0.1 / 3600.0)
"""Angle of a torquing pulse, rad."""
_T: Final = X_HEAD
_LAT: Final = X_HEAD + 1
_QIP: Final = X_HEAD + 2
_ROW: Final = X_HEAD + 6
_SINK_S: Final = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """A platform and its cruise: northwards at ``speed`` (m/s) from ``lat`` (rad), at height zero.

    ``gyro_bias`` (3,) rad/s is what the gyros read too much, ``accel_bias`` (3,) m/s^2 the accelerometers,
    both along p, which is east-north-up at the start. ``torquer`` is the share by which the torquers do too
    much. ``dt`` s is a cycle of the computer.
    """

    lat: float
    law: Modulation
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torquer: float = 0.0
    speed: float = 0.0
    dt: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Cruise:
    """What came of it: times ``t`` (M,) s, true latitude ``lat`` (M,) rad, error of the true heading given
    out, ``heading_error`` (M,) rad clockwise, and the computer's state heads ``x`` (M, X_HEAD).
    """

    t: Vector
    lat: Vector
    heading_error: Vector
    x: Matrix


def cruise(bench: Bench, seconds: float, every: float = 120.0) -> Cruise:
    """Run ``bench`` for ``seconds`` from a start without errors; a row every ``every`` seconds."""
    x = np.zeros(X_HEAD)
    x[X_Q] = 1.0
    x[X_V + 1] = bench.speed
    x[X_C : X_C + 9] = position_matrix(bench.lat, 0.0).ravel()
    # a ship is at sea level: the height channel is held by it
    u = control(free=bench.law.free, height_gains=(2.0 / _SINK_S, 1.0 / _SINK_S**2, 0.0))
    steps = round(seconds / bench.dt)
    stride = max(1, round(every / bench.dt))
    rows = np.empty((steps // stride, _ROW))
    q_ip = quat_from_dcm(position_matrix(bench.lat, 0.0))
    errors = np.array([*bench.gyro_bias, *bench.accel_bias, bench.torquer])
    _run(x, u, q_ip, bench.law.array, errors, bench.lat, bench.speed, bench.dt, PULSE, stride, rows)
    t, lat = rows[:, _T], rows[:, _LAT]
    C_ip = dcm_from_quat(rows[:, _QIP:_ROW])
    C_ig = _geographic(lat, EARTH_RATE * t)
    # the vehicle heads north: the gimbal shows how far to the left of north the platform's y axis is
    y_g = np.einsum("mji,mj->mi", C_ig, C_ip[:, :, 1])
    gimbal = -np.arctan2(y_g[:, 0], y_g[:, 1])
    heading = true_heading(rows[:, X_C : X_C + 9].reshape(-1, 3, 3), rows[:, X_Q : X_Q + 4], gimbal)
    error = np.mod(heading + np.pi, 2.0 * np.pi) - np.pi
    return Cruise(t, lat, error, rows[:, :X_HEAD])


def _geographic(lat: Vector, lon: Vector) -> Matrix:
    """Columns east, north, up (M, 3, 3) in axes that ``lon`` (M,) is counted in."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack((-so, co, np.zeros_like(so)), axis=-1)
    north = np.stack((-sl * co, -sl * so, cl), axis=-1)
    return np.stack((east, north, np.stack((cl * co, cl * so, sl), axis=-1)), axis=-1)


@kernel
def specific_force_i(lat: float, speed: float, t: float) -> tuple[float, float, float]:
    """Specific force (m/s^2), inertial axes, of a ship northwards on the meridian that had longitude 0."""
    s, c = math.sin(lat), math.cos(lat)
    so, co = math.sin(EARTH_RATE * t), math.cos(EARTH_RATE * t)
    r_m, _ = radii(s)
    east = -2.0 * EARTH_RATE * s * speed
    up = normal_gravity(s, 0.0) - speed * speed / r_m
    return -so * east + c * co * up, co * east + c * so * up, s * up


@kernel
def _run(
    x: Vector,
    u: Vector,
    q: Vector,
    law: Vector,
    errors: Vector,
    lat: float,
    speed: float,
    dt: float,
    weight: float,
    stride: int,
    rows: Matrix,
) -> None:
    """Fill ``rows`` (M, _ROW), one every ``stride`` cycles; ``errors`` (7,) as in `Bench`."""
    pulses, d, inc, mid = np.empty(3), np.empty(6), np.empty(6), np.empty(M_SIZE)
    e_x, e_y, e_z = errors[0] * dt, errors[1] * dt, errors[2] * dt
    a_x, a_y, a_z = errors[3] * dt, errors[4] * dt, errors[5] * dt
    scale = weight * (1.0 + errors[6])
    q_w, q_x, q_y, q_z = q[0], q[1], q[2], q[3]
    row, step = 0, 0
    while row < rows.shape[0]:
        t = step * dt
        u[U_TURN] = modulation_turn(law, t, dt)
        torque(x, u, dt, weight, pulses)

        # the platform obeys its gyros
        t_x, t_y, t_z = pulses[0] * scale - e_x, pulses[1] * scale - e_y, pulses[2] * scale - e_z
        h_w, h_x, h_y, h_z = exponential(0.5 * t_x, 0.5 * t_y, 0.5 * t_z)
        m_w, m_x, m_y, m_z = multiply(q_w, q_x, q_y, q_z, h_w, h_x, h_y, h_z)
        q_w, q_x, q_y, q_z = multiply(m_w, m_x, m_y, m_z, h_w, h_x, h_y, h_z)
        norm = 1.0 / math.sqrt(q_w * q_w + q_x * q_x + q_y * q_y + q_z * q_z)
        q_w, q_x, q_y, q_z = q_w * norm, q_x * norm, q_y * norm, q_z * norm

        # the accelerometers stand on it; force in the middle of the cycle
        middle = lat + 0.5 * dt * speed / radii(math.sin(lat))[0]
        lat += dt * speed / radii(math.sin(middle))[0]
        f_x, f_y, f_z = specific_force_i(middle, speed, t + 0.5 * dt)
        f_x, f_y, f_z = rotate(m_w, -m_x, -m_y, -m_z, f_x, f_y, f_z)

        # the computer knows its pulses and what the accelerometers counted
        d[0], d[1], d[2] = pulses[0] * weight, pulses[1] * weight, pulses[2] * weight
        d[3], d[4], d[5] = f_x * dt + a_x, f_y * dt + a_y, f_z * dt + a_z
        increments(d, 1, inc)
        strapdown(x, inc, dt, u, mid)

        step += 1
        if step % stride == 0:
            for j in range(X_HEAD):
                rows[row, j] = x[j]
            rows[row, _T], rows[row, _LAT] = t + dt, lat
            rows[row, _QIP], rows[row, _QIP + 1] = q_w, q_x
            rows[row, _QIP + 2], rows[row, _QIP + 3] = q_y, q_z
            row += 1
