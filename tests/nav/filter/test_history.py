"""Late data: what comes out is what would have come out had it been on time, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from nav.events import Innovation, ModeChange, Refusal
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.types import BaroSample, Mode, OdoSample
from tests.nav.truth import Drive, fix, hand_over, play, rolled, samples

DT, SECONDS = 0.01, 12
DRIVE = Drive(sway=0.03, nod=0.0)
CONFIG = NavigatorConfig(
    ImuErrors(1e-4, 1e-3, 1e-4, 1e-2, gyro_scale=1e-3, accel_scale=1e-3),
    odometer=True,
    odometer_sigma=0.1,
    non_holonomic=0.1,
    sigma_mounting=0.01,
    zero_velocity=None,
)
SIGMAS = np.array([1.0] * 3 + [0.1] * 3 + [5e-3] * 3 + [1e-4] * 3 + [1e-2] * 3)


@pytest.fixture(scope="module")
def inertial():
    rng = np.random.default_rng(5)
    dtheta, dv = DRIVE.increments(round(SECONDS / DT), DT)
    dtheta = dtheta + 1e-4 * np.sqrt(DT) * rng.normal(size=dtheta.shape)
    dv = dv + 1e-3 * np.sqrt(DT) * rng.normal(size=dv.shape)
    return samples(dtheta, dv, DT)


@pytest.fixture(scope="module")
def aids():
    """Fixes at 4 Hz between the epochs, odometer at 10 Hz, barometer at 5 Hz."""
    rng = np.random.default_rng(6)
    fixes = [fix(DRIVE, 0.25 * k + 0.0033, rng=rng) for k in range(1, 4 * SECONDS - 8)]
    wheel = [
        OdoSample(round(t * 1e9), 0.1, rolled(DRIVE, t - 0.1, t), False, "odo")
        for t in 0.1 * np.arange(1, 10 * SECONDS - 20) + 0.0021
    ]
    baro = [
        BaroSample(round(t * 1e9), DRIVE.geodetic(t)[2] + rng.normal(), 1.0, "baro")
        for t in 0.2 * np.arange(1, 5 * SECONDS - 10) + 0.0077
    ]
    return fixes + wheel + baro


def final(inertial, aids, delay, config=CONFIG):
    navigator = Navigator(config)
    navigator.begin(hand_over(DRIVE, sigmas=SIGMAS))
    arriving = [(a.t_ns * 1e-9 + delay(a), a) for a in aids]
    solutions, events = play(navigator, inertial, arriving)
    assert navigator.mode is Mode.NAVIGATE
    live = navigator._timeline.live
    return solutions, events, live.x.copy(), live.P.copy()


def test_late_data_gives_the_same_bits(inertial, aids):
    on_time = final(inertial, aids, lambda a: 0.0)
    delays = {"gnss": 0.37, "odo": 0.09, "baro": 0.21}
    late = final(inertial, aids, lambda a: delays[a.device])
    np.testing.assert_array_equal(late[2], on_time[2])
    np.testing.assert_array_equal(late[3], on_time[3])
    # the last solutions, after everything has arrived, are the same too
    for a, b in zip(on_time[0][-20:], late[0][-20:], strict=True):
        assert a.t_ns == b.t_ns
        np.testing.assert_array_equal(a.state, b.state)
    accepted = [sum(isinstance(e, Innovation) and e.accepted for e in r[1]) for r in (on_time, late)]
    assert accepted[0] == accepted[1]


def test_any_order_gives_the_same_bits(inertial, aids):
    """Fixes that overtake each other by up to a second and a half."""
    only = [a for a in aids if a.device != "odo"]
    rng = np.random.default_rng(8)
    jumbled = {id(a): rng.uniform(0.0, 1.5) for a in only}
    on_time = final(inertial, only, lambda a: 0.0)
    late = final(inertial, only, lambda a: jumbled[id(a)])
    np.testing.assert_array_equal(late[2], on_time[2])
    np.testing.assert_array_equal(late[3], on_time[3])


def test_each_measurement_is_reported_once(inertial, aids):
    _, events, _, _ = final(inertial, aids, lambda a: 0.3)
    seen = [(e.kind, e.t_ns) for e in events if isinstance(e, Innovation)]
    assert len(seen) == len(set(seen))
    assert {kind for kind, _ in seen} == {
        "gnss_position", "gnss_velocity", "odometer", "non_holonomic", "barometer",
    }  # fmt: skip


def test_work_per_call_is_bounded_and_shown_as_catch_up(inertial, aids):
    fixes = [a for a in aids if a.device == "gnss"]
    config = replace(CONFIG, replay_updates=4, odometer=False, non_holonomic=None)
    one = [f for f in fixes if 5.0 < f.t_ns * 1e-9 < 5.3]
    rest = [f for f in fixes if f not in one]
    reference = final(inertial, fixes, lambda a: 0.0, config)
    navigator = Navigator(config)
    navigator.begin(hand_over(DRIVE, sigmas=SIGMAS))
    arriving = [(f.t_ns * 1e-9, f) for f in rest] + [(8.0, f) for f in one]
    solutions, events = play(navigator, inertial, arriving)
    changes = [(e.old, e.new) for e in events if isinstance(e, ModeChange)]
    assert changes == [(Mode.NAVIGATE, Mode.CATCH_UP), (Mode.CATCH_UP, Mode.NAVIGATE)]
    behind = [s for s in solutions if s.mode is Mode.CATCH_UP]
    # 3 s are 150 updates; two calls of 4 come with each new update
    assert 150 / 8 - 3 <= len(behind) <= 150 / 7 + 3
    np.testing.assert_array_equal(navigator._timeline.live.x, reference[2])
    np.testing.assert_array_equal(navigator._timeline.live.P, reference[3])
    # the solution never pauses
    assert np.all(np.diff([s.t_ns for s in solutions]) == round(2 * DT * 1e9))


def test_a_fix_from_before_the_history_is_refused(inertial):
    navigator = Navigator(CONFIG)
    navigator.begin(hand_over(DRIVE, t=1.0))
    _, events = play(navigator, inertial[101:], [(2.0, fix(DRIVE, 0.5))])
    assert [e for e in events if isinstance(e, Refusal)] == [Refusal(500_000_000, "gnss", "stale")]


def test_a_fix_ahead_of_the_inertial_data_waits(inertial):
    """A fix may come before the inertial samples of its time."""
    fixes = [fix(DRIVE, 3.0033)]
    early = final(inertial, fixes, lambda a: -0.5)
    on_time = final(inertial, fixes, lambda a: 0.0)
    np.testing.assert_array_equal(early[2], on_time[2])


def test_innovations_between_epochs_are_those_of_the_instant(inertial):
    """Perfect fixes 3.3 ms after an epoch at up to 17 m/s, lever arm of 2 m: millimetres remain."""
    dtheta, dv = DRIVE.increments(400, DT)
    lever = np.array([1.0, -1.0, 1.5])
    config = NavigatorConfig(ImuErrors(1e-6, 1e-5, 1e-7, 1e-5), gnss_lever_arm=lever, zero_velocity=None)
    navigator = Navigator(config)
    navigator.begin(hand_over(DRIVE))
    aids = [(3.5, fix(DRIVE, t, lever)) for t in (1.0033, 1.5051, 2.0, 3.0199)]
    _, events = play(navigator, samples(dtheta, dv, DT), aids)
    innovations = [e for e in events if isinstance(e, Innovation)]
    assert len(innovations) == 8
    for e in innovations:
        # the rate of the lever arm is the mean of an update: 0.1 rad/s^2 over 10 ms at 2 m
        assert np.linalg.norm(e.residual) < 3e-3
