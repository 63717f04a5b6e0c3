"""What no monitor can do better: how much of a fault gets into the fused increments before it can be out.

Whoever knows when a fault began, of which sensor and how it goes on has of it, in parity space, the
noncentrality lambda = |v_i|^2 f' S^-1 f, with S the covariance of a sensor's increments since the start:
white noise, and what calibration has left of bias, scale and axis, which is constant and becomes known by and
by. Of a test with the chance a of a false alarm no more than Q(z_a - sqrt(lambda)) are detected then (Neyman
and Pearson); and where the nearest other sensor's direction is the angle t away, with a chance b of taking
that one for it no more than Q(z_b - sqrt(lambda) sin t) are isolated.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from nav.imu.redundant import Redundant
from nav.types import Vector


def apart(fusion: Redundant, k: int) -> float:
    """Sine of the angle in parity space between sensor ``k`` and the one most like it."""
    V = fusion.tables.sets.parity[-1]
    V = V / np.linalg.norm(V, axis=0)
    cosine = np.abs(V[:, k] @ V)
    cosine[k] = 0.0
    return float(np.sqrt(max(0.0, 1.0 - cosine.max() ** 2)))


def least(
    fusion: Redundant, k: int, fault: Vector, moved: Vector, begin: int, seconds: Vector, rate_hz: float
) -> Vector:
    """Mean square (s,) of what a fault has put into the fused sum ``seconds`` (s,) after it began, at least.

    ``fault`` (m,) rad or m/s is what sensor ``k`` has too much from sample ``begin`` on, ``moved``
    (begin + m, 3) the motion; both in increments.
    """
    tau, noise = 1.0 / rate_hz, fusion.noise
    white = noise.walk**2 * tau
    known = np.column_stack((np.full(len(moved), noise.bias * tau), noise.scale * moved))
    at = np.rint(seconds * rate_hz).astype(int) - 1
    both = np.cumsum(fault[:, None] * known[begin:], axis=0)[at]
    own = np.cumsum(known[:, :, None] * known[:, None, :], axis=0)[begin + at]
    taken = np.einsum("si,si->s", both, np.linalg.solve(white * np.eye(4) + own, both[:, :, None])[:, :, 0])
    told = 1.0 / fusion.tables.sets.inverse[-1, k]
    root = np.sqrt(told * np.maximum(np.cumsum(fault**2)[at] - taken, 0.0) / white)
    alarm = np.minimum(fusion.monitor.false_alarms / 3600.0 * seconds, 1.0)
    detected = stats.norm.sf(stats.norm.isf(alarm) - root)
    isolated = stats.norm.sf(stats.norm.isf(fusion.monitor.isolation) - root * apart(fusion, k))
    share = np.linalg.norm(fusion.tables.sets.fuse[-1][:, k])
    inside = (1.0 - np.minimum(detected, isolated)) * (np.cumsum(fault)[at] * share) ** 2
    return np.asarray(inside)
