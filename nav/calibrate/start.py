"""The textbook's calibration in two steps, from which the joint solution starts.

First the rates, from rotations both ways round each axis; then the positions, with scale and axes of the
gyros known. Both are least squares over whatever was done and hold for sensors on any axes: for a pair of
rotations about each axis of b they are the closed forms of "Inertial navigation", eqs. (2-175) to (2-183)
with the indices of (2-28), and for the eight positions of Table 2-12 (2-184) to (2-189).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nav.calibrate.intervals import Interval
from nav.calibrate.model import Model, Sensor
from nav.types import Vector


def rates(intervals: Sequence[Interval], sensor: int, w_g: Vector) -> Vector:
    """Pulses per rad about each axis of b (3,) of one gyro, from the rotations among ``intervals``.

    ``w_g`` (3,) rad/s is the Earth's rate. A constant rate of pulses (bias) is estimated with them.
    """
    turns = [one for one in intervals if one.rotation]
    shown = np.array([one.turned + one.attitude @ w_g for one in turns])
    seconds = np.array([[one.seconds] for one in turns])
    counts = np.array([one.plus[sensor] - one.minus[sensor] for one in turns])
    return np.asarray(np.linalg.lstsq(np.hstack((shown, seconds)), counts)[0][:3])


def drifts(
    intervals: Sequence[Interval], sensor: int, per_rad: Vector, w_g: Vector, f_g: Vector, g_terms: bool
) -> Vector:
    """Drift of one gyro (4,): bias in rad/s, and rad/s per m/s^2 along each axis, from the positions.

    ``per_rad`` (3,) from `rates`. Eqs. (2-184) to (2-186): what is left when the Earth's rate is taken off.
    """
    rests = [one for one in intervals if not one.rotation]
    k = 1.0 / float(np.linalg.norm(per_rad))
    counts = np.array([one.plus[sensor] - one.minus[sensor] for one in rests])
    seen = np.array([one.attitude @ w_g for one in rests]) @ per_rad
    seconds = np.array([[one.seconds] for one in rests])
    force = np.array([one.attitude @ f_g for one in rests])
    X = np.hstack((seconds, force)) if g_terms else seconds
    found = np.zeros(4)
    found[: X.shape[1]] = np.linalg.lstsq(X, k * (counts - seen))[0]
    return found


def forces(intervals: Sequence[Interval], sensor: int, f_g: Vector) -> tuple[Vector, float]:
    """Pulses per m/s along each axis (3,) and pulses per second at no force of one accelerometer.

    Eqs. (2-187) to (2-189).
    """
    rests = [one for one in intervals if not one.rotation]
    counts = np.array([one.plus[sensor] - one.minus[sensor] for one in rests])
    force = np.array([one.attitude @ f_g for one in rests])
    seconds = np.array([[one.seconds] for one in rests])
    found = np.linalg.lstsq(np.hstack((force, seconds)), counts)[0]
    return np.asarray(found[:3]), float(found[3])


def start(model: Model, intervals: Sequence[Interval]) -> Vector:
    """Unknowns (size,) of ``model`` by the two steps: no asymmetry, the table as it should be."""
    theta = np.zeros(model.size)
    w_g, f_g = model.place.w_g, model.place.f_g
    for place, one in enumerate(model.sensors):
        part = model.parts[place]
        if one.gyro:
            per_unit = rates(intervals, place, w_g)
            drift = drifts(intervals, place, per_unit, w_g, f_g, "g sensitivity x" in one.terms)
        else:
            per_unit, pulses = forces(intervals, place, f_g)
            drift = np.array([pulses / float(np.linalg.norm(per_unit)), 0.0, 0.0, 0.0])
        theta[part] = _coefficients(one, per_unit, drift)
    return theta


def _coefficients(one: Sensor, per_unit: Vector, drift: Vector) -> Vector:
    """A sensor's unknowns from its pulses per unit along b (3,) and its drift as the sensor's own output."""
    along = float(one.axis @ per_unit)
    # the part of the axis along a0 is one, not the axis' length
    drift = drift * float(np.linalg.norm(per_unit)) / along
    own = {"scale": 1.0 / (along * one.scale) - 1.0, "bias": drift[0]}
    for k in (0, 1):
        own[one.angle_of(k)] = float(one.across[:, k] @ per_unit) / along
    for k, letter in enumerate("xyz"):
        own[f"g sensitivity {letter}"] = drift[1 + k]
    return np.array([own.get(term, 0.0) for term in one.terms])
