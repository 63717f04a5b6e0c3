"""Pulses of any number of gyros or accelerometers, and the increments along their own axes.

The measurement model is that of `nav.imu.pulses`, without the inverse of the axes: with more than three
sensors that is the fusion of `nav.imu.redundant`, whose kernel is the twin of what is here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav.imu.pulses import coefficient
from nav.types import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """Error coefficients of n sensors of one kind, SI units.

    ``axes`` (n, 3): row i is what sensor i sees of a unit input along each axis of b; ``scale_plus``,
    ``scale_minus`` (n,) rad or m/s per pulse for positive and negative counts; ``bias`` (n,) rad/s or
    m/s^2; ``g_sensitivity`` (n, 3) rad/s per m/s^2, zero of accelerometers.

    Raises ValueError for a wrong shape, a value that is not finite or a scale of zero.
    """

    axes: Vector
    scale_plus: Vector
    scale_minus: Vector
    bias: Vector
    g_sensitivity: Vector

    def __post_init__(self) -> None:
        n = len(self.axes)
        for name in self.__slots__:
            shape = (n, 3) if name in ("axes", "g_sensitivity") else (n,)
            value = coefficient(name, getattr(self, name), shape)
            value.setflags(write=False)
            object.__setattr__(self, name, value)


def along(sensors: Sensors, counts: Vector, tau: float, dv: Vector) -> Vector:
    """Increments (n,) rad or m/s along the sensors' axes from ``counts`` (n,) over ``tau`` s.

    ``dv`` (3,) m/s is the velocity increment in b. "Inertial navigation", eqs. (2-192), (2-193) and the
    brackets of (2-190), (2-191).
    """
    scale = np.where(counts >= 0.0, sensors.scale_plus, sensors.scale_minus)
    return np.asarray(scale * counts - sensors.bias * tau - sensors.g_sensitivity @ dv)


def ideal(axes: Vector) -> Sensors:
    """Sensors about ``axes`` (n, 3) whose counts are their increments already."""
    n = len(axes)
    return Sensors(axes, np.ones(n), np.ones(n), np.zeros(n), np.zeros((n, 3)))
