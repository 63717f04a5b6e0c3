"""The slave's own navigation: kept samples, the state at the master's last epoch, and the live one.

The filter's state stands at an *anchor*, the time of the master's last message in use. Samples since then
are kept, so that a message that comes late is used at its own time: the state goes from the anchor to it with
its covariance, is corrected, and runs on to the newest sample by strapdown alone. Where nothing comes the
anchor follows at a fixed distance, so that the work of one call stays bounded.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig, TransferConfig
from nav.strapdown.kernels import X_V
from nav.transfer.kernels import S_DT, S_SIZE, run
from nav.transfer.model import Instant, bent, dynamics, place, predict
from nav.transfer.states import GYRO_AXES, GYRO_BIAS
from nav.types import ImuSample

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SEGMENT_NS: Final = 25_000_000
"""Longest step of the covariance: attitude turns little in it."""
RATE_S: Final = 0.005  # over which the rate at an instant is taken
CHANGE_S: Final = 0.02  # over which its change is
_MARGIN_NS: Final = 150_000_000  # kept behind the anchor for that
_BLOCK: Final = 4096


class Slave:
    """Samples, the state ``x`` (X_SIZE,) and covariance ``P`` at ``anchor_ns``, and the ``live`` state."""

    def __init__(self, config: AlignConfig, transfer: TransferConfig) -> None:
        self._config, self._transfer = config, transfer
        self._t = np.empty(_BLOCK, dtype=np.int64)
        self._rows = np.empty((_BLOCK, 7))
        self._first = self._count = 0
        self._index, self._share = 0, 0.0  # the anchor: this sample, and how much of it is used
        self.anchor_ns = 0
        self.x: Vector = np.empty(0)
        self.P: Matrix = np.empty((0, 0))
        self.live: Vector = np.empty(0)
        self._sums = np.zeros(S_SIZE)
        self._live_sums = np.zeros(S_SIZE)
        self._a_n = np.zeros(3)

    @property
    def newest_ns(self) -> int:
        """Time of the last sample."""
        return int(self._t[self._count - 1]) if self._count else -(2**62)

    @property
    def started(self) -> bool:
        """Whether there is a state."""
        return self.x.size > 0

    def add(self, s: ImuSample) -> None:
        """Take a sample; the live state goes along."""
        if self._count == len(self._t):
            self._compact()
        k = self._count
        self._t[k] = s.t_ns
        row = self._rows[k]
        row[0] = s.dt
        row[1:4] = s.dtheta
        row[4:7] = s.dv
        self._count = k + 1
        if self.started:
            self._live_sums[:] = 0.0
            run(self.live, self._rows, k, 0.0, k, 1.0, self._live_sums)
            oldest = s.t_ns - round(self._transfer.latest_s * 1e9)
            if self.anchor_ns < oldest - SEGMENT_NS:
                self.advance(oldest)

    def _compact(self) -> None:
        """Drop what is no longer needed; make more room where that is not enough."""
        keep = self._t[self._count - 1] - round(self._transfer.latest_s * 1e9) - _MARGIN_NS
        low = int(np.searchsorted(self._t[: self._count], keep))
        low = min(low, self._index) if self.started else low
        n = self._count - low
        size = len(self._t) if 2 * n <= len(self._t) else 2 * len(self._t)
        t, rows = np.empty(size, dtype=np.int64), np.empty((size, 7))
        t[:n], rows[:n] = self._t[low : self._count], self._rows[low : self._count]
        self._t, self._rows = t, rows
        self._index, self._count, self._first = self._index - low, n, max(0, self._first - low)

    def _find(self, t_ns: int) -> tuple[int, float]:
        """The sample in which ``t_ns`` lies, and the share of it that is over by then."""
        k = int(np.searchsorted(self._t[: self._count], t_ns))
        k = min(k, self._count - 1)
        share = 1.0 - (int(self._t[k]) - t_ns) * 1e-9 / float(self._rows[k, 0])
        return k, min(1.0, max(0.0, share))

    def covers(self, t_ns: int) -> bool:
        """Whether there are samples up to ``t_ns``, and enough before it."""
        if not self._count or t_ns > self.newest_ns:
            return False
        k = int(np.searchsorted(self._t[: self._count], t_ns))
        return k - self._first >= 2 * self._over(CHANGE_S, k)

    def begin(self, t_ns: int, x: Vector, P: Matrix) -> None:
        """Stand at ``t_ns``, which is covered, with this state."""
        self.x, self.P = x, P
        self._index, self._share = self._find(t_ns)
        self.anchor_ns = t_ns
        self._sums[:] = 0.0

    def advance(self, t_ns: int) -> None:
        """Bring state and covariance to ``t_ns``, between the anchor and the newest sample."""
        while self.anchor_ns < t_ns:
            goal = min(t_ns, self.anchor_ns + SEGMENT_NS)
            k, share = self._find(goal)
            sums, v = self._sums, self.x[X_V : X_V + 3].copy()
            sums[:] = 0.0
            run(self.x, self._rows, self._index, self._share, k, share, sums)
            self._index, self._share, self.anchor_ns = k, share, goal
            dt = float(sums[S_DT])
            if dt <= 0.0:
                continue
            self._a_n = (self.x[X_V : X_V + 3] - v) / dt
            bent(self.x, self._transfer, dt)
            self.P = predict(self.P, dynamics(self.x, sums), dt, self._config, self._transfer)

    def run_on(self) -> None:
        """Make the live state anew, from the anchor."""
        self.live = self.x.copy()
        self._live_sums[:] = 0.0
        run(self.live, self._rows, self._index, self._share, self._count - 1, 1.0, self._live_sums)

    @property
    def live_sums(self) -> Vector:
        """What `nav.transfer.kernels.run` summed up for the live state last."""
        return self._live_sums

    def _over(self, seconds: float, k: int) -> int:
        return max(1, round(seconds / float(self._rows[k, 0])))

    def instant(self, x: Vector, t_ns: int) -> Instant:
        """How the slave moves at ``t_ns``, which is covered; biases by ``x`` (X_SIZE,)."""
        k, _ = self._find(t_ns)
        few, some = self._over(RATE_S, k), self._over(CHANGE_S, k)
        rows = self._rows

        def mean(first: int, last: int) -> tuple[Vector, float]:
            part = rows[first:last]
            seconds = float(np.sum(part[:, 0]))
            return np.sum(part[:, 1:4], axis=0) / seconds, seconds

        w, over = mean(k + 1 - few, k + 1)
        new, long = mean(k + 1 - some, k + 1)
        old, _ = mean(k + 1 - 2 * some, k + 1 - some)
        dw = (new - old) / long
        middle = (int(self._t[k]) - t_ns) * 1e-9 - 0.5 * over
        w = w - dw * middle
        M = x[place(GYRO_AXES)].reshape(3, 3)
        w = w - x[place(GYRO_BIAS)]
        noise = self._config.angle_random_walk / over**0.5
        return Instant(w - M @ w, dw, self._a_n, noise)
