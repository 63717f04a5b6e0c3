"""What a calibration of redundant accelerometers is worth to a unit that navigates at rest and is flipped.

The unit stands at a known place and is turned over every now and then. Its accelerometers count what the
bench's Earth gives them, with their own axes, biases and two scales; the counts go through a calibration and
the least-squares fusion, and the program's strapdown kernel navigates by the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from bridge.studies.figures.exact_increments import GreatCircle, direction, integrals
from bridge.studies.figures.flights import Flight, compare
from nav import rotation as rot
from nav.calibrate.sequential import Sequential
from nav.strapdown.kernels import X_Q
from nav.types import Vector

RATE_HZ: Final = 100.0
TURN_S: Final = 10.0
"""A flip takes so long."""

Unit = tuple[Vector, Vector, Vector, Vector]
"""Axes (n, 3), pulses per m/s of positive and of negative output (n,), biases (n,) m/s^2."""


class Flips:
    """What a unit senses that is in one of ``attitudes``, C_gb, after the other, ``rest`` s in each.

    The way to it is included. Yields increments (samples, 6) and how often they come; no error is in them.
    """

    def __init__(self, lat_deg: float, height: float, attitudes: Sequence[Vector], rest: float) -> None:
        _, north, up = direction(lat_deg, 0.0)
        self.attitudes, self.rest = attitudes, rest
        level = GreatCircle(up, north, 0.0, height, np.eye(3))
        self.rate_g, self.force_g = np.split(level.rates(np.zeros(1))[0], 2)
        self.path = GreatCircle(up, north, 0.0, height, attitudes[0])

    def __iter__(self) -> Iterator[tuple[Vector, int]]:
        for k, C in enumerate(self.attitudes):
            left = self.rest
            if k > 0:
                yield from ((samples, 1) for samples in self._turn(self.attitudes[k - 1], C))
                left -= TURN_S
            still = np.concatenate((C.T @ self.rate_g, C.T @ self.force_g)) / RATE_HZ
            yield still[None], round(left * RATE_HZ)

    def _turn(self, before: Vector, after: Vector) -> Iterator[Vector]:
        """From one attitude to the next about a fixed axis, with a rate that is a half wave."""
        whole = rot.rotvec_from_quat(rot.quat_from_dcm(before.T @ after))

        def rates(t: Vector) -> Vector:
            phase = math.pi * t / TURN_S
            share = 0.5 * (1.0 - np.cos(phase))[:, None]
            C = before @ rot.dcm_from_quat(rot.quat_from_rotvec(share * whole))
            turned = 0.5 * math.pi / TURN_S * np.sin(phase)[:, None] * whole
            return np.hstack((turned + self.rate_g @ C, self.force_g @ C))

        return integrals(rates, 1.0 / RATE_HZ, round(TURN_S), round(RATE_HZ))


def read(said: Sequence[Sequential], unit: Unit, dv: Vector, dt: float) -> Vector:
    """Velocity increments (k, 3) that a calibration makes of a unit's counts for the true ones ``dv``."""
    axes, plus, minus, bias = unit
    out = dv @ axes.T + bias * dt
    counts = np.where(out >= 0.0, plus, minus) * out
    scale = np.where(counts >= 0.0, [one.plus for one in said], [one.minus for one in said])
    value = counts / scale - np.array([one.bias for one in said]) * dt
    return np.asarray(value @ np.linalg.pinv(np.array([one.axis for one in said])).T)


def distance(
    flips: Flips,
    sensed: Sequence[tuple[Vector, int]],
    said: Sequence[Sequential],
    unit: Unit,
    drift: Vector,
) -> float:
    """How far from its place, m, the unit is in the end, levelled by itself and with a known heading.

    ``sensed`` is what ``flips`` yield, ``drift`` (3,) rad/s that of its gyros.
    """
    flight, dt = Flight(flips.path, "wander"), 1.0 / RATE_HZ
    C = flips.attitudes[0]
    felt = C @ read(said, unit, sensed[0][0][:1, 3:], dt)[0]
    axis = np.cross(felt, [0.0, 0.0, 1.0])
    angle = math.atan2(float(np.linalg.norm(axis)), felt[2])
    tilt = axis / max(float(np.linalg.norm(axis)), 1e-300) * angle
    flight.x[X_Q : X_Q + 4] = rot.quat_multiply(rot.quat_from_rotvec(tilt), rot.quat_from_dcm(C))
    for samples, times in sensed:
        measured = np.hstack((samples[:, :3] + drift * dt, read(said, unit, samples[:, 3:], dt)))
        flight.navigate(np.tile(measured, (times, 1)), dt)
    seconds = sum(len(samples) * times for samples, times in sensed) * dt
    return float(compare(flips.path, np.array([seconds]), flight.x[None]).horizontal[0])
