"""Clocks: real, scaled and simulated, and stamps across a step of the wall clock."""

import os
import time

import pytest

from bridge.clock import HostClock, SimulatedClock, WallClock
from tests.bridge.fakes import SteppableClock

MS = 1_000_000


def test_simulated_time_moves_by_waiting_alone() -> None:
    clock = SimulatedClock(utc_ns=5_000, monotonic_ns=1_000)
    time.sleep(0.002)
    assert (clock.monotonic_ns(), clock.utc_ns()) == (1_000, 5_000)
    clock.wait_until(10_000)
    clock.wait_until(4_000)
    assert (clock.monotonic_ns(), clock.utc_ns()) == (10_000, 14_000)


def test_waiting_ends_at_input() -> None:
    reading, writing = os.pipe()
    try:
        os.write(writing, b"x")
        started = time.monotonic_ns()
        HostClock().wait_until(started + 5_000 * MS, [reading])
        assert time.monotonic_ns() - started < 1_000 * MS
    finally:
        os.close(reading)
        os.close(writing)


def test_waiting_for_the_past_returns() -> None:
    HostClock().wait_until(0)
    HostClock().wait_until(0, [])


def test_a_kernel_stamp_becomes_monotonic() -> None:
    clock = HostClock()
    wall = WallClock(clock)
    before = clock.monotonic_ns()
    stamp = clock.utc_ns()
    now = clock.monotonic_ns()
    # the offset is known to the two readings' distance, bounded here by 5 ms on a busy machine
    assert wall.to_monotonic(stamp, before - 5 * MS, now + 5 * MS) == pytest.approx(before, abs=5 * MS)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.5, -0.01])
def test_a_step_of_the_wall_clock_is_noticed_once(step_s: float) -> None:
    clock = SteppableClock()
    wall = WallClock(clock)
    assert wall.update() == 0
    clock.step_ns = round(step_s * 1e9)
    assert wall.update() == pytest.approx(step_s * 1e9, abs=5 * MS)
    assert wall.update() == 0


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.5, -0.5])
def test_stamps_from_both_sides_of_a_step_stay_in_place(step_s: float) -> None:
    clock = SteppableClock()
    wall = WallClock(clock)
    first, t0 = clock.utc_ns(), clock.monotonic_ns()
    clock.step_ns = round(step_s * 1e9)
    second, t1 = clock.utc_ns(), clock.monotonic_ns()
    wall.update()
    now = clock.monotonic_ns() + MS
    for stamp, truth in ((first, t0), (second, t1)):
        assert wall.to_monotonic(stamp, t0 - 10 * MS, now) == pytest.approx(truth, abs=5 * MS)


def test_a_stamp_without_sense_counts_as_now() -> None:
    wall = WallClock(HostClock())
    assert wall.to_monotonic(0, 100, 200) == 200


def test_a_simulated_clock_has_no_kernel_stamps() -> None:
    wall = WallClock(SimulatedClock(utc_ns=0))
    assert wall.update() == 0
    assert wall.to_monotonic(5, 0, 77) == 77
