"""Asymmetry of accelerometers one quantity after the other: the conventional and the iterative method.

For accelerometers on any axes, in the twelve positions that point every axis of the unit up and down, twice
each (Luo Rui, Li Peng, Yu Lingyan 2023). An accelerometer counts K (E . f + drift) per second, K being
``plus`` or ``minus`` by the sign of its output. The program solves all of it at once (`nav.calibrate.solve`);
these two are what that is compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav.calibrate.intervals import Interval
from nav.types import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Pulses per second (3,) of one accelerometer with x, y, z ``up`` and ``down``, mean of two positions."""

    up: Vector
    down: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Sequential:
    """``plus`` and ``minus`` pulses per m/s, ``bias`` m/s^2 and the unit vector ``axis`` (3,) of a sensor."""

    plus: float
    minus: float
    bias: float
    axis: Vector

    @property
    def asymmetry(self) -> float:
        """Eq. (18) of the paper: the difference of the two scales over their mean."""
        return 2.0 * (self.plus - self.minus) / (self.plus + self.minus)


def turned(intervals: Sequence[Interval], sensor: int) -> Turned:
    """Sort the rests by which axis of the unit is up or down.

    Raises:
        ValueError: an axis never is, or in a rest none is.
    """
    rates: dict[tuple[int, int], list[float]] = {}
    for one in intervals:
        if one.rotation:
            continue
        vertical = one.attitude[:, 2] / one.seconds
        m = int(np.argmax(np.abs(vertical)))
        if abs(vertical[m]) < 1.0 - 1e-9:
            raise ValueError(f"{one.name}: expected an axis of the unit up or down")
        pulses = float(one.plus[sensor] - one.minus[sensor]) / one.seconds
        rates.setdefault((m, int(np.sign(vertical[m]))), []).append(pulses)
    if len(rates) < 6:
        raise ValueError("expected every axis of the unit up and down")
    up, down = (np.array([np.mean(rates[m, sign]) for m in range(3)]) for sign in (1, -1))
    return Turned(up, down)


def conventional(of: Turned, gravity: float) -> Sequential:
    """As if one scale held for both signs, eqs. (12) to (17); the two scales from the largest component."""
    P = (of.up - of.down) / gravity
    mean = 0.5 * float(np.linalg.norm(P))
    axis = P / (2.0 * mean)
    bias = float(np.mean((of.up + of.down) / 2.0)) / mean
    m = int(np.argmax(np.abs(axis)))
    positive, negative = _signed(of, axis)
    pull = abs(float(axis[m])) * gravity
    return Sequential(float(positive[m]) / (pull + bias), float(negative[m]) / (bias - pull), bias, axis)


def iterate(of: Turned, gravity: float, passes: int) -> list[Sequential]:
    """The estimates after each pass of eqs. (9) to (11) and (19), from no bias on.

    The error of the bias shrinks by S^2 / 3 a pass, S being the sum of the axis' components without their
    signs: by a third along an axis of the unit, not at all at equal angles to all three.
    """
    plus = minus = bias = 0.0
    found = []
    for _ in range(passes):
        P = (of.up - of.down) / gravity
        sign = np.sign(P)
        P = P - sign * (plus - minus) * bias / gravity
        axis = P / np.linalg.norm(P)
        positive, negative = _signed(of, axis)
        above, below = np.abs(axis) * gravity + bias, bias - np.abs(axis) * gravity
        plus = float(positive @ above / (above @ above))
        minus = float(negative @ below / (below @ below))
        share = float(np.abs(axis).sum()) * gravity
        bias = float(positive.sum() + negative.sum() - (plus - minus) * share) / (3.0 * (plus + minus))
        found.append(Sequential(plus, minus, bias, axis))
    return found


def _signed(of: Turned, axis: Vector) -> tuple[Vector, Vector]:
    """The rates with the sensor's own direction up and down, axis by axis."""
    return np.where(axis > 0.0, of.up, of.down), np.where(axis > 0.0, of.down, of.up)
