"""Faults of frames: each changes what it says and nothing else."""

from __future__ import annotations

from collections import Counter

import pytest

from dbc.codec import contract
from virtual_bus.bus import Bench
from virtual_bus.faults import (
    Corrupt,
    Delay,
    Drop,
    Duplicate,
    Flood,
    FreezeCounter,
    SkipCounter,
    Truncate,
)

ODO = contract()["ODO"]
SECONDS = 6.0


def frames(*faults, frame_id=ODO.frame_id):
    bench = Bench("drive", seed=1, seconds=SECONDS)
    for fault in faults:
        bench.inject(fault)
    out = list(bench.due(bench.end_ns))
    assert [f.t_ns for f in out] == sorted(f.t_ns for f in out)
    return [f for f in out if f.frame_id == frame_id], out


def during(frame, start_s=2.0, seconds=2.0):
    return start_s * 1e9 <= frame.t_ns < (start_s + seconds) * 1e9


@pytest.fixture(scope="module")
def clean():
    return frames()


def others(pair):
    return [f for f in pair[1] if f.frame_id != ODO.frame_id]


def test_drop(clean):
    got = frames(Drop(device="odometer", start_s=2.0, duration_s=2.0))
    assert got[0] == [f for f in clean[0] if not during(f)]
    assert others(got) == others(clean)


def test_drop_some(clean):
    got = frames(Drop(device="odometer", start_s=0.0, duration_s=SECONDS, probability=0.3))[0]
    n = len(clean[0])
    assert len(got) == pytest.approx(0.7 * n, abs=5 * (0.3 * 0.7 * n) ** 0.5)


def test_drop_in_bursts(clean):
    got = frames(Drop(device="odometer", start_s=2.0, duration_s=2.0, probability=0.02, burst=5))[0]
    kept = {f.t_ns for f in got}
    runs, run = [], 0
    for f in clean[0]:
        if f.t_ns in kept:
            if run:
                runs.append(run)
            run = 0
        else:
            run += 1
    assert runs
    assert all(run >= 5 for run in runs)


def test_duplicate(clean):
    got = frames(Duplicate(device="odometer", start_s=2.0, duration_s=2.0))[0]
    counts = Counter(got)
    assert set(counts) == set(clean[0])
    assert all(counts[f] == (2 if during(f) else 1) for f in clean[0])


def test_corrupt_breaks_the_crc(clean):
    got = frames(Corrupt(device="odometer", start_s=2.0, duration_s=2.0))[0]
    for a, b in zip(clean[0], got, strict=True):
        assert ODO.crc_ok(b.data) != during(b)
        assert sum(x != y for x, y in zip(a.data, b.data, strict=True)) == (1 if during(b) else 0)


def test_truncate(clean):
    got = frames(Truncate(device="odometer", start_s=2.0, duration_s=2.0))[0]
    assert [len(f.data) for f in got] == [7 if during(f) else 8 for f in clean[0]]


def test_delay_lets_others_overtake(clean):
    got = frames(Delay(device="odometer", start_s=2.0, duration_s=2.0, delay_ms=50.0))[0]
    expected = [f._replace(t_ns=f.t_ns + 50_000_000) if during(f) else f for f in clean[0]]
    assert sorted(got) == sorted(expected)
    assert [ODO.alive(f.data) for f in got] != [ODO.alive(f.data) for f in clean[0]]


def test_freeze_counter():
    got = frames(FreezeCounter(device="odometer", start_s=2.0, duration_s=2.0))[0]
    assert all(ODO.crc_ok(f.data) for f in got)
    # the counter belongs to the sample, taken 0.4 ms before the frame
    assert len({ODO.alive(f.data) for f in got if during(f, 2.001, 1.998)}) == 1
    assert len({ODO.alive(f.data) for f in got if not during(f)}) == 15


def test_skip_counter():
    got = frames(SkipCounter(device="odometer", start_s=2.0, duration_s=2.0, step=3))[0]
    alive = [ODO.alive(f.data) for f in got]
    steps = Counter(
        (b - a) % 15 for a, b, f in zip(alive, alive[1:], got[1:], strict=False) if during(f, 2.001, 1.998)
    )
    assert set(steps) == {4}
    assert all(ODO.crc_ok(f.data) for f in got)


def test_one_identifier_of_a_device(clean):
    gyro, accel = contract()["IMU_GYRO"].frame_id, contract()["IMU_ACCEL"].frame_id
    got = frames(Drop(device="imu", frame_id=gyro, start_s=2.0, duration_s=2.0))[1]
    count = Counter(f.frame_id for f in got)
    full = Counter(f.frame_id for f in clean[1])
    assert full[gyro] - count[gyro] == pytest.approx(400, abs=1)
    assert count[accel] == full[accel]


def test_flood(clean):
    flooded, everything = frames(
        Flood(frame_id=0x555, start_s=2.0, duration_s=2.0, rate_hz=1000.0), frame_id=0x555
    )
    assert len(flooded) == 2000
    assert all(during(f) for f in flooded)
    assert [f for f in everything if f.frame_id != 0x555] == clean[1]


def test_an_impossible_interval_is_refused():
    with pytest.raises(ValueError, match="positive duration"):
        Drop(device="imu", start_s=1.0, duration_s=0.0)
