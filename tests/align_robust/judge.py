"""How an alignment that something happened to ends."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from nav.align import ALIGNMENTS, advance, begin, result
from nav.rotation import dcm_from_quat, quat_from_dcm, rotvec_from_quat
from tests.align_robust.scenes import Scene

BOUND = 16.27  # chi-square of three degrees of freedom: 99.9 %


class End(NamedTuple):
    """What it said: refusals, and the normalised error squared of its answer, if it gave one."""

    refusals: tuple[str, ...]
    chi2: float | None
    phi: np.ndarray | None = None
    sigma: np.ndarray | None = None


def end_of(name: str, scene: Scene, most: int = 1000) -> End:
    """Feed a scene to an alignment till it answers or refused ``most`` times; it begins anew by itself."""
    run, refusals = begin(ALIGNMENTS[name], scene.config), []
    for sample in scene.samples:
        run, status = advance(run, sample)
        if status.refusal is not None:
            refusals.append(status.refusal)
            if len(refusals) == most:
                break
        if status.done:
            init = result(run)
            C = scene.C_gb(init.t_ns * 1e-9)
            phi = rotvec_from_quat(quat_from_dcm(C @ dcm_from_quat(init.q_gb).T))
            chi2 = float(phi @ np.linalg.solve(init.P_phi, phi))
            return End(tuple(refusals), chi2, phi, np.sqrt(np.diag(init.P_phi)))
    return End(tuple(refusals), None)


def is_right(end: End, words: str) -> bool:
    """Whether the answer, if any, is as good as it says, and refusals, if any, name the cause."""
    if end.chi2 is not None and not end.chi2 < BOUND:
        return False
    named = any(re.search(words, reason) for reason in end.refusals)
    return named if end.refusals else end.chi2 is not None
