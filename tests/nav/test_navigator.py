"""The navigator as its users see it: modes, gaps, gates, standstill, output."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.events import Innovation, ModeChange, Notice, Refusal
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.types import (
    BaroSample,
    FixType,
    ImuFlag,
    ImuSample,
    Mode,
    OdoSample,
    S,
    Solution,
    SolutionFlag,
    SpeedSample,
)
from tests.nav.truth import Drive, error_of, fix, hand_over, play, samples

DT = 0.01
GOOD = ImuErrors(1e-5, 1e-4, 1e-6, 1e-4)
PLAIN = NavigatorConfig(GOOD, zero_velocity=None)
DRIVE = Drive()
SECONDS = 20


@pytest.fixture(scope="module")
def inertial():
    return samples(*DRIVE.increments(SECONDS * 100, DT), DT)


def started(config=PLAIN, drive=DRIVE, **kwargs):
    navigator = Navigator(config)
    navigator.begin(hand_over(drive, **kwargs))
    return navigator


def changes(events):
    return [(e.old, e.new) for e in events if isinstance(e, ModeChange)]


def fixes(seconds, step=0.25, drive=DRIVE, **kwargs):
    return [(t, fix(drive, t, **kwargs)) for t in np.arange(step, seconds, step)]


# ---- modes ----------------------------------------------------------------------------------------


def test_standby_start_and_stop(inertial):
    navigator = Navigator(PLAIN)
    assert navigator.mode is Mode.STANDBY
    assert play(navigator, inertial[:10]) == ([], [])
    assert changes(navigator.start(inertial[9].t_ns)) == [(Mode.STANDBY, Mode.ALIGN)]
    navigator.step(inertial[10])
    assert navigator.mode is Mode.ALIGN
    assert changes(navigator.stop(inertial[10].t_ns)) == [(Mode.ALIGN, Mode.STANDBY)]


def test_a_solution_with_every_second_sample(inertial):
    solutions, events = play(started(), inertial[:200])
    assert [s.t_ns for s in solutions] == [s.t_ns for s in inertial[1:200:2]]
    assert events == []
    assert all(s.mode is Mode.NAVIGATE and np.all(np.isfinite(s.state)) for s in solutions)


def test_free_inertial_drive_is_exact(inertial):
    solutions, _ = play(started(), inertial)
    e = error_of(solutions[-1], DRIVE)
    # two-sample algorithm at 100 Hz with 0.9 rad/s swaying: 1e-6 m/s^2
    assert np.linalg.norm(e[:3]) < 2e-3
    assert np.linalg.norm(e[3:6]) < 2e-4
    assert np.linalg.norm(e[6:]) < 1e-7
    assert solutions[-1].flags & SolutionFlag.DEAD_RECKONING
    assert solutions[-1].flags & SolutionFlag.HEADING


def test_degraded_while_a_counted_on_aid_is_missing(inertial):
    config = replace(PLAIN, gnss_timeout=2.0)
    aids = [(t, f) for t, f in fixes(SECONDS) if t < 5.0 or t > 12.0]
    solutions, events = play(started(config), inertial, aids)
    assert changes(events) == [(Mode.NAVIGATE, Mode.DEGRADED), (Mode.DEGRADED, Mode.NAVIGATE)]
    degraded = [s.t_ns * 1e-9 for s in solutions if s.mode is Mode.DEGRADED]
    # 2 s after the fix at 4.75 s until the one at 12.25 s, looked at every 0.1 s
    assert min(degraded) == pytest.approx(6.75, abs=0.15)
    assert max(degraded) == pytest.approx(12.25, abs=0.15)
    assert not solutions[200].flags & SolutionFlag.DEAD_RECKONING
    assert solutions[200].flags & SolutionFlag.GNSS
    assert solutions[500].flags & SolutionFlag.DEAD_RECKONING


def test_pure_inertial_is_not_degraded(inertial):
    _, events = play(started(), inertial)
    assert changes(events) == []


def test_numbers_that_are_none_end_in_fault(inertial):
    navigator = started()
    play(navigator, inertial[:10])
    bad = [s._replace(dv=np.array([1e300, 1e300, 0.0])) for s in inertial[10:14]]
    solutions, events = play(navigator, bad)
    assert changes(events) == [(Mode.NAVIGATE, Mode.FAULT)]
    assert all(np.all(np.isfinite(s.state)) for s in solutions)
    assert play(navigator, inertial[14:20]) == ([], [])
    assert changes(navigator.start(0)) == [(Mode.FAULT, Mode.ALIGN)]


# ---- inertial samples -----------------------------------------------------------------------------


def test_time_running_backwards_is_refused(inertial):
    navigator = started()
    play(navigator, inertial[:10])
    assert navigator.step(inertial[4]) == [Refusal(inertial[4].t_ns, "imu", "stale")]
    assert navigator.step(inertial[9]) == [Refusal(inertial[9].t_ns, "imu", "stale")]


def test_a_faulty_sample_is_refused(inertial):
    navigator = started()
    bad = inertial[0]._replace(flags=int(ImuFlag.DEVICE_FAULT))
    assert navigator.step(bad) == [Refusal(bad.t_ns, "imu", "invalid")]


@pytest.mark.parametrize("first", [1000, 1001])
def test_a_short_gap_is_bridged_honestly(inertial, first):
    """Half a second without inertial samples, at an even and an odd place; fixes go on."""
    config = replace(PLAIN, gap_rate=0.3, gap_accel=3.0)
    seen = inertial[:first] + inertial[first + 50 :]
    solutions, events = play(started(config), seen, fixes(SECONDS))
    assert changes(events) == []
    gap_end = inertial[first + 50].t_ns
    after = next(s for s in solutions if s.t_ns >= gap_end)
    before = next(s for s in reversed(solutions) if s.t_ns < gap_end - 500_000_000)
    assert after.state[S.SIGMA_PHI][2] > 100 * before.state[S.SIGMA_PHI][2]
    assert after.flags & SolutionFlag.IMU_GAP
    assert not before.flags & SolutionFlag.IMU_GAP
    e, s = error_of(after, DRIVE), after.state[16:25]
    assert np.all(np.abs(e) < 4.0 * s)
    e, s = error_of(solutions[-1], DRIVE), solutions[-1].state[16:25]
    assert np.all(np.abs(e) < 4.0 * s)
    assert np.linalg.norm(e[:2]) < 1.0


def test_a_long_gap_ends_navigation(inertial):
    navigator = started(replace(PLAIN, gap_limit=1.0))
    solutions, events = play(navigator, inertial[:500] + inertial[700:710])
    assert changes(events) == [(Mode.NAVIGATE, Mode.ALIGN)]
    reason = next(e.reason for e in events if isinstance(e, ModeChange))
    assert reason == "no inertial data for 2.0 s"
    assert all(s.t_ns <= inertial[500].t_ns for s in solutions if s.mode is Mode.NAVIGATE)


def test_bridged_and_saturated_samples_are_trusted_less(inertial):
    def sigma(flag):
        made = [s._replace(flags=int(flag)) if 100 <= i < 110 else s for i, s in enumerate(inertial[:200])]
        return play(started(), made)[0][-1].state[S.SIGMA_PHI][2]

    assert sigma(ImuFlag.OK) < sigma(ImuFlag.BRIDGED) < sigma(ImuFlag.SATURATED)


# ---- gates ----------------------------------------------------------------------------------------


def test_an_outlier_changes_nothing(inertial):
    good = fixes(SECONDS)
    _, lat, lon = None, good[30][1].lat, good[30][1].lon
    wild = good[30][1]._replace(t_ns=good[30][1].t_ns + 30_000_000, lat=lat + 1e-4, lon=lon + 1e-4, v_g=None)
    without, _ = play(started(), inertial, good)
    with_it, events = play(started(), inertial, [*good, (good[30][0] + 0.03, wild)])
    refused = [e for e in events if isinstance(e, Innovation) and not e.accepted]
    assert len(refused) == 1
    assert refused[0].nis > 1e4
    np.testing.assert_array_equal(without[-1].state, with_it[-1].state)


def test_a_shut_gate_opens_again(inertial):
    """The filter believes itself to a centimetre and is 60 m wrong: fixes win after `lockout`."""
    navigator = started(replace(PLAIN, lockout=4.0), error=[60.0, -30.0, 10.0] + [0.0] * 12)
    solutions, events = play(navigator, inertial, fixes(SECONDS, sigma_v=(0.05,) * 3))
    notices = [e for e in events if isinstance(e, Notice)]
    assert len(notices) == 1
    assert "gnss_position" in notices[0].text
    # the first fix is refused at 0.25 s
    assert notices[0].t_ns == pytest.approx(4.25e9, abs=0.3e9)
    e, s = error_of(solutions[-1], DRIVE), solutions[-1].state[16:25]
    assert np.all(np.abs(e) < 4.0 * s)
    assert np.linalg.norm(e[:3]) < 1.5


def test_a_shut_gate_stays_shut_to_fixes_that_disagree(inertial):
    """Fixes that are 60 m wrong in all directions change nothing, and do not add up to a belief."""
    rng = np.random.default_rng(8)
    good = fixes(SECONDS, sigma_v=(0.05,) * 3)

    def wild(f):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return f._replace(lat=f.lat + 1e-5 * np.cos(angle), lon=f.lon + 1e-5 * np.sin(angle))

    aids = [(t, wild(f) if 2.0 < t < 9.0 else f) for t, f in good]
    solutions, events = play(started(replace(PLAIN, lockout=3.0)), inertial, aids)
    refused = [e for e in events if isinstance(e, Innovation) and not e.accepted]
    assert len(refused) > 3 * 4
    assert not [e for e in events if isinstance(e, Notice)]
    assert all(np.linalg.norm(error_of(s, DRIVE)[:3]) < 3.0 for s in solutions)


def test_a_fix_without_position_is_refused(inertial):
    navigator = started()
    navigator.step(inertial[0])
    bad = fix(DRIVE, 0.005)._replace(fix_type=FixType.FIX_2D)
    assert navigator.step(bad) == [Refusal(5_000_000, "gnss", "invalid")]


def test_a_fix_without_velocity_is_used(inertial):
    bare = [(t, f._replace(v_g=None, sigma_velocity=None)) for t, f in fixes(3.0)]
    _, events = play(started(), inertial[:300], bare)
    assert {e.kind for e in events if isinstance(e, Innovation)} == {"gnss_position"}


# ---- aids -----------------------------------------------------------------------------------------


def test_barometer_holds_the_height(inertial):
    """300 s without it would run away; bias of the day is learned where GNSS gives the height."""
    drive = Drive(radius=0.0, sway=0.0, nod=0.0)
    still = samples(*drive.increments(3000, 0.1), 0.1)
    still = [s._replace(dv=s.dv + np.array([0.0, 0.0, 2e-4 * 0.1])) for s in still]
    config = replace(PLAIN, baro_bias=50.0, rest_gyro=0.0)
    baro = [(t, BaroSample(round(t * 1e9), 300.0 + 40.0, 0.5, "baro")) for t in np.arange(0.5, 300.0)]
    early = [(t, fix(drive, t)) for t in np.arange(0.25, 20.0, 1.0)]
    sigmas = np.array([1.0] * 3 + [0.1] * 3 + [1e-3] * 3 + [1e-6] * 3 + [3e-4] * 3)
    free, _ = play(started(config, drive, sigmas=sigmas), still)
    held, events = play(started(config, drive, sigmas=sigmas), still, baro + early)
    assert abs(free[-1].height - 300.0) > 5.0
    assert abs(held[-1].height - 300.0) < 1.0
    assert held[-1].state[S.BARO_BIAS] == pytest.approx(40.0, abs=1.0)
    assert all(e.accepted for e in events if isinstance(e, Innovation))


def test_speed_log_bounds_the_drift(inertial):
    drive = Drive(sway=0.0, nod=0.0)
    moving = samples(*drive.increments(2000, DT), DT)
    moving = [s._replace(dv=s.dv + np.array([0.0, 5e-2 * DT, 0.0])) for s in moving]
    speeds = []
    for t in np.arange(0.1, 20.0, 0.1):
        v = np.linalg.norm(drive.velocity_e(np.array(t)))
        speeds.append((t, SpeedSample(round(t * 1e9), float(v), 0.05, "log")))
    sigmas = np.array([1.0] * 3 + [0.1] * 3 + [1e-3] * 3 + [1e-6] * 3 + [5e-2] * 3)
    free, _ = play(started(PLAIN, drive, sigmas=sigmas), moving)
    aided, _ = play(started(PLAIN, drive, sigmas=sigmas), moving, speeds)
    # 0.05 m/s^2 for 20 s in turning directions against a few centimetres per second
    assert np.linalg.norm(error_of(free[-1], drive)[3:5]) > 0.4
    assert np.linalg.norm(error_of(aided[-1], drive)[3:5]) < 0.1
    assert aided[-1].flags & SolutionFlag.ODOMETER


# ---- standstill -----------------------------------------------------------------------------------

STILL = Drive(radius=0.0, sway=0.0, nod=0.0)
MEMS = ImuErrors(2e-4, 2e-3, 5e-3, 0.05)
MEMS_SIGMAS = np.array([1.0] * 3 + [0.1] * 3 + [5e-3] * 3 + [5e-3] * 3 + [5e-2] * 3)


def mems(drive, count, seed, bias):
    rng = np.random.default_rng(seed)
    dtheta, dv = drive.increments(count, DT)
    dtheta = dtheta + bias * DT + 2e-4 * math.sqrt(DT) * rng.normal(size=dtheta.shape)
    return samples(dtheta, dv + 2e-3 * math.sqrt(DT) * rng.normal(size=dv.shape), DT)


def test_standstill_is_seen_and_teaches_the_gyro_bias():
    bias = np.array([3e-3, -4e-3, 5e-3])
    config = NavigatorConfig(MEMS, zero_velocity=0.01, zero_rate=1e-5)
    solutions, _ = play(started(config, STILL, sigmas=MEMS_SIGMAS), mems(STILL, 6000, 1, bias))
    last = solutions[-1]
    assert last.flags & SolutionFlag.STANDSTILL
    # white noise over 60 s: 2e-4 / sqrt(60) = 2.6e-5 rad/s
    sigma = last.state[S.SIGMA_GYRO_BIAS]
    assert np.all(sigma < 4e-5)
    assert np.all(np.abs(last.state[S.GYRO_BIAS] - bias) < 4.0 * sigma)
    assert np.linalg.norm(last.v_g) < 0.03
    # the heading's sigma stopped growing: the same noise is in bias and heading
    assert abs(error_of(last, STILL)[8]) < 4.0 * last.state[S.SIGMA_PHI][2]


def test_a_moving_vehicle_is_not_taken_to_stand(inertial):
    config = NavigatorConfig(MEMS)
    _, events = play(started(config, sigmas=MEMS_SIGMAS), inertial, fixes(SECONDS))
    assert "zero_velocity" not in {e.kind for e in events if isinstance(e, Innovation)}


@pytest.mark.parametrize("stands", [True, False])
def test_the_odometer_has_the_last_word_on_standstill(stands):
    """A quiet IMU alone does not make a standstill while a wheel turns."""
    config = NavigatorConfig(MEMS, odometer=True)
    odo = [(t + 0.03, OdoSample(round(t * 1e9), 0.1, 0.0, stands, "odo")) for t in np.arange(0.1, 5.0, 0.1)]
    _, events = play(started(config, STILL, sigmas=MEMS_SIGMAS), mems(STILL, 500, 2, np.zeros(3)), odo)
    count = sum(isinstance(e, Innovation) and e.kind == "zero_velocity" for e in events)
    # one each half second, the first and the last may miss their confirmation
    assert (7 <= count <= 9) if stands else count == 0


# ---- output ---------------------------------------------------------------------------------------


def test_output_point_and_vehicle_axes():
    """The solution is that of the output point, in vehicle axes, with rates and forces turned too."""
    C_vb = rot.dcm_from_euler(0.5, 0.1, -0.2)
    drive = Drive(C_vb=C_vb)
    point = np.array([1.0, 2.0, -0.5])
    config = replace(PLAIN, C_vb=C_vb, output_point=point)
    solutions, _ = play(started(config, drive), samples(*drive.increments(200, DT), DT))
    s = solutions[-1]
    t = s.t_ns * 1e-9
    # a perfect fix of an antenna there says where it is; rate of the lever arm is an update's mean
    there = fix(drive, t, point)
    r = np.array(earth.geodetic_to_xyz(*s.state[:3]))
    np.testing.assert_allclose(r, earth.geodetic_to_xyz(there.lat, there.lon, there.height), atol=1e-4)
    np.testing.assert_allclose(s.v_g, there.v_g, atol=2e-3)
    # north is that of the point's own meridian
    lat, lon, _, _, C_gb = drive.geodetic(t)
    turned = earth.position_matrix(there.lat, there.lon).T @ earth.position_matrix(lat, lon)
    assert s.heading == pytest.approx(float(rot.euler_from_dcm(turned @ C_gb @ C_vb.T)[0]), abs=1e-8)
    middle = np.array(t - DT)
    np.testing.assert_allclose(s.state[S.W], C_vb @ drive.rate_ib(middle), atol=1e-4)
    np.testing.assert_allclose(s.state[S.F], C_vb @ drive.force(middle), atol=1e-3)
    assert s.flags & SolutionFlag.MOUNTING


def test_the_pole_is_a_place_like_any_other():
    """A figure of eight around the North Pole, with fixes."""
    drive = Drive(lat=math.pi / 2 - 1e-5, lon=0.3)
    solutions, events = play(
        started(PLAIN, drive), samples(*drive.increments(2000, DT), DT), fixes(SECONDS, drive=drive)
    )
    assert all(e.accepted for e in events if isinstance(e, Innovation))
    assert all(np.all(np.isfinite(s.state)) for s in solutions)
    e = error_of(solutions[-1], drive)
    assert np.linalg.norm(e[:3]) < 0.05
    assert np.linalg.norm(e[3:6]) < 0.01


def test_mounting_found_by_the_alignment_is_used():
    C_vb = rot.dcm_from_euler(2.0, 0.1, -0.2)
    init = replace(hand_over(DRIVE), C_vb=C_vb, sigma_mounting=np.full(3, 0.05))
    for config, known in ((replace(PLAIN, C_vb=None), C_vb), (PLAIN, np.eye(3))):
        navigator = Navigator(config)
        navigator.begin(init)
        step = [e for s in samples(*DRIVE.increments(2, DT), DT) for e in navigator.step(s)]
        solution = next(e for e in step if isinstance(e, Solution))
        C_gv = DRIVE.geodetic(2 * DT)[4] @ known.T
        np.testing.assert_allclose(rot.dcm_from_quat(solution.state[S.Q]), C_gv, atol=1e-6)


def test_mounting_is_found_on_the_first_drive():
    """Nobody knows it at the start; course against attitude shows it, then it is refined."""
    C_vb = rot.dcm_from_euler(2.0, 0.1, 0.0)
    drive = Drive(C_vb=C_vb, sway=0.0, nod=0.0)
    config = replace(PLAIN, C_vb=None, non_holonomic=0.05)
    moving = samples(*drive.increments(3000, DT), DT)
    solutions, events = play(started(config, drive), moving, fixes(30.0, drive=drive))
    notices = [e for e in events if isinstance(e, Notice)]
    assert len(notices) == 1
    assert 9.8e9 < notices[0].t_ns < 11e9
    assert not solutions[400].flags & SolutionFlag.MOUNTING
    assert solutions[-1].flags & SolutionFlag.MOUNTING
    phi, sigma = error_of(solutions[-1], drive)[6:], solutions[-1].state[S.SIGMA_PHI]
    # the constraint is perfect here, 0.05 m/s are claimed of 7 to 17 m/s
    assert abs(phi[2]) < 2e-3
    assert 1e-4 < sigma[2] < 5e-3
    innovations = [e for e in events if isinstance(e, Innovation) and e.kind == "non_holonomic"]
    assert len(innovations) > 50
    assert all(e.accepted for e in innovations)


def test_same_samples_same_bits(inertial):
    first, _ = play(started(), inertial, fixes(SECONDS))
    again, _ = play(started(), inertial, fixes(SECONDS))
    for a, b in zip(first, again, strict=True):
        assert a.t_ns == b.t_ns
        assert a.state.tobytes() == b.state.tobytes()


def test_samples_of_one_interval_keep_their_time():
    """The solution's stamp is that of the second sample, whatever the device's own interval says."""
    navigator = started(replace(PLAIN))
    s = [ImuSample(10_000_100 * (i + 1), 0.01, np.zeros(3), np.array([0, 0, 0.098]), "imu") for i in range(2)]
    events = [e for x in s for e in navigator.step(x)]
    assert [e.t_ns for e in events if isinstance(e, Solution)] == [s[1].t_ns]
