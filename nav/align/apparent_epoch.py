"""Epochs of displacement: means over squared sines that overlap by half, against what gravity does in them.

A squared sine of length L averages out whatever swings k/L times a second, k = 2, 3 ...; epochs come twice in
L, so a sway that looks like a drift from epoch to epoch would have to swing 2k/L times a second, and is gone.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import A_T, A_V, C_i0g, gravity_integrals
from nav.align.constant import OFFSET, POS, START, VEL
from nav.align.disturbance import Window, weigh, window
from nav.earth import gravity_g
from nav.types import Vector

_EYE: Final = np.eye(3)
_SQUARE: Final = 1.0 / 12.0 - 0.5 / math.pi**2  # mean square of the seconds in a window of one second


class Pair(NamedTuple):
    """The two open epochs: ``newer`` begins in the middle of ``older``, at ``row``."""

    older: Window | None
    newer: Window
    row: Vector


class Mean(NamedTuple):
    """A closed epoch: mean ``values`` (n,), the row near its middle, seconds and squared seconds since that.

    ``whole`` is the variance of the time that an epoch of its length has, whatever samples fall into it.
    """

    row: Vector
    early: float
    square: float
    whole: float
    values: Vector


def pair(row: Vector, length: float, n: int) -> Pair:
    """Begin at a row, with epochs of ``length`` s for values (n,)."""
    return Pair(None, window(float(row[A_T]), length, n), row.copy())


def fill(open_: Pair, t: float, values: Vector) -> None:
    """Add ``values`` (n,) at ``t`` s."""
    if open_.older is not None:
        weigh(open_.older.sums, open_.older.begin, open_.older.length, t, values)
    weigh(open_.newer.sums, open_.newer.begin, open_.newer.length, t, values)


def close(open_: Pair, row: Vector) -> tuple[Pair, Mean | None]:
    """At a row in the middle of the newer epoch: the older one is over, and the next begins."""
    newer, older = open_.newer, open_.older
    following = Pair(newer, window(newer.middle, newer.length, len(newer.sums) - 3), row.copy())
    if older is None:
        return following, None
    early, square, values = older.mean()
    offset = older.middle - float(open_.row[A_T])
    early += offset
    square += offset * (2.0 * early - offset)
    return following, Mean(open_.row, early, square, _SQUARE * older.length**2, values)


def against_gravity(
    mean: Mean, lat: float, height: float, further: Vector | None = None, axis: Vector | None = None
) -> tuple[Vector, float, Vector]:
    """H (3, SIZE) of the mean displacement at a fixed place, its time, and what its curvature is off by (3,).

    ``further`` and ``axis`` as in `constant.design`. A mean lies above the middle of a parabola, by more or
    less as samples fall; without that difference epochs compare.
    """
    seconds = float(mean.row[A_T])
    once, twice = gravity_integrals(lat, height, seconds)
    g_i0 = C_i0g(lat, lat, 0.0, seconds) @ gravity_g(lat, height)
    H = constant.design(twice + once * mean.early - 0.5 * mean.square * g_i0, further, axis)
    seconds += mean.early
    H[:, POS], H[:, VEL], H[:, OFFSET] = -_EYE, -mean.early * _EYE, _EYE
    H[:, START] = -seconds * _EYE
    off = mean.square - mean.early**2 - mean.whole
    return H, seconds, 0.5 * off / seconds * mean.row[A_V : A_V + 3]
