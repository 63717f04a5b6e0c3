"""The mounting of an IMU that nobody told and the alignment could not see: found on the first drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from nav.align.mounting import SLOWEST, Mounting, find_mounting
from nav.filter import states as st
from nav.filter.records import Filter
from nav.rotation import dcm_from_quat, quat_from_dcm
from nav.types import S, Vector

_COURSES: Final = 100  # ten seconds of driving
_SIGMA_HEADING: Final = math.radians(5.0)
_ENOUGH: Final = math.radians(3.0)
_SLOPE: Final = math.radians(2.0)  # of the ground on which the vehicle stood at first


class MountingSearch:
    """Gathers courses while the vehicle drives, until they say how the IMU sits in it."""

    def __init__(self) -> None:
        self._C_gb: list[Vector] = []
        self._v_g: list[Vector] = []
        self._rate_up: list[float] = []
        self._up_b: Vector | None = None

    def look(self, row: Vector) -> Mounting | None:
        """Take a solution row (S.SIZE,) made with v = b; returns the mounting once it is known."""
        C_gb = dcm_from_quat(row[S.Q])
        if self._up_b is None:
            self._up_b = C_gb[2]
        v_g = row[S.V]
        if math.hypot(v_g[0], v_g[1]) < SLOWEST or row[24] > _SIGMA_HEADING:
            return None
        self._C_gb.append(C_gb)
        self._v_g.append(v_g)
        self._rate_up.append(float(C_gb[2] @ row[S.W]))
        if len(self._v_g) < _COURSES:
            return None
        found = find_mounting(
            np.array(self._C_gb),
            np.array(self._v_g),
            np.array(self._rate_up),
            self._up_b,
            _SLOPE,
            float(np.max(row[S.SIGMA_V])),
            float(row[24]),
        )
        # the newest minute is enough, and bounds the work
        for kept in (self._C_gb, self._v_g, self._rate_up):
            del kept[: max(0, len(kept) - 600)]
        return found if found is not None and max(found.sigma[0], found.sigma[2]) < _ENOUGH else None


def settle(mounting: Mounting) -> Callable[[Filter], None]:
    """The action that gives a filter its mounting."""

    def action(f: Filter) -> None:
        f.x[st.X_QV : st.X_QV + 4] = quat_from_dcm(mounting.C_vb)
        f.x[st.X_Q0 : st.X_Q0 + 4] = f.x[st.X_QV : st.X_QV + 4]
        f.x[st.X_ROLL] += mounting.sigma[1] ** 2
        f.P[st.MOUNTING, :] = 0.0
        f.P[:, st.MOUNTING] = 0.0
        f.P[st.MOUNTING, st.MOUNTING] = np.diag(mounting.sigma[[0, 2]] ** 2)

    return action
