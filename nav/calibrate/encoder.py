"""Attitudes of a turntable as its encoders tell them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav import rotation
from nav.types import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Encoder:
    """Readings in order: ``C_gb`` (k, 3, 3) at ``time`` (k,) s of the unit's clock since a stream began."""

    time: Vector
    C_gb: Vector

    def between(self, begin: float, end: float) -> slice:
        """The readings from ``begin`` to ``end`` s."""
        first, last = np.searchsorted(self.time, (begin, end))
        return slice(int(first), int(last))

    def attitude(self, begin: float, end: float) -> Vector | None:
        """The mean attitude (3, 3) over a rest; None where nothing was read."""
        part = self.C_gb[self.between(begin, end)]
        if not len(part):
            return None
        u, _, vt = np.linalg.svd(part.mean(axis=0))
        return np.asarray(u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt)

    def turned(self, before: Vector, begin: float, end: float, after: Vector) -> Vector:
        """The angle (3,) rad in b from the attitude ``before`` to that ``after``, with what is read between.

        What the unit turns through is the sum of the steps from reading to reading, each in b.
        """
        C = np.concatenate((before[None], self.C_gb[self.between(begin, end)], after[None]))
        step = np.einsum("kji,kjl->kil", C[:-1], C[1:])
        # twice the sine of its angle, along its axis
        s = np.stack(
            [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]]
        )
        size = np.linalg.norm(s, axis=0)
        angle = np.arctan2(size, np.trace(step, axis1=1, axis2=2) - 1.0)
        return np.asarray(s @ np.where(size > 0.0, angle / np.where(size > 0.0, size, 1.0), 0.5))


def attitudes(angles: Vector, axes: str) -> Vector:
    """C_gb (k, 3, 3) of a table whose outer, middle and inner axis stand at ``angles`` (k, 3) rad.

    ``axes``, as "zxy", are those of the unit that they are along when all angles are zero; then the unit's
    point east, north and up.
    """
    C = np.eye(3)
    for k, letter in enumerate(axes):
        about = np.outer(angles[:, k], np.eye(3)["xyz".index(letter)])
        C = C @ rotation.dcm_from_quat(rotation.quat_from_rotvec(about))
    return np.asarray(C)
