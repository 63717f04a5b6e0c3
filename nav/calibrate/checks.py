"""Whether the table stood where the plan has it, from what the fit leaves over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular

from nav.calibrate.intervals import Interval
from nav.calibrate.solve import Fit, Noise, prior_rows
from nav.types import Vector

_LARGE: Final = 17.0
"""Of the F ratio: chance gives this once in a million tries with 3 and 30 degrees of freedom."""
_ALIKE: Final = 9.0
"""Explanations whose squares differ by less than this, in units of what is left, cannot be told apart."""
_ARCSEC: Final = np.pi / 648000.0


def moved(fit: Fit, intervals: Sequence[Interval], noise: Noise) -> str | None:
    """Says where the table was moved or stood wrong, if that explains the residuals; None if it was not.

    For every interval, three small angles of the table from there on, and in that interval alone, are put
    beside the other unknowns. The best of these is believed when it takes away far more of the squared
    residuals than chance could.
    """
    rows, slopes, left, owners = [], [], [], []
    held = prior_rows(fit.model)
    shown = [fit.model.shown(one, fit.theta) for one in intervals]
    roots = []
    for place, one in enumerate(fit.model.sensors):
        used = fit.model.used(one, intervals)
        chosen = [intervals[k] for k in used]
        _, jacobian = fit.model.rows(place, chosen, [shown[k] for k in used], fit.theta)
        root = np.linalg.cholesky(noise.covariance(one, chosen))
        rows.append(solve_triangular(root, jacobian, lower=True))
        slopes.append(jacobian[:, -4:-1])
        left.append(fit.residuals[place].white)
        owners.append(np.array(used))
        roots.append(root)
    design = np.concatenate([*rows, held])
    Q = np.linalg.qr(design / np.linalg.norm(design, axis=0))[0]
    r = np.concatenate([*left, held @ fit.theta])

    total = float(r @ r)

    def gained(inside: Vector) -> tuple[float, Vector]:
        """What angles of the table in the intervals (k,) ``inside`` take off the squares; and they, (3,)."""
        parts = [
            solve_triangular(root, slope * inside[owner][:, None], lower=True)
            for root, slope, owner in zip(roots, slopes, owners, strict=True)
        ]
        A = np.concatenate([*parts, np.zeros((4, 3))])
        A = A - Q @ (Q.T @ A)
        # what cannot be told from the other unknowns takes nothing away
        angle = -np.linalg.lstsq(A, r, rcond=1e-6)[0]
        return total - float((r + A @ angle) @ (r + A @ angle)), angle

    found = []
    order = np.arange(len(intervals))
    for k, interval in enumerate(intervals):
        if k:
            found.append(
                (*gained((order >= k).astype(np.float64)), f"the table was moved before {interval.name}")
            )
        text = f"the table does not stand in {interval.name} where the plan has it"
        found.append((*gained((order == k).astype(np.float64)), text))
    found.sort(key=lambda one: -one[0])
    gain, angle, text = found[0]
    rest = max(total - gain, 1e-12) / max(fit.freedom - 3, 1)
    if gain / 3.0 < _LARGE * rest:
        return None
    said = f"{text}: by {_angles(angle)} arcsec about east, north, up"
    others = [text for less, _, text in found[1:] if gain - less < _ALIKE * rest]
    return "; or as likely, ".join([said, *others])


def _angles(angle: Vector) -> str:
    return str([round(value / _ARCSEC) for value in angle.tolist()])
