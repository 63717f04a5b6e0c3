"""The slave's own navigation: kept samples, the state at the master's last epoch, and the live one.

The filter's state stands at an *anchor*, the time of the master's last message in use. Samples since then
are kept, so that a message that comes late is used at its own time: the state goes from the anchor to it with
its covariance, is corrected, and runs on to the newest sample by strapdown alone. Where nothing comes the
anchor follows at a fixed distance, so that the work of one call stays bounded.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig, TransferConfig
from nav.rotation import quat_rotate
from nav.strapdown.kernels import M_F, X_Q
from nav.transfer.covariance import SEGMENT_NS, advance, noise
from nav.transfer.instant import CHANGE_S, find, instant, part_over
from nav.transfer.kernels import S_DT, S_FB, S_MID, S_SIZE, run
from nav.transfer.states import DELAY, X_REST
from nav.types import ImuSample

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SPREAD: Final = 3.0**0.5  # sigmas of the delay that a message's time may be off by
_MARGIN_NS: Final = 150_000_000  # kept behind the anchor for that
_BLOCK: Final = 4096
_FORCE: Final = slice(S_MID + M_F, S_MID + M_F + 3)


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
        self._noise = noise(config, transfer)

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

    def covers(self, t_ns: int) -> bool:
        """Whether there are samples from `ahead_ns` before ``t_ns`` to as long after it."""
        ahead = self.ahead_ns
        if not self._count or t_ns + ahead > self.newest_ns:
            return False
        return t_ns - ahead - round(2e9 * float(self._rows[self._first, 0])) > int(self._t[self._first])

    def begin(self, t_ns: int, x: Vector, P: Matrix) -> None:
        """Stand at ``t_ns``, which is covered, with this state."""
        self.x, self.P = x, P
        self._index = find(self._t, self._count, t_ns)
        self._share = part_over(self._t, self._rows, self._index, t_ns)
        self.anchor_ns = t_ns
        self._sums[:] = 0.0

    def advance(self, t_ns: int) -> None:
        """Bring state and covariance to ``t_ns``, between the anchor and the newest sample."""
        if t_ns > self.anchor_ns:
            self._index, self._share = advance(
                self.x,
                self.P,
                self._t,
                self._rows,
                self._index,
                self._share,
                self.anchor_ns,
                t_ns,
                self._noise,
                self._sums,
                self._a_n,
            )
            self.anchor_ns = t_ns

    def run_on(self) -> None:
        """Make the live state anew, from the anchor."""
        self.live = self.x.copy()
        sums = np.zeros(S_SIZE)
        run(self.live, self._rows, self._index, self._share, self._count - 1, 1.0, sums)
        if sums[S_DT] > 0.0:
            self._live_sums = sums

    @property
    def force(self) -> Vector:
        """Specific force (3,), m/s^2 in b, over the last step of `advance`."""
        return self._sums[S_FB : S_FB + 3] / max(float(self._sums[S_DT]), 1e-9)

    @property
    def live_sums(self) -> Vector:
        """What `nav.transfer.kernels.run` summed up for the live state last."""
        return self._live_sums

    @property
    def ahead_ns(self) -> int:
        """How far beyond a message's time samples are needed: its true time may lie there."""
        return round(max(CHANGE_S, self._spread) * 1e9)

    @property
    def _spread(self) -> float:
        if not self.started:
            return SPREAD * self._transfer.latency
        return SPREAD * math.sqrt(max(0.0, float(self.P[DELAY, DELAY])))

    def instant(self, t_ns: int) -> Vector:
        """How the slave moves at ``t_ns``, which is covered and `ahead_ns` more: `nav.transfer.instant`."""
        x, sums, arw = self.x, self._sums, self._config.angle_random_walk
        # gravity and the turns of n, by the last step; before there is one by what is felt at rest
        pull = -quat_rotate(x[X_Q : X_Q + 4], x[X_REST : X_REST + 3])
        if sums[S_DT] > 0.0:
            pull = self._a_n - sums[_FORCE] / sums[S_DT]
        return instant(x, self._t, self._rows, self._count, t_ns, self._spread, arw, pull)
