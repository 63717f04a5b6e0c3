"""Units of more than three gyros and three accelerometers: which way their sensors look."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NO_COUNT: Final = -32768
"""What is sent of a sensor that gives nothing, or is not there."""
PLACES: Final = 6
"""Sensors of one kind that the frames have room for."""

_EDGE: Final = math.acos(math.sqrt(1.0 / 3.0))  # from a cube's diagonal to its edges


def _cone() -> Array:
    """Six sensors round the right axis, each as far from it as edges of a cube are from its diagonal."""
    turns = [math.radians(60.0 * k) for k in range(6)]
    c, s = math.cos(_EDGE), math.sin(_EDGE)
    return np.array([[c, s * math.cos(turn), s * math.sin(turn)] for turn in turns])


def _skew() -> Array:
    """Right, forward, up, and the diagonals between these and between left, forward and up."""
    diagonal = math.cos(_EDGE)
    rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    return np.array([*rows, [diagonal] * 3, [-diagonal, diagonal, diagonal]])


AXES: Final = {"cone": _cone(), "skew": _skew()}
"""Unit vectors (n, 3) by the arrangement's name; gyros and accelerometers look the same ways."""
