"""Epochs of apparent velocity or displacement, taken into the filter when it is known how rough they are."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from nav.align import constant
from nav.align.apparent import Change, change
from nav.align.constant import Estimate
from nav.align.disturbance import Roughness, follow
from nav.align.types import AlignConfig
from nav.types import Vector

SETTLE_S: Final = 25.0  # before that the nine elements are not told apart
SIGMAS: Final = 6.0
_EYE: Final = np.eye(3)


class Epoch(NamedTuple):
    """What one epoch says: z (3,) = H (3, SIZE) x + noise, and the change since the one before."""

    change: Change
    H: Vector
    z: Vector
    walk: Vector  # (3, 3) m^2/s of the offset


class Book(NamedTuple):
    """The estimate at a row, the roughness of the epochs so far, and those that wait for it."""

    estimate: Estimate
    row: Vector
    rough: Roughness = Roughness()
    waiting: tuple[Epoch, ...] = ()
    taken: int = 0

    @property
    def settled(self) -> bool:
        """Whether the estimate holds all epochs, and enough of them to mean something."""
        return not self.waiting and float(self.row[0]) > SETTLE_S


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
) -> tuple[Book, float]:
    """Add an epoch at ``row``; returns also by how much it contradicts the others, or 0.

    ``bare`` (3,) at ``t`` s is what its roughness is seen in, smooth but for that; ``floor`` is the least
    standard deviation a component is given.
    """
    epoch = Epoch(change(book.row, row), H, z, walk)
    rough = follow(book.rough, t, bare)
    usual, now = book.rough.sigma, rough.sigma
    e, waiting, moved = book.estimate, (*book.waiting, epoch), 0.0
    if now is not None:
        noise = max(floor, now) ** 2 * _EYE
        for past in waiting:
            e = constant.predict(e, past.change, config, past.walk)
            if past is epoch and usual is not None and t > SETTLE_S:
                nu = constant.innovation(e, H, z, max(floor, usual) ** 2 * _EYE)
                if nu.chi2 > SIGMAS**2 + 3.0:
                    moved = float(np.linalg.norm(nu.nu))
            e = constant.update(e, past.H, past.z, noise)
        waiting = ()
    return Book(e, row, rough, waiting, book.taken + 1), moved


def bring(book: Book, config: AlignConfig, row: Vector, walk: Vector) -> Book:
    """The estimate at a later row; no epoch may wait."""
    e = constant.predict(book.estimate, change(book.row, row), config, walk)
    return book._replace(estimate=e, row=row.copy())
