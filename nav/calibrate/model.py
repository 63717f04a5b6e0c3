"""The measurement model of n gyros and m accelerometers as equations in their coefficients.

It is the model of `nav.imu.pulses`, for sensors on any axes: over an interval in which the table showed the
angle W (3,) rad and the velocity F (3,) m/s in b,

    gyros            scale_plus * plus - scale_minus * minus = a . W + bias * T + g . F + q . P
    accelerometers   scale_plus * plus - scale_minus * minus = a . F + bias * T + q . P

"Inertial navigation", eqs. (2-27), (2-28). With scale_plus = k (1 + kappa - xi / 2), scale_minus =
k (1 + kappa + xi / 2), k the scale before, and a = a0 + B m, a0 the unit vector that the axis is about and B
(3, 2) the directions across it, every equation is linear in a sensor's coefficients kappa, xi, m, bias,
g and q. Where a0 is an axis of b, m are the textbook's misalignments and the part of a along a0 is 1.

P are integrals of products of two components of specific force, where second-order terms are asked for: of
gyros (2-13) those along two axes of b, of accelerometers the square of the one along a0 and its products with
those across it, (2-25) and IEEE Std 1293. The square of each component would be too much: over all attitudes
their sum is that of gravity, which is a bias. The table's own errors in P are left out: they are of the order
of tilt times q.

Where a unit is calibrated at several temperatures, each interval at one of its own, d degC above a reference,
scales are multiplied by 1 + c_1 d + c_2 d^2 + ... and to biases is added b_1 d + b_2 d^2 + ....

Tilt and north error of the table turn east-north-up by a small vector delta, gravity differs by a
share gamma: C_bg f_g becomes C_bg (I - [delta x]) f_g (1 + gamma), and the Earth's rate likewise. They
multiply axes and g sensitivities, as powers of temperature do scales, so that the whole is solved by
Gauss-Newton steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from nav import rotation
from nav.calibrate.intervals import Interval, Place
from nav.types import Vector

_NEAR: Final = 0.9
"""An axis with this much of it along one of b's is about that one."""
LETTERS: Final = "xyz"
NUISANCE: Final = ("tilt about east", "tilt about north", "north error", "gravity")
Shown = tuple[Vector, Vector, Vector, Vector]
"""See `Model.shown`."""


@dataclass(frozen=True, slots=True)
class Terms:
    """What is estimated besides scale, bias and axes."""

    asymmetry: bool = True
    g_sensitivity: bool = True
    second_order: bool = False
    temperature_order: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """One sensor before its calibration: its name, what it is, its nominal axis a0 and scale.

    ``axis`` (3,) is a unit vector in b; ``across`` (3, 2) two more that make it a triad, named ``toward``.
    ``scale`` is rad or m/s per pulse; ``terms`` names its coefficients in order. Towards the end each of
    ``forms`` (k, 3, 3), symmetric matrices, has one for f . form @ f; then come those of the powers 1 to
    ``temperature_order`` of temperature, of the scale and of the bias.
    """

    name: str
    gyro: bool
    axis: Vector
    across: Vector
    toward: tuple[str, str]
    scale: float
    terms: tuple[str, ...]
    forms: Vector
    temperature_order: int

    def angle_of(self, count: int) -> str:
        """Name of one of the two angles of its axis."""
        return f"axis toward {self.toward[count]}"


def sensor(name: str, gyro: bool, axis: Vector, scale: float, terms: Terms) -> Sensor:
    """A sensor about ``axis`` (3,), of any length, with ``scale`` SI per pulse.

    Raises:
        ValueError: no axis, or a scale of zero.
    """
    length = float(np.linalg.norm(axis))
    if not (length > 0.0 and np.isfinite(length)):
        raise ValueError(f"{name}: expected an axis that is not zero")
    if scale == 0.0:
        raise ValueError(f"{name}: expected a scale that is not zero")
    unit = np.asarray(axis) / length
    near = int(np.argmax(np.abs(unit)))
    if abs(unit[near]) > _NEAR:
        unit = np.sign(unit[near]) * np.eye(3)[near]
        others = [k for k in range(3) if k != near]
        across, toward = np.eye(3)[:, others], (LETTERS[others[0]], LETTERS[others[1]])
    else:
        first = np.cross(np.eye(3)[int(np.argmin(np.abs(unit)))], unit)
        first /= np.linalg.norm(first)
        second = np.cross(unit, first)
        across = np.stack((first, second), axis=1)
        toward = (_direction(first), _direction(second))
    named = ["scale"]
    if terms.asymmetry:
        named.append("asymmetry")
    named += [f"axis toward {where}" for where in toward]
    named.append("bias")
    if gyro and terms.g_sensitivity:
        named += [f"g sensitivity {letter}" for letter in LETTERS]
    forms: dict[str, Vector] = {}
    if terms.second_order and gyro:
        b = np.eye(3)
        forms = {f"product {LETTERS[j]}{LETTERS[k]}": _form(b[j], b[k]) for j, k in ((1, 2), (2, 0), (0, 1))}
    elif terms.second_order:
        forms = {"square": _form(unit, unit)}
        forms |= {f"product toward {where}": _form(unit, across[:, k]) for k, where in enumerate(toward)}
    named += forms
    order = terms.temperature_order
    named += [f"{what} temperature {j}" for what in ("scale", "bias") for j in range(1, order + 1)]
    matrices = np.array(list(forms.values())).reshape(-1, 3, 3)
    return Sensor(name, gyro, unit, across, toward, scale, tuple(named), matrices, order)


