"""Pulse counts of gyros and accelerometers, and the increments of angle and velocity they stand for.

The measurement model is the textbook's, "Inertial navigation", eqs. (2-27), (2-28); its inverse, the
compensation, is eqs. (2-190) to (2-193), with the sampling interval restored before the g-sensitive
drift in (2-191). Per sensor, with f the specific force and w the rate in b, over an interval tau:

    accelerometers   scale * N_a = (axes_a @ f + bias_a + q_a(f)) tau
    gyros            scale * N_g = (axes_g @ w + bias_g + g_sensitivity @ f + q_g(f)) tau

where ``scale`` is one number for positive and another for negative counts. The second-order terms are

    q(f) = square @ (f_x f_x, f_y f_y, f_z f_z) + product @ (f_y f_z, f_z f_x, f_x f_y)

and scales and biases are polynomials in temperature (`Thermal`). There are no classes of instruments: what
the text has of each is which of these coefficients are not zero.

    instrument                      equations        bias  scale  axes  g_sensitivity  second order
    dynamically tuned gyro          (2-13) to (2-15)  x     x      x     x             product: B_axz f_x f_z
    ring-laser gyro                 (2-23), (2-24)    x     x      x
    fibre gyro                      (2-23), (2-24)    x     x      x                   and their temperature
    quartz pendulous accelerometer  (2-25), (2-26)    x     x      x                   product: B_y f_x f_y

The squares are in the models of IEEE Std 1293 (K_2 of accelerometers) and 813 (dynamically tuned gyros).

Of f over an interval its mean is known, dv / tau, and q is taken of that. What is left out is each
coefficient times the covariance of two components of f over the interval: d_i d_j / 12 where f changes by d
in a straight line, a_i a_j / 2 for a vibration of amplitude a faster than the samples, which no increment
shows.
Beyond `RANGE` q is that of the nearest f within, so that every count has its increments and the other way
round.

Accelerometers are inverted by f = axes^-1 (y - q(f)), y being what the sensors read without bias. That map
shrinks distances by |axes^-1| times the largest slope of q, which the root of 12 Q bounds, Q the sum of
squares of all entries of the three symmetric matrices of q, times `RANGE`. A calibration for which this is
more than `CONTRACTION` is refused: `PASSES` then leave nothing of an error that 52 bits could show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from nav.jit import in_place
from nav.types import Vector

RANGE: Final = 981.0
"""Specific force (m/s^2) up to which second-order terms grow: the widest range of Table 2-5 in use, 100 g."""
CONTRACTION: Final = 0.25
"""So much of an error at most a pass over the accelerometers' second-order terms may leave."""
PASSES: Final = 26
"""As many bits a double has, at two a pass."""
_ROUNDING: Final = 2.0**-52
_SMALLEST_TRIPLE_PRODUCT: Final = 1e-3

# places in a table; with second-order terms it goes on after the plain part
_PLAIN: Final = 45
_GYRO_SECOND: Final = 45
_ACCEL_SECOND: Final = 63


def _zeros() -> Vector:
    return np.zeros(3)


def _square() -> Vector:
    return np.zeros((3, 3))


def _eye() -> Vector:
    return np.eye(3)


def _none() -> Vector:
    return np.zeros((3, 0))


def coefficient(name: str, given: object, shape: tuple[int, ...], zero: bool = False) -> Vector:
    """Error coefficients called ``name`` as an array of ``shape``.

    Raises ValueError for another shape, a value that is not finite or, but for ``zero``, a scale of zero.
    """
    value = np.array(given, dtype=np.float64)
    if value.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, found {value.shape}")
    if not np.all(np.isfinite(value)):
        raise ValueError(f"{name}: a value is not finite")
    if "scale" in name and not zero and np.any(value == 0.0):
        raise ValueError(f"{name}: a scale of zero")
    return value


