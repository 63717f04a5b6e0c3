"""The readable twin of `nav.imu.redundant_kernel`: fusion, tests and isolation from their definitions."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from nav.imu.many import along
from nav.imu.redundant import Redundant
from nav.imu.redundant_kernel import DETECTED, EXCLUDED, READMITTED
from nav.types import Vector


class Readable:
    """The twin of `quick` and `fuse`: the same from definitions, for the unit of ``of``."""

    def __init__(self, of: Redundant) -> None:
        self.of, n = of, len(of.sigma)
        self.active, self.suspects = list(range(n)), list[int]()
        self.windows: list[list[tuple[Vector, float]]] = [[] for _ in of.monitor.windows]
        self.before, self.agreed = np.zeros(n), np.zeros(n, int)
        self.missing, self.alarm = set[int](), False

    def _solve(self, z: Vector, active: list[int]) -> tuple[Vector, Vector]:
        """x (3,) and its cofactor (3, 3) by weighted least squares, NaN where there is none."""
        H = self.of.tables.axes[active] / self.of.sigma[active, None]
        if not self.of.tables.sets.spans[sum(1 << k for k in active)]:
            return np.full(3, math.nan), np.full((3, 3), math.nan)
        x = np.linalg.lstsq(H, z[active] / self.of.sigma[active])[0]
        return np.asarray(x, dtype=np.float64), np.asarray(np.linalg.inv(H.T @ H), dtype=np.float64)

    def _test(self, window: int, z: Vector, seconds: float) -> int | None:
        """The sensor that has to go; sets `suspects` and `alarm`."""
        of = self.of
        x = self._solve(z, self.active)[0]
        freedom = len(self.active) - 3
        if np.isnan(x).any() or freedom == 0:
            return None
        H = of.tables.axes[self.active] / of.sigma[self.active, None]
        residual = z[self.active] / of.sigma[self.active] - H @ x
        S = np.eye(len(H)) - H @ np.linalg.inv(H.T @ H) @ H.T
        variance = of.noise.variance(seconds, float(np.linalg.norm(x)))
        if residual @ residual <= stats.chi2.isf(of.chances[window], freedom) * variance:
            return None
        self.alarm = True
        watched = np.diag(S) > 1e-9
        share = np.where(watched, residual**2 / np.where(watched, np.diag(S), 1.0), 0.0) / variance
        limit = share.max() + 2.0 * math.log(of.monitor.isolation)
        near = [k for k, part in zip(self.active, share, strict=True) if part > limit]
        rest = [k for k in self.active if k not in near]
        known = [k for k in near if k in self.suspects]
        told = len(near) == 1 and not np.isnan(self._solve(z, rest)[0]).any()
        if told and (known or not self.suspects):
            return near[0]
        self.suspects = known or sorted({*near, *self.suspects})
        return None

    def _exclude(self, k: int) -> Vector:
        total = self.before + sum(
            (z for window in self.windows for z, _ in window), np.zeros(len(self.before))
        )
        old = self._solve(total, self.active)[0]
        self.active = [j for j in self.active if j != k]
        self.agreed[k] = 0
        return np.asarray(np.nan_to_num(self._solve(total, self.active)[0] - old))

    def sample(self, counts: Vector, tau: float, dv: Vector) -> tuple[Vector, Vector, int]:
        """Fused sample (3,), what is owed (3,), status."""
        z = along(self.of.sensors, counts, tau, dv)
        owed, status = np.zeros(3), 0

        def settle(window: int, z: Vector, seconds: float) -> int:
            nonlocal owed
            found = 0
            while True:
                self.alarm, before = False, self.alarm
                worst = self._test(window, z, seconds)
                found |= DETECTED if self.alarm else 0
                self.alarm |= before
                if worst is None:
                    return found
                found |= EXCLUDED
                self.suspects = []
                owed = owed + self._exclude(worst)

        for k in np.flatnonzero(np.isnan(z)):
            self.missing.add(int(k))
            if k in self.active:
                status |= EXCLUDED
                owed = owed + self._exclude(int(k))
        z = np.nan_to_num(z)
        status |= settle(0, z, tau)
        x = self._solve(z, self.active)[0]
        self.windows[0].append((z, tau))
        for window, length in enumerate(self.of.tables.lengths):
            if len(self.windows[window]) < length:
                return x, owed, status
            parts = self.windows[window]
            whole = (np.sum([z for z, _ in parts], axis=0), float(sum(t for _, t in parts)))
            status |= settle(window + 1, *whole)
            if window + 1 < len(self.windows):
                self.windows[window] = []
                self.windows[window + 1].append(whole)
        status |= self._readmit(*whole)
        self.windows[-1] = []
        self.suspects = self.suspects if self.alarm else []
        self.alarm, self.missing = False, set()
        return x, owed, status

    def _readmit(self, z: Vector, seconds: float) -> int:
        of, back = self.of, list[int]()
        x, cofactor = self._solve(z, self.active)
        blind = bool(np.isnan(x).any())
        variance = of.noise.variance(seconds, float(np.linalg.norm(x)))
        for k in set(range(len(z))) - set(self.active):
            h, here = of.tables.axes[k], k not in self.missing
            wide = (
                math.sqrt(variance * (of.sigma[k] ** 2 + h @ cofactor @ h))
                if np.isfinite(cofactor).all()
                else 0.0
            )
            self.agreed[k] = self.agreed[k] + 1 if here and abs(z[k] - h @ x) <= of.monitor.near * wide else 0
            if self.agreed[k] >= of.monitor.agreements or (here and blind):
                back.append(k)
        self.active = sorted({*self.active, *back})
        self.before = np.zeros(len(z)) if back else z
        return READMITTED if back else 0
