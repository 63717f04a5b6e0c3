"""Latch times in integers against rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from virtual_bus.dither import CYCLE, Dither


@given(
    mhz=st.integers(1, 1_000_000),
    phase=st.integers(0, CYCLE - 1),
    t_ns=st.integers(-(10**15), 10**15),
)
def test_the_last_latch_is_the_last_whole_cycle(mhz: int, phase: int, t_ns: int) -> None:
    one = Dither(mhz, phase)
    frequency = Fraction(mhz, 1000)  # Hz
    cycles = Fraction(t_ns, 10**9) * frequency + Fraction(phase, CYCLE)
    age = (cycles - cycles.numerator // cycles.denominator) / frequency
    t = np.array([t_ns])
    assert one.age(t)[0] == pytest.approx(float(age), rel=1e-15, abs=0.0)
    assert abs(t_ns - int(one.latched(t)[0]) - age * 10**9) <= Fraction(1, 2)


def test_an_instant_at_the_end_of_a_cycle_is_latched_then() -> None:
    """Where floating point counts one cycle too few: 0.29 s at 100 Hz and many more."""
    one = Dither(359_000)
    t = np.arange(601) * 1_000_000_000
    assert not one.since(t).any()
    assert (one.latched(t) == t).all()


@pytest.mark.parametrize(("mhz", "phase"), [(0, 0), (1_000_001, 0), (1, CYCLE), (1, -1)])
def test_what_is_no_dither_is_refused(mhz: int, phase: int) -> None:
    with pytest.raises(ValueError, match="no dither"):
        Dither(mhz, phase)
