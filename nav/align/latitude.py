"""A latitude that is not quite what it was said to be: seen in how gravity turns, and allowed for.

In inertial axes gravity goes round a cone about the Earth's axis, whose half angle is the colatitude. Told of
another latitude, the constant matrix of `nav.align.constant` comes out as a rotation times a stretch, longer
about the axis and shorter along it, or the other way round. Gyro biases do nearly the same, so what the data
say of it is worth what gyros are; and where it goes unseen, their biases and the level take it up. So some
error of latitude is always allowed for, an unknown like theirs, which costs the level a few microradians; and
as much more as is seen of it beyond chance, until that speaks against the answer.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.apparent import cross_matrix, polar_axis
from nav.align.constant import MAT, START, Estimate, Solved, attitude_of_all
from nav.earth import normal_gravity
from nav.rotation import skew
from nav.types import Vector

USUAL: Final = math.radians(0.05)  # that is allowed for where nothing is seen of it
CHANCE: Final = 2.0  # sigma of what is seen
UNSURE: Final = math.radians(0.1)  # what is seen worse, or is less, does not speak against the answer
DOUBT: Final = 3.3  # sigma beyond which it is more than that: 99.9 %
_LEAST: Final = 1e-3  # of a sine or cosine: on the equator nothing is seen of the stretch along the axis
_STEP: Final = 1e-3  # rad
_CROSS: Final = skew(np.eye(3))


class Latitude(NamedTuple):
    """How far latitude is off what was said by what is seen, rad, with its standard deviation."""

    off: float
    sigma: float


def contradiction(seen: Latitude, else_: str) -> str | None:
    """What to say where that is more than is allowed for, and seen well; or None.

    A gyro that fails turns gravity as a latitude does; ``else_`` says what else may look like one.
    """
    if seen.sigma > UNSURE or abs(seen.off) <= DOUBT * math.hypot(seen.sigma, UNSURE):
        return None
    return (
        f"gravity turns as it does {abs(math.degrees(seen.off)):.2f} deg further "
        f"{'north' if seen.off > 0.0 else 'south'}: the latitude, a gyro or calibration is wrong, or {else_}"
    )


def _stretch(lat: float) -> Vector:
    """What gravity's images are longer by, (3, 3) in i0 per rad of latitude; gravity grows poleward."""
    sine, cosine = math.sin(lat), math.cos(lat)
    ahead, behind = (normal_gravity(math.sin(lat + step), 0.0) for step in (_STEP, -_STEP))
    grown = (ahead - behind) / (2.0 * _STEP * normal_gravity(sine, 0.0))
    along = cosine / math.copysign(max(abs(sine), _LEAST), sine)
    around = -sine / max(cosine, _LEAST)
    axis = polar_axis(lat)
    return np.asarray((grown + around) * np.eye(3) + (along - around) * np.outer(axis, axis))


def solve(e: Estimate, lat: float, C_i0g: Vector, once: Vector) -> tuple[Solved, Latitude] | None:
    """`attitude_of_all` where ``lat`` (rad) of the start may be off, and how far it is; None: not known yet.

    The rotation is that which takes ``C_i0g`` (3, 3) of the present, made with ``lat``, to true axes now;
    ``once`` (3,) m/s is gravity's integral up to now, in i0. What latitude makes of a velocity by it goes
    into the velocity at the start.
    """
    first = attitude_of_all(e)
    if first is None:
        return None
    # i0 turns about the east of the present, so that the axes of the present stay
    by = first.C @ (cross_matrix(C_i0g[:, 0]) + _stretch(lat))
    seen = _seen(e, first.C, by.ravel())
    c = np.zeros(len(e.x))
    c[MAT], c[START] = by.ravel(), by @ once
    beyond = max(0.0, seen.off**2 - (CHANCE * seen.sigma) ** 2) if math.isfinite(seen.sigma) else 0.0
    found = attitude_of_all(e._replace(P=e.P + (USUAL**2 + beyond) * np.outer(c, c)))
    return None if found is None else (found, seen)


def _seen(e: Estimate, C: Vector, by: Vector) -> Latitude:
    """From what the elements miss the rotation ``C`` by, along ``by`` (9,) per rad."""
    weight = np.linalg.inv(e.P[MAT, MAT])
    true = weight - e.feigned
    J = np.column_stack([(_CROSS @ C).reshape(3, 9).T, by])
    A = J.T @ true @ J
    told = J.T @ (weight @ e.x[MAT] - true @ C.ravel())
    across = np.linalg.solve(A[0:3, 0:3], A[0:3, 3])
    information = float(A[3, 3] - A[3, 0:3] @ across)
    if information <= 0.0:
        return Latitude(0.0, math.inf)
    return Latitude(float(told[3] - across @ told[0:3]) / information, 1.0 / math.sqrt(information))