def _form(a: Vector, b: Vector) -> Vector:
    """The symmetric matrix (3, 3) with f . form @ f = (a . f) (b . f)."""
    return 0.5 * (np.outer(a, b) + np.outer(b, a))


def _direction(v: Vector) -> str:
    return "(" + " ".join(f"{value:+.2f}" for value in v) + ")"


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Sensors on a table at a place; gyros first, in the order of the counts.

    The unknowns are every sensor's ``terms`` in order, then `NUISANCE`. Scales and biases are those at
    ``reference`` degC where there are terms in temperature.
    """

    sensors: tuple[Sensor, ...]
    place: Place
    reference: float = 0.0
    names: tuple[str, ...] = field(init=False)
    parts: tuple[slice, ...] = field(init=False)

    def __post_init__(self) -> None:
        names: list[str] = []
        parts = []
        for one in self.sensors:
            parts.append(slice(len(names), len(names) + len(one.terms)))
            names += [f"{one.name} {term}" for term in one.terms]
        object.__setattr__(self, "names", (*names, *NUISANCE))
        object.__setattr__(self, "parts", tuple(parts))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.names)

    @property
    def prior(self) -> Vector:
        """One sigma (4,) of `NUISANCE` before."""
        p = self.place
        return np.array([p.tilt, p.tilt, p.north, p.gravity_sigma])

    def used(self, one: Sensor, intervals: Sequence[Interval]) -> list[int]:
        """Intervals that say something about a sensor: accelerometers are not asked while the table turns."""
        return [k for k, interval in enumerate(intervals) if one.gyro or not interval.rotation]

    def shown(self, interval: Interval, theta: Vector) -> Shown:
        """W (3,) rad, F (3,) m/s of an interval, and their derivatives (3, 4) by `NUISANCE`."""
        delta, gamma = theta[-4:-1], theta[-1]
        C = rotation.dcm_from_quat(rotation.quat_from_rotvec(delta)).T
        w, f = C @ self.place.w_g, C @ self.place.f_g
        M = interval.attitude
        W = interval.turned + M @ w
        F = M @ f * (1.0 + gamma)
        dW = np.concatenate((M @ rotation.skew(w), np.zeros((3, 1))), axis=1)
        dF = np.concatenate((M @ rotation.skew(f) * (1.0 + gamma), (M @ f)[:, None]), axis=1)
        return W, F, dW, dF

    def axis(self, place: int, theta: Vector) -> Vector:
        """What sensor number ``place`` sees of a unit input along each axis of b, (3,)."""
        one = self.sensors[place]
        m = [theta[self.index(place, one.angle_of(k))] for k in (0, 1)]
        return np.asarray(one.axis + one.across @ m)

    def index(self, place: int, term: str) -> int:
        """Where a term of sensor number ``place`` is among the unknowns."""
        return int(self.parts[place].start) + self.sensors[place].terms.index(term)

    def rows(
        self, place: int, intervals: Sequence[Interval], shown: Sequence[Shown], theta: Vector
    ) -> tuple[Vector, Vector]:
        """Residuals (k,) of sensor number ``place`` over ``intervals``, and their derivatives (k, size).

        SI: what the counts say minus what the table showed (`shown`, of each), of gyros rad, of
        accelerometers m/s.
        """
        one, part = self.sensors[place], self.parts[place]
        own = theta[part]
        a = self.axis(place, theta)
        residual, jacobian = np.empty(len(intervals)), np.zeros((len(intervals), self.size))
        for k, (interval, (W, F, dW, dF)) in enumerate(zip(intervals, shown, strict=True)):
            seen, slopes = (W, dW) if one.gyro else (F, dF)
            plus, minus = one.scale * interval.plus[place], one.scale * interval.minus[place]
            by = one.temperature_order
            powers = (interval.temperature - self.reference) ** np.arange(1.0, by + 1.0)
            growth, drift = (
                1.0 + own[len(own) - 2 * by : len(own) - by] @ powers,
                own[len(own) - by :] @ powers,
            )
            columns = [growth * (plus - minus)]
            if "asymmetry" in one.terms:
                columns.append(-0.5 * growth * (plus + minus))
            first = len(columns)
            counted = columns[0] + np.array(columns) @ own[:first]
            columns += list(-one.across.T @ seen)
            columns.append(-interval.seconds)
            nuisance = -a @ slopes
            if "g sensitivity x" in one.terms:
                nuisance = nuisance - own[len(columns) : len(columns) + 3] @ dF
                columns += list(-F)
            columns += list(np.einsum("kij,ij->k", one.forms, -(self.place.gravity**2) * interval.squares))
            felt = one.axis @ seen + drift * interval.seconds
            residual[k] = counted - felt + np.array(columns[first:]) @ own[first : len(columns)]
            columns += [*(counted / growth * powers), *(-interval.seconds * powers)]
            jacobian[k, part] = columns
            jacobian[k, -4:] = nuisance
        return residual, jacobian

    def expected(self, intervals: Sequence[Interval]) -> list[Interval]:
        """The same intervals with the pulses, not whole, of sensors that have nominal axes and scales."""
        theta = np.zeros(self.size)
        found = []
        for interval in intervals:
            W, F, _, _ = self.shown(interval, theta)
            N = np.array([one.axis @ (W if one.gyro else F) / one.scale for one in self.sensors])
            found.append(replace(interval, plus=np.maximum(N, 0.0), minus=-np.minimum(N, 0.0)))
        return found
