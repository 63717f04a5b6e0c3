"""Epochs of apparent velocity or displacement, taken into the filter when it is known how rough they are.

What happens to an IMU (a push, a turn that its gyros did not see, a wheel that slips) looks small in one
epoch and changes all that follow. So rivals go along for a few epochs each: filters that take something to
have happened at their first epoch. One that foretells the epochs much better is right.

What happens in the first seconds is hidden twice: nothing is foretold yet, and all of it seems rough. A start
in the midst of a slip is the rule, since the one before refused because of it. So those that begin then stay
till what is seen of roughness has nothing to do with the beginning any more.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import Change, change
from nav.align.constant import POS, SIZE, THETA, VEL, Estimate
from nav.align.disturbance import BACK, Roughness, follow
from nav.align.types import AlignConfig
from nav.types import Vector

SETTLE_S: Final = 25.0  # before that the nine elements are not told apart
SIGMAS: Final = 6.0
RIVALS: Final = 3
EVENT: Final = 100.0  # chi-square; a sway, which is no white noise, gives 60 by chance
LEAST: Final = 1e-6  # m or m/s, of an epoch
DOUBT: Final = 0.4  # of what is no chance: from there on the answer may be off by what made a rival better
_HAPPENED: Final = np.zeros((SIZE, SIZE))  # covariance of what may have happened: rad, m/s, m
_HAPPENED[THETA, THETA] = 1e-3**2 * np.eye(3)
_HAPPENED[VEL, VEL], _HAPPENED[POS, POS] = 0.1**2 * np.eye(3), 0.3**2 * np.eye(3)
_EYE: Final = np.eye(3)


class Epoch(NamedTuple):
    """What one epoch at ``t`` s says: z (3,) = H (3, SIZE) x + noise, and the change since the one before."""

    t: float
    change: Change
    H: Vector
    z: Vector
    walk: Vector  # (3, 3) m^2/s of the offset


class Rival(NamedTuple):
    """What the estimate is if something happened; it goes along till ``last`` epochs are taken.

    ``better``: sum of the chi-squares that it foretold all since better by, times their variance in that of
    their floor.
    """

    estimate: Estimate
    last: int
    better: float = 0.0


class Book(NamedTuple):
    """The estimate at a row, the roughness of the epochs so far, and those that wait for it.

    A rival goes along for ``lasts`` epochs, from the first seconds on till `BACK` have been taken and as many
    more. ``white``: chi-square by which it must be better where epochs are no rougher than their floor; it
    grows with their variance up to `EVENT`. ``worst``: the largest part of it that one reached.
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
    epoch = Epoch(t, change(book.row, row), H, z, walk)
    rough = follow(book.rough, t, bare, float(np.trace(walk)) / 3.0 * epoch.change.dt)
    usual, now, moved = book.rough.sigma, rough.sigma, 0.0
    e, rivals, worst, taken = book.estimate, book.rivals, book.worst, book.taken
    waiting: tuple[Epoch, ...] = (*book.waiting, epoch)
    if now is not None:
        variance, least = max(floor, now) ** 2, max(floor, LEAST) ** 2
        for past in waiting:
            if taken % (book.lasts // RIVALS) == 0:
                since = taken if past.t > SETTLE_S else max(taken, BACK)
                rivals = (*rivals, Rival(_happened(e), since + book.lasts))
            ahead = constant.predict(e, past.change, config, past.walk)
            rivals, better = _rivalled(rivals, config, past, ahead, variance, variance / least)
            rivals = tuple(rival for rival in rivals if rival.last > taken + 1)
            if past.t > SETTLE_S:
                worst = max(worst, better / min(EVENT, book.white * variance / least))
            if past is epoch and usual is not None and t > SETTLE_S:
                seen = constant.innovation(ahead, H, z, max(floor, usual) ** 2 * _EYE)
                size = float(np.linalg.norm(seen.nu))
                if worst > 1.0 or (seen.chi2 > SIGMAS**2 + 3.0 and size > large):
                    moved = size
            e = constant.update(ahead, past.H, past.z, variance * _EYE)
            taken += 1
        waiting = ()
    return book._replace(
        estimate=e, row=row, rough=rough, waiting=waiting, taken=taken, rivals=rivals, worst=worst
    ), moved


def _happened(e: Estimate) -> Estimate:
    """The estimate, if something happened now."""
    P = e.P.copy()
    P[:SIZE, :SIZE] += _HAPPENED
    return e._replace(P=P)


def _rivalled(
    rivals: tuple[Rival, ...],
    config: AlignConfig,
    epoch: Epoch,
    ahead: Estimate,
    variance: float,
    rougher: float,
) -> tuple[tuple[Rival, ...], float]:
    """Let the rivals take an epoch, ``ahead`` of which the estimate is; and how much better the best is.

    ``rougher``: the epoch's variance in that of its floor.
    """
    noise, best, taken = variance * _EYE, 0.0, []
    known = constant.innovation(ahead, epoch.H, epoch.z, noise)
    for rival in rivals:
        e = constant.predict(rival.estimate, epoch.change, config, epoch.walk)
        gained = known.chi2 - constant.innovation(e, epoch.H, epoch.z, noise).chi2
        better = rival.better + gained * rougher
        best = max(best, better / rougher)
        taken.append(rival._replace(estimate=constant.update(e, epoch.H, epoch.z, noise), better=better))
    return tuple(taken), best


def bring(book: Book, config: AlignConfig, row: Vector, walk: Vector) -> Book:
    """The estimate at a later row; no epoch may wait."""
    e = constant.predict(book.estimate, change(book.row, row), config, walk)
    return book._replace(estimate=e, row=row.copy())
