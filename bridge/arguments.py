"""What options of several commands hold, checked as they are read: each says what it expected."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable


def seconds(text: str) -> float:
    """A time above zero."""
    return _above_zero(text, "a number of seconds above 0")


def angle(text: str) -> float:
    """An angle above zero."""
    return _above_zero(text, "a number of degrees above 0")


def rate(text: str) -> float:
    """A frequency above zero."""
    return _above_zero(text, "a number above 0")


def speed(text: str) -> float:
    """How many times real time; infinity for "max"."""
    return math.inf if text == "max" else _above_zero(text, "max or a number above 0")


def whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """A reader of whole numbers from ``least`` to ``most``."""
    limits = f"from {least} to {most}" if most is not None else f"{least} or more"
    expected = f"a whole number, {limits}"

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise _wrong(text, expected) from None
        if value < least or (most is not None and value > most):
            raise _wrong(text, expected)
        return value

    return read


def site(text: str) -> tuple[float, ...]:
    """Latitude in deg and height in m, and gravity in m/s^2 where it is known, with commas between."""
    expected = "latitude in deg,height in m, and gravity in m/s^2 where it is known"
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise _wrong(text, expected) from None
    inside = len(values) in (2, 3) and -90.0 <= values[0] <= 90.0 and -1000.0 <= values[1] <= 10_000.0
    if not inside or not all(9.7 <= gravity <= 9.9 for gravity in values[2:]):
        raise _wrong(text, expected)
    return values


def digest(text: str) -> str:
    """A SHA-256 as hexadecimal digits, in lower case."""
    if re.fullmatch("[0-9a-fA-F]{64}", text) is None:
        raise _wrong(text, "the 64 hexadecimal digits of a SHA-256")
    return text.lower()


def _above_zero(text: str, expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise _wrong(text, expected) from None
    if not 0.0 < value < math.inf:
        raise _wrong(text, expected)
    return value


def _wrong(found: str, expected: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f'found "{found}", expected {expected}')
