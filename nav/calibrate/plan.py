"""What a turntable is to do: positions in which it rests, and rotations by whole turns about one axis.

The table's axes are those of the unit on it (b); where they point is told in east, north, up (g).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from nav.calibrate.intervals import Interval, resting, turning
from nav.types import Vector

_POINTS: Final = {
    "E": (1.0, 0.0, 0.0),
    "W": (-1.0, 0.0, 0.0),
    "N": (0.0, 1.0, 0.0),
    "S": (0.0, -1.0, 0.0),
    "U": (0.0, 0.0, 1.0),
    "D": (0.0, 0.0, -1.0),
}
_ALONG: Final = 1e-6
_PER_TURN: Final = 72  # places at which a rotation that is only planned is looked at


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """The table rests ``seconds`` in attitude ``C_gb`` (3, 3), which takes b to east, north, up.

    ``temperature`` degC is what the unit is to have, NaN where that is not said.
    """

    name: str
    C_gb: Vector
    seconds: float
    temperature: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Rotation:
    """From attitude ``C_gb`` the table turns about ``axis`` (3,), a unit vector in b, and back into it.

    ``rate`` rad/s is signed, ``turns`` whole and positive; ``temperature`` as of a `Position`.
    """

    name: str
    C_gb: Vector
    axis: Vector
    rate: float
    turns: int
    temperature: float = math.nan

    @property
    def turned(self) -> Vector:
        """The angle turned through, (3,) rad in b."""
        return np.asarray(np.sign(self.rate) * 2.0 * np.pi * self.turns * self.axis)

    @property
    def seconds(self) -> float:
        """How long it takes at its rate."""
        return 2.0 * np.pi * self.turns / abs(self.rate)


Step = Position | Rotation


def faces(letters: str) -> Vector:
    """C_gb (3, 3) of an attitude told by where x, y and z of the unit point, as "SUW".

    The letters of "Inertial navigation", Table 2-12: N, E, S, W, U, D.

    Raises:
        ValueError: not three of these letters, or no right-handed triad.
    """
    if len(letters) != 3 or any(letter not in _POINTS for letter in letters):
        raise ValueError("expected three letters of N, E, S, W, U, D: where x, y and z point")
    C_gb = np.array([_POINTS[letter] for letter in letters]).T
    if np.linalg.det(C_gb) < 0.5:
        raise ValueError("expected a right-handed triad, as ENU")
    return C_gb


def letters_of(C_gb: Vector) -> str | None:
    """The letters of `faces` for an attitude, None where it is not among them."""
    found = ""
    for column in np.asarray(C_gb).T:
        near = [letter for letter, point in _POINTS.items() if np.abs(column - point).max() < _ALONG]
        if not near:
            return None
        found += near[0]
    return found


def planned(steps: Sequence[Step]) -> list[Interval]:
    """What each step shows to ideal sensors: intervals without counts, one after the other.

    Rotations are taken at constant rate, and the way from one position to the next as taking no time.
    """
    intervals = []
    begin = 0.0
    for step in steps:
        if isinstance(step, Position):
            turned, shown = np.zeros(3), resting(step.C_gb, step.seconds)
        else:
            count = _PER_TURN * step.turns
            turned, even = step.turned, np.full(count, step.seconds / count)
            shown = turning(step.C_gb, turned, np.arange(count + 1.0), even)
        turns, t = isinstance(step, Rotation), step.temperature
        intervals.append(Interval(step.name, turns, begin, step.seconds, turned, *shown, temperature=t))
        begin += step.seconds
    return intervals


def candidates(seconds: float) -> list[Step]:
    """Steps to choose from where a plan does not show everything.

    An axis, an edge or a corner of the unit upwards, each in two headings a quarter turn apart, and both ways
    round about every axis that points up.
    """
    found: list[Step] = []
    for up in product((0.0, 1.0, -1.0), repeat=3):
        if not any(up):
            continue
        u = np.array(up) / np.linalg.norm(up)
        level = np.eye(3)[int(np.argmin(np.abs(u)))]
        east = np.cross(level, u)
        east /= np.linalg.norm(east)
        C_gb = np.stack((east, np.cross(u, east), u))
        quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        found += [Position("", C, seconds) for C in (C_gb, quarter @ C_gb)]
        if np.count_nonzero(up) == 1:
            rate = 2.0 * np.pi / seconds
            found += [Rotation("", C_gb, np.abs(u), sign * rate, 1) for sign in (1.0, -1.0)]
    return found
