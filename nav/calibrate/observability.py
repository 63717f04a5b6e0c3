"""What a plan shows of a unit and what not, before anything is measured; and what to add to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import qr

from nav.calibrate.intervals import Interval
from nav.calibrate.model import Model
from nav.calibrate.plan import Step, candidates, planned
from nav.calibrate.solve import Noise, prior_rows, whitened
from nav.types import Vector

_RANK: Final = 1e-9
"""Singular values of the scaled design below this share of the largest are zero but for rounding."""
_PART: Final = 0.1
"""A coefficient with less than this share of the largest in an unseen direction is not named."""
_WEAK: Final = 10.0
"""A coefficient is weakly seen where the others multiply its sigma by more than this."""
_MOST: Final = 24


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """``unseen`` names for every direction that leaves no trace the coefficients in it, largest first.

    ``sigma`` (size,) is what the plan promises for each unknown, infinite where it is in such a direction;
    ``factor`` how many times larger that is than if all others were known.
    """

    unseen: tuple[tuple[str, ...], ...]
    sigma: Vector
    factor: Vector
    names: tuple[str, ...]

    @property
    def weak(self) -> tuple[tuple[str, float], ...]:
        """Coefficients that are seen mostly in combination with others, worst first, with their factor."""
        found = [
            (name, float(factor))
            for name, factor in zip(self.names, self.factor, strict=True)
            if _WEAK < factor < np.inf
        ]
        return tuple(sorted(found, key=lambda item: -item[1]))


def observe(model: Model, steps: Sequence[Step], noise: Noise) -> Observability:
    """What ``steps`` show of nominal sensors: the scaled design matrix and its singular values."""
    return _look(model, _design(model, planned(steps), noise))


def propose(model: Model, steps: Sequence[Step], noise: Noise, seconds: float) -> list[Step]:
    """The fewest steps found that, added to ``steps``, show everything; each position takes ``seconds``.

    One after the other, that candidate which says most about what is still unseen, when it is done at every
    temperature of ``steps``. Empty where nothing is missing, or nothing that a turntable can show helps.
    """
    design = _design(model, planned(steps), noise)
    possible = candidates(seconds)
    soaks = sorted({one.temperature for one in steps if not math.isnan(one.temperature)}) or [math.nan]
    soaked = [[replace(one, temperature=soak) for soak in soaks] for one in possible]
    rows = [_design(model, planned(every), noise)[:-4] for every in soaked]
    chosen: list[Step] = []
    while len(chosen) < _MOST:
        hidden = _hidden(design)[0]
        if not len(hidden):
            return chosen
        # what a candidate makes of the unseen directions, as information
        gain = [float(np.linalg.slogdet(np.eye(len(hidden)) + _gram(one, hidden))[1]) for one in rows]
        best = int(np.argmax(gain))
        seen = np.vstack((design, rows[best]))
        if len(_hidden(seen)[0]) == len(hidden) and gain[best] < _RANK:
            return []
        chosen.append(possible[best])
        design = seen
    return []


def _gram(rows: Vector, directions: Vector) -> Vector:
    part = rows @ directions.T
    return np.asarray(part.T @ part)


def _design(model: Model, intervals: Sequence[Interval], noise: Noise) -> Vector:
    """The whitened design matrix of nominal sensors, the priors of the nuisance in its last rows."""
    parts = whitened(model, model.expected(intervals), noise, np.zeros(model.size))
    return np.concatenate([*(rows for _, _, _, rows in parts), prior_rows(model)])


def _hidden(design: Vector) -> tuple[Vector, Vector]:
    """Unseen directions (k, size) in units of the unknowns, and the scale of each column."""
    size = np.linalg.norm(design, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, values, V = np.linalg.svd(design / size)
    rank = int(np.sum(values > _RANK * values[0]))
    hidden = V[rank:]
    if len(hidden):
        # any basis of them is as true; this one keeps apart what can be kept apart
        _, _, order = qr(hidden, pivoting=True, mode="economic")
        hidden = np.linalg.solve(hidden[:, order[: len(hidden)]], hidden)
    return hidden / size, size


def _look(model: Model, design: Vector) -> Observability:
    hidden, size = _hidden(design)
    unseen: list[list[int]] = []
    touched = np.zeros(model.size, dtype=bool)
    for direction in hidden:
        share = np.abs(direction * size)
        share /= share.max()
        order = [int(k) for k in np.argsort(-np.round(share, 6), kind="stable") if share[k] > _PART]
        touched[order] = True
        unseen.append(order)
    _, values, V = np.linalg.svd(design / size, full_matrices=False)
    keep = values > _RANK * values[0]
    factor = np.linalg.norm(V[keep] / values[keep, None], axis=0)
    factor = np.where(touched, np.inf, factor)
    named = tuple(tuple(model.names[k] for k in order) for order in sorted(unseen, key=min))
    return Observability(named, factor / size, factor, model.names)
