"""The gimballed (semi-analytic) platform navigator, as a way of feeding the strapdown kernel.

Gyros and accelerometers sit on a platform that its servos hold on the gyros' nulls, so it turns as the gyros
are torqued. The navigation computer torques them with the rate of n, and the platform's axes p are n. What
it has sent is what it knows of the platform's motion: the torqued angle takes the place of the strapdown
gyros' increments, the accelerometers' increments along p that of the body's, and `nav.strapdown.kernels`
does the rest. Its attitude ``q_np`` then holds what whole pulses and the lag of a cycle have left, and
the next command takes that away. Turning the platform about the vertical is a rate of n (U_TURN, U_FREE).

A cycle of the computer, with ``dt`` its length:

1. ``u[U_TURN] = modulation_turn(law, t, dt)``
2. ``torque(x, u, dt, weight, pulses)``: pulses for the torquers during the cycle
3. at its end ``increments`` of ``pulses * weight`` and the accelerometers' increments, then ``strapdown``

Signs: wander and platform azimuth are counter-clockwise from north seen from above, headings and the gimbal
azimuth clockwise. Sources: Zhao Wangyang et al., "Research on High-Latitude Work of Semi-Analytical Inertial
Navigation System Based on Platform Modulation", Dynamical Systems and Control 10(4), 2021, 211-220 ("Zhao"
below), corrected where it says so; textbook chapter "Inertial navigation", section on the platform's command
rates, eq. (2-65).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav.earth import EARTH_RATE, curvature, radii
from nav.jit import kernel
from nav.polar import Frame, view_n
from nav.rotation import dcm_from_quat, exponential, logarithm, multiply
from nav.strapdown.control import U_WC
from nav.strapdown.kernels import vertical_rate

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SWING_AMPLITUDE: Final = 2.404825557695773
"""First zero of the Bessel function J0, rad: a sine of this amplitude averages e^{ik} to nothing."""


class Modulation(NamedTuple):
    """How the platform is turned about the vertical, relative to the wander-azimuth n.

    Its azimuth k, counter-clockwise, starts at zero and follows
    ``k' = -free w_ie sin L + rate + d/dt [amplitude (cos(frequency t) - 1)]``; ``rate`` and ``frequency``
    in rad/s, ``amplitude`` in rad. With ``free`` = 1 the azimuth gyro is torqued with the rest alone.
    """

    free: float = 0.0
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0

    @property
    def array(self) -> Vector:
        """The same (4,) for `modulation_turn`."""
        return np.array(self)


def uniform(rate: float) -> Modulation:
    """Turning at ``rate`` (rad/s, counter-clockwise) with respect to the Earth."""
    return Modulation(rate=rate)


def zhao(rate: float) -> Modulation:
    """Zhao, eq. (19): ``|k'| = w_ie sin L + rate``, in the sense of ``rate`` (rad/s).

    Printed with sin L on the rate too and as 1 deg/s; the text's 60 deg/h are 1 deg/min. A negative rate
    is the equation with k as in eq. (4): the azimuth gyro is torqued with ``rate`` alone. A positive one is
    it with k counted clockwise.
    """
    return Modulation(free=-math.copysign(1.0, rate), rate=rate)


def swing(period: float) -> Modulation:
    """To and fro, sinusoidal, ``period`` s: averages level errors without ever making a whole turn.

    ``k = A (cos(2 pi t / period) - 1)`` with J0(A) = 0, A = 137.8 deg, so the mean of cos k and of sin k is
    zero. It begins at a turning point, where the integrals of both are in the middle of their range and the
    rate is zero: no jump of the torquing rate, ever. The azimuth torqued comes back every period, so an
    error of the torquer's scale stays below 2 A times it, where a platform that turns one way drifts. A
    period well below Schuler's also takes the accelerometers' biases away, which no slower turning does.
    Peak rate: A times the frequency.
    """
    return Modulation(amplitude=SWING_AMPLITUDE, frequency=2.0 * math.pi / period)


@kernel
def modulation_turn(law: Vector, t: float, dt: float) -> float:
    """Mean over the ``dt`` seconds from ``t`` (s) of the turn rate of a `Modulation`, rad/s, for U_TURN.

    ``law`` (4,) is its ``array``; U_FREE takes its first place.
    """
    wave = math.cos(law[3] * (t + dt)) - math.cos(law[3] * t)
    return float(law[1] + law[2] * wave / dt)


def command_rate_g(lat: float, height: float, azimuth: float, v_p: ArrayLike, turn: float = 0.0) -> Vector:
    """Command rate w_ip_p (3,), rad/s, from latitude and azimuth: the readable twin of `command_rate`.

    ``lat`` rad, ``height`` m, ``azimuth`` rad of the platform (wander angle or k), ``v_p`` (3,) m/s along p,
    ``turn`` rad/s the vertical transport rate: 0 for wander, eqs. (10), (11) of Zhao, else eqs. (23) to (25).
    Corrected: (10), (11) are printed with ``cos^2/R_M - sin^2/R_N``; (23), (24) with the sign of 1/R_py and
    the radii exchanged; the vertical command is missing in (25).
    """
    v = np.asarray(v_p, dtype=np.float64)
    r_m, r_n = (r + height for r in radii(math.sin(lat)))
    s, c = math.sin(azimuth), math.cos(azimuth)
    of_x, of_y = s * s / r_m + c * c / r_n, c * c / r_m + s * s / r_n  # 1/R_px and 1/R_py
    torsion = (1.0 / r_n - 1.0 / r_m) * s * c
    earth = EARTH_RATE * math.cos(lat)
    return np.array(
        [
            earth * s + torsion * v[0] - of_y * v[1],
            earth * c + of_x * v[0] - torsion * v[1],
            EARTH_RATE * math.sin(lat) + turn,
        ]
    )


@kernel
def command_rate(x: Vector, u: Vector) -> tuple[float, float, float]:
    """Command rate w_in_n + w_c (rad/s) of the state at the head of ``x`` under control vector ``u``.

    In the axes of n, regular at the poles. Textbook chapter "Inertial navigation", eq. (2-65).
    """
    ex, ey, ez, h, vx, vy = x[13], x[14], x[15], x[16], x[4], x[5]
    kxx, kxy, kyy = curvature(ex, ey, ez, h)
    tx, ty = -kxy * vx - kyy * vy, kxx * vx + kxy * vy
    return (
        EARTH_RATE * ex + tx + u[U_WC],
        EARTH_RATE * ey + ty + u[U_WC + 1],
        EARTH_RATE * ez + vertical_rate(u, ex, ey, ez, tx, ty) + u[U_WC + 2],
    )


@kernel
def torque(x: Vector, u: Vector, dt: float, weight: float, pulses: Vector) -> None:
    """Torquing command of the coming cycle: whole ``pulses`` (3,) of ``weight`` rad, along p.

    The angle that turns the platform from where the state ``x`` knows it (q_np) onto n as it will stand after
    ``dt`` seconds. What rounding leaves stays in q_np and is in the next command: pulses are never lost.
    """
    cx, cy, cz = command_rate(x, u)
    w, i, j, k = exponential(cx * dt, cy * dt, cz * dt)
    w, i, j, k = multiply(x[0], -x[1], -x[2], -x[3], w, i, j, k)
    rx, ry, rz = logarithm(w, i, j, k)
    pulses[0], pulses[1], pulses[2] = np.rint(rx / weight), np.rint(ry / weight), np.rint(rz / weight)


def gimbal_matrix(gimbal_azimuth: ArrayLike) -> Matrix:
    """C_pf (..., 3, 3): the axes of the gimbals' torque motors f to platform axes p, base level.

    ``gimbal_azimuth`` k (...) rad is the vehicle's heading from the platform's y axis, clockwise. Gyro axes
    and motor axes are parallel at k = 0 alone; to torque ``w_p`` the motors must turn ``C_pf.T @ w_p``. Zhao,
    eqs. (1) to (3); (3) is printed as taking p to f, but is that of eq. (2).
    """
    k = np.asarray(gimbal_azimuth, dtype=np.float64)
    s, c, zero, one = np.sin(k), np.cos(k), np.zeros_like(k), np.ones_like(k)
    rows = ((c, s, zero), (-s, c, zero), (zero, zero, one))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def heading_n(q_np: ArrayLike, gimbal_azimuth: ArrayLike) -> Vector:
    """Vehicle's heading (...) rad from the y axis of n, clockwise, not wrapped.

    ``gimbal_azimuth`` (...) rad as in `gimbal_matrix`, read off the azimuth gimbal; ``q_np`` (..., 4) is
    what the computer knows the platform to be off n by.
    """
    C_np = dcm_from_quat(q_np)
    return np.asarray(np.asarray(gimbal_azimuth) + np.arctan2(C_np[..., 0, 1], C_np[..., 1, 1]))


def true_heading(C_en: ArrayLike, q_np: ArrayLike, gimbal_azimuth: ArrayLike) -> Vector:
    """Heading (...) rad in [0, 2 pi) from true north: `heading_n` less the wander angle in ``C_en``.

    Has no meaning at a pole. Zhao, eq. (17), printed with plus, which is for angles of one sense; its eq.
    (4) makes the wander angle counter-clockwise.
    """
    return _heading(Frame.GEOGRAPHIC, C_en, q_np, gimbal_azimuth)


def grid_heading(C_en: ArrayLike, q_np: ArrayLike, gimbal_azimuth: ArrayLike) -> Vector:
    """Heading (...) rad in [0, 2 pi) from grid north, regular at the poles. Zhao, eq. (29)."""
    return _heading(Frame.GRID, C_en, q_np, gimbal_azimuth)


def _heading(frame: Frame, C_en: ArrayLike, q_np: ArrayLike, gimbal_azimuth: ArrayLike) -> Vector:
    angle = heading_n(q_np, gimbal_azimuth)
    return view_n(frame, C_en, angle, np.zeros((*angle.shape, 3))).heading


def heading_drift(t: ArrayLike, lat: float, gyro_bias: ArrayLike, rate: float = 0.0) -> Vector:
    """Heading error (...) rad, clockwise positive, at times ``t`` (...) s after a start without errors.

    At rest at ``lat`` (rad), platform east-north-up at the start and turning at ``rate`` (rad/s,
    counter-clockwise from above, with respect to the Earth); ``gyro_bias`` (3,) rad/s along p is what the
    gyros read too much. Free of Schuler's oscillation, which averages the tilts to nothing: the platform
    drifts against the computed frame in inertial space, and heading sees the drift about the level line in
    the equator's plane, sec L times. Derived for this program. With ``rate`` = 0 its largest value is
    `heading_limit`.
    """
    t = np.asarray(t, dtype=np.float64)
    s, c = math.sin(lat), math.cos(lat)
    e_x, e_y, e_z = (float(e) for e in np.asarray(gyro_bias, dtype=np.float64))
    level = complex(e_x, e_y)
    # p' = -i w_ie p - e1 - i e2 in axes 1 (in the equator's plane, away from the axis) and 2 (east)
    drift = -0.5 * (1.0 + s) * level * _forced(t, rate)
    drift = drift - 0.5 * (1.0 - s) * level.conjugate() * _forced(t, -rate)
    drift = drift + 1j * e_z * c * _forced(t, 0.0)
    # phi_U turns the platform counter-clockwise: what is read off it is too large by as much
    return np.asarray(drift.real / c)


def _forced(t: Vector, rate: float) -> NDArray[np.complex128]:
    """``(e^{i rate t} - e^{-i w_ie t}) / (rate + w_ie)``, regular where they resonate."""
    half = 0.5 * (rate + EARTH_RATE)
    beat = np.exp(0.5j * (rate - EARTH_RATE) * t)
    return np.asarray(1j * beat * t * np.sinc(half * t / math.pi))


def heading_limit(lat: float, gyro_bias: ArrayLike) -> float:
    """Largest heading error (rad) of a day at rest at ``lat`` (rad) of a platform that is not turned.

    ``gyro_bias`` (3,) rad/s east, north, up, no errors at the start. Derived for this program:
    `heading_drift` at its extreme, ``sec L / w_ie (|e_E| + sqrt(e_E^2 + (e_N sin L - e_U cos L)^2))``.
    """
    east, north, up = (float(e) for e in np.asarray(gyro_bias, dtype=np.float64))
    level = north * math.sin(lat) - up * math.cos(lat)
    return (abs(east) + math.hypot(east, level)) / (EARTH_RATE * math.cos(lat))
