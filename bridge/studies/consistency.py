"""Are errors as large as the navigator says they are? Statistics over independent runs.

The normalised estimation error squared (NEES) of n states is chi-square with n degrees of freedom where
errors and covariance agree; its sum over N runs is chi-square with N n. Bar-Shalom, Li and Kirubarajan,
"Estimation with Applications to Tracking and Navigation", section 5.4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

Array = NDArray[np.float64]

KINDS: Final = {"position": slice(0, 3), "velocity": slice(3, 6), "attitude": slice(6, 9)}
AXES: Final = ("east", "north", "up")
SHARE: Final = 0.95
"""Of the two-sided bands."""
INSIDE: Final = 0.9
"""Share of epochs that must lie in their band."""
FLIPS: Final = 2000
"""Sets of signs that say what chance does."""
LIMIT_FACTOR: Final = 1.2
"""How far a static alignment may stay behind its theoretical limit."""


def band(states: int, runs: int, share: float = SHARE) -> tuple[float, float]:
    """Two-sided band that holds the mean over ``runs`` of a NEES of ``states`` in ``share`` of all cases."""
    tail = 0.5 * (1.0 - share)
    dof = states * runs
    return float(chdtri(dof, 1.0 - tail)) / runs, float(chdtri(dof, tail)) / runs


def nees(error: Array, covariance: Array) -> Array:
    """NEES (...,) of errors (..., n) with covariances (..., n, n)."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray(np.sum(error * solved, axis=-1))


def share_inside(values: Array, low: Array | float, high: Array | float) -> float:
    """Share of ``values`` between ``low`` and ``high``, one of each or one for each value."""
    return float(np.mean((values >= low) & (values <= high)))


@dataclass(frozen=True, slots=True)
class Consistency:
    """What N runs say at K epochs ``t_s`` (K,).

    ``nees`` (K, 3): mean over the runs for position, velocity, attitude, to lie in ``nees_band``.
    ``bias`` (K, 9): mean of error over sigma, times the root of N, to lie within ``bias_band``.
    ``rms`` (K, 9) are the errors' own, ``sigma`` (K, 9) what was claimed (rms over the runs).

    ``chance``: share of mean errors inside their band that these errors would show if they had no common
    part, on average and in the worst of twenty cases. Each run's errors get one sign at random: that takes
    away what is common and leaves how epochs and axes of a run hang together, by which the mean errors of a
    campaign come or stay away in crowds.
    """

    runs: int
    t_s: Array
    nees: Array
    nees_band: tuple[float, float]
    bias: Array
    bias_band: float
    rms: Array
    sigma: Array
    chance: tuple[float, float]

    @property
    def nees_inside(self) -> float:
        """Share of epochs and kinds whose NEES lies in the band."""
        return share_inside(self.nees, *self.nees_band)

    @property
    def bias_inside(self) -> float:
        """Share of epochs and axes whose mean error lies in the band."""
        return share_inside(self.bias, -self.bias_band, self.bias_band)

    @property
    def passed(self) -> bool:
        """Whether enough lies inside."""
        return self.nees_inside >= INSIDE and self.bias_inside >= INSIDE


def consistency(t_s: Array, error: Array, covariance: Array) -> Consistency:
    """Statistics of errors (N, K, 9) and covariances (N, K, 9, 9) at epochs ``t_s`` (K,)."""
    runs = len(error)
    parts = list(KINDS.values())
    variance = np.einsum("nkii->nki", covariance)
    normalised = error / np.sqrt(variance)
    bias_band = float(ndtri(0.5 * (1.0 + SHARE)))
    return Consistency(
        runs=runs,
        t_s=np.asarray(t_s),
        nees=np.stack([nees(error[..., p], covariance[..., p, p]).mean(axis=0) for p in parts], axis=-1),
        nees_band=band(3, runs),
        bias=normalised.mean(axis=0) * math.sqrt(runs),
        bias_band=bias_band,
        rms=np.sqrt(np.mean(error**2, axis=0)),
        sigma=np.sqrt(variance.mean(axis=0)),
        chance=_by_chance(normalised.reshape(runs, -1), bias_band),
    )


def _by_chance(normalised: Array, bias_band: float) -> tuple[float, float]:
    """Share of means of ``normalised`` (N, M) inside the band, signs drawn anew: mean, 5 % quantile."""
    runs = len(normalised)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, runs))
    inside = np.mean(np.abs(signs @ normalised) <= bias_band * math.sqrt(runs), axis=1)
    return float(inside.mean()), float(np.quantile(inside, 0.05))


@dataclass(frozen=True, slots=True)
class Alignment:
    """What N alignments at rest say, all (3,) about east, north, up, rad.

    ``rms`` is the spread of the errors about the truth, ``limit`` the theoretical limit, ``sigma`` what was
    claimed (rms). ``ratio_band``: where rms over sigma lies when sigma is right. ``nees`` of the three
    axes together lies in ``nees_band`` then. Four numbers must lie in their bands at once, so each band holds
    its number in all but a quarter of the 5 % of cases in which an honest navigator may fail (Bonferroni's
    inequality, which asks for no independence: the NEES is made of the same errors as the three ratios).
    """

    runs: int
    rms: Array
    mean: Array
    limit: Array
    sigma: Array
    ratio_band: tuple[float, float]
    nees: float
    nees_band: tuple[float, float]

    @property
    def to_limit(self) -> Array:
        """Spread over limit (3,)."""
        return self.rms / self.limit

    @property
    def to_sigma(self) -> Array:
        """Spread over what was claimed (3,)."""
        return self.rms / self.sigma

    @property
    def passed(self) -> bool:
        """Whether the spread is near the limit, as far as N runs can tell, and sigma agrees with it."""
        low, high = self.ratio_band
        near = bool(np.all(self.to_limit <= LIMIT_FACTOR * high))
        agree = self.nees_band[0] <= self.nees <= self.nees_band[1]
        return near and agree and bool(np.all((self.to_sigma >= low) & (self.to_sigma <= high)))


