"""Gyros latched at whole cycles: corrections against motions they are exact for, and against each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav.imu import whole_cycle
from nav.imu.whole_cycle import COAST, METHODS, SPACING, WholeCycle, ahead_readable

DT = 0.01
RATES = (370.0, 359.0, 408.0)


def latches(samples, dt=DT, seed=1, rates=RATES):
    """Times (samples + 1, 3) of the last latch at the instants k dt, gyros of random phases."""
    phase = np.random.default_rng(seed).random(3)
    f = np.array(rates)
    instants = dt * np.arange(samples + 1)[:, None]
    return (np.floor(instants * f + phase) - phase) / f


def corrected(name, angle, samples=40, dt=DT, seed=1, unknown=(), lost=()):
    """Increments (samples, 3) of a method for a motion ``angle(t)`` in pulses, the same of all gyros."""
    at = latches(samples, dt, seed)
    unit = WholeCycle(METHODS[name])
    out = []
    for k in range(1, samples + 1):
        counts = angle(at[k]) - angle(at[k - 1])
        ages = np.full(3, -1.0) if k in unknown else k * dt - at[k]
        if k in lost:
            unit.restart()
        unit.correct(ages, dt, counts)
        out.append(counts.copy())
    return np.array(out)


def true(angle, samples, dt=DT):
    return np.diff(angle(dt * np.arange(samples + 1)))[:, None]


# the degree of the angle that each is exact for: a mean rate is that of the middle for a rate on a line
EXACT = {"constant": 1, "linear": 2, "parabolic": 2, "linear+parabolic": 2, "sextic+septic": 6}


@pytest.mark.parametrize("name", METHODS)
def test_a_method_is_exact_for_the_motion_it_assumes(name):
    def angle(t):
        return 1000.0 * sum((7.0 * t) ** n / (n + 1.0) for n in range(1, EXACT[name] + 1))

    got = corrected(name, angle)
    # angles of 3e7 pulses and weights of up to ten: rounding is 1e-7
    np.testing.assert_allclose(got[10:], np.broadcast_to(true(angle, 40), (40, 3))[10:], rtol=0, atol=3e-6)


def test_a_steady_rate_comes_out_steady_from_the_first_sample():
    for name in METHODS:
        got = corrected(name, lambda t: 3e4 * t)
        # the first has a latch before it that nobody knows
        np.testing.assert_allclose(got[1:], 300.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", METHODS)
def test_nothing_counted_is_lost(name):
    """(6-14): what is put ahead of one sample is taken off the next."""

    def angle(t):
        return 2e4 * np.sin(20.0 * t)

    at = latches(200)
    got = corrected(name, angle, 200)
    for i in range(3):
        x, y = at[1:, i], angle(at[1:, i])
        # ahead of the first latch that is known is what its rate turns in its age
        before = y[0] + (y[1] - y[0]) / (x[1] - x[0]) * (DT - x[0])
        after = y[-1] + ahead_readable(METHODS[name], x, y, 2.0)
        assert np.sum(got[1:, i]) == pytest.approx(after - before, abs=1e-7)


@settings(deadline=None, max_examples=40)  # the first example compiles the kernel
@given(
    name=st.sampled_from(sorted(METHODS)),
    dt=st.sampled_from([0.0025, 0.005, 0.01]),
    seed=st.integers(0, 1000),
    counts=st.lists(st.floats(-3e4, 3e4), min_size=30, max_size=30),
)
def test_the_kernel_is_its_readable_twin(name, dt, seed, counts):
    """Counts of any kind, at rates at which every instant has a new latch and at which not."""
    at = latches(len(counts), dt, seed)
    given_ = np.array(counts)
    unit = WholeCycle(METHODS[name])
    first = np.zeros(3)
    unit.correct(dt - at[1], dt, first)
    nodes = [[(at[1, i], 0.0)] for i in range(3)]
    before = [None, None, None]
    for k in range(2, len(counts) + 1):
        new = at[k] - at[k - 1] > 0.5 / max(RATES)
        sample = np.where(new, given_[k - 1], 0.0)
        one = sample.copy()
        unit.correct(k * dt - at[k], dt, sample)
        for i in range(3):
            if new[i]:
                nodes[i].append((at[k, i], nodes[i][-1][1] + one[i]))
            x, y = np.array(nodes[i]).T
            ahead = ahead_readable(METHODS[name], x, y, k * dt) if len(x) > 1 else 0.0
            if before[i] is None:
                before[i] = (y[1] / (x[1] - x[0]) if len(x) > 1 else 0.0) * (dt - x[0])
            # rounding of ages, 1e-16 s, over the least time between latches, on 30 counts of 3e4
            assert sample[i] == pytest.approx(one[i] + ahead - before[i], rel=1e-12, abs=1e-7)
            before[i] = ahead


def test_linear_is_6_12_and_6_13_by_hand():
    """Two intervals of 11 and 9 ms with mean rates of 100 and 130 pulses a second, the latch 2 ms ago."""
    rate = 130.0 + (9.0 + 2.0) / (9.0 + 11.0) * 30.0
    x, y = np.array([0.0, 0.011, 0.020]), np.array([0.0, 1.1, 1.1 + 1.17])
    assert ahead_readable(METHODS["linear"], x, y, 0.022) == pytest.approx(rate * 2e-3, rel=1e-13)
    assert ahead_readable(METHODS["constant"], x, y, 0.022) == pytest.approx(0.26, rel=1e-13)


def test_linear_and_parabolic_have_the_mean_of_both():
    rng = np.random.default_rng(3)
    x, y = np.cumsum(rng.uniform(0.008, 0.012, 6)), np.cumsum(rng.standard_normal(6))
    one, two, both = (
        ahead_readable(METHODS[n], x, y, x[-1] + 2e-3) for n in ("linear", "parabolic", "linear+parabolic")
    )
    assert both == pytest.approx(0.5 * (one + two), rel=1e-13)


@pytest.mark.parametrize("age", [0.0013, 0.0025])
def test_ours_leaves_a_tenth_order_part_in_phase_of_an_oscillation(age):
    """Of the turn between latches; polynomials of degree six or seven alone leave one of the eighth."""
    x = -age - 0.01 * np.arange(12)[::-1]

    def in_phase(omega, nodes=None):
        wave = np.cos(omega * x)
        if nodes is None:
            return ahead_readable(METHODS["sextic+septic"], x, wave, 0.0) + wave[-1] - 1.0
        return np.polyval(np.polyfit(x[-nodes:] / 0.1, wave[-nodes:], nodes - 1), 0.0) - 1.0

    order = np.log2(in_phase(31.4) / in_phase(15.7))
    assert 9.0 < order < 10.2  # terms of higher order count at a third of a radian
    for nodes in (7, 8):
        assert np.log2(in_phase(31.4, nodes) / in_phase(15.7, nodes)) < 8.2
        assert abs(in_phase(15.7)) < 0.2 * abs(in_phase(15.7, nodes))


def test_latches_that_carry_the_polynomial_keep_apart():
    """At 400 samples a second noise of a pulse must not come out as tens of them."""
    rng = np.random.default_rng(4)
    at = latches(4000, 0.0025)
    noise = rng.uniform(-0.5, 0.5, 3 * 4001).reshape(4001, 3)
    new = np.vstack([np.ones((1, 3), bool), np.diff(at, axis=0) > 1e-4])
    held = np.array(
        [noise[np.maximum.accumulate(np.where(new[:, i], np.arange(4001), 0)), i] for i in range(3)]
    ).T
    unit = WholeCycle(METHODS["sextic+septic"])
    out = []
    for k in range(1, 4001):
        counts = held[k] - held[k - 1]
        unit.correct(k * 0.0025 - at[k], 0.0025, counts)
        out.append(counts.copy())
    angle = np.cumsum(out, axis=0)
    assert np.std(angle, axis=0).max() < 10.0 / np.sqrt(12.0)
    assert SPACING < 0.01 - 1.0 / 300.0


class TestGaps:
    """What is not told."""

    @staticmethod
    def angle(t):
        return 3e4 * t + 400.0 * np.sin(9.0 * t)

    def test_a_lost_age_is_bridged_and_nothing_counted_is_lost(self):
        whole = corrected("linear", self.angle, 60)
        got = corrected("linear", self.angle, 60, unknown=(30,))
        # the one without an age is extrapolated over 10 ms more, and given back by the next
        np.testing.assert_allclose(got[29], whole[29], atol=0.5 * 400.0 * 81.0 * (0.013**2))
        np.testing.assert_allclose(got[:29], whole[:29], atol=1e-9)
        np.testing.assert_allclose(np.sum(got[29:40], axis=0), np.sum(whole[29:40], axis=0), atol=0.02)

    def test_without_ages_it_comes_back_to_what_is_counted(self):
        unknown = range(20, 41)
        got = corrected("sextic+septic", self.angle, 60, unknown=unknown)
        at = latches(60)
        last = 20 + int(COAST / DT)
        raw = np.diff(self.angle(at), axis=0)
        np.testing.assert_allclose(got[last:40], raw[last:40], atol=1e-9)
        # all that was counted has come out then, and with the ages what is ahead of it
        np.testing.assert_allclose(np.sum(got[1:40], axis=0), self.angle(at[40]) - self.angle(DT), atol=2.0)
        np.testing.assert_allclose(np.sum(got[1:], axis=0), self.angle(0.6) - self.angle(DT), atol=0.5)

    def test_never_an_age_is_the_plain_count(self):
        got = corrected("sextic+septic", self.angle, 30, unknown=range(31))
        np.testing.assert_array_equal(got, np.diff(self.angle(latches(30)), axis=0))

    def test_after_a_gap_the_count_is_taken_as_it_is_and_corrected_from_then_on(self):
        got = corrected("sextic+septic", self.angle, 60, lost=(30,))
        want = np.broadcast_to(true(self.angle, 60), (60, 3))
        # unknown is the age of one latch: at most a cycle's turn
        np.testing.assert_allclose(got[29], want[29], atol=3e4 / 359.0)
        np.testing.assert_allclose(got[45:], want[45:], atol=1e-3)


def test_a_state_of_gyros_latched_together():
    """The text's simulation: all begin at time zero, so that the first interval is known."""
    state = whole_cycle.synchronised()
    counts = np.array([90.0, 80.0, 70.0])
    ages = np.array([0.001, 0.002, 0.003])
    slope, bend, degree = METHODS["constant"]
    whole_cycle.correct(slope, bend, degree, state, ages, DT, counts)
    np.testing.assert_allclose(counts, 100.0, rtol=1e-14)