@dataclass(frozen=True, slots=True, eq=False)
class Thermal:
    """How scales and biases of three gyros and three accelerometers go with temperature.

    With d degC above ``reference`` a scale is multiplied by 1 + c_1 d + c_2 d^2 + ..., and to a bias is added
    b_1 d + b_2 d^2 + ...; the columns of ``gyro_scale``, ``accel_scale`` (1 per degC^j), ``gyro_bias`` (rad/s
    per degC^j) and ``accel_bias`` (m/s^2 per degC^j), each (3, as many as there are), are these coefficients.
    They hold from ``lowest`` to ``highest`` degC; beyond, what holds at that end.

    Raises ValueError for a wrong shape, a value that is not finite, a reference that is not in the range, or
    where a scale might become zero in it.
    """

    reference: float
    lowest: float
    highest: float
    gyro_scale: Vector = field(default_factory=_none)
    gyro_bias: Vector = field(default_factory=_none)
    accel_scale: Vector = field(default_factory=_none)
    accel_bias: Vector = field(default_factory=_none)

    def __post_init__(self) -> None:
        if not -math.inf < self.lowest <= self.reference <= self.highest < math.inf:
            raise ValueError(
                f"reference temperature: expected one in the range {self.lowest:g} to {self.highest:g} degC, "
                f"found {self.reference:g}"
            )
        furthest = max(self.highest - self.reference, self.reference - self.lowest)
        for name in ("gyro_scale", "gyro_bias", "accel_scale", "accel_bias"):
            given = np.asarray(getattr(self, name), dtype=np.float64)
            value = coefficient(name, given, (3, given.shape[-1] if given.ndim else 0), zero=True)
            change = np.abs(value) @ furthest ** np.arange(1.0, value.shape[1] + 1.0)
            if name.endswith("scale") and np.any(change >= 1.0):
                raise ValueError(f"{name}: it may become zero between the lowest and the highest temperature")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def powers(self, temperature: float, order: int) -> Vector:
        """Powers 1 to ``order`` of ``temperature`` degC, or the nearest in the range, from the reference."""
        away = min(max(temperature, self.lowest), self.highest) - self.reference
        return np.asarray(away ** np.arange(1.0, order + 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Error coefficients of one IMU of three gyros and three accelerometers, SI units.

    ``gyro_scale_plus``, ``gyro_scale_minus`` (3,) rad per pulse for positive and negative counts,
    ``accel_scale_plus``, ``accel_scale_minus`` (3,) m/s per pulse; ``gyro_bias`` (3,) rad/s,
    ``accel_bias`` (3,) m/s^2; ``gyro_g`` (3, 3) rad/s per m/s^2, row: gyro, column: axis of f in b;
    ``gyro_axes``, ``accel_axes`` (3, 3): row i is what sensor i sees of a unit input along each axis of b,
    so the diagonal is 1 and the rest the misalignment in radians where the sensors are nearly along b (any
    non-singular arrangement is allowed). ``accel_arms`` (3, 3) m: row i is where accelerometer i sits, from
    the origin of b; what that costs is taken off in `nav.imu.size_effect`.

    ``gyro_square``, ``gyro_product`` (3, 3) rad/s per (m/s^2)^2, ``accel_square``, ``accel_product`` (3, 3)
    m/s^2 per (m/s^2)^2, are the second-order terms; row: sensor, column: f_x^2, f_y^2, f_z^2, or f_y f_z,
    f_z f_x, f_x f_y in b. With ``thermal`` scales and biases are those at its reference temperature.

    Raises ValueError for a wrong shape, a value that is not finite, a zero scale, dependent axes or
    second-order terms of accelerometers so large that they have no inverse.
    """

    gyro_scale_plus: Vector
    accel_scale_plus: Vector
    gyro_scale_minus: Vector | None = None
    accel_scale_minus: Vector | None = None
    gyro_bias: Vector = field(default_factory=_zeros)
    accel_bias: Vector = field(default_factory=_zeros)
    gyro_g: Vector = field(default_factory=_square)
    gyro_axes: Vector = field(default_factory=_eye)
    accel_axes: Vector = field(default_factory=_eye)
    accel_arms: Vector = field(default_factory=_square)
    gyro_square: Vector = field(default_factory=_square)
    gyro_product: Vector = field(default_factory=_square)
    accel_square: Vector = field(default_factory=_square)
    accel_product: Vector = field(default_factory=_square)
    thermal: Thermal | None = None

    def __post_init__(self) -> None:
        if self.gyro_scale_minus is None:
            object.__setattr__(self, "gyro_scale_minus", self.gyro_scale_plus)
        if self.accel_scale_minus is None:
            object.__setattr__(self, "accel_scale_minus", self.accel_scale_plus)
        for name in self.__slots__:
            if name == "thermal":
                continue
            shape = (3,) if name.endswith(("_plus", "_minus", "_bias")) else (3, 3)
            value = coefficient(name, getattr(self, name), shape)
            if name.endswith("axes"):
                rows = value / np.maximum(np.linalg.norm(value, axis=1, keepdims=True), 1e-300)
                if abs(np.linalg.det(rows)) < _SMALLEST_TRIPLE_PRODUCT:
                    raise ValueError(f"{name}: the sensor axes do not span three directions")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.contraction() > CONTRACTION:
            raise ValueError(
                f"accel_square, accel_product: too large to be inverted: their slope may be "
                f"{self.contraction():.2g} up to {RANGE:g} m/s^2, expected at most {CONTRACTION}"
            )

    def contraction(self) -> float:
        """Bound of what a pass over the second-order terms of accelerometers leaves of an error."""
        total = float(np.sum(self.accel_square**2) + 0.5 * np.sum(self.accel_product**2))
        return float(np.linalg.norm(np.linalg.inv(self.accel_axes), 2)) * math.sqrt(12.0 * total) * RANGE

    def scales_and_biases(self, temperature: float | None = None) -> Vector:
        """The first (18,) of a `table`: those at ``temperature`` degC, by default at the reference."""
        scales = [
            self.gyro_scale_plus,
            _given(self.gyro_scale_minus),
            self.accel_scale_plus,
            _given(self.accel_scale_minus),
        ]
        biases = [self.gyro_bias, self.accel_bias]
        t = self.thermal
        if t is not None and temperature is not None:
            for k, by in enumerate((t.gyro_scale, t.gyro_scale, t.accel_scale, t.accel_scale)):
                scales[k] = scales[k] * (1.0 + by @ t.powers(temperature, by.shape[1]))
            for k, by in enumerate((t.gyro_bias, t.accel_bias)):
                biases[k] = biases[k] + by @ t.powers(temperature, by.shape[1])
        return np.concatenate((*scales, *biases))

    def at(self, temperature: float) -> Calibration:
        """The calibration that this one is at ``temperature`` degC."""
        parts = self.scales_and_biases(temperature).reshape(6, 3)
        return replace(
            self,
            gyro_scale_plus=parts[0],
            gyro_scale_minus=parts[1],
            accel_scale_plus=parts[2],
            accel_scale_minus=parts[3],
            gyro_bias=parts[4],
            accel_bias=parts[5],
            thermal=None,
        )

    def table(self) -> Vector:
        """The coefficients as `compensate` wants them: scales, biases, g sensitivity, inverse axes, (45,).

        Where there are second-order terms they follow: (81,). Scales and biases are those at the reference
        temperature; those at another one may be put in their place.
        """
        parts = [
            self.scales_and_biases(),
            self.gyro_g.ravel(),
            np.linalg.inv(self.gyro_axes).ravel(),
            np.linalg.inv(self.accel_axes).ravel(),
        ]
        second = (
            np.hstack((self.gyro_square, self.gyro_product)),
            np.hstack((self.accel_square, self.accel_product)),
        )
        if np.any(second):
            parts += [part.ravel() for part in second]
        return np.concatenate(parts)


def _given(scale: Vector | None) -> Vector:
    assert scale is not None  # __post_init__ has filled it in
    return scale


def second_order(square: Vector, product: Vector, f: Vector) -> Vector:
    """The second-order terms (n,) of n sensors under a specific force ``f`` (3,) m/s^2 in b.

    ``square``, ``product`` (n, 3) as in `Calibration`.
    """
    x, y, z = np.clip(f, -RANGE, RANGE)
    return np.asarray(square @ [x * x, y * y, z * z] + product @ [y * z, z * x, x * y])


def compensate_readable(
    calibration: Calibration, gyro: Vector, accel: Vector, tau: float
) -> tuple[Vector, Vector]:
    """Increments (dtheta (3,) rad, dv (3,) m/s) in b from counts ``gyro``, ``accel`` (3,) over ``tau`` s.

    "Inertial navigation", eqs. (2-192), (2-190), (2-193), (2-191) in the order they are used.
    """
    c = calibration
    dv_s = np.where(accel >= 0.0, c.accel_scale_plus, _given(c.accel_scale_minus)) * accel  # (2-192)
    dv_s = dv_s - c.accel_bias * tau
    back = np.linalg.inv(c.accel_axes)
    dv = back @ dv_s  # (2-190)
    for _ in range(PASSES if np.any(c.accel_square) or np.any(c.accel_product) else 0):
        dv = back @ (dv_s - second_order(c.accel_square, c.accel_product, dv / tau) * tau)
    dtheta_s = np.where(gyro >= 0.0, c.gyro_scale_plus, _given(c.gyro_scale_minus)) * gyro  # (2-193)
    # f tau is dv: the drift that f causes needs no division by the interval
    drift = c.gyro_bias * tau + c.gyro_g @ dv
    if np.any(c.gyro_square) or np.any(c.gyro_product):
        drift += second_order(c.gyro_square, c.gyro_product, dv / tau) * tau
    dtheta = np.linalg.inv(c.gyro_axes) @ (dtheta_s - drift)  # (2-191)
    return dtheta, dv


@in_place
def _felt(increment: float, tau: float) -> float:
    """Mean over an interval, within `RANGE`; none over none."""
    return min(max(increment / tau, -RANGE), RANGE) if tau > 0.0 else 0.0


@in_place
def _second(table: Vector, place: int, x: float, y: float, z: float) -> float:
    """The second-order terms of the sensor whose six begin at ``place``."""
    squares = table[place] * x * x + table[place + 1] * y * y + table[place + 2] * z * z
    return float(squares + table[place + 3] * y * z + table[place + 4] * z * x + table[place + 5] * x * y)


@in_place
def _settle(table: Vector, s0: float, s1: float, s2: float, tau: float, dv: Vector) -> None:
    """Take the accelerometers' second-order terms off ``dv``; ``s0`` to ``s2`` m/s are read without bias."""
    for _ in range(PASSES):
        x, y, z = _felt(dv[0], tau), _felt(dv[1], tau), _felt(dv[2], tau)
        r0 = s0 - _second(table, _ACCEL_SECOND, x, y, z) * tau
        r1 = s1 - _second(table, _ACCEL_SECOND + 6, x, y, z) * tau
        r2 = s2 - _second(table, _ACCEL_SECOND + 12, x, y, z) * tau
        change, size = 0.0, 0.0
        for i in range(3):
            new = table[36 + 3 * i] * r0 + table[37 + 3 * i] * r1 + table[38 + 3 * i] * r2
            change += abs(new - dv[i])
            size += abs(new)
            dv[i] = new
        if change <= _ROUNDING * size:
            return


@in_place
def compensate(table: Vector, counts: Vector, tau: float, dtheta: Vector, dv: Vector) -> None:
    """Write the increments of one sample: the twin of `compensate_readable`.

    ``table`` from `Calibration.table`; ``counts`` (6,) gyro then accelerometer pulses, as floats; ``tau`` s;
    results go to ``dtheta`` (3,) rad and ``dv`` (3,) m/s.
    """
    s0 = counts[3] * (table[6] if counts[3] >= 0.0 else table[9]) - table[15] * tau
    s1 = counts[4] * (table[7] if counts[4] >= 0.0 else table[10]) - table[16] * tau
    s2 = counts[5] * (table[8] if counts[5] >= 0.0 else table[11]) - table[17] * tau
    for i in range(3):
        dv[i] = table[36 + 3 * i] * s0 + table[37 + 3 * i] * s1 + table[38 + 3 * i] * s2
    second = table.size > _PLAIN
    if second:
        _settle(table, s0, s1, s2, tau, dv)
    s0 = counts[0] * (table[0] if counts[0] >= 0.0 else table[3]) - table[12] * tau
    s1 = counts[1] * (table[1] if counts[1] >= 0.0 else table[4]) - table[13] * tau
    s2 = counts[2] * (table[2] if counts[2] >= 0.0 else table[5]) - table[14] * tau
    s0 -= table[18] * dv[0] + table[19] * dv[1] + table[20] * dv[2]
    s1 -= table[21] * dv[0] + table[22] * dv[1] + table[23] * dv[2]
    s2 -= table[24] * dv[0] + table[25] * dv[1] + table[26] * dv[2]
    if second:
        x, y, z = _felt(dv[0], tau), _felt(dv[1], tau), _felt(dv[2], tau)
        s0 -= _second(table, _GYRO_SECOND, x, y, z) * tau
        s1 -= _second(table, _GYRO_SECOND + 6, x, y, z) * tau
        s2 -= _second(table, _GYRO_SECOND + 12, x, y, z) * tau
    for i in range(3):
        dtheta[i] = table[27 + 3 * i] * s0 + table[28 + 3 * i] * s1 + table[29 + 3 * i] * s2


def expected_pulses(
    calibration: Calibration, dtheta: Vector, dv: Vector, tau: float
) -> tuple[Vector, Vector]:
    """Counts (gyro (3,), accel (3,)), not rounded, that increments in b over ``tau`` s produce.

    "Inertial navigation", eqs. (2-27), (2-28) over one interval: the exact inverse of the compensation.
    ``dtheta`` (3,) rad, ``dv`` (3,) m/s. A count's sign is that of the output, bias included.
    """
    c = calibration
    dv_s = c.accel_axes @ dv + c.accel_bias * tau
    dv_s += second_order(c.accel_square, c.accel_product, dv / tau) * tau
    dtheta_s = c.gyro_axes @ dtheta + c.gyro_bias * tau + c.gyro_g @ dv
    dtheta_s += second_order(c.gyro_square, c.gyro_product, dv / tau) * tau
    gyro_positive = dtheta_s * np.sign(c.gyro_scale_plus) >= 0.0
    accel_positive = dv_s * np.sign(c.accel_scale_plus) >= 0.0
    gyro_scale = np.where(gyro_positive, c.gyro_scale_plus, _given(c.gyro_scale_minus))
    accel_scale = np.where(accel_positive, c.accel_scale_plus, _given(c.accel_scale_minus))
    return dtheta_s / gyro_scale, dv_s / accel_scale
