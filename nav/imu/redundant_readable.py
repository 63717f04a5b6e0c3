"""The readable twin of `nav.imu.redundant_kernel`: fusion, tests and isolation from their definitions."""

from __future__ import annotations

import math

import numpy as np

from nav.imu.many import along
from nav.imu.redundant import Redundant
from nav.imu.redundant_kernel import DETECTED, EXCLUDED, READMITTED
from nav.types import Vector


class Readable:
    """The twin of `quick` and `fuse`: the same from definitions, for the unit of ``of``."""

    def __init__(self, of: Redundant) -> None:
        self.of, n = of, len(of.sigma)
        self.longest = int(of.tables.lengths[-1])
        self.active, self.suspects = list(range(n)), list[int]()
        self.part: list[tuple[Vector, float]] = []
        self.parts: list[tuple[Vector, float]] = []
        self.kept, self.turn = 0, 0
        self.agreed, self.present, self.test = np.zeros(n, int), np.full(n, self.longest), np.zeros(n, int)
        self.missing, self.alarm = set[int](), False

    def _spans(self, active: list[int]) -> bool:
        return bool(self.of.tables.sets.spans[sum(1 << k for k in active)])

    def _solve(self, z: Vector, active: list[int]) -> tuple[Vector, Vector]:
        """x (3,) and its cofactor (3, 3) by weighted least squares, NaN where there is none."""
        H = self.of.tables.axes[active] / self.of.sigma[active, None]
        if not self._spans(active):
            return np.full(3, math.nan), np.full((3, 3), math.nan)
        x = np.linalg.lstsq(H, z[active] / self.of.sigma[active])[0]
        return np.asarray(x, dtype=np.float64), np.asarray(np.linalg.inv(H.T @ H), dtype=np.float64)

    def _shares(self, z: Vector, active: list[int], variance: float) -> tuple[float, dict[int, float]]:
        """Of the squared residuals in variances: all, and what each sensor explains."""
        H = self.of.tables.axes[active] / self.of.sigma[active, None]
        residual = z[active] / self.of.sigma[active] - H @ self._solve(z, active)[0]
        told = np.diag(np.eye(len(H)) - H @ np.linalg.inv(H.T @ H) @ H.T)
        watched = told > 1e-9
        share = np.where(watched, residual**2 / np.where(watched, told, 1.0), 0.0) / variance
        return float(residual @ residual) / variance, dict(zip(active, share.tolist(), strict=True))

    def _likely(self, share: dict[int, float]) -> list[int]:
        limit = max(share.values()) + 2.0 * math.log(self.of.monitor.isolation)
        return [k for k, part in share.items() if part > limit]

    def _agrees(self, k: int, z: Vector, active: list[int], variance: float) -> bool:
        x, cofactor = self._solve(z, active)
        h = self.of.tables.axes[k]
        wide = math.sqrt(variance * (self.of.sigma[k] ** 2 + h @ cofactor @ h))
        return bool(abs(z[k] - h @ x) <= self.of.monitor.near * wide)

    def _wronged(self, window: int, z: Vector, variance: float) -> tuple[int, int] | None:
        """The sensor that has to go and the one that comes back for it."""
        of = self.of
        limit = of.tables.limits[window, len(self.active) - 3]
        there = of.tables.lengths[window - 1] if window else 0
        for a in set(range(len(z))) - set(self.active) - self.missing:
            if self.present[a] < there or self.test[a] > window:
                continue
            everybody, share = self._shares(z, sorted([*self.active, a]), variance)
            likely = self._likely(share)
            if len(likely) != 1 or likely == [a]:
                continue
            rest = [k for k in self.active if k != likely[0]]
            left = everybody - share[likely[0]]
            if self._spans(rest) and left <= limit and self._agrees(a, z, rest, variance):
                return likely[0], a
        return None

    def _test(self, window: int, z: Vector, seconds: float) -> tuple[int, int | None] | None:
        """The sensor that has to go, and one that comes back for it; sets `suspects` and `alarm`."""
        of = self.of
        x = self._solve(z, self.active)[0]
        freedom = len(self.active) - 3
        if np.isnan(x).any() or freedom == 0:
            return None
        variance = of.noise.variance(seconds, float(np.linalg.norm(x)))
        square, share = self._shares(z, self.active, variance)
        if square <= of.tables.limits[window, freedom]:
            return None
        self.alarm = True
        if (wronged := self._wronged(window, z, variance)) is not None:
            return wronged
        near = self._likely(share)
        known = [k for k in near if k in self.suspects]
        told = len(near) == 1 and self._spans([k for k in self.active if k not in near])
        if told and (known or not self.suspects):
            return near[0], None
        self.suspects = known or sorted({*near, *self.suspects})
        return None

    def _exclude(self, k: int, window: int, back: int | None = None) -> Vector:
        kept = self.parts[len(self.parts) - self.kept :]
        total = sum((z for z, _ in (*kept, *self.part)), np.zeros(len(self.of.sigma)))
        old = self._solve(total, self.active)[0]
        self.active = sorted({*self.active, *([] if back is None else [back])} - {k})
        self.agreed[k], self.test[k] = 0, window
        return np.asarray(np.nan_to_num(self._solve(total, self.active)[0] - old))

    def sample(self, counts: Vector, tau: float, dv: Vector) -> tuple[Vector, Vector, int]:
        """Fused sample (3,), what is owed (3,), status."""
        of = self.of
        z = along(of.sensors, counts, tau, dv)
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
                found |= EXCLUDED if worst[1] is None else EXCLUDED | READMITTED
                self.suspects = []
                owed = owed + self._exclude(worst[0], window, worst[1])

        for k in np.flatnonzero(np.isnan(z)):
            self.missing.add(int(k))
            if k in self.active:
                status |= EXCLUDED
                owed = owed + self._exclude(int(k), 0)
        z = np.nan_to_num(z)
        status |= settle(0, z, tau)
        x = self._solve(z, self.active)[0]
        self.part.append((z, tau))
        if len(self.part) < of.tables.samples:
            return x, owed, status
        self.present += 1
        self.present[sorted(self.missing)] = 0
        self.missing = set()
        everything = [*self.parts, _sum(self.part)]
        for window, length in enumerate(of.tables.lengths.tolist(), 1):
            if len(everything) >= length:
                status |= settle(window, *_sum(everything[-length:]))
        self.parts, self.part = everything[1 - self.longest :] if self.longest > 1 else [], []
        self.kept, self.turn = min(self.kept + 1, self.longest - 1), self.turn + 1
        if self.turn == self.longest:
            self.turn = 0
            status |= self._readmit(*_sum(everything[-self.longest :]))
            self.suspects = self.suspects if self.alarm else []
            self.alarm = False
        return x, owed, status

    def _readmit(self, z: Vector, seconds: float) -> int:
        of, back, blind = self.of, list[int](), not self._spans(self.active)
        variance = of.noise.variance(seconds, float(np.linalg.norm(self._solve(z, self.active)[0])))
        for k in set(range(len(z))) - set(self.active):
            here = bool(self.present[k] >= self.longest)
            agrees = here and not blind and self._agrees(k, z, self.active, variance)
            self.agreed[k] = self.agreed[k] + 1 if agrees else 0
            if self.agreed[k] >= of.monitor.agreements or (here and blind):
                back.append(k)
        self.active = sorted({*self.active, *back})
        self.kept = 0 if back else self.kept
        return READMITTED if back else 0


def _sum(parts: list[tuple[Vector, float]]) -> tuple[Vector, float]:
    return np.sum([z for z, _ in parts], axis=0), float(sum(seconds for _, seconds in parts))
