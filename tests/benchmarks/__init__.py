"""Benchmarks as ratios within one run: run one with ``python -m tests.benchmarks.NAME``."""
