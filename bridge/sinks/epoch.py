"""The values of an epoch's frames in one kernel: a solution in the units and the order of the contract."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav import polar
from nav.jit import in_place
from nav.polar import Frame
from nav.rotation import euler
from nav.types import S, Solution, SolutionFlag, Vector

EPOCH: Final = (
    "SOL_TIME",
    "SOL_LEVEL",
    "SOL_HEADING",
    "SOL_VEL_H",
    "SOL_VEL_U",
    "SOL_LAT",
    "SOL_LON",
    "SOL_HEIGHT",
    "SOL_RATE",
    "SOL_FORCE",
    "SOL_SIGMA_ATT",
    "SOL_SIGMA_VEL",
)
"""Frames of one epoch in sending order; the last one closes the epoch."""

# where the signals of each message begin among all of them
_LEVEL: Final = 4
_HEADING: Final = 6
_VEL_H: Final = 9
_VEL_U: Final = 12
_LAT: Final = 13
_LON: Final = 16
_HEIGHT: Final = 19
_RATE: Final = 21
_FORCE: Final = 24
_SIGMA_ATT: Final = 27
_SIGMA_VEL: Final = 30
SIZE: Final = 34

_DEGREES: Final = 180.0 / math.pi
_HEADING_KNOWN: Final = int(SolutionFlag.HEADING)
_PLACE: Final = S.LAT
_Q: Final = S.Q.start
_V: Final = S.V.start
_W: Final = S.W.start
_F: Final = S.F.start
_SIGMA_P: Final = S.SIGMA_P.start
_SIGMA_V: Final = S.SIGMA_V.start
_SIGMA_PHI: Final = S.SIGMA_PHI.start


@in_place
def _level_sigmas(heading: float, east: float, north: float) -> tuple[float, float]:
    s, c = np.sin(heading), np.cos(heading)
    return np.hypot(s * east, c * north), np.hypot(c * east, s * north)


@in_place
def _geographic(x: Vector, flags: int, out: Vector) -> None:
    """Fill ``out`` (SIZE,) from the state ``x`` (S.SIZE,), but for the time; NaN where unknown."""
    heading, pitch, roll = euler(x[_Q], x[_Q + 1], x[_Q + 2], x[_Q + 3])
    sigma_roll, sigma_pitch = _level_sigmas(heading, x[_SIGMA_PHI], x[_SIGMA_PHI + 1])
    out[_LEVEL], out[_LEVEL + 1] = roll * _DEGREES, pitch * _DEGREES
    out[_HEADING], out[_HEADING + 1], out[_HEADING + 2] = heading * _DEGREES, flags & 0xFFFF, 0.0
    out[_VEL_H], out[_VEL_H + 1], out[_VEL_H + 2] = x[_V], x[_V + 1], 0.0
    out[_VEL_U] = x[_V + 2]
    out[_LAT], out[_LAT + 1], out[_LAT + 2] = x[_PLACE] * _DEGREES, x[_SIGMA_P + 1], 0.0
    out[_LON], out[_LON + 1], out[_LON + 2] = x[_PLACE + 1] * _DEGREES, x[_SIGMA_P], 0.0
    out[_HEIGHT], out[_HEIGHT + 1] = x[_PLACE + 2], x[_SIGMA_P + 2]
    for i in range(3):
        out[_RATE + i] = x[_W + i] * _DEGREES
        out[_FORCE + i] = x[_F + i]
        out[_SIGMA_VEL + i] = x[_SIGMA_V + i]
    out[_SIGMA_ATT], out[_SIGMA_ATT + 1] = sigma_roll * _DEGREES, sigma_pitch * _DEGREES
    out[_SIGMA_ATT + 2] = x[_SIGMA_PHI + 2] * _DEGREES
    out[_SIGMA_VEL + 3] = 0.0


def _seen_from(frame: Frame, solution: Solution, out: Vector) -> None:
    """Put what differs in a polar ``frame`` into ``out``."""
    x = solution.state.tolist()
    lat, lon, (east, north, up) = x[S.LAT], x[S.LON], x[S.V]
    seen = polar.view(frame, lat, lon, solution.heading, (east, north, up))
    turn = float(seen.turn)
    sigma_e, sigma_n, _ = x[S.SIGMA_P]
    sigma_ve, sigma_vn, _ = x[S.SIGMA_V]
    out[_HEADING], out[_HEADING + 2] = math.degrees(float(seen.heading)), frame
    out[_VEL_H], out[_VEL_H + 1], out[_VEL_U] = seen.v
    out[_VEL_H + 2] = out[_SIGMA_VEL + 3] = frame
    out[_SIGMA_VEL], out[_SIGMA_VEL + 1] = polar.turn_sigma(sigma_ve, sigma_vn, turn)
    if frame is Frame.TRANSVERSE:
        sigma_e, sigma_n = polar.turn_sigma(sigma_e, sigma_n, turn)
        out[_LAT], out[_LAT + 1], out[_LAT + 2] = math.degrees(float(seen.lat)), sigma_n, frame
        out[_LON], out[_LON + 1], out[_LON + 2] = math.degrees(float(seen.lon)), sigma_e, frame


class EpochValues:
    """Fills one vector with the values of an epoch, again and again."""

    def __init__(self) -> None:
        self.values = np.zeros(SIZE)
        """All signals of all messages of `EPOCH`, in the order of both."""
        _geographic(np.zeros(S.SIZE), 0, self.values)  # compiled here, before a bus is opened

    def fill(self, time: tuple[int, ...], solution: Solution, frame: Frame) -> Vector:
        """The values of ``solution`` in ``frame``, behind those of SOL_TIME."""
        out = self.values
        out[0], out[1], out[2], out[3] = time
        _geographic(solution.state, solution.flags, out)
        if frame is not Frame.GEOGRAPHIC:
            _seen_from(frame, solution, out)
        if not math.isfinite(out.item(_HEADING)):
            out[_HEADING], out[_HEADING + 1] = 0.0, solution.flags & 0xFFFF & ~_HEADING_KNOWN
        return out


def level_sigmas(solution: Solution) -> tuple[float, float, float]:
    """Standard deviations of roll, pitch and heading (rad) from those of phi about east, north, up.

    Roll is about the level projection of the forward axis, pitch about the level right axis; east and
    north errors are taken as uncorrelated.
    """
    east, north, up = solution.state[S.SIGMA_PHI].tolist()
    roll, pitch = _level_sigmas(solution.heading, east, north)
    return roll, pitch, up
