"""All coefficients of a unit at once, with the table's own errors, by weighted Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats
from scipy.linalg import solve_triangular

from nav.calibrate.intervals import Interval, covariance, unsure
from nav.calibrate.model import Model, Sensor
from nav.calibrate.start import start
from nav.types import Vector

_STEPS: Final = 20
_CONVERGED: Final = 1e-3  # of a sigma
_TAIL: Final = 1e-4
"""So improbable a sum of squared residuals says that something is not as it was told."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a unit: white densities (rad/s, m/s^2 per root Hz), instabilities (sigma) and their time s.

    ``attitude`` rad is one sigma of the attitude in which the table rests, ``turn`` rad of what it turns by.
    """

    gyro_walk: float
    gyro_instability: float
    accel_walk: float
    accel_instability: float
    correlation: float
    attitude: float = 0.0
    turn: float = 0.0

    def covariance(self, one: Sensor, intervals: Sequence[Interval]) -> Vector:
        """Covariance (k, k) of a sensor's sums over ``intervals``, SI."""
        walk, drift = (
            (self.gyro_walk, self.gyro_instability) if one.gyro else (self.accel_walk, self.accel_instability)
        )
        own = covariance(intervals, walk, drift, self.correlation, one.scale)
        return own + unsure(intervals, one.axis, one.gyro, self.attitude, self.turn)


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What the fit leaves of one sensor: in which intervals, rad or m/s, and decorrelated in sigmas."""

    used: tuple[int, ...]
    values: Vector
    white: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Unknowns of a model, their covariance, and what is left.

    ``chi2`` and ``freedom`` are of all residuals with the priors of the nuisance; ``inflation`` is what the
    sigmas of the noise were multiplied by because the residuals are too large for chance, else 1.
    """

    model: Model
    theta: Vector
    covariance: Vector
    residuals: tuple[Residuals, ...]
    steps: int
    chi2: float
    freedom: int
    inflation: float

    @property
    def sigma(self) -> Vector:
        """One sigma of every unknown."""
        return np.sqrt(np.diag(self.covariance))


def whitened(
    model: Model, intervals: Sequence[Interval], noise: Noise, theta: Vector
) -> list[tuple[list[int], Vector, Vector, Vector]]:
    """Of each sensor: intervals used, residuals, and residuals and Jacobian in uncorrelated unit noise."""
    found = []
    shown = [model.shown(one, theta) for one in intervals]
    for place, one in enumerate(model.sensors):
        used = model.used(one, intervals)
        chosen = [intervals[k] for k in used]
        residual, jacobian = model.rows(place, chosen, [shown[k] for k in used], theta)
        root = np.linalg.cholesky(noise.covariance(one, chosen))
        both = solve_triangular(root, np.column_stack((residual, jacobian)), lower=True)
        found.append((used, residual, both[:, 0], both[:, 1:]))
    return found


def prior_rows(model: Model) -> Vector:
    """Rows (4, size) that hold the nuisance to its prior, in sigmas."""
    rows = np.zeros((4, model.size))
    rows[:, -4:] = np.diag(1.0 / model.prior)
    return rows


def fit(model: Model, intervals: Sequence[Interval], noise: Noise) -> Fit:
    """Solve for every coefficient and the nuisance from the counts of ``intervals``.

    Raises:
        ValueError: it does not converge.
        numpy.linalg.LinAlgError: the intervals do not show every coefficient.
    """
    theta = start(model, intervals)
    held = prior_rows(model)
    steps, converged = 0, False
    while not converged:
        if steps == _STEPS:
            raise ValueError(f"the calibration does not converge in {_STEPS} steps")
        steps += 1
        parts = whitened(model, intervals, noise, theta)
        r = np.concatenate([*(white for _, _, white, _ in parts), held @ theta])
        J = np.concatenate([*(rows for _, _, _, rows in parts), held])
        size = np.linalg.norm(J, axis=0)
        Q, R = np.linalg.qr(J / size)
        step = -np.linalg.solve(R, Q.T @ r) / size
        inverse = np.linalg.inv(R)
        P = inverse @ inverse.T / np.outer(size, size)
        theta = theta + step
        converged = bool(np.all(np.abs(step) < _CONVERGED * np.sqrt(np.diag(P))))
    parts = whitened(model, intervals, noise, theta)
    chi2 = float(sum(white @ white for _, _, white, _ in parts) + (held @ theta) @ (held @ theta))
    freedom = len(r) - model.size
    inflation = 1.0
    if freedom > 0 and stats.chi2.sf(chi2, freedom) < _TAIL:
        inflation = float(np.sqrt(chi2 / freedom))
    residuals = tuple(Residuals(tuple(used), raw, white) for used, raw, white, _ in parts)
    return Fit(model, theta, P * inflation**2, residuals, steps, chi2, freedom, inflation)
