"""Allan deviation of a sensor at rest, and the densities of the noises that it is made of.

The deviation itself, overlapping, is that of the library allantools. Its square is a sum of noises with a
slope of their own each (IEEE Std 952-1997, annex C): quantisation 3 Q^2 / tau^2, random walk of the angle or
velocity N^2 / tau, bias instability (2 ln 2 / pi) B^2, random walk of the rate K^2 tau / 3 and ramp
R^2 tau^2 / 2. Their squared coefficients are found by generalised least squares, none of them negative.
Estimates at different tau come from the same samples: how they go together is

    Cov = 4 / T int_0^(1 / 2 tau_0) |H_i|^2 |H_j|^2 S^2 df
    |H_m|^2 = 2 sin^4(pi f m tau_0) / (m sin(pi f tau_0))^2

of the spectrum S of the fitted noises, because an Allan variance is the mean square of what a filter H leaves
of a Gaussian process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import allantools
import numpy as np
from scipy import stats
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from nav.types import Vector

TERMS: Final = ("quantisation", "random walk", "instability", "rate random walk", "ramp")
SLOPES: Final = {
    "quantisation": -1.0,
    "random walk": -0.5,
    "instability": 0.0,
    "rate random walk": 0.5,
    "ramp": 1.0,
}
"""Of the deviation over tau in a log-log picture."""
MARKOV: Final = "drift"
"""A Gauss-Markov process: what a filter has instead of the instability and all that rises."""
OF_FILTER: Final = ("quantisation", "random walk", MARKOV)

LONGEST: Final = 9
"""The longest averaging time is this share of the record: ten averages say something, two do not."""
LEAST: Final = 64 * LONGEST
"""Samples from which on there is something to fit."""
LEVEL: Final = 0.95
"""Of the confidence intervals and bounds."""
_WORTH: Final = 4.0
"""How much likelier (twice the logarithm) a further noise has to make a curve."""
_WORTH_RAMP: Final = 12.0
"""The same of a ramp: a rate that walks looks like one often enough."""
_SURE: Final = 1e-4
_GROWTH: Final = 2.0
_HALVINGS: Final = 6
_ROUNDS: Final = 12
_FEWEST: Final = 7  # times from which noises are found: more than there are noises
_TAIL: Final = 1e-4
"""So improbable a chi-square says that a curve is another sum."""
STRANGE: Final = 3.0
"""With residuals so many times too large nothing is read off: pulses that are too coarse, or a tone."""
_DENSE: Final = 4096  # frequencies of a record that are all taken; beyond, so many an octave


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Overlapping Allan deviation of n sensors: ``tau`` (k,) s and ``deviation`` (k, n).

    ``m`` (k,) is tau in samples of ``tau0`` s; the record has ``count`` of them.
    """

    tau0: float
    count: int
    m: Vector
    deviation: Vector

    @property
    def tau(self) -> Vector:
        """Averaging times (k,) s."""
        return np.asarray(self.m * self.tau0)


@dataclass(frozen=True, slots=True)
class Term:
    """A coefficient: what it is, and between what it lies; ``value`` is None where it does not show."""

    value: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Noises:
    """The noises of one sensor by their names, and how well they explain its curve.

    They hold from time number ``first`` on. ``chi2`` has ``freedom`` degrees of freedom; intervals are
    ``inflation`` times as wide as chance makes them where the curve is another sum than that. ``fitted`` (k,)
    is the deviation of the sum, and ``edf`` (k,) the degrees of freedom that the curve's squares have.
    """

    terms: dict[str, Term]
    first: int
    chi2: float
    freedom: int
    inflation: float
    fitted: Vector
    edf: Vector

    def band(self, deviation: Vector) -> tuple[Vector, Vector]:
        """Between what (k,) a curve's true deviations lie, at `LEVEL`."""
        low, high = (
            np.sqrt(self.edf / q)
            for q in stats.chi2.ppf([[0.5 + 0.5 * LEVEL], [0.5 - 0.5 * LEVEL]], self.edf)
        )
        return deviation * low, deviation * high


