"""The benchmarks run and measure what they say; their numbers are for the commands, not for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import kernels, latency, replay, strapdown


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


@pytest.mark.parametrize("n", range(1, 7))
def test_the_update_in_c_is_the_kernels(tmp_path: Path, n: int) -> None:
    if strapdown.compiler() is None:
        pytest.skip("no C compiler here: neither CC is set nor is there a cc")
    samples = strapdown.drive(600)
    a, b = strapdown.start(), strapdown.start()
    strapdown.compiled(tmp_path)(a, samples, n)
    strapdown.run_kernel(b, samples, n)
    # the same operations in the same order; sums of products may be grouped differently by a compiler
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_the_update_is_timed_beside_its_twins() -> None:
    found = strapdown.measure(rounds=3, updates=200, sizes=(1, 2))
    assert set(found) == {1, 2}
    for kernel, _, readable in found.values():
        assert readable > 5.0 * kernel
