"""When a gate has refused measurements for long and they agree with each other, the filter is wrong.

A receiver among houses, or a wheel on ice, errs this way and that; a filter that has lost its way errs
smoothly, and everything it refuses tells the same story. But a claim of sigmas that are much too small looks
like the first, and a filter that trusts nobody never comes back: after `PATIENCE` times as long it gives in
anyway.

That the wheels do not slide is no measurement but an assumption. Where fixes agree with the filter all the
while, it is the vehicle that slides, or an inertial sensor that fails, and nothing is to be believed.

The variances that the measurement speaks about grow until its residual is within one sigma. A diagonal
addition keeps the covariance positive and its correlations honest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from nav.filter.measurements import Measurement
from nav.filter.records import Book
from nav.types import Vector

PATIENCE: Final = 10


def inflate(P: Vector, measurement: Measurement, residual: Vector, elapsed: float) -> None:
    """Add to the covariance ``P`` (N, N) what ``residual`` (rows,) shows that it lacks.

    ``elapsed`` s: for how long the gate was shut. A position that went wrong by r in that time was
    moved by a velocity of about r / elapsed, which is added too.
    """
    size = float(np.sqrt(np.mean(np.square(residual))))
    for part in measurement.recover:
        for i in range(part.start, part.stop):
            if measurement.name == "gnss_velocity" and i == 8:
                # a wrong heading shows as a velocity error across; up to one radian
                P[i, i] += min(1.0, size / 10.0) ** 2
            elif measurement.name == "non_holonomic":
                P[i, i] += min(0.2, size / 10.0) ** 2
            elif measurement.name == "zero_rate":
                P[i, i] += size**2
            elif measurement.rows == 3:
                P[i, i] += max(size, abs(float(residual[i - part.start]))) ** 2
            else:
                P[i, i] += min(0.05, size / 10.0) ** 2 if part.start == 15 else size**2
    if measurement.name == "gnss_position":
        for i in range(3, 6):
            P[i, i] += (size / max(elapsed, 1.0)) ** 2


def contradicted(measurement: Measurement, books: Mapping[str, Book]) -> bool:
    """Whether what it yields to has agreed with the filter since the gate was shut to it."""
    since = books[measurement.name][2]
    return any(books[kind][0] > since for kind in measurement.yields)


def agree(residuals: Vector) -> bool:
    """Whether ``residuals`` (K, rows) of K >= 3 refused measurements in a row lie on a smooth course.

    The second differences of white noise of variance s^2 have 6 s^2, those of a course that bends little
    nearly none: noise may make up a quarter of the residuals' mean square.
    """
    bend = residuals[2:] - 2.0 * residuals[1:-1] + residuals[:-2]
    return bool(np.mean(np.square(bend)) / 6.0 <= 0.25 * np.mean(np.square(residuals)))
