"""The least error that any estimator can have in a transfer alignment: the Cramér-Rao bound of its model.

For a linear model with normal noise and priors the bound is the covariance of the filter that estimates every
state by every row, linearised where there is no error (Tichavsky, Muravchik and Nehorai, IEEE Transactions on
Signal Processing 46, 1998, 1386-1396). So it is the stage itself that runs, with all states to be
estimated, on samples without errors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig
from nav.transfer.correction import Use
from nav.transfer.matching import Matching, Uses
from nav.transfer.stage import Transfer
from nav.transfer.states import MOUNTING, SIZE
from nav.types import ImuSample, MasterState

Vector = NDArray[np.float64]
Times = NDArray[np.int64]


def whole(matching: Matching) -> Matching:
    """The matching that takes the same rows and estimates everything by them."""

    def all_matched(uses: Uses) -> Uses:
        east, north, up = (Use.MATCH if use is not Use.NOT else Use.NOT for use in uses)
        return east, north, up

    return replace(
        matching,
        # with the geometry, which is estimated by every matching that estimates
        estimated=tuple(range(MOUNTING.stop)),
        position=all_matched(matching.position),
        velocity=all_matched(matching.velocity),
        attitude=all_matched(matching.attitude),
        rate=all_matched(matching.rate),
    )


def bound(
    config: AlignConfig, matching: Matching, samples: Iterable[ImuSample | MasterState]
) -> tuple[Times, Vector]:
    """Times (n,), ten a second, and least standard deviations (n, SIZE) of the states there.

    ``samples`` in the order of arrival are those of the flight without errors, noise and flexure, the slave
    mounted as built; how large these would be is in ``config``. Position, velocity and phi are east, north,
    up, relative to the master.
    """
    state = Transfer(config, whole(matching))
    times, sigmas = [], []
    for sample in samples:
        if isinstance(sample, MasterState):
            state.message(sample)
            continue
        state.inertial(sample)
        said = state.status.transfer
        if said is not None:
            times.append(sample.t_ns)
            sigmas.append(np.sqrt(np.diag(said.relative)))
    return np.array(times, dtype=np.int64), np.array(sigmas).reshape(-1, SIZE)
