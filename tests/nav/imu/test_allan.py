"""Noises that were put together are found again, as well as they say; and what their statistics rest on."""

from __future__ import annotations

import allantools
import numpy as np
import pytest
from scipy import integrate

from nav.imu import allan

TAU0 = 0.01
COUNT = 60_000
SIZES = {"quantisation": 0.05, "random walk": 1.0, "rate random walk": 0.2}


def white(rng, density, count=COUNT):
    return density / np.sqrt(TAU0) * rng.standard_normal(count)


def rounding(rng, size, count=COUNT):
    """Of the angle at the ends of the samples."""
    return np.diff(size * rng.standard_normal(count + 1)) / TAU0


def walk(rng, density, count=COUNT):
    """The mean over each sample of a rate that walks."""
    rate = np.cumsum(density * np.sqrt(TAU0) * rng.standard_normal(count + 1))
    # within a step the walk is off the line between its ends by as much again, TAU0 / 12 of variance
    return 0.5 * (rate[1:] + rate[:-1]) + density * np.sqrt(TAU0 / 12.0) * rng.standard_normal(count)


MAKERS = {"quantisation": rounding, "random walk": white, "rate random walk": walk}


@pytest.fixture(scope="module")
def expected():
    return allan.Expectation(allan.curve(np.zeros((COUNT, 1)) + np.arange(COUNT)[:, None], TAU0))


def curve_of(rates):
    return allan.curve(rates[:, None], TAU0)


@pytest.mark.parametrize("name", SIZES)
def test_a_single_noise_has_its_slope_and_size(name, expected):
    """Slope and value at 1 s within three sigmas of the estimator's degrees of freedom."""
    rng = np.random.default_rng(5)
    found = curve_of(MAKERS[name](rng, SIZES[name]))
    deviation = found.deviation[:, 0]
    own = allan.TERMS.index(name)
    squares = np.zeros(len(allan.TERMS))
    squares[own] = SIZES[name] ** 2
    relative = expected.covariance(squares) / np.outer(*2 * [expected.mean @ squares])
    # least squares in the logarithms, of which the covariance is a quarter of that of the squares
    X = np.stack((np.ones(len(deviation)), np.log(found.tau)), axis=1)
    weight = np.linalg.inv(0.25 * relative)
    P = np.linalg.inv(X.T @ weight @ X)
    height, slope = P @ X.T @ weight @ np.log(deviation)
    sigma = np.sqrt(np.diag(P))
    at_one = {"quantisation": np.sqrt(3.0), "random walk": 1.0, "rate random walk": np.sqrt(1.0 / 3.0)}[name]
    want = {"quantisation": -1.0, "random walk": -0.5, "rate random walk": 0.5}[name]
    assert sigma.max() < 0.1
    assert abs(slope - want) < 3.0 * sigma[1]
    assert abs(height - np.log(at_one * SIZES[name])) < 3.0 * sigma[0]
    term = allan.noises(deviation, expected).terms[name]
    assert term.value is not None
    # twice as wide as 95 %
    assert term.low - (term.value - term.low) < SIZES[name] < term.high + (term.high - term.value)


def test_three_noises_at_once_are_as_wrong_as_they_say(expected):
    """Of 60 intervals at 95 % no less than 51 hold but once in 2000 times."""
    rng = np.random.default_rng(6)
    held, chi2, freedom, shown = 0, 0.0, 0, 0
    for _ in range(20):
        rates = sum(MAKERS[name](rng, size) for name, size in SIZES.items())
        found = allan.noises(curve_of(rates).deviation[:, 0], expected)
        chi2, freedom = chi2 + found.chi2, freedom + found.freedom
        for name, size in SIZES.items():
            term = found.terms[name]
            shown += term.value is not None
            held += term.low <= size <= term.high
    assert held >= 51
    assert shown >= 57  # a rise is one of another power now and then
    assert abs(chi2 / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom)


def test_what_does_not_show_is_bounded(expected):
    """A walk that is less than the white noise at all times, in 20 records."""
    rng = np.random.default_rng(7)
    size = 0.02
    bounds = []
    for _ in range(20):
        rates = white(rng, 1.0) + walk(rng, size)
        bounds.append(allan.noises(curve_of(rates).deviation[:, 0], expected).terms["rate random walk"].high)
    # 95 % of cases: fewer than 15 of 20 but once in 3000 times
    assert np.count_nonzero(np.array(bounds) > size) >= 15


def test_a_tone_is_no_sum_of_noises(expected):
    rng = np.random.default_rng(8)
    rates = white(rng, 0.1) + 5.0 * np.sin(2.0 * np.pi * 0.8 * TAU0 * np.arange(COUNT))
    found = allan.noises(curve_of(rates).deviation[:, 0], expected)
    assert found.inflation >= allan.STRANGE
    assert all(term.value is None and term.high > 0.0 for term in found.terms.values())


def test_short_times_that_are_otherwise_are_left_out(expected):
    """A sensor that is filtered over 8 samples."""
    rng = np.random.default_rng(9)
    rates = np.convolve(white(rng, 1.0, COUNT + 7), np.ones(8) / 8.0, mode="valid")
    found = allan.noises(curve_of(rates).deviation[:, 0], expected)
    assert found.first >= 4
    term = found.terms["random walk"]
    # at the first times left the filter still takes some off, as much as the test of the residuals lets pass
    assert term.value == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(
    ("name", "alpha"),
    [("quantisation", 2), ("random walk", 0), ("instability", -1), ("rate random walk", -2)],
)
def test_degrees_of_freedom_are_those_of_greenhall_and_riley(name, alpha, expected):
    """Their approximation for records of any length agrees where many averages make one of ours."""
    of = allan.curve(np.arange(float(COUNT))[:, None], TAU0)
    k = allan.TERMS.index(name)
    squares = np.eye(len(allan.TERMS))[k]
    edf = 2.0 * (expected.mean @ squares) ** 2 / np.diag(expected.covariance(squares))
    for place in range(5, len(of.m) - 2):
        want = allantools.edf_greenhall(alpha, 2, int(of.m[place]), COUNT, overlapping=True)
        assert edf[place] == pytest.approx(want, rel=0.06)


@pytest.mark.parametrize("correlation", [0.5, 20.0, 3000.0])
def test_a_gauss_markov_process_against_its_spectrum(correlation):
    of = allan.curve(np.arange(float(COUNT))[:, None], TAU0)
    found = allan.Expectation(of, allan.OF_FILTER, correlation).mean[:, -1]
    for place in (4, 9):
        tau = of.tau[place]
        # 4 int S sin^4(pi f tau) / (pi f tau)^2 df, in x = f tau
        a = 2.0 * np.pi * correlation / tau

        def inside(x, a=a):
            return np.sin(np.pi * x) ** 4 / (np.pi * x) ** 2 / (1.0 + (a * x) ** 2)

        whole = sum(integrate.quad(inside, k, k + 1.0)[0] for k in range(1, 400))
        whole += integrate.quad(inside, 1e-12, 1.0, limit=500, points=[min(0.9, 1.0 / a)])[0]
        assert found[place] == pytest.approx(8.0 * correlation / tau * whole, rel=2e-3)


def test_what_cannot_be_looked_at():
    with pytest.raises(ValueError, match="found 100 samples, expected at least 576"):
        allan.curve(np.zeros((100, 1)), TAU0)
    of = allan.curve(np.zeros((1000, 1)), TAU0)
    with pytest.raises(ValueError, match="says the same all the time"):
        allan.noises(of.deviation[:, 0], allan.Expectation(of))
