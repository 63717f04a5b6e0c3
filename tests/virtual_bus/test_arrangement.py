"""Gyros that are latched at whole cycles and accelerometers that sit apart, against the plain unit."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from dbc.codec import contract
from virtual_bus import scenario
from virtual_bus.arrangement import Arrangement
from virtual_bus.bus import Bench
from virtual_bus.devices import FRAME_NS
from virtual_bus.dither import Dither
from virtual_bus.faults import Faults
from virtual_bus.grades import GRADES, ideal_imu
from virtual_bus.sensors import Imu, generator
from virtual_bus.truth import Trajectory, Vehicle

DITHERS = (Dither(370_000, 1), Dither(359_000, 7 * 10**11), Dither(408_000))
ARMS = np.array([[0.05, -0.02, 0.03], [0.01, 0.04, -0.03], [-0.02, 0.03, 0.05]])


def test_gyros_count_from_latch_to_latch(ride):
    grade = GRADES["rlg"]
    plain, dithered = (
        Imu(ride, grade, ideal_imu(grade), generator(1, "imu"), Faults([]), noise=False, arrangement=one)
        for one in (Arrangement(), Arrangement(DITHERS))
    )
    t = np.arange(12_000_000_000, 14_000_000_001, 5_000_000)
    a, _ = plain.block(t)
    b, _ = dithered.block(t)
    np.testing.assert_array_equal(a[:, 3:], b[:, 3:])
    for i, dither in enumerate(DITHERS):
        dtheta, _ = ride.increments(dither.latched(t))
        pulses = np.cumsum(dtheta[:, i]) / plain._errors.gyro.scale[i]
        assert np.abs(np.cumsum(b[:, i]) - pulses).max() <= 0.5 + 1e-9
    ages = dithered.arrangement.ages(t)
    assert ages is not None
    assert (ages >= 0.0).all()
    assert (ages < 1.0 / 359.0).all()


def test_accelerometers_feel_what_is_where_they_are(ride):
    """Against a unit that sits in the accelerometer's place: the same path, another lever arm."""
    grade = GRADES["rlg"]
    ideal = ideal_imu(grade)
    t = np.arange(24_000_000_000, 27_000_000_001, 5_000_000)
    got = Arrangement(arms=ARMS).outputs(ride, ideal, t)[0][:, 3:]
    v = ride.vehicle
    for i, arm in enumerate(ARMS):
        there = Vehicle(v.imu + v.C_vb @ arm, v.C_vb, v.roll_per_accel, v.pitch_per_accel, v.crab, v.sway)
        lat, lon, height = _start(ride)
        dv = Trajectory(ride.profile, there, lat, lon, height).increments(t)[1][:, i]
        # gravity differs by 2e-7 m/s2 over 5 cm; the parabola of the rate by less
        np.testing.assert_allclose(got[:, i], dv, rtol=0, atol=3e-9)
    assert np.abs(got - ride.increments(t)[1]).max() > 1e-6


def _start(trajectory):
    from virtual_bus.ellipsoid import to_geodetic

    lat, lon, height = to_geodetic(trajectory._r0[:1])
    return float(lat[0]), float(lon[0]), float(height[0])


@pytest.mark.parametrize("fd", [False, True])
def test_latch_times_come_before_each_sample(fd):
    what = scenario.load("dithered")
    what = msgspec.structs.replace(what, imu=msgspec.structs.replace(what.imu, fd=fd))
    bench = Bench(what, seed=4, seconds=3.0)
    latch, first = contract()["IMU_LATCH"], contract()["IMU_FD" if fd else "IMU_GYRO"]
    last = contract()["IMU_FD" if fd else "IMU_TIME"]
    frames = [
        f for f in bench.due(bench.end_ns) if f.frame_id in (latch.frame_id, first.frame_id, last.frame_id)
    ]
    numbers, ages = [], []
    for before, frame in pairwise(frames):
        if before.frame_id == latch.frame_id:
            assert frame.frame_id == first.frame_id
            assert frame.t_ns - before.t_ns == FRAME_NS
            assert not before.is_fd
            sample, *age = latch.decode(before.data)
            numbers.append(sample)
            ages.append(age)
    counts = [
        int(last.decode(f.data)[last.signals.index("SAMPLE")]) & 15
        for f in frames
        if f.frame_id == last.frame_id
    ]
    assert numbers[: len(counts)] == counts
    assert len(ages) > 590
    for i, frequency in enumerate(what.imu.dither_hz):
        x = np.array(ages)[:, i]
        # 1.85, 1.7 and 2.04 cycles a sample: twentieths, tenths and twenty-fifths of a cycle
        assert 0.0 <= x.min() < 300.0
        assert 1e6 / frequency - 300.0 < x.max() <= 1e6 / frequency + 0.1


def test_a_correction_of_gyros_that_do_not_dither_is_refused(tmp_path):
    text = (scenario.PACKAGED / "dithered.toml").read_text().replace("dither_hz", "# dither_hz")
    path = tmp_path / "odd.toml"
    path.write_text(text)
    with pytest.raises(scenario.ScenarioError, match=r"navigator\.whole_cycle.*imu\.dither_hz"):
        scenario.load(path)


def test_the_sheet_and_the_configuration_tell_of_both():
    files = Bench("dithered", seed=1, seconds=1.0).files("virtual", "x")
    assert 'whole_cycle = "sextic+septic"' in files["config.toml"]
    assert "latency_ms = 0.79" in files["config.toml"]  # its frame with the time is the fourth
    assert "lever_arm_mm = [[35.0, 10.0, -20.0]" in files["imu_calibration.toml"]
