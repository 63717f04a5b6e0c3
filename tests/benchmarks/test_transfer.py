"""The benchmark of transfer alignments runs; its numbers are for the command."""

from bridge.studies.transfer_runs import Trial
from tests.benchmarks import transfer

BRIEF = Trial("straight", 2.0)


def test_a_matching_is_timed_beside_the_kernel() -> None:
    kernel, found = transfer.measure(("velocity_attitude",), rounds=1, trial=BRIEF)
    each, message = found["velocity_attitude"]
    # a compiled loop against a call of Python for every sample
    assert each > kernel > 0.0
    # eight samples to a message: what it costs is in theirs
    assert message < 2.0 * 8.0 * each


def test_every_frame_of_the_hardest_case_is_timed() -> None:
    spent = transfer.frames("velocity_attitude", BRIEF)
    # half a second more is flown; 200 samples and 25 messages a second, and those at both ends
    assert abs(len(spent) - 2.5 * 225) <= 2
    assert spent.min() >= 0.0
    assert spent.sum() > 0.0
