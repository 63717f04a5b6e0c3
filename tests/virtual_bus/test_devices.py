"""Devices: what is on the wire, decoded, against the truth; order, wraps and determinism."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from collections import defaultdict

import msgspec
import numpy as np
import pytest

from dbc.codec import contract
from virtual_bus import scenario
from virtual_bus.bus import Bench
from virtual_bus.devices import FRAME_NS
from virtual_bus.faults import GnssOutage, Reset
from virtual_bus.tables import SpeedTable


def frames_of(bench):
    """All frames by message name: (time, alive, values by signal)."""
    out = defaultdict(list)
    for frame in bench.due(bench.end_ns):
        codec = contract().by_id[frame.frame_id]
        assert codec.crc_ok(frame.data)
        assert frame.is_fd == codec.is_fd
        values = codec.decode(frame.data)
        assert codec.in_range(values)
        out[codec.name].append(
            (frame.t_ns, codec.alive(frame.data), dict(zip(codec.signals, values, strict=True)))
        )
    return out


def column(rows, name):
    return np.array([row[2][name] for row in rows])


def digest(bench):
    sha = hashlib.sha256()
    for frame in bench.due(bench.end_ns):
        sha.update(f"{frame.t_ns} {frame.channel} {frame.frame_id} {frame.is_fd} ".encode() + frame.data)
    return sha.hexdigest()


@pytest.fixture(scope="module")
def drive():
    bench = Bench("drive", seed=3, seconds=125.0)
    return bench, frames_of(bench)


def test_rates_and_counters(drive):
    _, frames = drive
    for name, rate in (("IMU_GYRO", 200), ("IMU_STATUS", 10), ("ODO", 50), ("BARO", 25), ("GNSS_TIME", 5)):
        rows = frames[name]
        assert len(rows) == pytest.approx(125 * rate, abs=2)
        alive = np.array([row[1] for row in rows])
        assert ((np.diff(alive) - 1) % 15 == 0).all()
        assert alive[0] == 0


def test_the_frames_of_one_sample_belong_together(drive):
    _, frames = drive
    gyro, accel, time = frames["IMU_GYRO"], frames["IMU_ACCEL"], frames["IMU_TIME"]
    for g, a, t in zip(gyro, accel, time, strict=False):
        assert g[1] == a[1] == t[1]
        assert (a[0] - g[0], t[0] - a[0]) == (FRAME_NS, FRAME_NS)
    assert ((np.diff(column(time, "SAMPLE")) - 1) % 256 == 0).all()
    names = ("GNSS_TIME", "GNSS_LAT", "GNSS_LON", "GNSS_HEIGHT", "GNSS_VEL", "GNSS_ACC")
    for epoch in zip(*(frames[name] for name in names), strict=False):
        assert len({row[1] for row in epoch}) == 1


def test_device_time_wraps_and_drifts_as_its_clock(drive):
    bench, frames = drive
    rows = frames["IMU_TIME"]
    stamps = column(rows, "TIME")
    assert stamps.max() > 4_294_960_000  # 32 bits of microseconds: it wraps in the 100th second
    steps = np.diff(stamps) % 2**32
    assert (steps == 5000).all()
    device_s = 5e-3 * np.arange(1, len(rows) + 1)
    sent_s = np.array([row[0] for row in rows]) * 1e-9
    # jitter of 0.1 ms averaged over 125 s of samples leaves the drift to some 1e-3 ppm
    slope = np.polyfit(sent_s, device_s, 1)[0]
    ppm = bench._device("imu", bench.scenario.imu, 200.0).clock_ppm
    assert (slope - 1.0) * 1e6 == pytest.approx(ppm, abs=0.1)
    for name in ("ODO", "BARO"):
        assert (
            np.diff(column(frames[name], "TIME")) % 6_553_600 == 1_000_000 // {"ODO": 50, "BARO": 25}[name]
        ).all()


def test_ticks_wrap_and_are_the_distance(drive):
    bench, frames = drive
    ticks = column(frames["ODO"], "TICKS")
    assert (np.diff(ticks) < 0).sum() == 1
    total = int((np.diff(ticks) % 2**32).sum())
    way = float(bench.trajectory.profile.distance(np.array([bench.end_ns]))[0])
    # scale error 0.2 % (one sigma), a tick at either end, and the last sample's way
    assert total * 0.02 == pytest.approx(way, rel=0.008, abs=0.3)
    still = column(frames["ODO"], "STANDSTILL")
    assert still[: 59 * 50].all()
    assert not still[64 * 50 : 90 * 50].any()


def test_pulses_with_the_calibration_sheet_give_the_true_motion(drive):
    """Compensation written out here: what is left is the unit's own small error."""
    bench, frames = drive
    sheet = bench.imu_errors
    gyro = np.stack([column(frames["IMU_GYRO"], f"GYRO_{a}") for a in "XYZ"], axis=1)[:24000]
    accel = np.stack([column(frames["IMU_ACCEL"], f"ACCEL_{a}") for a in "XYZ"], axis=1)[:24000]
    dv = np.linalg.inv(sheet.calibrated_accel.axes) @ (
        accel.sum(axis=0) * sheet.calibrated_accel.scale - 120.0 * sheet.calibrated_accel.bias
    )
    dtheta = np.linalg.inv(sheet.calibrated_gyro.axes) @ (
        gyro.sum(axis=0) * sheet.calibrated_gyro.scale - 120.0 * sheet.calibrated_gyro.bias
    )
    true_dtheta, true_dv = bench.trajectory.increments(np.array([0, 120_000_000_000]))
    # five sigma of bias 200 ug with scale and axes of 100 ug; of bias 0.1 deg/h and walk 0.01 deg/sqrt(h)
    assert np.abs(dv - true_dv[0]).max() < 5 * 2.3e-3 * 120.0
    assert np.abs(dtheta - true_dtheta[0]).max() < 5 * math.radians(
        math.hypot(0.1 / 30.0, 0.01 / math.sqrt(30))
    )


