"""Epochs of apparent velocity or displacement, taken into the filter when it is known how rough they are.

What happens to an IMU (a push, a turn that its gyros did not see, a wheel that slips) looks small in one
epoch and changes all that follow. So rivals go along for a few epochs each: filters that take something to
have happened at their first epoch. One that foretells the epochs much better is right.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import Change, change
from nav.align.constant import POS, SIZE, THETA, VEL, Estimate
from nav.align.disturbance import Roughness, follow
from nav.align.types import AlignConfig
from nav.types import Vector

SETTLE_S: Final = 25.0  # before that the nine elements are not told apart
SIGMAS: Final = 6.0
RIVALS: Final = 3
EVENT: Final = 100.0  # chi-square; a sway, which is no white noise, gives 60 by chance
DOUBT: Final = 0.4  # of what is no chance: from there on the answer may be off by what made a rival better
_HAPPENED: Final = np.zeros((SIZE, SIZE))  # covariance of what may have happened: rad, m/s, m
_HAPPENED[THETA, THETA] = 1e-3**2 * np.eye(3)
_HAPPENED[VEL, VEL], _HAPPENED[POS, POS] = 0.1**2 * np.eye(3), 0.3**2 * np.eye(3)
_EYE: Final = np.eye(3)


class Epoch(NamedTuple):
    """What one epoch says: z (3,) = H (3, SIZE) x + noise, and the change since the one before."""

    change: Change
    H: Vector
    z: Vector
    walk: Vector  # (3, 3) m^2/s of the offset


class Rival(NamedTuple):
    """What the estimate is if something happened ``epochs`` ago.

    ``better``: sum of the chi-squares that it foretold them better by, times the variances they were given.
    """

    estimate: Estimate
    better: float = 0.0
    epochs: int = 0


class Book(NamedTuple):
    """The estimate at a row, the roughness of the epochs so far, and those that wait for it.

    A rival goes along for ``lasts`` epochs. ``white``: chi-square by which it must be better where epochs are
    no rougher than their floor; it grows with their variance up to `EVENT`. ``worst``: the largest part of it
    that one reached.
    """

    estimate: Estimate
    row: Vector
    rough: Roughness
    waiting: tuple[Epoch, ...] = ()
    taken: int = 0
    rivals: tuple[Rival, ...] = ()
    lasts: int = 6
    white: float = EVENT
    worst: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether the estimate holds all epochs, and enough of them to mean something."""
        return not self.waiting and float(self.row[0]) > SETTLE_S

    @property
    def doubt(self) -> float:
        """What covariances are to be widened by: something may have happened that is not certain."""
        return max(1.0, self.worst / DOUBT) ** 2


def take(
    book: Book,
    config: AlignConfig,
    row: Vector,
    t: float,
    bare: Vector,
    H: Vector,
    z: Vector,
    walk: Vector,
    floor: float,
    large: float,
) -> tuple[Book, float]:
    """Add an epoch at ``row``; returns also by how much it contradicts the others, or 0.

    ``bare`` (3,) at ``t`` s is what its roughness is seen in, smooth but for that; ``floor`` is the least
    standard deviation a component is given. A single epoch contradicts if it is off by more than ``large``.
    """
    epoch = Epoch(change(book.row, row), H, z, walk)
    rough = follow(book.rough, t, bare)
    usual, now = book.rough.sigma, rough.sigma
    e, rivals, waiting, moved = book.estimate, book.rivals, (*book.waiting, epoch), 0.0
    worst = book.worst
    if now is not None:
        variance = max(floor, now) ** 2
        for past in waiting:
            ahead = constant.predict(e, past.change, config, past.walk)
            if past is epoch and usual is not None and t > SETTLE_S:
                seen = constant.innovation(ahead, H, z, max(floor, usual) ** 2 * _EYE)
                size = float(np.linalg.norm(seen.nu))
                rivals, better = _rivalled(book, config, epoch, ahead, variance)
                worst = max(worst, better / _chance(book, variance, floor))
                if worst > 1.0 or (seen.chi2 > SIGMAS**2 + 3.0 and size > large):
                    moved = size
            e = constant.update(ahead, past.H, past.z, variance * _EYE)
        waiting = ()
    taken = book.taken + 1
    return book._replace(
        estimate=e, row=row, rough=rough, waiting=waiting, taken=taken, rivals=rivals, worst=worst
    ), moved


def _chance(book: Book, variance: float, floor: float) -> float:
    """Chi-square by which a rival is not better by chance."""
    return min(EVENT, book.white * variance / floor**2) if floor > 0.0 else EVENT


def _rivalled(
    book: Book, config: AlignConfig, epoch: Epoch, ahead: Estimate, variance: float
) -> tuple[tuple[Rival, ...], float]:
    """Let the rivals take an epoch, ``ahead`` of which the estimate is; and how much better the best is."""
    noise, rivals, best = variance * _EYE, book.rivals, 0.0
    if book.taken % (book.lasts // RIVALS) == 0:
        rivals = (*rivals, Rival(book.estimate._replace(P=book.estimate.P + _HAPPENED)))
    known = constant.innovation(ahead, epoch.H, epoch.z, noise)
    left = []
    for estimate, better, epochs in rivals:
        e = constant.predict(estimate, epoch.change, config, epoch.walk)
        better += (known.chi2 - constant.innovation(e, epoch.H, epoch.z, noise).chi2) * variance
        best = max(best, better / variance)
        if epochs + 1 < book.lasts:
            left.append(Rival(constant.update(e, epoch.H, epoch.z, noise), better, epochs + 1))
    return tuple(left), best


def bring(book: Book, config: AlignConfig, row: Vector, walk: Vector) -> Book:
    """The estimate at a later row; no epoch may wait."""
    e = constant.predict(book.estimate, change(book.row, row), config, walk)
    return book._replace(estimate=e, row=row.copy())
