"""Directions of the sensors of inertial units, of three and of more than three axes.

Those of more are the units of Luo Rui, Li Peng, Yu Lingyan 2023, section 1, Figs. 1 and 2.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from nav.types import Vector


def orthogonal() -> Vector:
    """Along right, forward and up: (3, 3), row: sensor."""
    return np.eye(3)


def with_skew() -> Vector:
    """Five axes (5, 3): x, y, z, then S at equal angles (54.74 deg) to them, and T, S mirrored in y-z."""
    return np.vstack((np.eye(3), np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]) / np.sqrt(3.0)))


def cone() -> Vector:
    """Six axes (6, 3) evenly spaced on a cone about x.

    Its half angle of 54.74 deg, of which the paper is silent, tells every direction equally well.
    """
    angle = np.arange(6) * np.pi / 3.0
    across = np.stack((np.cos(angle), np.sin(angle)), axis=1) * np.sqrt(2.0 / 3.0)
    return np.column_stack((np.full(6, np.sqrt(1.0 / 3.0)), across))


GEOMETRIES: Final = {"orthogonal": orthogonal(), "skew": with_skew(), "cone": cone()}
"""Directions of the gyros, and of the accelerometers, by the arrangement's name."""
