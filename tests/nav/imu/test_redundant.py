"""Fusion and fault isolation against closed forms, distributions and the readable twin."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from nav.imu.geometry import GEOMETRIES, cone, with_skew
from nav.imu.many import Sensors, ideal
from nav.imu.parity import MOST, alarm, noncentrality, parity_matrix, sets_of, thresholds
from nav.imu.redundant import Monitor, Noise, Redundant, RedundantUnit
from nav.imu.redundant_kernel import DETECTED, EXCLUDED, READMITTED
from nav.imu.redundant_readable import Readable

RATE_HZ = 100.0
TAU = 1.0 / RATE_HZ
WALK = 1e-6
SIGMA = WALK * math.sqrt(TAU)  # of one sample
UNITS = ("cone", "skew")
ALL = (1 << 6) - 1


def axes_of(seed: int, n: int) -> np.ndarray:
    """Random unit vectors, the first three nearly along x, y, z so that they span space."""
    rng = np.random.default_rng(seed)
    axes = np.vstack((np.eye(3) + 0.1 * rng.standard_normal((3, 3)), rng.standard_normal((n - 3, 3))))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


class Feed:
    """A fusion of ideal sensors, and what it has put out."""

    def __init__(self, axes: np.ndarray, monitor: Monitor | None = None) -> None:
        self.axes = axes
        self.fusion = Redundant(ideal(axes), Noise(WALK), RATE_HZ, monitor or Monitor())
        self.total = np.zeros(3)
        self.statuses: list[int] = []

    def __call__(self, z: np.ndarray) -> np.ndarray:
        x, owed = np.zeros(3), np.zeros(3)
        padded = np.pad(z, (0, MOST - len(z)))
        self.statuses.append(self.fusion.sample(padded, TAU, np.zeros(3), x, owed))
        self.total += x + owed
        return x


@given(seed=st.integers(0, 10_000), n=st.integers(4, 8))
@settings(max_examples=40, deadline=None)
def test_parity_space_is_free_of_motion_and_orthonormal(seed, n):
    H = axes_of(seed, n)
    V = parity_matrix(H)
    assert V.shape == (n - 3, n)
    np.testing.assert_allclose(V @ H, 0.0, atol=1e-14)
    np.testing.assert_allclose(V @ V.T, np.eye(n - 3), atol=1e-14)


@given(seed=st.integers(0, 10_000), n=st.integers(4, 6))
@settings(max_examples=20, deadline=None)
def test_every_set_gives_back_the_motion_and_nothing_else(seed, n):
    H = axes_of(seed, n)
    sigma = np.random.default_rng(seed).uniform(0.5, 2.0, n)
    sets = sets_of(H, sigma)
    for m in np.flatnonzero(sets.spans):
        np.testing.assert_allclose(sets.fuse[m] @ H, np.eye(3), atol=1e-11)
        np.testing.assert_allclose(sets.parity[m] @ H, 0.0, atol=1e-11)
        assert not sets.fuse[m][:, [k for k in range(n) if not m >> k & 1]].any()
        # the covariance of the estimate by the law of its own weights
        spread = sets.fuse[m] @ np.diag(sigma**2) @ sets.fuse[m].T
        np.testing.assert_allclose(sets.cofactor[m], spread, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", UNITS)
def test_what_is_left_of_a_sensor_is_its_distance_from_the_others(name):
    """sigma^2 / (diagonal of I - H H+) is the variance of what the others predict less what it says."""
    n = len(GEOMETRIES[name])
    sets = sets_of(GEOMETRIES[name], np.linspace(0.7, 1.4, n))
    everybody = (1 << n) - 1
    for k in range(n):
        without = everybody ^ 1 << k
        if sets.spans[without]:
            assert sets.inverse[everybody, k] == pytest.approx(sets.outside[without, k], rel=1e-9)


def test_the_cone_in_closed_form():
    """H'H = 2 I: half of every fault is in parity space, and without one sensor one direction is alone."""
    sets = sets_of(cone(), np.ones(6))
    np.testing.assert_allclose(sets.cofactor[ALL], 0.5 * np.eye(3), atol=1e-14)
    np.testing.assert_allclose(sets.inverse[ALL], 2.0, atol=1e-13)
    for k in range(6):
        found = np.linalg.eigvalsh(sets.cofactor[ALL ^ 1 << k])
        np.testing.assert_allclose(found, [0.5, 0.5, 1.0], atol=1e-13)
    # directions in parity space: neighbours -2/3, next but one 0, opposite 1/3
    V = parity_matrix(cone())
    np.testing.assert_allclose(2.0 * (V.T @ V)[0], [1.0, -2 / 3, 0.0, 1 / 3, 0.0, -2 / 3], atol=1e-13)


