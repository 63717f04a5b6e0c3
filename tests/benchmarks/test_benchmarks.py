"""The benchmarks run and measure what they say; their numbers are for the commands, not for tests."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks import kernels, latency, replay


def test_the_kernels_beat_their_readable_twin() -> None:
    seconds = kernels.measure(rounds=3, samples=2000)
    assert set(seconds) == {"kernel", "dense", "unrolled", "readable"}
    # hundreds of times in truth; a test must not fail for a busy machine
    assert seconds["readable"] > 5.0 * seconds["kernel"]


def test_every_solution_is_measured_beside_its_echo(tmp_path: Path) -> None:
    # still aligning: the answers are shorter and ten a second
    bridge, echo = latency.measure(tmp_path, seconds=20.0, smallest=2)
    assert len(bridge) == len(echo) > 10
    assert (bridge > 0).all()
    assert (echo > 0).all()


def test_a_replay_is_timed(tmp_path: Path) -> None:
    ((report, busy),) = replay.measure(tmp_path, seconds=5.0, rounds=1)
    assert report.agrees
    assert busy > 0.0
    assert report.seconds > 4.0
