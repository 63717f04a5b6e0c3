"""Matchings: which states a filter estimates, and which rows of a message it takes for that.

All states are in every covariance. Those that a matching does not estimate are *considered*: they are never
corrected, but what their uncertainty makes of the others is told (Schmidt's filter), so that a filter of few
states knows what it leaves out. What is not matched of position and velocity is *copied* from the
master with each message, with the message's noise and what the arm and the delay make of it: the vertical
channel would run away otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.transfer.correction import Use
from nav.transfer.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    DELAY,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_AXES,
    GYRO_BIAS,
    LEVER,
    MOUNTING,
    PHI,
    SIZE,
    VELOCITY,
)

Vector = NDArray[np.float64]


_NOT: Final = (Use.NOT,) * 3
_MATCH: Final = (Use.MATCH,) * 3
_COPY: Final = (Use.COPY,) * 3
_LEVEL: Final = (Use.MATCH, Use.MATCH, Use.COPY)
Uses = tuple[Use, Use, Use]

GEOMETRY: Final[tuple[int, ...]] = (*range(FLEXURE.start, FLEXURE_RATE.stop), *range(SIZE)[LEVER], DELAY)
"""Estimated by every matching that estimates anything, where it is not known exactly."""


@dataclass(frozen=True, slots=True)
class Matching:
    """One way to align from a master.

    ``estimated`` states besides `GEOMETRY`; what is done with the rows, east, north, up each. ``level`` and
    ``heading`` name the manoeuvre that shows these angles best.
    """

    name: str
    estimated: tuple[int, ...]
    position: Uses
    velocity: Uses
    attitude: Uses = _NOT
    rate: Uses = _NOT
    level: str = ""
    heading: str = ""

    @property
    def mask(self) -> Vector:
        """1 for states that are corrected by matching, 0 for others (SIZE,)."""
        mask = np.zeros(SIZE)
        if self.estimated:
            mask[list(self.estimated + GEOMETRY)] = 1.0
        return mask

    @property
    def white(self) -> bool:
        """Whether it estimates what matters, so that its innovations have nothing in common."""
        return set(_states(VELOCITY, PHI, *_BIASES, MOUNTING)) <= set(self.estimated)

    @property
    def needs(self) -> frozenset[str]:
        """Parts of `nav.types.MasterState`, beyond the first attitude, that it cannot do without."""
        named = (("q_ga", self.attitude), ("w_ia_a", self.rate))
        return frozenset(name for name, uses in named if any(uses))


def _states(*parts: slice | int) -> tuple[int, ...]:
    return tuple(k for part in parts for k in (range(SIZE)[part] if isinstance(part, slice) else (part,)))


_SCALES: Final = (*range(SIZE)[GYRO_AXES][::4], *range(SIZE)[ACCEL_AXES][::4])
_AZIMUTH: Final = MOUNTING.stop - 1
_BIASES: Final = (GYRO_BIAS, ACCEL_BIAS)
_ABOUT_UP: Final = (Use.NOT, Use.NOT, Use.MATCH)

ONE_SHOT: Final = Matching("one_shot", (), _COPY, _COPY, _COPY)
VELOCITY_5: Final = Matching(
    "velocity", _states(slice(3, 5), PHI), _COPY, _LEVEL, level="coordinated turn", heading="S-turn"
)
VELOCITY_11: Final = Matching(
    "velocity_11",
    _states(slice(3, 5), PHI, *_BIASES),
    _COPY,
    _LEVEL,
    level="coordinated turn",
    heading="S-turn",
)
POSITION_10: Final = Matching(
    "position",
    _states(slice(0, 2), slice(3, 5), PHI, GYRO_BIAS),
    _LEVEL,
    (Use.NOT, Use.NOT, Use.COPY),
    level="coordinated turn",
    heading="S-turn",
)
HEADING_19: Final = Matching(
    "velocity_heading",
    _states(VELOCITY, PHI, *_BIASES, *_SCALES, _AZIMUTH),
    _COPY,
    _MATCH,
    _ABOUT_UP,
    level="coordinated turn",
    heading="S-turn",
)
HEADING_13: Final = Matching(
    "velocity_heading_13",
    _states(VELOCITY, PHI, *_BIASES, _AZIMUTH),
    _COPY,
    _MATCH,
    _ABOUT_UP,
    level="coordinated turn",
    heading="S-turn",
)
HEADING_7: Final = Matching(
    "velocity_heading_7",
    _states(VELOCITY, PHI, _AZIMUTH),
    _COPY,
    _MATCH,
    _ABOUT_UP,
    level="coordinated turn",
    heading="S-turn",
)
ATTITUDE_16: Final = Matching(
    "velocity_attitude",
    _states(VELOCITY, PHI, *_BIASES, MOUNTING),
    _COPY,
    _MATCH,
    _MATCH,
    level="coordinated turn",
    heading="wing rock",
)
RATE: Final = Matching(
    "velocity_rate",
    _states(VELOCITY, PHI, *_BIASES, MOUNTING),
    _COPY,
    _MATCH,
    rate=_MATCH,
    level="heading wiggle",
    heading="wing rock",
)
