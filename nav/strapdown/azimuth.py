"""The azimuth laws: what the vertical component of the transport rate of n is.

The law says nothing about where the vehicle is or how fast: latitude, longitude, true heading and the
velocity east and north are views of the position matrix, the same under every law. Source: textbook chapter
"Inertial navigation", sections on local-level, wander and free azimuth systems; Savage, "Strapdown
Analytics", section 4.5.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from nav.strapdown.control import Vector, control

NORTH_LIMIT: Final = math.radians(85.0)
"""Latitude above which the north law is refused: its vertical rate v_E tan L/R grows without bound."""


class NorthLawRefusal(ValueError):
    """The north law was asked for at a latitude where it is about to fail."""


class AzimuthLaw(NamedTuple):
    """Entries of the control vector: ``north``, ``free``; ``turns`` says that it has a rate of its own.

    ``limit`` is the latitude (rad, either side) up to which it may be used, ``use`` what it is good for.
    """

    north: float
    free: float
    turns: bool
    limit: float
    use: str


AZIMUTH_LAWS: Final[dict[str, AzimuthLaw]] = {
    "north": AzimuthLaw(1.0, 0.0, False, NORTH_LIMIT, "textbook local-level north, away from the poles"),
    "wander": AzimuthLaw(0.0, 0.0, False, math.inf, "regular at every latitude and through the pole"),
    "free": AzimuthLaw(0.0, 1.0, False, math.inf, "an azimuth gyro that is not torqued"),
    "rotating": AzimuthLaw(0.0, 0.0, True, math.inf, "a platform turned about the vertical"),
}


def azimuth_control(name: str, rate: float = 0.0) -> Vector:
    """Control vector (U_SIZE,) of the law called ``name``; ``rate`` (rad/s) of a rotating one.

    Raises ValueError for an unknown name, or a rate given to a law that has none.
    """
    if name not in AZIMUTH_LAWS:
        raise ValueError(f"unknown azimuth law {name!r}, expected one of {', '.join(AZIMUTH_LAWS)}")
    law = AZIMUTH_LAWS[name]
    if rate != 0.0 and not law.turns:
        raise ValueError(f"the azimuth law {name!r} has no rate of its own, found {rate} rad/s")
    return control(north=law.north, free=law.free, turn=rate)


def refuse_latitude(name: str, lat: float) -> None:
    """Raise NorthLawRefusal where the law called ``name`` may not be used at latitude ``lat`` (rad)."""
    limit = AZIMUTH_LAWS[name].limit
    if abs(lat) > limit:
        raise NorthLawRefusal(
            f"azimuth law {name!r}: latitude {math.degrees(lat):.2f} deg is beyond its limit of "
            f"{math.degrees(limit):.0f} deg; wander azimuth works there"
        )
