"""Campaigns: the same scenario with many seeds, in worker processes, and what follows from all of them.

The seeds are ``seed_base``, ``seed_base + 1``, ... and every one counts; none is left out or chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from bridge.errors import ConfigError
from bridge.studies.consistency import Alignment, Consistency, alignment, consistency
from bridge.studies.headless import Sampled, fly, load, navigator_of
from bridge.studies.workers import Progress, each
from nav.align.static import limits
from nav.filter.settings import align_config
from virtual_bus.scenario import Scenario

EPOCHS: Final = 12
_START_S: Final = 5.0  # of navigation before the first epoch
_END_S: Final = 2.0
STATIC_SCENARIO: Final = "static_rlg"


def epochs(what: Scenario, seconds: float | None = None, count: int = EPOCHS) -> list[float]:
    """``count`` instants (s), equally spaced from the end of the alignment or of the rest to the run's end.

    Raises:
        ConfigError: the run is too short for them.
    """
    aligned = what.rest_s() if what.navigator.alignment_s is None else what.navigator.alignment_s
    first, last = aligned + _START_S, (seconds or what.seconds()) - _END_S
    least = first + count + _END_S
    if last + _END_S < least:
        raise ConfigError(f"--seconds: found {last + _END_S:g}, expected {least:g} or more for this scenario")
    return [float(t) for t in np.linspace(first, last, count)]


def run_consistency(
    scenario: str,
    runs: int,
    *,
    seconds: float | None = None,
    seed_base: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Consistency:
    """Errors against covariances at fixed epochs of ``runs`` runs.

    Raises:
        ConfigError: there is no such scenario, or it is too short.
        RunError: a run did not navigate to its end.
    """
    what = load(scenario)
    instants = epochs(what, seconds)
    flown = _fly_all(what, runs, seconds, instants, seed_base, jobs, progress)
    return consistency(
        np.array(instants), np.array([f.error for f in flown]), np.array([f.covariance for f in flown])
    )


def run_static(
    scenario: str = STATIC_SCENARIO,
    runs: int = 100,
    *,
    seed_base: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Alignment:
    """Attitude when a static alignment hands over, against its limit.

    Raises:
        ConfigError: there is no such scenario, or it does not align at rest.
        RunError: an alignment did not end.
    """
    what = load(scenario)
    config = navigator_of(what)
    if config.alignment != "static":
        raise ConfigError(f"{scenario}: navigator.alignment: found {config.alignment}, expected static")
    flown = _fly_all(what, runs, None, [0.0], seed_base, jobs, progress)
    align = align_config(config)
    limit = limits(align, flown[0].lat, flown[0].height, align.coarse_s + align.fine_s)
    return alignment(
        np.array([f.error[0, 6:9] for f in flown]),
        np.array([f.covariance[0, 6:9, 6:9] for f in flown]),
        limit,
    )


def _fly_all(
    what: Scenario,
    runs: int,
    seconds: float | None,
    instants: Sequence[float],
    seed_base: int,
    jobs: int,
    progress: Progress | None,
) -> list[Sampled]:
    one = partial(_fly_one, what, seconds, tuple(instants))
    seeds = range(seed_base, seed_base + runs)
    flown: dict[int, Sampled] = {}
    for sampled in each(one, seeds, jobs):
        flown[sampled.seed] = sampled
        if progress is not None:
            progress(len(flown), runs)
    return [flown[seed] for seed in seeds]


def _fly_one(what: Scenario, seconds: float | None, instants: tuple[float, ...], seed: int) -> Sampled:
    return fly(what, seed, seconds, instants)
