"""Units of DBC files: spellings, factors, refusals."""

from __future__ import annotations

import math

import pytest

from dbc.codec import contract
from dbc.units import UNITS, parse, si_factor


@pytest.mark.parametrize(
    ("text", "quantity", "expected"),
    [
        ("m/s^2", "acceleration", 1.0),
        ("m/s2", "acceleration", 1.0),
        ("m/s²", "acceleration", 1.0),
        ("m/s**2", "acceleration", 1.0),
        ("m/s/s", "acceleration", 1.0),
        ("m/sec^2", "acceleration", 1.0),
        ("[m/s^2]", "acceleration", 1.0),
        ("g", "acceleration", 9.80665),
        ("G", "acceleration", 9.80665),
        ("mg", "acceleration", 9.80665e-3),
        ("µg", "acceleration", 9.80665e-6),
        ("deg/s", "angular rate", math.pi / 180),
        ("°/s", "angular rate", math.pi / 180),
        ("deg / sec", "angular rate", math.pi / 180),
        ("dps", "angular rate", math.pi / 180),
        ("rad/s", "angular rate", 1.0),
        ("deg/h", "angular rate", math.pi / 180 / 3600),
        ("°/hr", "angular rate", math.pi / 180 / 3600),
        ("km/h", "speed", 1 / 3.6),
        ("KM/H", "speed", 1 / 3.6),
        ("kph", "speed", 1 / 3.6),
        ("m/s", "speed", 1.0),
        ("knots", "speed", 1852 / 3600),
        ("deg", "angle", math.pi / 180),
        ("Degrees", "angle", math.pi / 180),
        ("°", "angle", math.pi / 180),
        ("rad", "angle", 1.0),
        ("m", "length", 1.0),
        ("mm", "length", 1e-3),
        ("Pa", "pressure", 1.0),
        ("hPa", "pressure", 100.0),
        ("mbar", "pressure", 100.0),
        ("kPa", "pressure", 1000.0),
        ("sec", "time", 1.0),
        ("s", "time", 1.0),
        ("ms", "time", 1e-3),
        ("us", "time", 1e-6),
        ("μs", "time", 1e-6),
        ("", "ratio", 1.0),
        ("%", "ratio", 0.01),
    ],
)
def test_spellings(text: str, quantity: str, expected: float) -> None:
    assert si_factor(text, quantity) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("quantity", UNITS)
def test_every_unit_is_understood_as_written(quantity: str) -> None:
    for name, factor in UNITS[quantity].items():
        assert parse(name) == (quantity, name, factor)
        assert parse(f" {name} ") == (quantity, name, factor)


def test_no_two_units_differ_by_case_alone() -> None:
    names = [name.casefold() for units in UNITS.values() for name in units]
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    "text", ["furlong", "m/s^3", "deg/s^2", "m^2/s", "0.1 m", "m/", "/s", "raw", "m/s/s/s"]
)
def test_unknown_units_are_refused_with_the_known_ones(text: str) -> None:
    with pytest.raises(ValueError, match=r"unknown unit .*; known are time: s, ms.*acceleration: m/s\^2"):
        parse(text)
    with pytest.raises(ValueError, match=r"unknown unit .* of speed; known are m/s, cm/s"):
        si_factor(text, "speed")


def test_a_unit_of_something_else_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unit 'deg' measures angle, not angular rate; known are rad/s"):
        si_factor("deg", "angular rate")


def test_our_own_contract_uses_units_that_are_understood() -> None:
    counted = {"pulse", "tick", "frame", "sample", "degC"}
    for codec in contract().values():
        for signal in codec.info:
            if signal.unit not in counted:
                parse(signal.unit)
