"""The half swing against a number found elsewhere, and against its sum by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from bridge.studies.figures.result import Result
from bridge.studies.figures.size_effect import RATES_HZ, live_course


def test_the_half_swing_as_found_independently(computed: Callable[[str], Result]) -> None:
    rows = {row.name: row.ours for row in computed("size-effect").rows}
    assert rows["half swing"] == pytest.approx(-0.4393776, abs=5e-8)
    assert rows["one period (5-14)"] == pytest.approx(2.0 * rows["half swing"], rel=1e-14)


def test_the_half_swing_by_the_series_of_the_bessel_function(computed: Callable[[str], Result]) -> None:
    """-pi r w alpha J1(alpha) at 90 deg, 5 cm, 0.5 Hz."""
    x = math.pi / 2.0
    bessel = sum(
        (-1) ** k / (math.factorial(k) * math.factorial(k + 1)) * (x / 2.0) ** (2 * k + 1) for k in range(20)
    )
    rows = {row.name: row.exact for row in computed("size-effect").rows}
    assert rows["half swing"] == pytest.approx(-math.pi * 0.05 * math.pi * x * bessel, rel=1e-14)


def test_what_the_live_compensation_leaves_falls_with_the_third_power_of_the_step() -> None:
    """The rate's own change is found to second order, its sum over the swing to one more."""
    left = [abs(float(live_course(rate)[2][-1])) for rate in RATES_HZ[:3]]
    for coarse, fine in pairwise(left):
        assert math.log2(coarse / fine) == pytest.approx(3.0, abs=0.15)


def test_misprints_are_told(computed: Callable[[str], Result]) -> None:
    why = {row.name: row.why for row in computed("size-effect").rows if row.why}
    assert "inverse" in why["the same with U as printed"]
    assert "twice" in why["sculling of (5-25)"]
