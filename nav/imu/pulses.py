"""Pulse counts of gyros and accelerometers, and the increments of angle and velocity they stand for.

The measurement model is the textbook's, "Inertial navigation", eqs. (2-27), (2-28); its inverse, the
compensation, is eqs. (2-190) to (2-193), with the sampling interval restored before the g-sensitive
drift in (2-191). Per sensor, with f the specific force and w the rate in b, over an interval tau:

    accelerometers   scale * N_a = (axes_a @ f + bias_a) tau
    gyros            scale * N_g = (axes_g @ w + bias_g + g_sensitivity @ f) tau

where ``scale`` is one number for positive and another for negative counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from nav.jit import in_place
from nav.types import Vector

_SMALLEST_TRIPLE_PRODUCT: Final = 1e-3


def _zeros() -> Vector:
    return np.zeros(3)


def _eye() -> Vector:
    return np.eye(3)


def coefficient(name: str, given: object, shape: tuple[int, ...]) -> Vector:
    """Error coefficients called ``name`` as an array of ``shape``.

    Raises ValueError for another shape, a value that is not finite or a scale of zero.
    """
    value = np.array(given, dtype=np.float64)
    if value.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, found {value.shape}")
    if not np.all(np.isfinite(value)):
        raise ValueError(f"{name}: a value is not finite")
    if "scale" in name and np.any(value == 0.0):
        raise ValueError(f"{name}: a scale of zero")
    return value


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

    Raises ValueError for a wrong shape, a value that is not finite, a zero scale or dependent axes.
    """

    gyro_scale_plus: Vector
    accel_scale_plus: Vector
    gyro_scale_minus: Vector | None = None
    accel_scale_minus: Vector | None = None
    gyro_bias: Vector = field(default_factory=_zeros)
    accel_bias: Vector = field(default_factory=_zeros)
    gyro_g: Vector = field(default_factory=lambda: np.zeros((3, 3)))
    gyro_axes: Vector = field(default_factory=_eye)
    accel_axes: Vector = field(default_factory=_eye)
    accel_arms: Vector = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        if self.gyro_scale_minus is None:
            object.__setattr__(self, "gyro_scale_minus", self.gyro_scale_plus)
        if self.accel_scale_minus is None:
            object.__setattr__(self, "accel_scale_minus", self.accel_scale_plus)
        for name in self.__slots__:
            shape = (3, 3) if name.endswith(("_g", "_axes", "_arms")) else (3,)
            value = coefficient(name, getattr(self, name), shape)
            if name.endswith("axes"):
                rows = value / np.maximum(np.linalg.norm(value, axis=1, keepdims=True), 1e-300)
                if abs(np.linalg.det(rows)) < _SMALLEST_TRIPLE_PRODUCT:
                    raise ValueError(f"{name}: the sensor axes do not span three directions")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def table(self) -> Vector:
        """The coefficients as `compensate` wants them, (45,): scales, biases, g sensitivity, inverse axes."""
        return np.concatenate(
            (
                self.gyro_scale_plus,
                _given(self.gyro_scale_minus),
                self.accel_scale_plus,
                _given(self.accel_scale_minus),
                self.gyro_bias,
                self.accel_bias,
                self.gyro_g.ravel(),
                np.linalg.inv(self.gyro_axes).ravel(),
                np.linalg.inv(self.accel_axes).ravel(),
            )
        )


def _given(scale: Vector | None) -> Vector:
    assert scale is not None  # __post_init__ has filled it in
    return scale


def compensate_readable(
    calibration: Calibration, gyro: Vector, accel: Vector, tau: float
) -> tuple[Vector, Vector]:
    """Increments (dtheta (3,) rad, dv (3,) m/s) in b from counts ``gyro``, ``accel`` (3,) over ``tau`` s.

    "Inertial navigation", eqs. (2-192), (2-190), (2-193), (2-191) in the order they are used.
    """
    c = calibration
    dv_s = np.where(accel >= 0.0, c.accel_scale_plus, _given(c.accel_scale_minus)) * accel  # (2-192)
    dv = np.linalg.inv(c.accel_axes) @ (dv_s - c.accel_bias * tau)  # (2-190)
    dtheta_s = np.where(gyro >= 0.0, c.gyro_scale_plus, _given(c.gyro_scale_minus)) * gyro  # (2-193)
    # f tau is dv: the drift that f causes needs no division by the interval
    dtheta = np.linalg.inv(c.gyro_axes) @ (dtheta_s - c.gyro_bias * tau - c.gyro_g @ dv)  # (2-191)
    return dtheta, dv


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
    s0 = counts[0] * (table[0] if counts[0] >= 0.0 else table[3]) - table[12] * tau
    s1 = counts[1] * (table[1] if counts[1] >= 0.0 else table[4]) - table[13] * tau
    s2 = counts[2] * (table[2] if counts[2] >= 0.0 else table[5]) - table[14] * tau
    s0 -= table[18] * dv[0] + table[19] * dv[1] + table[20] * dv[2]
    s1 -= table[21] * dv[0] + table[22] * dv[1] + table[23] * dv[2]
    s2 -= table[24] * dv[0] + table[25] * dv[1] + table[26] * dv[2]
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
    dtheta_s = c.gyro_axes @ dtheta + c.gyro_bias * tau + c.gyro_g @ dv
    gyro_positive = dtheta_s * np.sign(c.gyro_scale_plus) >= 0.0
    accel_positive = dv_s * np.sign(c.accel_scale_plus) >= 0.0
    gyro_scale = np.where(gyro_positive, c.gyro_scale_plus, _given(c.gyro_scale_minus))
    accel_scale = np.where(accel_positive, c.accel_scale_plus, _given(c.accel_scale_minus))
    return dtheta_s / gyro_scale, dv_s / accel_scale
