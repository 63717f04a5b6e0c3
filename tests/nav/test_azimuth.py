"""The navigator under every azimuth law and with any number of samples an update."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from nav.events import ModeChange
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.strapdown.azimuth import NorthLawRefusal, azimuth_control, refuse_latitude
from nav.types import Mode, S
from tests.nav.truth import Drive, error_of, fix, hand_over, play, samples

DT = 0.01
SECONDS = 20
IMU = ImuErrors(1e-5, 1e-4, 1e-6, 1e-4)
PLAIN = NavigatorConfig(IMU, zero_velocity=None)
LAWS = {"north": 0.0, "wander": 0.0, "free": 0.0, "rotating": math.radians(1.0)}


def started(config, drive):
    navigator = Navigator(config)
    navigator.begin(hand_over(drive))
    return navigator


@pytest.fixture(scope="module", params=[0.8, -1.2], ids=["north", "south"])
def aided(request):
    """Solutions of every law: an aided drive with late fixes and a receiver's slow error."""
    drive = Drive(lat=request.param)
    inertial = samples(*drive.increments(round(SECONDS / DT), DT), DT)
    rng = np.random.default_rng(2)
    fixes = [(t + 0.13, fix(drive, t, (0.3, -0.5, 1.0), rng=rng)) for t in np.arange(0.5, 19.5, 0.5)]
    config = replace(PLAIN, gnss_lever_arm=np.array([0.3, -0.5, 1.0]), gnss_correlated=(0.5, 0.8))
    return {
        law: play(started(replace(config, azimuth=law, azimuth_rate=rate), drive), inertial, fixes)[0]
        for law, rate in LAWS.items()
    }


@pytest.mark.parametrize("law", ["north", "free", "rotating"])
def test_a_law_changes_nothing_that_is_put_out(aided, law):
    mine, wander = aided[law], aided["wander"]
    assert len(mine) == len(wander)
    a, b = np.array([s.state for s in mine]), np.array([s.state for s in wander])
    # covariances turn by steps of first order: at 1 deg/s they grow by (17e-3 * 20e-3)^2 a step, 1e-4 in all,
    # and that much of the corrections, below 1 m and 0.5 m/s, comes out differently; under other laws n turns
    # by less than a hundredth of that
    fine = 1e-4 if law == "rotating" else 1e-6
    np.testing.assert_allclose(a[:, :2], b[:, :2], rtol=0, atol=fine / (6.4e6 * math.cos(1.2)))
    np.testing.assert_allclose(a[:, 2:6], b[:, 2:6], rtol=0, atol=fine * 0.5)
    np.testing.assert_allclose(a[:, S.Q], b[:, S.Q], rtol=0, atol=fine * 1e-3)
    np.testing.assert_allclose(a[:, 16:25], b[:, 16:25], rtol=fine)


@pytest.mark.parametrize("n", range(1, 7))
def test_a_free_inertial_drive_with_n_samples_an_update(n):
    drive = Drive()
    inertial = samples(*drive.increments(1200, DT), DT)
    solutions, _ = play(started(replace(PLAIN, samples_per_update=n), drive), inertial)
    assert [s.t_ns for s in solutions] == [s.t_ns for s in inertial[n - 1 :: n]]
    e = error_of(solutions[-1], drive)
    # position: velocity is taken to be straight over up to 60 ms; attitude: what a manoeuvre has beyond the
    # cone that the coefficients are made for grows with the length of the update, and one sample has no cone
    assert np.linalg.norm(e[:3]) < 1e-3
    assert np.linalg.norm(e[3:6]) < (1e-6 if n > 1 else 1e-5)
    assert np.linalg.norm(e[6:]) < (3e-8 if n > 1 else 1e-7)


def test_samples_before_a_gap_are_not_lost():
    """Two of four samples wait when the IMU falls silent: they make an update of their own."""
    drive = Drive()
    inertial = samples(*drive.increments(1200, DT), DT)
    config = replace(PLAIN, samples_per_update=4)
    solutions, _ = play(started(config, drive), inertial[:402] + inertial[403:])
    step = [b.t_ns - a.t_ns for a, b in pairwise(solutions)]
    assert sorted(set(step)) == [40_000_000, 70_000_000]
    # 10 ms at half a m/s^2 were guessed
    assert np.linalg.norm(error_of(solutions[-1], drive)[3:6]) < 0.05


def test_the_north_law_stops_with_the_latitude():
    drive = Drive(lat=math.radians(84.9996))
    inertial = samples(*drive.increments(2500, DT), DT)
    navigator = started(replace(PLAIN, azimuth="north"), drive)
    solutions, events = play(navigator, inertial)
    (stop,) = [e for e in events if isinstance(e, ModeChange)]
    assert stop.new is Mode.FAULT
    assert "latitude 85.00 deg" in stop.reason
    assert "north" in stop.reason
    assert all(s.state[0] < math.radians(85.0) + 1e-6 for s in solutions)
    assert play(started(replace(PLAIN, azimuth="free"), drive), inertial)[1] == []


def test_the_north_law_does_not_start_at_a_pole():
    navigator = Navigator(replace(PLAIN, azimuth="north"))
    events = navigator.begin(hand_over(Drive(lat=-math.pi / 2 + 1e-9)))
    assert events[-1].new is Mode.FAULT
    assert "-90.00 deg" in events[-1].reason


def test_what_is_refused():
    with pytest.raises(ValueError, match="unknown azimuth law 'west'"):
        NavigatorConfig(IMU, azimuth="west")
    with pytest.raises(ValueError, match="no rate of its own"):
        NavigatorConfig(IMU, azimuth_rate=1e-3)
    with pytest.raises(ValueError, match="7 samples"):
        NavigatorConfig(IMU, samples_per_update=7)
    with pytest.raises(ValueError, match="vibration"):
        NavigatorConfig(replace(IMU, gyro_vibration=1.0), samples_per_update=1)
    with pytest.raises(NorthLawRefusal, match=r"latitude 86\.00 deg"):
        refuse_latitude("north", math.radians(86.0))
    refuse_latitude("wander", math.pi / 2)
    assert np.count_nonzero(azimuth_control("rotating", 1e-3)) == 1