def alignment(error: Array, covariance: Array, limit: Array) -> Alignment:
    """Statistics of attitude errors (N, 3) and covariances (N, 3, 3) against a limit (3,), rad."""
    runs = len(error)
    share = 1.0 - (1.0 - SHARE) / 4.0
    low, high = band(1, runs, share)
    return Alignment(
        runs=runs,
        rms=np.sqrt(np.mean(error**2, axis=0)),
        mean=error.mean(axis=0),
        limit=np.asarray(limit),
        sigma=np.sqrt(np.einsum("nii->ni", covariance).mean(axis=0)),
        ratio_band=(math.sqrt(low), math.sqrt(high)),
        nees=float(nees(error, covariance).mean()),
        nees_band=band(3, runs, share),
    )


def consistency_lines(found: Consistency) -> list[str]:
    """A table for people."""
    low, high = found.nees_band
    lines = [
        f"{found.runs} runs; mean NEES of 3 states, 95 % band {low:.2f} to {high:.2f} (* outside)",
        f"{'time':>8}" + "".join(f"{kind:>12} " for kind in KINDS) + f"{'largest bias / sigma':>24}",
    ]
    for t, row, bias in zip(found.t_s, found.nees, found.bias, strict=True):
        marks = "".join(f"{value:>12.2f}{' ' if low <= value <= high else '*'}" for value in row)
        k = int(np.argmax(np.abs(bias)))
        where = f"{list(KINDS)[k // 3]} {AXES[k % 3]}"
        flag = " " if abs(bias[k]) <= found.bias_band else "*"
        lines.append(f"{t:>7.1f}s{marks}{bias[k]:>8.2f}{flag} {where}")
    least = f"(at least {100 * INSIDE:.0f} %)"
    mean, worst = found.chance
    lines += [
        f"NEES inside the band: {100 * found.nees_inside:.1f} % of epochs {least}",
        f"mean error inside the band of zero: {100 * found.bias_inside:.1f} % {least}",
        f"  with signs drawn anew, run by run: {100 * mean:.1f} % on average, {100 * worst:.1f} % or less "
        "in one case of twenty",
        "consistent" if found.passed else "NOT consistent",
    ]
    return lines


def alignment_lines(found: Alignment) -> list[str]:
    """A table for people, angles in degrees."""
    low, high = found.ratio_band
    lines = [
        f"{found.runs} alignments at rest (deg)",
        f"{'':>7}{'rms':>11}{'mean':>11}{'limit':>11}{'claimed':>11}{'rms/limit':>11}{'rms/claimed':>13}",
    ]
    for k, axis in enumerate(AXES):
        values = (found.rms[k], found.mean[k], found.limit[k], found.sigma[k])
        angles = "".join(f"{math.degrees(value):>11.5f}" for value in values)
        lines.append(f"{axis:>7}{angles}{found.to_limit[k]:>11.2f}{found.to_sigma[k]:>13.2f}")
    lines += [
        f"rms/claimed of so many runs lies in {low:.2f} to {high:.2f} when the claim is right",
        f"NEES {found.nees:.2f}, band {found.nees_band[0]:.2f} to {found.nees_band[1]:.2f}",
        "at the limit, and honest" if found.passed else "NOT at the limit, or not honest",
    ]
    return lines


def consistency_document(found: Consistency) -> dict[str, Any]:
    """The same as plain JSON; angles rad."""
    return {
        "runs": found.runs,
        "passed": found.passed,
        "nees_band": list(found.nees_band),
        "nees_inside": found.nees_inside,
        "bias_band": found.bias_band,
        "bias_inside": found.bias_inside,
        "bias_inside_by_chance": {"mean": found.chance[0], "one_in_twenty": found.chance[1]},
        "epochs": [
            {
                "t_s": float(t),
                "nees": dict(zip(KINDS, row.tolist(), strict=True)),
                "bias": bias.tolist(),
                "rms": rms.tolist(),
                "sigma": sigma.tolist(),
            }
            for t, row, bias, rms, sigma in zip(
                found.t_s, found.nees, found.bias, found.rms, found.sigma, strict=True
            )
        ],
    }


def alignment_document(found: Alignment) -> dict[str, Any]:
    """The same as plain JSON; angles rad."""
    return {
        "runs": found.runs,
        "passed": found.passed,
        "rms": found.rms.tolist(),
        "mean": found.mean.tolist(),
        "limit": found.limit.tolist(),
        "claimed": found.sigma.tolist(),
        "rms_to_limit": found.to_limit.tolist(),
        "rms_to_claimed": found.to_sigma.tolist(),
        "ratio_band": list(found.ratio_band),
        "nees": found.nees,
        "nees_band": list(found.nees_band),
    }
