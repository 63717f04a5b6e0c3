"""The statistics of campaigns on errors that are drawn from what is claimed, and from more or less."""

import numpy as np
import pytest

from bridge.errors import ConfigError
from bridge.studies.campaign import epochs, run_static
from bridge.studies.consistency import alignment, band, consistency, nees
from bridge.studies.headless import load

RUNS, EPOCHS = 50, 40


def drawn(seed=0):
    """Covariances with cross terms, and errors that are theirs."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(RUNS, EPOCHS, 9, 9))
    return np.einsum("nkij,nkj->nki", A, rng.normal(size=(RUNS, EPOCHS, 9))), A @ np.swapaxes(A, -1, -2)


def test_honest_errors_lie_inside():
    error, covariance = drawn()
    found = consistency(np.arange(EPOCHS), error, covariance)
    # 120 independent means, 5 % outside expected: four sigma of the binomial are 8 % more
    assert found.nees_inside > 0.87
    assert found.bias_inside > 0.90
    assert found.passed


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_larger_and_smaller_errors_lie_outside(factor):
    error, covariance = drawn(1)
    found = consistency(np.arange(EPOCHS), factor * error, covariance)
    assert found.nees_inside < 0.2
    assert not found.passed


def test_a_common_error_is_a_bias():
    error, covariance = drawn(2)
    shift = 1.0 * np.sqrt(np.einsum("nkii->nki", covariance))
    found = consistency(np.arange(EPOCHS), error + shift, covariance)
    assert found.bias_inside < 0.01
    assert not found.passed


def test_signs_drawn_anew_tell_a_bias_from_chance():
    error, covariance = drawn(5)
    honest = consistency(np.arange(EPOCHS), error, covariance)
    sigma = np.sqrt(np.einsum("nkii->nki", covariance))
    biased = consistency(np.arange(EPOCHS), error + 0.5 * sigma, covariance)
    # of 360 independent means 5 % lie outside, give or take 1.1 %; means of square one quarter more than one
    # lie in a band of 1.96 sigma / 1.12 = 1.75 sigma: 92 %
    assert honest.chance == pytest.approx((0.95, 0.93), abs=0.01)
    assert biased.chance[0] == pytest.approx(0.92, abs=0.01)
    assert biased.bias_inside < 0.1
    # where all epochs of a run say the same, nine means are all there is, and one of them outside is a ninth
    same = np.repeat(error[:, :1], EPOCHS, axis=1), np.repeat(covariance[:, :1], EPOCHS, axis=1)
    crowd = consistency(np.arange(EPOCHS), *same)
    assert crowd.chance[0] == pytest.approx(0.95, abs=0.02)
    assert crowd.chance[1] == pytest.approx(7.0 / 9.0, abs=0.01)


def test_the_band_holds_what_it_says():
    rng = np.random.default_rng(3)
    means = rng.chisquare(3, size=(20_000, 8)).mean(axis=1)
    low, high = band(3, 8)
    # sigma of the counted share is sqrt(.95 .05 / 20000) = 0.0015
    assert np.mean((means >= low) & (means <= high)) == pytest.approx(0.95, abs=0.006)


def test_nees_of_a_diagonal_is_the_sum_of_squares():
    assert nees(np.array([1.0, 2.0, 3.0]), np.diag([1.0, 4.0, 9.0])) == pytest.approx(3.0)


def test_an_alignment_is_judged_by_limit_and_claim():
    rng = np.random.default_rng(4)
    sigma = np.array([1e-5, 1e-5, 1e-3])
    error = rng.normal(size=(40, 3)) * sigma
    covariance = np.broadcast_to(np.diag(sigma**2), (40, 3, 3))
    assert alignment(error, covariance, sigma).passed
    assert not alignment(error, covariance, sigma / 2.0).passed  # far from its limit
    assert not alignment(error, covariance / 4.0, sigma).passed  # overconfident
    assert not alignment(error, covariance * 4.0, sigma).passed  # too modest


def test_an_honest_alignment_fails_one_campaign_in_twenty():
    rng = np.random.default_rng(5)
    sigma = np.array([1e-5, 1e-5, 1e-3])
    covariance = np.broadcast_to(np.diag(sigma**2), (30, 3, 3))
    campaigns = 2000
    failed = sum(
        not alignment(rng.normal(size=(30, 3)) * sigma, covariance, sigma).passed for _ in range(campaigns)
    )
    # at most 5 %, less by what the four bands have in common; sigma of the counted share is 0.5 %
    assert 0.025 < failed / campaigns < 0.06


def test_epochs_lie_between_driving_off_and_the_end():
    what = load("drive")
    found = epochs(what, 200.0)
    assert len(found) >= 10
    assert found[0] > what.rest_s()
    assert found[-1] < 200.0
    with pytest.raises(ConfigError, match="expected 79 or more"):
        epochs(what, 70.0)
    # where it sways on the spot it has driven off when it is aligned
    assert 60.0 < epochs(load("dithered"))[0] < 70.0


def test_a_campaign_needs_a_scenario_that_fits():
    with pytest.raises(ConfigError, match="no such scenario"):
        load("nowhere")
    with pytest.raises(ConfigError, match="expected static"):
        run_static("mems_drive", 1)