def curve(rates: Vector, tau0: float) -> Curve:
    """The curve of ``rates`` (samples, n), each the mean over an interval of ``tau0`` s.

    Averaging times are octaves from one sample to a ninth of the record. Raises ValueError where there are
    fewer samples than `LEAST`.
    """
    count = len(rates)
    if count < LEAST:
        raise ValueError(f"found {count} samples, expected at least {LEAST}")
    m: Vector = 2.0 ** np.arange(int(np.log2(count / LONGEST)) + 1, dtype=np.float64)
    found = []
    for one in rates.T:
        _, deviation, _, _ = allantools.oadev(one - one.mean(), 1.0 / tau0, data_type="freq", taus=m * tau0)
        if len(deviation) != len(m):
            raise ValueError("expected rates that are finite")
        found.append(deviation)
    return Curve(tau0, count, m, np.array(found).T)


class Expectation:
    """What noises of unit coefficients make of the Allan variances at the times of a curve.

    ``correlation`` s is that of `MARKOV`, where that is among ``names``.
    """

    def __init__(self, of: Curve, names: Sequence[str] = TERMS, correlation: float | None = None) -> None:
        self.names = tuple(names)
        tau, tau0, T = of.tau, of.tau0, of.count * of.tau0
        f, weight = _frequencies(of.count)
        f = f / T
        spectra = {
            "quantisation": 4.0 / tau0 * np.sin(np.pi * f * tau0) ** 2,
            "random walk": np.ones_like(f),
            "instability": 1.0 / (2.0 * np.pi * f),
            "rate random walk": 1.0 / (2.0 * np.pi * f) ** 2,
            "ramp": np.zeros_like(f),
        }
        means = {
            "quantisation": 3.0 / tau**2,
            "random walk": 1.0 / tau,
            "instability": np.full_like(tau, 2.0 * np.log(2.0) / np.pi),
            "rate random walk": tau / 3.0,
            "ramp": tau**2 / 2.0,
        }
        if correlation is not None:
            spectra[MARKOV] = 2.0 * correlation / (1.0 + (2.0 * np.pi * f * correlation) ** 2)
            means[MARKOV] = _markov(tau / correlation)
        self.mean = np.stack([means[name] for name in self.names], axis=1)
        gain = 2.0 * np.sin(np.pi * np.outer(of.m, f * tau0)) ** 4
        gain /= np.outer(of.m, np.sin(np.pi * f * tau0)) ** 2
        S = np.stack([spectra[name] for name in self.names])
        # of a record that is longer than two averaging times by so much
        longest = 1.0 - np.maximum.outer(of.m, of.m) * 2.0 / of.count
        self.spread = np.empty((len(self.names), len(self.names), len(tau), len(tau)))
        for p in range(len(S)):
            for q in range(p + 1):
                part = (gain * (weight * S[p] * S[q])) @ gain.T
                self.spread[p, q] = self.spread[q, p] = 4.0 / T**2 * part / longest

    def covariance(self, squares: Vector) -> Vector:
        """Covariance (k, k) of the variances for squared coefficients (p,)."""
        return np.asarray(np.einsum("p,q,pqij->ij", squares, squares, self.spread))


def _frequencies(count: int) -> tuple[Vector, Vector]:
    """Places among the frequencies 1 to count / 2 of a record, and for how many each stands."""
    last = count // 2
    f = [np.arange(1.0, min(_DENSE, last) + 1.0)]
    weight = [np.ones(len(f[0]))]
    begin = _DENSE
    while begin < last:
        end = min(2 * begin, last)
        step = max(1.0, (end - begin) / _DENSE)
        places = np.arange(begin + 0.5, end + 0.5, step)
        # evenly spread, but in step with no averaging time
        places = places + (np.arange(len(places)) * 0.6180339887498949 % 1.0) * (step - 1.0)
        f.append(np.minimum(places, float(last)))
        weight.append(np.full(len(places), (end - begin) / len(places)))
        begin = end
    return np.concatenate(f), np.concatenate(weight)