def test_gnss_epochs_are_exact_and_late(drive):
    bench, frames = drive
    rows = frames["GNSS_TIME"]
    tow = column(rows, "TOW")
    start = bench.scenario.start
    epoch_us = tow - start.gps_tow_s * 1_000_000
    assert (np.diff(epoch_us) == 200_000).all()
    assert set(column(rows, "WEEK")) == {start.gps_week}
    late_ms = np.array([row[0] for row in rows]) * 1e-6 - epoch_us * 1e-3
    assert late_ms.min() >= 60.0
    # 4 ms of exponential jitter, cut at ten of them
    assert late_ms.mean() == pytest.approx(64.0, abs=5 * 4.0 / math.sqrt(len(late_ms)))
    assert late_ms.std() > 2.0
    assert late_ms.max() <= 100.0


def test_gnss_reports_the_antenna(drive):
    bench, frames = drive
    epochs = (column(frames["GNSS_TIME"], "TOW") - bench.scenario.start.gps_tow_s * 1_000_000) * 1000
    antenna = bench.trajectory.motion(epochs, np.array(bench.scenario.vehicle.antenna_m))
    n = len(frames["GNSS_ACC"])
    north = (np.radians(column(frames["GNSS_LAT"], "LAT"))[:n] - antenna.lat[:n]) * 6.37e6
    up = column(frames["GNSS_HEIGHT"], "HEIGHT")[:n] - antenna.height[:n]
    assert north.std() == pytest.approx(0.5, rel=5 / math.sqrt(2 * n))
    assert abs(north.mean()) < 5 * 0.5 / math.sqrt(n)
    assert abs(up.mean()) < 5 * 0.8 / math.sqrt(n)
    east = column(frames["GNSS_VEL"], "VEL_E")[:n] - antenna.v_g[:n, 0]
    assert east.std() == pytest.approx(0.03, rel=5 / math.sqrt(2 * n))
    assert set(column(frames["GNSS_HEIGHT"], "FIX_TYPE")) == {3}


def test_an_outage_says_no_fix():
    bench = Bench("drive", seed=1, seconds=20.0)
    bench.inject(GnssOutage(start_s=10.0, duration_s=5.0))
    frames = frames_of(bench)
    t_s = column(frames["GNSS_TIME"], "TOW") * 1e-6 - bench.scenario.start.gps_tow_s
    during = (t_s > 9.99) & (t_s < 14.99)
    fix = column(frames["GNSS_HEIGHT"], "FIX_TYPE")
    assert set(fix[during[: len(fix)]]) == {1}
    assert set(fix[~during[: len(fix)]]) == {3}
    valid = column(frames["GNSS_ACC"], "VEL_VALID")
    assert not valid[during[: len(valid)]].any()


