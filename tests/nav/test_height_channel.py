"""The height channel in the navigator: a barometer, no GNSS, and what the filter knows of its height."""

from dataclasses import replace

import numpy as np
import pytest

from nav.events import Innovation, ModeChange, Refusal
from nav.filter import states as st
from nav.filter.covariance import feedback, feedback_readable
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.strapdown.height import height_gains
from nav.types import BaroSample, Mode, S
from tests.nav.filter.making import covariance
from tests.nav.truth import Drive, fix, hand_over, play, samples

DT = 0.05
BIAS = 2e-3
IMU = ImuErrors(2e-6, 2e-4, 1e-8, BIAS)
CONFIG = NavigatorConfig(IMU, zero_velocity=None, height_channel=(2, 30.0), baro_wander=0.05)
REST = Drive(radius=0.0, sway=0.0, nod=0.0)
SIGMAS = np.array([1.0, 1.0, 2.0] + [0.02] * 3 + [1e-5] * 3 + [1e-8] * 3 + [BIAS] * 3)


def stand(seconds, rng):
    """Inertial samples, barometer samples with a bias that walks, and the hand-over; errors are drawn."""
    count = round(seconds / DT)
    dtheta, dv = (np.tile(a, (count, 1)) for a in REST.increments(1, DT))
    dtheta += rng.normal(size=(count, 3)) * 2e-6 * DT**0.5
    dv += rng.normal(size=(count, 3)) * 2e-4 * DT**0.5
    error = SIGMAS * rng.normal(size=15)
    dv -= error[12:15] * DT
    dtheta -= error[9:12] * DT
    init = hand_over(REST, error=error, sigmas=SIGMAS)
    # what the sensors have is not known: the hand-over's biases are zero
    init = replace(init, gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
    step = 0.5
    t = np.arange(step, seconds, step)
    walk = 12.0 + np.cumsum(rng.normal(size=len(t))) * 0.05 * step**0.5
    heights = 300.0 + walk + rng.normal(size=len(t)) * 0.3
    aids = [(a + 0.07, BaroSample(round(a * 1e9), b, 0.3, "baro")) for a, b in zip(t, heights, strict=True)]
    return samples(dtheta, dv, DT), aids, init


def stood(config, inertial, aids, init):
    navigator = Navigator(config)
    navigator.begin(init)
    solutions, events = play(navigator, inertial, aids)
    return solutions, events


@pytest.mark.parametrize("order", [2, 3])
def test_half_an_hour_on_the_barometer_alone(order):
    rng = np.random.default_rng(order)
    solutions, events = stood(replace(CONFIG, height_channel=(order, 30.0)), *stand(1800.0, rng))
    assert [e for e in events if isinstance(e, Innovation | Refusal)] == []
    rows = np.array([s.state for s in solutions])
    error, sigma = rows[:, 2] - 300.0, rows[:, 18]
    # the barometer walks by 0.05 m/sqrt(s), 2 m in half an hour; to begin with 2 m are not known
    assert np.abs(error).max() < 8.0
    assert 2.0 < sigma[-1] < 4.0
    assert np.mean((error / sigma) ** 2) < 3.0
    assert np.abs(error / sigma).max() < 3.5
    assert np.abs(rows[-18000:, 5]).max() < 0.3
    assert np.mean((rows[-18000:, 5] / rows[-18000:, 21]) ** 2) < 2.0


@pytest.mark.parametrize("order", [2, 3])
def test_its_sigmas_are_those_of_many_runs(order):
    """Thirty runs of two minutes: mean squared errors over variances stay within the band of chi-square."""
    squares = []
    for seed in range(30):
        rng = np.random.default_rng(100 + seed)
        config = replace(CONFIG, height_channel=(order, 20.0))
        row = stood(config, *stand(120.0, rng))[0][-1].state
        squares.append([((row[2] - 300.0) / row[18]) ** 2, (row[5] / row[21]) ** 2])
    # 30 degrees of freedom: 0.34 to 2.1 is passed by all but one in ten thousand
    mean = np.mean(squares, axis=0)
    assert np.all((mean > 0.34) & (mean < 2.1))


def test_gnss_and_height_channel_together():
    """Fixes find the barometer's bias; the height is then better than what was handed over."""
    rng = np.random.default_rng(7)
    inertial, aids, init = stand(120.0, rng)
    fixes = [(t, fix(REST, t, sigma=(0.5, 0.5, 0.5), rng=rng)) for t in np.arange(1.03, 119.0)]
    for order in (2, 3):
        solutions, events = stood(replace(CONFIG, height_channel=(order, 30.0)), inertial, aids + fixes, init)
        refused = [e for e in events if isinstance(e, Innovation) and not e.accepted]
        assert refused == []
        row = solutions[-1].state
        assert abs(row[2] - 300.0) < 3.0 * row[18]
        assert row[18] < 0.25
        assert abs(row[34] - 12.0) < 1.5


def test_the_same_bits_whatever_else_is_late():
    """Late fixes send the filter back over rows that hold the heights as they were known."""
    inertial, aids, init = stand(60.0, np.random.default_rng(3))
    late = [(t + 0.9, fix(REST, t)) for t in np.arange(5.03, 58.0, 2.0)]
    first = stood(CONFIG, inertial, aids + late, init)[0]
    again = stood(CONFIG, inertial, aids + late, init)[0]
    assert [a.state.tobytes() for a in first] == [b.state.tobytes() for b in again]


def test_a_barometer_that_falls_silent_lets_go():
    """Without a height for two seconds nothing is fed back: sigma grows, the mode says so."""
    config = replace(CONFIG, barometer_timeout=3.0)
    inertial, aids, init = stand(120.0, np.random.default_rng(4))
    aids = [(t, s) for t, s in aids if not 40.0 < t < 80.0]
    solutions, events = stood(config, inertial, aids, init)
    modes = [e.new for e in events if isinstance(e, ModeChange)]
    assert modes == [Mode.DEGRADED, Mode.NAVIGATE]
    sigma = {round(s.t_ns * 1e-9, 1): s.state[21] for s in solutions}
    assert sigma[79.0] > 1.3 * sigma[40.0]
    assert sigma[110.0] < sigma[79.0]


def test_a_height_that_comes_twice_is_stale():
    inertial, aids, init = stand(3.0, np.random.default_rng(5))
    _, events = stood(CONFIG, inertial, [*aids[:2], (2.0, aids[0][1])], init)
    assert [e.reason for e in events if isinstance(e, Refusal)] == ["stale"]


def test_without_a_channel_the_filter_uses_the_barometer():
    inertial, aids, init = stand(5.0, np.random.default_rng(6))
    _, events = stood(replace(CONFIG, height_channel=None), inertial, aids, init)
    assert {e.kind for e in events if isinstance(e, Innovation)} == {"barometer"}


def test_third_order_is_a_state_more():
    assert NavigatorConfig(IMU, height_channel=(3, 30.0)).states == st.ALL
    assert NavigatorConfig(IMU, height_channel=(2, 30.0)).states == st.BASIC
    with pytest.raises(ValueError, match="order 4"):
        NavigatorConfig(IMU, height_channel=(4, 30.0))


@pytest.mark.parametrize("n", [st.BASIC, st.FULL, st.ALL])
def test_covariance_of_the_feedback_is_the_twin(n):
    P = np.eye(n)
    P[: st.FULL, : st.FULL] = covariance(min(n, st.FULL)) if n <= st.FULL else covariance(st.FULL)
    if n > st.FULL:
        P[st.HEIGHT_A.start, 2] = P[2, st.HEIGHT_A.start] = 0.1
    gains = height_gains(3 if n == st.ALL else 2, 5.0)
    expected = feedback_readable(P, gains, 0.4, 0.02)
    feedback(P, *gains, 0.4, 0.02)
    d = np.sqrt(np.diag(expected))
    assert np.max(np.abs(P - expected) / np.outer(d, d)) < 1e-12
    np.testing.assert_array_equal(P, P.T)


def test_the_solution_stays_a_solution():
    inertial, aids, init = stand(5.0, np.random.default_rng(8))
    solutions, _ = stood(replace(CONFIG, height_channel=(3, 30.0)), inertial, aids, init)
    assert all(np.isfinite(s.state).all() and s.state.shape == (S.SIZE,) for s in solutions)