def test_faults_of_y_and_z_of_the_unit_with_two_askew_look_the_same():
    V = parity_matrix(with_skew())
    np.testing.assert_allclose(V[:, 1], V[:, 2], atol=1e-14)
    sets = sets_of(with_skew(), np.ones(5))
    assert not sets.spans[0b11001]  # and without both, x, S and T lie in a plane


def test_thresholds_and_smallest_faults_in_closed_form():
    """Two degrees: -2 ln p. One degree: a normal variable on either side."""
    limits = thresholds(2, np.array([1e-6]), [1])[0]
    assert limits[2] == pytest.approx(-2.0 * math.log(1e-6), rel=1e-12)
    assert limits[1] == pytest.approx(stats.norm.isf(0.5e-6) ** 2, rel=1e-9)
    found = noncentrality(limits[1], 1, 1e-3)
    # below the limit on one side, next to never beyond it on the other
    assert math.sqrt(found) == pytest.approx(math.sqrt(limits[1]) + stats.norm.isf(1e-3), rel=1e-9)
    fusion = Redundant(ideal(cone()), Noise(WALK, bias=1e-8), RATE_HZ, Monitor(windows=(10.0,)))
    chance = 0.01 / 3600.0 / 2.0 * 10.0
    needed = noncentrality(float(stats.chi2.isf(chance, 3)), 3, 1e-3)
    by_hand = math.sqrt(needed * (WALK**2 * 10.0 + (1e-8 * 10.0) ** 2) * 2.0) / 10.0
    assert fusion.smallest(2) == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize("name", UNITS)
def test_false_alarms_come_at_the_rate_asked_for(name):
    """100 expected; 999 of 1000 Poisson counts are in the band."""
    samples, axes = 400_000, GEOMETRIES[name]
    hours = samples * TAU / 3600.0
    feed = Feed(axes, Monitor(false_alarms=100.0 / hours, windows=(0.1, 0.3, 1.0)))
    z = np.random.default_rng(3).standard_normal((samples, len(axes))) * SIGMA
    fusion, x, owed, still = feed.fusion, np.zeros(3), np.zeros(3), np.zeros(3)
    padded = np.pad(z, ((0, 0), (0, MOST - len(axes))))
    failed = np.flatnonzero([fusion.sample(one, TAU, still, x, owed) & DETECTED for one in padded])
    # tests within a longest window of each other are one alarm
    found = 1 + np.count_nonzero(np.diff(failed) > fusion.monitor.windows[-1] * RATE_HZ)
    low, high = stats.poisson.ppf([0.5e-3, 1.0 - 0.5e-3], 100.0)
    assert low <= found <= high


def test_a_smallest_fault_is_missed_as_often_as_said():
    """Windows of 0.1 s with a bias that half of the tests miss: a binomial count."""
    monitor = Monitor(false_alarms=36.0, windows=(0.1,), isolation=1e-300)  # nobody is ever excluded
    feed = Feed(cone(), monitor)
    bias, windows = feed.fusion.smallest(1, missed=0.5), 2000
    z = np.random.default_rng(4).standard_normal((10 * windows, 6)) * SIGMA
    z[:, 1] += bias * TAU
    for one in z:
        feed(one)
    by_window = np.array(feed.statuses).reshape(windows, 10)[:, -1] & DETECTED
    low, high = stats.binom.ppf([0.5e-3, 1.0 - 0.5e-3], windows, 0.5)
    assert low <= by_window.sum() <= high


@pytest.mark.parametrize(("name", "k"), [(name, k) for name in UNITS for k in range(len(GEOMETRIES[name]))])
def test_a_step_is_isolated_or_left_between_those_that_look_alike(name, k):
    feed = Feed(GEOMETRIES[name])
    n = len(feed.axes)
    z = np.random.default_rng(k).standard_normal((2200, n)) * SIGMA
    z += feed.axes @ np.array([1e-3, -2e-3, 5e-4])
    z[100:, k] += 3.0 * feed.fusion.smallest(k) * TAU
    for one in z:
        feed(one)
    if name == "skew" and k in (1, 2):
        assert feed.fusion.suspects == (1, 2)
        assert len(feed.fusion.active) == n
    else:
        assert feed.fusion.active == tuple(j for j in range(n) if j != k)
        assert feed.fusion.suspects == ()


