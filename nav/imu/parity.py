"""What redundant sensors tell of each other: parity space, thresholds, smallest faults that are seen.

n sensors of one kind measure z = H x + noise, H (n, 3) their directions. With V (n - 3, n), V H = 0 and
V V' = I, the parity vector p = V z is free of the motion x: it holds noise and faults alone. Noise of
variance s^2 in every sensor makes p'p / s^2 chi-square of n - 3 degrees. A fault of sensor i moves p along
column i of V, so that the sensor in whose direction most of p lies is the likeliest: its share of p'p is
(v_i . p)^2 / |v_i|^2, and |v_i|^2 is the diagonal of I - H (H'H)^-1 H'.

For any set of sensors still in use all this is computed once; sets are numbered by their bits, sensor 0 the
lowest. The units of Luo Rui, Li Peng, Yu Lingyan 2023 are in `nav.imu.geometry`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from nav.types import Vector

_SPAN: Final = 0.05
"""Unit vectors whose smallest singular value is below this do not span space."""
_TOLD: Final = 1e-9
"""A sensor with less than this of its fault in parity space is not watched by the others."""
_LOW: Final = 6.0
"""No limit is lower: there sums that overlap are beyond it most of the time, and alarms have no beginning."""
MOST: Final = 8
"""Sensors of one kind: tables have two to this power of rows."""


class Sets(NamedTuple):
    """Of every set of sensors m: how to fuse and how to test it.

    ``fuse`` (m, 3, n) takes measurements to x (NaN where they do not span space); ``parity`` (m, n - 3, n)
    to p, rows beyond ``freedom`` (m,) zero; ``inverse`` (m, n) is 1 / |v_i|^2 of its columns, 0 where sensor
    i is not in the set or not watched; ``outside`` (m, n), of a sensor that is not in the set, the variance
    of its difference from what the set predicts; ``cofactor`` (m, 3, 3) the covariance of x; ``spans`` (m,)
    whether there is one. Variances are for unit variance of what ``sigma`` of `sets_of` is in proportion to.
    """

    fuse: Vector
    parity: Vector
    inverse: Vector
    outside: Vector
    cofactor: Vector
    freedom: Vector
    spans: Vector


def parity_matrix(H: Vector) -> Vector:
    """V (n - 3, n) with V H = 0 and V V' = I, of H (n, 3) of rank 3."""
    U = np.linalg.svd(H)[0]
    return np.asarray(U[:, 3:].T)


def sets_of(axes: Vector, sigma: Vector) -> Sets:
    """Tables of all sets of sensors along ``axes`` (n, 3), with noise in proportion to ``sigma`` (n,).

    Raises:
        ValueError: fewer than four sensors or more than `MOST`, wrong shapes, axes that do not span space.
    """
    n = len(axes)
    if axes.shape != (n, 3) or not 4 <= n <= MOST:
        raise ValueError(f"axes: expected shape (4 to {MOST}, 3), found {axes.shape}")
    if sigma.shape != (n,) or not np.all(sigma > 0.0) or not np.all(np.isfinite(axes)):
        raise ValueError("sigma: expected a positive number for each sensor, axes finite")
    count = 1 << n
    out = Sets(
        np.full((count, 3, n), np.nan),
        np.zeros((count, n - 3, n)),
        np.zeros((count, n)),
        np.full((count, n), np.inf),
        np.full((count, 3, 3), np.inf),
        np.zeros(count, np.int64),
        np.zeros(count, np.bool_),
    )
    for m in range(count):
        chosen = np.array([k for k in range(n) if m >> k & 1], dtype=int)
        unit = axes[chosen] / np.linalg.norm(axes[chosen], axis=1, keepdims=True)
        if len(chosen) < 3 or np.linalg.svd(unit, compute_uv=False)[-1] < _SPAN:
            continue
        H = axes[chosen] / sigma[chosen, None]
        cofactor = np.linalg.inv(H.T @ H)
        out.spans[m], out.freedom[m], out.cofactor[m] = True, len(chosen) - 3, cofactor
        out.fuse[m] = 0.0
        out.fuse[m][:, chosen] = cofactor @ H.T / sigma[chosen]
        V = parity_matrix(H)
        out.parity[m][: len(V), chosen] = V / sigma[chosen]
        told = np.sum(V**2, axis=0)
        out.inverse[m, chosen] = np.where(told > _TOLD, sigma[chosen] ** 2 / np.maximum(told, _TOLD), 0.0)
        for k in set(range(n)) - set(chosen.tolist()):
            out.outside[m, k] = sigma[k] ** 2 + axes[k] @ cofactor @ axes[k]
    if not out.spans[-1]:
        raise ValueError("axes: the sensors do not span three directions")
    return out


def thresholds(most: int, alarms: Vector, overlaps: Sequence[int]) -> Vector:
    """Limits (k, most + 1) of p'p in variances, of 0 to ``most`` degrees, of k series of tests.

    Each has so many ``alarms`` (k,) per test, one test for each new of ``overlaps`` (k,) terms of a sum.

    Raises:
        ValueError: more alarms than `alarm` holds for.
    """
    found = np.full((len(alarms), most + 1), np.inf)
    for freedom in range(1, most + 1):
        for k, (rate, overlap) in enumerate(zip(alarms, overlaps, strict=True)):
            high = float(stats.chi2.isf(rate, freedom))
            if alarm(_LOW, freedom, overlap) < rate:
                raise ValueError(f"more alarms than tests can make: {rate:g} per test")

            def excess(limit: float, rate: float = rate, freedom: int = freedom, n: int = overlap) -> float:
                return alarm(limit, freedom, n) / rate - 1.0

            found[k, freedom] = high if overlap == 1 else float(brentq(excess, _LOW, high + 2.0, xtol=1e-12))
    return found


def alarm(limit: float, freedom: int, overlap: int) -> float:
    """Chance per test that an alarm begins: p'p of sums of the last ``overlap`` terms is beyond ``limit``.

    Sums that overlap fail one after the other. From one to the next p'p / 2 moves near the limit as a random
    walk that falls by limit / overlap a step, with twice that as its variance; how often an alarm begins
    follows from the density at the limit and the walk's overshoot (Siegmund, Sequential Analysis, 1985, eq.
    (4.37)). To 7 % from a limit of 12 on.
    """
    if overlap == 1:
        return float(stats.chi2.sf(limit, freedom))
    step = math.sqrt(2.0 * limit / overlap)
    n = np.arange(1, 10 + int(150.0 / step**2))
    overshoot = math.exp(-2.0 * float(np.sum(stats.norm.cdf(-0.5 * step * np.sqrt(n)) / n)))
    return 2.0 * float(stats.chi2.pdf(limit, freedom)) * overshoot


def noncentrality(threshold: float, freedom: int, missed: float) -> float:
    """Noncentrality at which chi-square stays below ``threshold`` with the chance ``missed``."""

    def excess(root: float) -> float:
        return float(stats.ncx2.cdf(threshold, freedom, root**2)) - missed

    # a normal deviate beyond the threshold is always enough
    high = np.sqrt(threshold) + float(stats.norm.isf(missed)) + 1.0
    return float(brentq(excess, 1e-6, high, xtol=1e-12)) ** 2
