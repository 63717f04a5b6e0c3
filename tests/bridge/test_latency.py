"""Histograms of durations keep what they promise."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.latency import Histogram


@settings(deadline=None)
@given(st.lists(st.integers(0, 2**50), min_size=1, max_size=200), st.floats(0.0, 100.0))
def test_percentiles_are_upper_bounds_within_a_step(values: list[int], percent: float) -> None:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    values.sort()
    exact = values[max(0, math.ceil(len(values) * percent / 100.0) - 1)]
    got = histogram.percentile_ns(percent)
    # 32 steps an octave
    assert exact <= got <= exact * (1 + 1 / 32) + 1
    assert histogram.worst_ns == values[-1]


def test_an_empty_histogram_and_a_negative_duration() -> None:
    histogram = Histogram()
    assert histogram.percentile_ns(99.0) == 0
    histogram.add(-5)
    assert histogram.percentile_ns(50.0) == 0
    assert histogram.count == 1


@pytest.mark.parametrize("value", [0, 31, 32, 63, 64, 65, 127, 128, 10**6, 10**9])
def test_a_single_value_is_returned_exactly(value: int) -> None:
    histogram = Histogram()
    histogram.add(value)
    assert histogram.percentile_ns(50.0) == value
