"""Unit texts as they stand in DBC files and mappings, and their factors to SI.

``si_factor("deg/s", "angular rate")`` is the number that takes a value in that unit to radians a
second. A text is understood in the spellings people use (``m/s^2``, ``m/s2``, ``m/s²``, ``m/s/s``);
one that is not understood is refused with the list of those that are, because a guess here would
be a wrong solution later.
"""

from __future__ import annotations

import math
import re
from typing import Final, NamedTuple

G0: Final = 9.80665
"""Standard acceleration of gravity, m/s^2 (SI Brochure)."""

_DEG: Final = math.pi / 180.0

UNITS: Final[dict[str, dict[str, float]]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0},
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": _DEG,
        "mdeg": _DEG * 1e-3,
        "arcmin": _DEG / 60.0,
        "arcsec": _DEG / 3600.0,
    },
    "angular rate": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _DEG,
        "mdeg/s": _DEG * 1e-3,
        "deg/min": _DEG / 60.0,
        "deg/h": _DEG / 3600.0,
        "rpm": math.pi / 30.0,
    },
    "length": {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048, "in": 0.0254},
    "speed": {
        "m/s": 1.0,
        "cm/s": 1e-2,
        "mm/s": 1e-3,
        "km/h": 1.0 / 3.6,
        "mph": 0.44704,
        "kn": 1852.0 / 3600.0,
        "ft/s": 0.3048,
    },
    "acceleration": {
        "m/s^2": 1.0,
        "cm/s^2": 1e-2,
        "mm/s^2": 1e-3,
        "g": G0,
        "mg": G0 * 1e-3,
        "ug": G0 * 1e-6,
        "ft/s^2": 0.3048,
    },
    "pressure": {"Pa": 1.0, "hPa": 100.0, "kPa": 1e3, "bar": 1e5, "mbar": 100.0, "psi": 6894.757293168},
    "ratio": {"1": 1.0, "%": 1e-2, "ppm": 1e-6},
}
"""Factor to SI by quantity and unit, in the spelling used in messages."""

_SPELLINGS: Final = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "hr": "h",
    "hour": "h",
    "hours": "h",
    "d": "day",
    "days": "day",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "dps": "deg/s",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "feet": "ft",
    "inch": "in",
    "mps": "m/s",
    "kph": "km/h",
    "kmh": "km/h",
    "kmph": "km/h",
    "kt": "kn",
    "kts": "kn",
    "knot": "kn",
    "knots": "kn",
    "mi/h": "mph",
    "pct": "%",
    "percent": "%",
    "": "1",
    "-": "1",
}


class Unit(NamedTuple):
    """What a unit measures, how it is spelt here, and its factor to SI."""

    quantity: str
    name: str
    factor: float


_KNOWN: Final = {
    name: Unit(quantity, name, factor) for quantity, units in UNITS.items() for name, factor in units.items()
}
_FOLDED: Final = {name.casefold(): unit for name, unit in _KNOWN.items()}


def parse(text: str) -> Unit:
    """Return the unit that ``text`` means; an empty text is the plain number 1.

    Raises ValueError listing every known unit.
    """
    for tidy in (_tidy(text), _tidy(text.casefold())):
        unit = _KNOWN.get(tidy) or _FOLDED.get(tidy)
        if unit is not None:
            return unit
    listed = "; ".join(f"{quantity}: {', '.join(units)}" for quantity, units in UNITS.items())
    raise ValueError(f"unknown unit {text!r}; known are {listed}")


def si_factor(text: str, quantity: str) -> float:
    """Return the factor from the unit ``text`` to SI, for a value that is a ``quantity`` of `UNITS`.

    Raises ValueError listing the units of that quantity when ``text`` is unknown or measures
    something else.
    """
    units = UNITS[quantity]
    try:
        unit = parse(text)
    except ValueError:
        raise ValueError(f"unknown unit {text!r} of {quantity}; known are {', '.join(units)}") from None
    if unit.quantity != quantity:
        raise ValueError(
            f"unit {text!r} measures {unit.quantity}, not {quantity}; known are {', '.join(units)}"
        )
    return unit.factor


def _tidy(text: str) -> str:
    """One spelling of many: signs, exponents and long names."""
    text = text.strip().strip("[]()").replace(" ", "")
    text = text.replace("°", "deg").replace("µ", "u").replace("μ", "u").replace("²", "^2").replace("**", "^")
    if text.casefold() in _SPELLINGS:
        return _SPELLINGS[text.casefold()]
    head, *rest = text.split("/")
    parts = [_SPELLINGS.get(head, head)]
    for part in rest:
        base, power = re.fullmatch(r"(.*?)\^?(2?)", part).groups()  # type: ignore[union-attr]
        parts.append(_SPELLINGS.get(base, base) + ("^2" if power else ""))
    if len(parts) == 3 and parts[1] == parts[2]:
        parts = [parts[0], parts[1] + "^2"]
    return "/".join(parts)
