"""What was counted while the table rested or turned, and what is known of that time.

An interval is reduced to sums before anything is fitted. Pulses are summed by their sign, because a pulse
that counts up and one that counts down differ in size: with ``plus`` and ``minus`` the sums of positive and
of negative counts (both as positive numbers), the compensation of `nav.imu.pulses` gives over the interval
scale_plus * plus - scale_minus * minus, whatever the samples were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from nav import rotation
from nav.earth import EARTH_RATE, earth_rate_g, normal_gravity
from nav.types import Vector

_GRAVITY: Final = 9.80665  # m/s^2, near enough for a sigma
_SAME: Final = 0.1  # of an attitude: neighbours in a plan are further apart


def _none() -> Vector:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """One position or rotation: sums of n gyros and m accelerometers, and where the table was.

    ``begin`` and ``seconds`` in s; ``turned`` (3,) rad, in b, is what the table turned through;
    ``attitude`` (3, 3) s the integral of C_bg over the interval, ``squares`` (3, 3) s that of u u^T, u being
    the direction up in b, both as planned. ``plus``, ``minus`` hold pulses, (n + m,) gyros first; they are
    empty in an interval that is only planned. ``temperature`` degC is the mean, NaN where nobody said.
    """

    name: str
    rotation: bool
    begin: float
    seconds: float
    turned: Vector
    attitude: Vector
    squares: Vector
    plus: Vector = field(default_factory=_none)
    minus: Vector = field(default_factory=_none)
    temperature: float = math.nan


@dataclass(frozen=True, slots=True)
class Place:
    """Where the table stands, latitude rad and gravity m/s^2, and how well that is known.

    One sigma: ``tilt`` rad about east and about north, ``north`` rad about up, ``gravity_sigma`` relative.
    """

    lat: float
    gravity: float
    tilt: float
    north: float
    gravity_sigma: float

    @property
    def w_g(self) -> Vector:
        """Earth rate (3,) rad/s in east, north, up."""
        return earth_rate_g(self.lat)

    @property
    def f_g(self) -> Vector:
        """Specific force (3,) m/s^2 of what rests, in east, north, up."""
        return np.array([0.0, 0.0, self.gravity])


def place_at(lat: float, height: float, gravity: float | None, sigmas: tuple[float, float, float]) -> Place:
    """A place by latitude (rad) and height (m), with normal gravity where none was measured.

    ``sigmas`` are those of tilt and north (rad) and of gravity (m/s^2).
    """
    g = float(normal_gravity(math.sin(lat), height)) if gravity is None else gravity
    return Place(lat, g, sigmas[0], sigmas[1], sigmas[2] / g)


def sums(counts: Vector) -> tuple[Vector, Vector]:
    """Sums by sign (n,), both positive, of ``counts`` (k, n) pulses."""
    return np.maximum(counts, 0.0).sum(axis=0), -np.minimum(counts, 0.0).sum(axis=0)


def resting(C_gb: Vector, seconds: float) -> tuple[Vector, Vector]:
    """Integrals of C_bg and of u u^T, each (3, 3) s, over a rest in attitude ``C_gb``."""
    up = np.asarray(C_gb)[2]
    return np.asarray(C_gb).T * seconds, np.outer(up, up) * seconds


def turning(C_gb: Vector, turned: Vector, angle: Vector, dt: Vector) -> tuple[Vector, Vector]:
    """Both integrals while the table turns by ``turned`` (3,) rad out of attitude ``C_gb``.

    ``angle`` (k + 1,) is how far it has come at the ends of k samples, in any unit and with any error of
    scale: the last value is the whole angle. ``dt`` (k,) s is how long they are.
    """
    share = (angle - angle[0]) / (angle[-1] - angle[0])
    middle = 0.5 * (share[1:] + share[:-1])
    C = rotation.dcm_from_quat(rotation.quat_from_rotvec(np.outer(middle, turned)))
    up = np.asarray(C_gb)[2] @ C
    return (
        np.asarray(np.einsum("kji,k->ij", C, dt) @ np.asarray(C_gb).T),
        np.asarray(np.einsum("ki,kj,k->ij", up, up, dt)),
    )


def unsure(intervals: Sequence[Interval], axis: Vector, gyro: bool, attitude: float, turn: float) -> Vector:
    """Covariance (k, k) that a table which does not stand or turn as told adds to the sums of one sensor, SI.

    ``axis`` (3,) is the sensor's; ``attitude`` rad is one sigma of an attitude about each axis of b, the same
    every time that the table takes it up, ``turn`` rad that of the angle of a rotation.
    """
    seconds = np.array([one.seconds for one in intervals])
    turned = np.array([one.turned for one in intervals]).reshape(-1, 3)
    mean = np.array([one.attitude / one.seconds for one in intervals]).reshape(-1, 3, 3)
    seen = turned if gyro else _GRAVITY * seconds[:, None] * mean[:, :, 2]
    across = attitude * np.cross(seen, axis)
    apart = np.abs(mean[:, None] - mean[None]).max(axis=(2, 3))
    out = across @ across.T
    if gyro:  # and the Earth's rate, wherever it points
        earth = attitude * np.sqrt(2.0 / 3.0) * EARTH_RATE * seconds
        out += np.outer(earth, earth)
    out = np.where(apart < _SAME, out, 0.0)
    if gyro:
        angle = np.linalg.norm(turned, axis=1)
        out += np.diag((turn * (turned @ axis) / np.where(angle > 0.0, angle, 1.0)) ** 2)
    return np.asarray(out)


def covariance(
    intervals: Sequence[Interval], walk: float, instability: float, correlation: float, pulse: float
) -> Vector:
    """Covariance (k, k) of one sensor's sums over the intervals, in its output unit squared.

    White noise of density ``walk``, a Gauss-Markov process of sigma ``instability`` and time ``correlation``
    s in its steady state, and rounding to whole pulses of size ``pulse`` at either end.
    """
    begin = np.array([one.begin for one in intervals])
    length = np.array([one.seconds for one in intervals])
    x = length / correlation
    gap = np.maximum(begin[:, None] - (begin + length)[None, :], 0.0)
    lag = np.maximum(gap, gap.T) / correlation
    part = -np.expm1(-x)
    between = np.exp(-lag) * np.outer(part, part)
    np.fill_diagonal(between, 2.0 * (x + np.expm1(-x)))
    out = (instability * correlation) ** 2 * between
    out[np.diag_indices_from(out)] += walk**2 * length + pulse**2 / 6.0
    return np.asarray(out)
