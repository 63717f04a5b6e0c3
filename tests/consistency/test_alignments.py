"""Eight seeded runs of every alignment: what it says as it goes on is off by as much as it says.

The seeds are 0 to 7, by rule and not by result. `navbridge campaign alignment` does the same with a hundred.

Of an honest method the mean NEES of a number of runs lies in its 95 % band at nineteen epochs of twenty. But
the errors of an epoch are those of the one before, so a method is inside at nearly all or at few: it is below
the 90 % that a campaign asks for in 5 % of samples where its epochs are one, in 13.5 % (two or more of 13
outside) where they are independent. The sample holds the number of such methods to what chance allows, and
every method to bands so wide that all means of all methods keep them in 99 samples of 100 (Bonferroni).
"""

import os

import numpy as np
import pytest
from scipy.stats import binom, norm

from bridge.studies import alignment_campaign as study
from bridge.studies.consistency import INSIDE, band
from nav.align import ALIGNMENTS

RUNS = 8
JOBS = min(2, os.cpu_count() or 1)
EPOCHS = study.EPOCHS + 1  # and the hand-over
BELOW = 1.0 - sum(binom.pmf(k, EPOCHS, 0.05) for k in range(2))


@pytest.fixture(scope="module")
def found():
    return {one.method: one for one in study.run_alignments(tuple(ALIGNMENTS), RUNS, jobs=JOBS)}


@pytest.mark.parametrize("method", ALIGNMENTS)
def test_a_method_is_as_good_as_it_says(found, method):
    one = found[method]
    assert one.refusals == ()
    assert len(one.t_s) >= 10
    assert np.all(one.seen == RUNS)
    share = 1.0 - 0.01 / (len(ALIGNMENTS) * EPOCHS)
    low, high = band(3, RUNS, share)
    assert np.all((one.nees > low) & (one.nees < high)), one.nees
    # sums of eight are nearly normal, and three axes to each
    assert np.all(np.abs(one.bias) < norm.ppf(0.5 + 0.5 * (1.0 - (1.0 - share) / 3.0))), one.bias


def test_no_more_methods_are_outside_than_chance_has_there(found):
    below = [one.method for one in found.values() if one.nees_inside < INSIDE]
    assert len(below) <= binom.ppf(0.99, len(ALIGNMENTS), BELOW), below
    below = [one.method for one in found.values() if one.bias_inside < INSIDE]
    assert len(below) <= binom.ppf(0.99, len(ALIGNMENTS), BELOW), below