def _markov(x: Vector) -> Vector:
    """Allan variance of a Gauss-Markov process of unit variance over averaging times in correlation times."""
    series = 2.0 * x / 3.0 - x**2 / 2.0
    safe = np.maximum(x, 1e-3)
    exact = (2.0 * safe - 3.0 + 4.0 * np.exp(-safe) - np.exp(-2.0 * safe)) / safe**2
    return np.where(x > 1e-3, exact, series)


def noises(deviation: Vector, expected: Expectation) -> Noises:
    """The noises in a curve (k,) of one sensor.

    At the shortest times a sensor may be otherwise: it is filtered, or counts a pulse now and then. Times
    are left out from there on until the rest is such a sum, as long as `_FEWEST` are left.

    Raises:
        ValueError: a deviation is zero: the sensor is stuck.
    """
    if not np.all(deviation > 0.0):
        raise ValueError("found a sensor that says the same all the time")
    tried: list[Noises] = []
    for first in range(len(deviation) - _FEWEST + 1):
        tried.append(noises_from(first, deviation, expected))
        if tried[-1].inflation == 1.0:
            return tried[-1]
    return min(tried, key=lambda one: one.inflation)


def noises_from(first: int, deviation: Vector, expected: Expectation) -> Noises:
    """The noises as the times from number ``first`` on show them: the fewest that are about as likely as all.

    The interval of each is where the likelihood is not much less, whatever the others are, so that it tells
    of those that could stand in for it. Where the curve is no such sum at all, by `STRANGE`, each is only
    bounded by the curve itself.
    """
    fit = _Fit(deviation[first:] ** 2, expected.mean[first:], expected.spread[:, :, first:, first:])
    every = range(len(expected.names))
    sets = [kept for count in range(1, len(every) + 1) for kept in combinations(every, count)]
    found = [(kept, fit.squares(kept)) for kept in sets]
    worth = [_WORTH_RAMP if name == "ramp" else _WORTH for name in expected.names]
    kept, squares = min(found, key=lambda one: fit.likelihood(one[1]) + sum(worth[k] for k in one[0]))
    rivals = [k for k in every if k in kept or expected.names[k] != "ramp"]
    chi2, freedom = fit.chi2(squares), len(fit.variance) - len(kept)
    inflation = float(np.sqrt(chi2 / freedom)) if stats.chi2.sf(chi2, freedom) < _TAIL else 1.0
    terms = {}
    for k, name in enumerate(expected.names):
        if inflation >= STRANGE:
            terms[name] = Term(None, 0.0, fit.most(k))
        else:
            value = float(np.sqrt(squares[k])) if k in kept and squares[k] > 0.0 else None
            terms[name] = Term(value, *fit.interval(k, squares[k], rivals, inflation, value is None))
    fitted = expected.mean @ squares
    edf = 2.0 * fitted**2 / np.diag(expected.covariance(squares))
    return Noises(terms, first, chi2, freedom, inflation, np.sqrt(fitted), edf)


def unlikely(first: int, deviation: Vector, expected: Expectation) -> float:
    """Minus twice the logarithm of the likelihood of a curve, from time number ``first`` on."""
    fit = _Fit(deviation[first:] ** 2, expected.mean[first:], expected.spread[:, :, first:, first:])
    return fit.likelihood(fit.squares(range(len(expected.names))))


