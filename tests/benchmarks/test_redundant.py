"""Six sensors of a kind cost at most three times what three do, parity tests included."""

from __future__ import annotations

from tests.benchmarks import redundant


def test_fusion_and_parity_test_cost_at_most_three_compensations() -> None:
    seconds = redundant.measure(rounds=7, samples=20_000)
    # one call a sample as a driver makes it, windows' ends included; 2.1 where nothing else runs
    assert seconds["six, called"] < 3.0 * seconds["three, called"]
    assert seconds["readable"] > 5.0 * seconds["six, called"]