def test_frames_come_in_time_order_whatever_the_steps():
    whole = [tuple(frame) for frame in Bench("drive", seed=2, seconds=6.0).due(6_000_000_000)]
    assert [frame[0] for frame in whole] == sorted(frame[0] for frame in whole)
    bench, parts = Bench("drive", seed=2, seconds=6.0), []
    rng = np.random.default_rng(0)
    now = 0
    while now < bench.end_ns:
        now = min(bench.end_ns, now + int(rng.integers(1, 40_000_000)))
        parts += [tuple(frame) for frame in bench.due(now)]
        assert bench.next_ns is None or bench.next_ns > now
    assert parts == whole


def test_start_moves_every_time():
    here, there = Bench("drive", seed=2, seconds=2.0), Bench("drive", seed=2, seconds=2.0, start_ns=10**12)
    for a, b in zip(here.due(here.end_ns), there.due(there.end_ns), strict=True):
        assert b == a._replace(t_ns=a.t_ns + 10**12)
    a, b = here.truth(1_500_000_000), there.truth(10**12 + 1_500_000_000)
    assert (a.lat, a.t_ns + 10**12) == (b.lat, b.t_ns)


def test_the_fd_variant_carries_the_same_pulses():
    classic = scenario.load("drive")
    fd = msgspec.structs.replace(classic, imu=msgspec.structs.replace(classic.imu, fd=True))
    a, b = frames_of(Bench(classic, seed=4, seconds=3.0)), frames_of(Bench(fd, seed=4, seconds=3.0))
    assert "IMU_GYRO" not in b
    n = len(a["IMU_TIME"])
    for axis in "XYZ":
        assert (column(a["IMU_GYRO"], f"GYRO_{axis}")[:n] == column(b["IMU_FD"], f"GYRO_{axis}")[:n]).all()
        assert (column(a["IMU_ACCEL"], f"ACCEL_{axis}")[:n] == column(b["IMU_FD"], f"ACCEL_{axis}")[:n]).all()
    assert (column(a["IMU_TIME"], "TIME")[:n] == column(b["IMU_FD"], "TIME")[:n] % 2**32).all()
    assert set(column(b["IMU_FD"], "SERIAL")) == set(column(a["IMU_STATUS"], "SERIAL"))


def test_another_device_changes_no_other():
    one = scenario.load("drive")
    two = msgspec.structs.replace(one, speed=SpeedTable())
    extra = contract()["SPEED"].frame_id
    a = list(Bench(one, seed=5, seconds=5.0).due(5_000_000_000))
    b = list(Bench(two, seed=5, seconds=5.0).due(5_000_000_000))
    speed = [frame for frame in b if frame.frame_id == extra]
    assert len(speed) in (49, 50)
    assert sorted(frame for frame in b if frame.frame_id != extra) == sorted(a)


def test_a_reset_device_starts_from_zero():
    bench = Bench("drive", seed=6, seconds=12.0)
    bench.inject(Reset(device="imu", start_s=4.0, duration_s=1.5))
    bench.inject(Reset(device="odometer", start_s=6.0, duration_s=1.0))
    frames = frames_of(bench)
    rows = frames["IMU_TIME"]
    t = np.array([row[0] for row in rows]) * 1e-9
    gap = int(np.argmax(np.diff(t)))
    # up to a period before and one after
    assert 1.5 <= np.diff(t)[gap] < 1.5 + 2 * 0.005 + 2e-4
    assert rows[gap + 1][1] == 0
    assert rows[gap + 1][2]["TIME"] == 5000
    assert rows[gap + 1][2]["SAMPLE"] == 1
    odo = frames["ODO"]
    gap = int(np.argmax(np.diff([row[0] for row in odo])))
    assert odo[gap + 1][1] == 0
    assert odo[gap + 1][2]["TICKS"] == 0
    assert odo[gap + 1][2]["TIME"] == 20_000


def test_one_seed_is_one_bench_in_every_process():
    code = (
        "from tests.virtual_bus.test_devices import digest; from virtual_bus.bus import Bench; "
        "print(digest(Bench('mems_drive', seed=11, seconds=8.0)))"
    )
    here = digest(Bench("mems_drive", seed=11, seconds=8.0))
    others = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": hash_seed},
            stdout=subprocess.PIPE,
            text=True,
        )
        for hash_seed in ("1", "2")
    ]
    for other in others:
        out, _ = other.communicate(timeout=60)
        assert (other.returncode, out.strip()) == (0, here)
    assert digest(Bench("mems_drive", seed=12, seconds=8.0)) != here
