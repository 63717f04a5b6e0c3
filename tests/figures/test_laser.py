"""Table 6-1 against numbers found by a plain simulation elsewhere, and what stands beside it."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from bridge.studies.figures.laser import CELLS, OURS, PRINTED, TABLE_6_1, exact_ideal
from bridge.studies.figures.laser_runs import ARCMIN, Cone, Run
from bridge.studies.figures.result import Result
from nav.imu.whole_cycle import METHODS
from virtual_bus.dither import Dither


def test_every_cell_of_the_table_is_there(computed: Callable[[str], Result]) -> None:
    rows = {row.name: row for row in computed("laser").rows}
    for number, case in enumerate(TABLE_6_1, 1):
        for name, printed in zip(CELLS, case.printed, strict=True):
            assert rows[f"{number} {name}"].published == printed
    unjudged = {row.name for row in rows.values() if row.published is not None and row.passed is None}
    assert {one for one in unjudged if one[0].isdigit()} == {"1 linear", "3 constant"}


def test_cells_as_found_independently(computed: Callable[[str], Result]) -> None:
    """Numbers of a simulation that shares nothing with the program, to their last digit."""
    rows = {row.name: row.ours for row in computed("laser").rows}
    assert rows["1 whole cycle"] == pytest.approx(18.40, abs=0.006)
    assert rows["1 constant"] == pytest.approx(-104.77, abs=0.006)
    assert rows["Figure 6-8 whole cycle"] == pytest.approx(69.6, abs=0.06)
    assert rows["Figure 6-8 linear"] == pytest.approx(-7.6, abs=0.06)


def test_our_correction_is_ten_times_nearer_than_the_mean_of_two(computed: Callable[[str], Result]) -> None:
    rows = {row.name: row.ours for row in computed("laser").rows}
    assert rows[f"rms to ideal, {OURS}"] < 0.1 * rows[f"rms to ideal, {PRINTED}"]
    # by chance the mean of two does better over random dithers than in the table
    assert rows[f"random rms, {OURS}"] < 0.2 * rows[f"random rms, {PRINTED}"]
    assert len(computed("laser").numbers["random"][OURS]) == 100


def test_the_ideal_drift_has_the_series_of_small_angles() -> None:
    """alpha^2 lambda^5 / 30 an update of two samples, the cone's own next term in the step left out."""
    case = TABLE_6_1[1]
    lam = 2.0 * math.pi * 3.0 * 0.01
    want = math.radians(1.0) ** 2 * lam**5 / 30.0 * 30_000 / ARCMIN
    assert exact_ideal(case) == pytest.approx(want, rel=0.03)


def test_a_whole_cycle_run_by_fractions() -> None:
    """Latch times of the run, and what is counted between two of them, by rational arithmetic."""
    cone = Cone(math.radians(1.0), 6.0 * math.pi)
    run = Run(cone, [Dither(1000 * f) for f in (370, 359, 408)])
    counts = run.read()
    for i, f in enumerate((370, 359, 408)):
        at = [Fraction(k * f // 100, f) for k in (4321, 4322)]
        t = np.array([[float(one)] * 3 for one in at])
        assert run.ages[4322, i] == pytest.approx(float(Fraction(4322, 100) - at[1]), abs=1e-15)
        assert counts[4321, i] == pytest.approx(np.diff(cone.counted(t), axis=0)[0, i], abs=1e-15)


def test_a_whole_second_is_a_latch_of_every_gyro() -> None:
    run = Run(Cone(0.1, 1.0), [Dither(1000 * f) for f in (370, 359, 408)])
    assert not run.ages[::100].any()


def test_noise_of_latches_is_magnified_as_the_weights_say(computed: Callable[[str], Result]) -> None:
    """A straight line through two latches ten milliseconds apart: 1 + r/h of the one, r/h of the other."""
    run = Run(Cone(0.1, 1.0), [Dither(1000 * f) for f in (370, 359, 408)])
    share = run.ages[2:] / np.diff(0.01 * np.arange(len(run.ages))[:, None] - run.ages, axis=0)[1:]
    want = math.sqrt(float(np.mean((1.0 + share) ** 2 + share**2)))
    got = run.magnified(METHODS["constant"], np.random.default_rng(2))
    assert got == pytest.approx(want, rel=0.01)  # of 6e4 draws a gyro
