"""The benchmark of alignments runs; its numbers are for the command."""

from tests.benchmarks import alignments


def test_a_method_is_timed_beside_the_kernel():
    kernel, found = alignments.measure(("static",), rounds=2, seconds=20.0)
    each, dearest = found["static"]
    # a compiled loop against a call of Python for every sample
    assert each > kernel > 0.0
    # a second of 200 samples is dearer than their mean
    assert dearest > 200 * 0.5 * each
