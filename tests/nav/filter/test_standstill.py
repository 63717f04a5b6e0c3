"""What a standstill looks like: limits that are configured, usual, or learned axis by axis at rest."""

from dataclasses import replace

import numpy as np
import pytest

from nav.align.types import NavInit
from nav.filter.settings import ImuErrors, NavigatorConfig
from nav.filter.standstill import Standstill
from nav.types import OdoSample
from virtual_bus.manoeuvres import Blend, Profile

CONFIG = NavigatorConfig(ImuErrors(1e-5, 1e-3, 1e-5, 1e-3))
REST = np.array([0.01, 0.002, 0.002]), np.array([0.05, 0.3, 0.05])  # an engine at idle
INIT = NavInit(
    0,
    0.7,
    0.2,
    100.0,
    np.zeros(3),
    np.array([1.0, 0.0, 0.0, 0.0]),
    np.eye(3) * 1e-4,
    *(np.full(3, 0.1) for _ in range(6)),
    rest_rate=REST[0],
    rest_force=REST[1],
)


def sums(rate, force):
    """What an interval of half a second gathers, with these standard deviations (3,) of single updates."""
    mean = np.concatenate([[0.01, -0.02, 0.03], [0.1, -0.2, 9.8]])
    n = 25
    rest = np.zeros(14)
    rest[0], rest[1] = 0.5, n
    rest[2:8] = mean * 0.5
    rest[8:14] = n * (mean**2 + np.concatenate([rate, force]) ** 2)
    return rest


def stands(config, init, rate, force, speed=0.0):
    """Whether an interval of these counts as a rest when the next is the same."""
    watch = Standstill(config, init)
    found = []
    for end_ns in (1_000_000_000, 1_500_000_000):
        rest = sums(rate, force)
        found.append(watch.interval(end_ns, rest, np.array([speed, 0.0, 0.0]), 0.1))
        assert not rest.any()  # begun again
    assert found[0] is None
    if found[1] is not None:
        np.testing.assert_allclose(found[1].rate_b, [0.01, -0.02, 0.03], rtol=1e-12)
        assert (found[1].start_ns, found[1].end_ns) == (500_000_000, 1_000_000_000)
    return found[1] is not None


def test_an_axis_may_shake_as_it_did_at_rest():
    assert stands(CONFIG, INIT, *REST)


@pytest.mark.parametrize("axis", range(6))
def test_no_axis_may_shake_a_third_more_than_it_did_at_rest(axis):
    shaken = np.concatenate(REST)
    shaken[axis] *= 1.33
    assert not stands(CONFIG, INIT, shaken[:3], shaken[3:])


def test_a_quiet_axis_does_not_excuse_another():
    # below the sum over axes of what was seen at rest, yet a motion that no axis but the first had
    assert not stands(CONFIG, INIT, np.array([0.002, 0.008, 0.002]), REST[1])


def test_what_is_configured_comes_first():
    config = replace(CONFIG, rest_gyro=0.02, rest_accel=1.0)
    assert stands(config, INIT, np.array([0.002, 0.018, 0.002]), np.array([0.9, 0.1, 0.1]))
    assert not stands(config, INIT, np.array([0.015, 0.015, 0.002]), np.array([0.9, 0.1, 0.1]))


def test_nothing_seen_and_nothing_configured():
    assert stands(CONFIG, None, np.full(3, 0.005), np.full(3, 0.08))
    assert not stands(CONFIG, None, np.full(3, 0.006), np.full(3, 0.08))
    assert not stands(CONFIG, None, np.full(3, 0.005), np.full(3, 0.09))


def test_a_smooth_ride_is_no_standstill():
    assert not stands(CONFIG, INIT, *REST, speed=0.6)


def test_the_interval_in_which_it_sets_off_is_no_rest():
    """Gently: it is as quiet as the others, and slow. What lies between two quiet ones was a rest."""
    watch = Standstill(CONFIG, INIT)
    shaken = [1.0, 1.0, 1.0, 1.5, 1.0, 1.5]
    found = [
        watch.interval((k + 1) * 500_000_000, sums(REST[0], x * REST[1]), np.zeros(3), 0.1)
        for k, x in enumerate(shaken)
    ]
    assert [None if r is None else r.end_ns for r in found] == [
        None,
        500_000_000,
        1_000_000_000,
        None,
        None,
        None,
    ]


@pytest.mark.parametrize(("starts_ms", "rested"), [(1760, False), (1780, True)])
def test_a_wheel_must_stand_for_a_while_after_an_interval(starts_ms, rested):
    """A start begins below what a wheel can tell: the last three quarters of a second before it shows are no
    rest."""
    watch = Standstill(CONFIG, INIT)
    found = []
    for t_ms in range(20, 2100, 20):
        sample = OdoSample(t_ms * 1_000_000, 0.02, 0.0, t_ms < starts_ms, "odo")
        found.append(watch.odometer(sample))
        if t_ms == 1000:
            rest = np.zeros(14)
            rest[0], rest[1] = 0.5, 50
            assert watch.interval(1_000_000_000, rest, np.zeros(3), 0.1) is None
    assert [r.end_ns for r in found if r is not None] == ([1_000_000_000] if rested else [])


@pytest.mark.parametrize(("speed", "seconds"), [(12.0, 8.0), (16.0, 9.0), (20.0, 10.0)])
def test_no_rest_ends_while_a_smooth_start_creeps(speed, seconds):
    """The virtual wheel shows a start at 5 mm/s. Whenever intervals end, the last that counts as a rest ends
    at less than the 20 um/s to which a standstill of the bench is believed: none pulls at the velocity."""
    start_ns = 10_000_000_000
    profile = Profile([Blend(10.0), Blend(seconds, speed=speed)])
    for phase_ns in range(0, 500_000_000, 40_000_000):
        watch = Standstill(CONFIG, INIT)
        ends = []
        for t_ns in range(20_000_000, start_ns + 3_000_000_000, 20_000_000):
            v = float(profile.speed(np.array([t_ns]))[0])
            found = [watch.odometer(OdoSample(t_ns, 0.02, 0.0, v < 0.005, "odo"))]
            if (t_ns - phase_ns) % 500_000_000 == 0:
                rest = np.zeros(14)
                rest[0], rest[1] = 0.5, 50
                found.append(watch.interval(t_ns, rest, np.zeros(3), 0.1))
            ends += [r.end_ns for r in found if r is not None]
        assert ends[-1] > start_ns - 1_000_000_000
        assert profile.speed(np.array(ends)).max() < 20e-6