def test_a_fault_that_a_sample_shows_never_gets_out():
    feed = Feed(cone())
    rng = np.random.default_rng(7)
    for _ in range(30):
        feed(rng.standard_normal(6) * SIGMA)
    z = rng.standard_normal(6) * SIGMA
    z[4] += 1000.0 * SIGMA
    x = feed(z)
    assert feed.statuses[-1] == DETECTED | EXCLUDED
    assert np.linalg.norm(x) < 10.0 * SIGMA


def test_what_a_fault_brought_in_is_handed_back():
    """Without noise: the sum is the truth once a window shows it."""
    feed = Feed(cone())
    motion = np.array([2e-3, -1e-3, 3e-3])
    fault = 1.5 * feed.fusion.smallest(3) * TAU
    for k in range(3000):
        z = cone() @ motion
        z[3] += fault if k >= 300 else 0.0
        feed(z)
    # after j s, j^2 of it in a window of T s: the first of 10 and 30 s, the others are too short for it
    square = (fault / TAU) ** 2 / 2.0 / WALK**2
    limits = feed.fusion.tables.limits[:, 3]
    shown = [j for j in range(1, 28) if square * j**2 / 10.0 > limits[3] and j <= 10]
    first = min(shown or [j for j in range(1, 28) if j > 25 and square * j**2 / 30.0 > limits[4]])
    assert np.flatnonzero(np.array(feed.statuses) & EXCLUDED).tolist() == [300 + 100 * first - 1]
    np.testing.assert_allclose(feed.total, 3000 * motion, rtol=1e-12)