class _Fit:
    """The variances (k,) of a curve, what unit coefficients make of them (k, p), and how they spread.

    A variance is distributed about as chi-square, so that its cube root is about normal (Wilson, Hilferty).
    """

    def __init__(self, variance: Vector, mean: Vector, spread: Vector) -> None:
        self.variance = variance
        self._mean = mean
        self._spread = spread

    def _covariance(self, squares: Vector) -> Vector:
        C = np.einsum("p,q,pqij->ij", squares, squares, self._spread)
        # a ramp has no spread, and no curve is known any better
        return np.asarray(C + np.diag((_SURE * self.variance) ** 2))

    def squares(self, kept: Sequence[int], fixed: int | None = None, size: float = 0.0) -> Vector:
        """Squared coefficients (p,) by repeated least squares: zero but for ``kept`` and one ``fixed``."""
        free = [k for k in kept if k != fixed]
        found = np.zeros(self._mean.shape[1])
        if fixed is not None:
            found[fixed] = size
        A, y = self._mean[:, free], self.variance - self._mean @ found
        root: Vector = np.asarray(np.diag(self.variance))
        for _ in range(_ROUNDS):
            before = found.copy()
            if free:
                B, left = (solve_triangular(root, part, lower=True) for part in (A, y))
                found[free] = nnls(B, left)[0]
            if np.allclose(found, before, rtol=1e-3, atol=0.0) or not found.any():
                break
            root = np.asarray(np.linalg.cholesky(self._covariance(found)))
        return found

    def _roots(self, squares: Vector) -> tuple[Vector, Vector, Vector]:
        """Cube roots (k,) less what is expected, the Cholesky factor of their covariance, the variances."""
        fitted = self._mean @ squares
        relative = self._covariance(squares) / np.outer(fitted, fitted)
        z = 3.0 * (np.cbrt(self.variance / fitted) - 1.0 + np.diag(relative) / 9.0)
        return z, np.asarray(np.linalg.cholesky(relative)), fitted

    def chi2(self, squares: Vector) -> float:
        """Sum of the squares of what is left."""
        z, L, _ = self._roots(squares)
        left = solve_triangular(L, z, lower=True)
        return float(left @ left)

    def likelihood(self, squares: Vector) -> float:
        """Minus twice its logarithm."""
        if not squares.any():
            return np.inf
        z, L, fitted = self._roots(squares)
        left = solve_triangular(L, z, lower=True)
        return float(left @ left + 2.0 * np.log(np.diag(L)).sum() + 2.0 / 3.0 * np.log(fitted).sum())

    def interval(
        self, k: int, square: float, rivals: Sequence[int], inflation: float, bound: bool
    ) -> tuple[float, float]:
        """Between what a coefficient lies, or with ``bound`` below what, ``rivals`` being what they want."""
        whole = self.squares(rivals)
        limit = min(self.likelihood(whole), self.likelihood(self.squares(rivals, k, square)))
        limit += inflation**2 * float(stats.norm.ppf(LEVEL if bound else 0.5 + 0.5 * LEVEL)) ** 2

        def inside(size: float) -> bool:
            return self.likelihood(self.squares(rivals, k, size)) < limit

        # as small as the curve could not tell from nothing
        least = 1e-6 * float(np.min(self.variance / self._mean[:, k]))
        middle = max(square, whole[k] if bound else 0.0, least)
        low = 0.0
        if not bound and not inside(0.0):
            low = _edge(inside, middle, 1.0 / _GROWTH)
        return float(np.sqrt(low)), float(np.sqrt(_edge(inside, middle, _GROWTH)))

    def most(self, k: int) -> float:
        """How large a coefficient may be at most if all of the curve is its own."""
        place = int(np.argmax(self._mean[:, k] / self.variance))
        square = np.zeros(self._mean.shape[1])
        square[k] = 1.0
        edf = 2.0 * self._mean[place, k] ** 2 / self._covariance(square)[place, place]
        rest = stats.chi2.ppf(1.0 - LEVEL, edf) / edf
        return float(np.sqrt(self.variance[place] / rest / self._mean[place, k]))


def _edge(inside: Callable[[float], bool], begin: float, growth: float) -> float:
    """Where ``inside`` ends, from ``begin`` on, up or down."""
    here, there = begin, begin * growth
    while inside(there):
        here, there = there, there * growth
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(here * there))
        here, there = (middle, there) if inside(middle) else (here, middle)
    return float(np.sqrt(here * there))