def test_a_sensor_comes_back_when_it_agrees_and_not_before():
    feed = Feed(cone(), Monitor(windows=(0.1, 1.0)))
    z = np.random.default_rng(9).standard_normal((1500, 6)) * SIGMA
    z[150:600, 2] += 100.0 * SIGMA
    for one in z:
        feed(one)
    status = np.array(feed.statuses)
    out, back = np.flatnonzero(status & EXCLUDED)[0], np.flatnonzero(status & READMITTED)[0]
    assert out == 150
    # two whole windows of 1 s after the one that the fault ends with, more where chance says so
    assert back >= 799
    assert (back + 1) % 100 == 0
    assert feed.fusion.active == (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize(("name", "one", "other"), [("cone", 1, 2), ("skew", 0, 3), ("skew", 4, 0)])
def test_a_sensor_that_was_excluded_for_nothing_is_exchanged_for_the_one_that_failed(name, one, other):
    """The first fault's end makes it the wrong one: from then on the other alone explains what is seen."""
    feed = Feed(GEOMETRIES[name], Monitor(windows=(0.1, 1.0), agreements=10**6))
    rng = np.random.default_rng(12)
    motion = np.array([2e-3, -1e-3, 3e-3])
    for k in range(1000):
        z = feed.axes @ motion + rng.standard_normal(len(feed.axes)) * SIGMA
        z[one] += 40.0 * SIGMA if k == 200 else 0.0
        z[other] += 3.0 * SIGMA if k >= 500 else 0.0
        feed(z)
    status = np.array(feed.statuses)
    assert feed.fusion.active == tuple(k for k in range(len(feed.axes)) if k != other)
    exchanged = np.flatnonzero(status == DETECTED | EXCLUDED | READMITTED)
    assert len(exchanged) == 1
    assert 500 < exchanged[0] < 600
    # and all that the other brought in is handed back: noise of 1000 samples is left
    P = feed.fusion.covariance(TAU) * 1000.0
    error = feed.total - 1000.0 * motion
    assert error @ np.linalg.solve(P, error) < stats.chi2.isf(1e-3, 3)


def test_a_sensor_that_has_failed_is_not_acquitted_by_tests_too_short_to_see_it():
    """Its bias shows in seconds; a second fault shows in every sample, in which the bias is nothing."""
    feed = Feed(cone(), Monitor(windows=(1.0, 10.0)))
    rng = np.random.default_rng(13)
    for k in range(4000):
        z = rng.standard_normal(6) * SIGMA
        z[1] += 0.8 * SIGMA if k >= 100 else 0.0
        z[3] += 30.0 * SIGMA if k >= 2050 else 0.0
        feed(z)
    assert feed.fusion.active == (0, 2, 4, 5)
    # the first alone, then the second, and nobody for them
    excluded = np.flatnonzero(np.array(feed.statuses) & EXCLUDED)
    assert len(excluded) == 2
    assert excluded[1] == 2050
    assert not np.any(np.array(feed.statuses) & READMITTED)


@pytest.mark.parametrize(("freedom", "overlap"), [(1, 3), (2, 10), (3, 30)])
def test_alarms_of_sums_that_overlap_begin_as_often_as_said(freedom, overlap):
    """Some hundred are counted; the law holds to 7 % there, the count to three sigmas."""
    tests, limit = 3_000_000, 16.0
    steps = np.random.default_rng(freedom).standard_normal((tests, freedom)).cumsum(axis=0)
    square = np.sum((steps[overlap:] - steps[:-overlap]) ** 2, axis=1) / overlap
    failed = np.flatnonzero(square > limit)
    found = 1 + np.count_nonzero(np.diff(failed) > overlap)
    assert found == pytest.approx(alarm(limit, freedom, overlap) * tests, rel=0.07 + 3.0 / math.sqrt(found))
    # and the threshold is its inverse
    rate = alarm(limit, freedom, overlap)
    assert thresholds(3, np.array([rate]), [overlap])[0, freedom] == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize("pair", list(combinations(range(6), 2)))
def test_any_two_of_the_cone_may_be_dead(pair):
    feed = Feed(cone())
    rng = np.random.default_rng(11)
    motion = np.array([1e-3, 2e-3, -1e-3])
    errors = []
    for _ in range(400):
        z = cone() @ motion + rng.standard_normal(6) * SIGMA
        z[list(pair)] = np.nan
        errors.append(feed(z) - motion)
    assert feed.fusion.active == tuple(k for k in range(6) if k not in pair)
    # the covariance that it says: chi-square of three degrees for each sample
    P = feed.fusion.covariance(TAU)
    total = sum(e @ np.linalg.solve(P, e) for e in errors)
    low, high = stats.chi2.ppf([0.5e-3, 1.0 - 0.5e-3], 3 * len(errors))
    assert low < total < high


def test_no_solution_is_said_and_ends_when_sensors_are_back():
    feed = Feed(cone(), Monitor(windows=(0.1, 1.0)))
    motion = np.array([1e-3, 0.0, 0.0])
    for k in range(400):
        z = cone() @ motion
        if 50 <= k < 120:
            z[:4] = np.nan
        x = feed(z)
        lost = 50 <= k < 300  # a longest window that they are all there in has to pass
        assert np.isnan(x).all() if lost else np.allclose(x, motion, rtol=1e-12)
    assert feed.fusion.active == (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize("name", UNITS)
def test_the_kernel_is_its_twin(name):
    """Faults one after the other, missing sensors, uneven scales, sensors of unequal noise."""
    rng = np.random.default_rng(5)
    n = len(GEOMETRIES[name])
    axes = GEOMETRIES[name] + 1e-3 * rng.standard_normal((n, 3))
    sensors = Sensors(
        axes,
        1e-7 * (1.0 + 1e-2 * rng.standard_normal(n)),
        1e-7 * (1.0 + 1e-2 * rng.standard_normal(n)),
        1e-6 * rng.standard_normal(n),
        1e-8 * rng.standard_normal((n, 3)),
    )
    sigma = rng.uniform(0.7, 1.4, n)
    noise = Noise(WALK, 1e-9, 1e-8, 1e-5)
    fusion = Redundant(sensors, noise, RATE_HZ, Monitor(200.0, 1e-3, (0.1, 0.5)), sigma)
    twin, x, owed = Readable(fusion), np.zeros(3), np.zeros(3)
    seen = set()
    for k in range(1500):
        felt = np.array([0.01, 0.1 * math.sin(0.01 * k), 0.098])
        z = axes @ np.array([1e-4, 2e-4 * math.sin(0.003 * k), 0.0]) + rng.standard_normal(n) * SIGMA
        z[0] += 5e-7 if 150 < k < 400 else 0.0
        z[4] += 1e-8 * max(k - 260, 0) if k < 500 else 0.0
        counts = (z + sensors.bias * TAU) / 1e-7
        counts[1] = np.nan if 800 < k < 850 else counts[1]
        counts[:3] = np.nan if 1000 < k < 1030 else counts[:3]
        counts[3] += 300.0 if k == 1200 else 0.0  # excluded for nothing, as what comes after shows
        counts[1] += 10.0 if k > 1250 else 0.0
        expected, lacking, status = twin.sample(counts, TAU, felt)
        assert fusion.sample(np.pad(counts, (0, MOST - n)), TAU, felt, x, owed) == status
        assert fusion.active == tuple(twin.active)
        assert fusion.suspects == tuple(twin.suspects)
        # of sums of terms of 1e-3: what is left is a rounding of these
        np.testing.assert_allclose(x, expected, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(owed, lacking, rtol=1e-12, atol=1e-14)
        seen.add(status)
    assert seen >= {0, DETECTED, EXCLUDED, DETECTED | EXCLUDED, READMITTED, DETECTED | EXCLUDED | READMITTED}


def test_a_unit_of_both_kinds_and_accelerometers_that_are_lost():
    g = np.zeros((6, 3))
    g[:, 2] = 1e-6
    gyros = Redundant(
        Sensors(cone(), np.full(6, 2e-7), np.full(6, 2e-7), np.zeros(6), g), Noise(WALK), RATE_HZ
    )
    accels = Redundant(ideal(cone()), Noise(1e-3), RATE_HZ)
    unit = RedundantUnit(gyros, accels)
    turn, push = np.array([1e-3, 2e-3, 0.0]), np.array([0.0, 0.01, 0.098])
    counts, dtheta, dv = np.zeros(2 * MOST), np.zeros(3), np.zeros(3)
    counts[:6] = (cone() @ turn + g @ push) / 2e-7
    counts[MOST : MOST + 6] = cone() @ push
    for k in range(250):  # over windows' ends
        assert unit.sample(counts, TAU, dtheta, dv) == (0, 0), k
        np.testing.assert_allclose(dtheta, turn, rtol=1e-12, atol=1e-17)
        np.testing.assert_allclose(dv, push, rtol=1e-12, atol=1e-15)
    counts[MOST : MOST + 6] = np.nan
    counts[:6] = cone() @ turn / 2e-7
    assert unit.sample(counts, TAU, dtheta, dv) == (0, EXCLUDED)
    assert np.isnan(dv).all()
    np.testing.assert_allclose(dtheta, turn, rtol=1e-12, atol=1e-17)


def test_accelerometers_that_were_lost_come_back():
    gyros = Redundant(ideal(cone()), Noise(WALK), RATE_HZ)
    unit = RedundantUnit(gyros, Redundant(ideal(cone()), Noise(1e-3), RATE_HZ, Monitor(windows=(0.1, 1.0))))
    push = np.array([0.0, 0.01, 0.098])
    counts, dtheta, dv = np.zeros(2 * MOST), np.zeros(3), np.zeros(3)
    for k in range(400):
        counts[MOST : MOST + 6] = np.nan if 50 <= k < 60 else cone() @ push
        unit.sample(counts, TAU, dtheta, dv)
        # a longest window that they are all there in has to pass
        assert np.isnan(dv).all() if 50 <= k < 200 else np.allclose(dv, push, rtol=1e-12), k
        assert np.isfinite(dtheta).all()


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="span"):
        sets_of(np.tile(np.eye(3)[0], (4, 1)), np.ones(4))
    with pytest.raises(ValueError, match="shape"):
        sets_of(np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="sigma"):
        sets_of(cone(), np.zeros(6))
    with pytest.raises(ValueError, match="windows"):
        Redundant(ideal(cone()), Noise(WALK), RATE_HZ, Monitor(windows=(1.0, 1.5)))
    with pytest.raises(ValueError, match="windows"):
        Redundant(ideal(cone()), Noise(WALK), RATE_HZ, Monitor(windows=(1.0, 10.0, 5.0)))
    with pytest.raises(ValueError, match="false_alarms"):
        Redundant(ideal(cone()), Noise(WALK), RATE_HZ, Monitor(false_alarms=1e4))
    with pytest.raises(ValueError, match="lanes"):
        Feed(cone()).fusion.sample(np.zeros(6), TAU, np.zeros(3), np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="scale"):
        Sensors(cone(), np.zeros(6), np.ones(6), np.zeros(6), np.zeros((6, 3)))
