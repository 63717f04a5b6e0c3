"""The filter in time: increments, snapshots and measurements kept, so that late data finds its own time.

Updates are numbered from 0. The ring holds the increments of the latest of them, a snapshot of state
and covariance is kept at every eighth, and the log holds every measurement in the order of its time.
A measurement that belongs before the present is entered in the log, and a second copy of the filter, the
one at work, starts from the snapshot before it and goes through increments and log again. Meanwhile the
live filter goes on; when the copy has caught up it takes the live one's place. What comes out is, to the
bit, what the measurements would have given in the order of their times.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from nav.events import Innovation, NavEvent, Notice
from nav.filter.height_feed import HeightFeed, take_offset
from nav.filter.measurements import MEASUREMENTS, Measurement
from nav.filter.motion import restart_path
from nav.filter.propagate import (
    REST_SIZE,
    ROW_D,
    ROW_DT,
    ROW_GAP,
    ROW_N,
    ROW_NOISE,
    ROW_WALK,
    WORK_SIZE,
    advance,
    replay,
    row_size,
    solution_row,
)
from nav.filter.records import NEVER, Filter, Record, Snapshots
from nav.filter.recovery import PATIENCE, agree, contradicted, inflate
from nav.filter.states import X_PT
from nav.jit import in_place
from nav.types import ImuSample, S, Vector

CAPACITY: Final = 2048
"""Updates kept."""
STRIDE: Final = 8
"""Updates between snapshots."""
_BRIDGE_S: Final = 0.02  # longest update over a silence
_OPEN: Final = float("inf")
_JOIN_NS: Final = 10_000_000  # between the begin of a path and of the interval that it is compared with


@in_place
def _put(row: Vector, k: int, dtheta: Vector, dv: Vector) -> None:
    """Put sample ``k`` into its row."""
    o = ROW_D + 3 * k
    p = o + 3 * int(row[ROW_N])
    for i in range(3):
        row[o + i], row[p + i] = dtheta[i], dv[i]


class Timeline:
    """The live filter, its history, and the copy that goes back when data comes late."""

    def __init__(
        self, states: int, par: Vector, lockout: float, replay_updates: int, samples: int = 2
    ) -> None:
        self.par = par
        self.live = Filter(states)
        self._work = Filter(states)
        self.behind = False
        """Whether late data is still being worked in."""
        self._scratch = np.zeros(WORK_SIZE)
        self._out = np.zeros(12)
        self.rest = np.zeros(REST_SIZE)
        self.walk = np.zeros(18)
        """Densities of noise beyond those of ``par`` from now on, as of a row: see `ROW_WALK`."""
        self._ring = np.zeros((CAPACITY, row_size(samples)))
        self._rows = [self._ring[i] for i in range(CAPACITY)]
        self._times = np.zeros(CAPACITY, dtype=np.int64)
        self._snapshots = Snapshots(CAPACITY // STRIDE, STRIDE, states)
        self._log: list[Record] = []
        self._keys: list[tuple[int, int, int]] = []
        self._serial = 0
        self._lockout_ns = round(lockout * 1e9)
        self._budget = replay_updates
        self.t_ns = 0
        self._begin_ns = 0
        self.events: list[NavEvent] = []
        self._feed = HeightFeed()

    def begin(self, t_ns: int, x: Vector, P: Vector) -> None:
        """Start afresh at ``t_ns`` with state ``x`` (X_SIZE,) and covariance ``P`` (states, states)."""
        self.live.begin(t_ns, x, P)
        self.behind = False
        self._snapshots.clear()
        self._feed = HeightFeed()
        self._log.clear()
        self._keys.clear()
        self._times[0] = t_ns
        self.t_ns = self._begin_ns = t_ns

    def last_accepted(self, kind: str) -> int:
        """Time (ns) of the last accepted measurement of a kind; the start of navigation before any."""
        if kind == "barometer" and self._feed.t_ns is not None:
            return self._feed.t_ns
        return self.live.books[kind][0]

    def used(self, *kinds: str) -> bool:
        """Whether a measurement of one of these kinds was ever accepted."""
        return any(self.live.books[kind][0] != self._begin_ns for kind in kinds)

    # ---- forward -------------------------------------------------------------------------------

    def advance(self, t_ns: int, dt: float, noise: float, samples: Sequence[ImuSample]) -> Vector | None:
        """One update over samples; returns the solution row (S.SIZE,), None when it is not finite.

        ``dt`` s over all of them, ``noise`` factor on the noise densities.
        """
        place = self._next(t_ns, dt, 0.0, noise, len(samples))
        live = self.live
        store = self._rows[place]
        for k, sample in enumerate(samples):
            _put(store, k, sample.dtheta, sample.dv)
        row = np.empty(S.SIZE)
        good = advance(live.x, live.P, self.par, self._scratch, store, self.rest, row)
        live.u += 1
        self.t_ns = t_ns
        if not self.behind and live.cursor < len(self._log) and self._log[live.cursor].t_ns <= t_ns:
            self._apply_due(live, t_ns)
            good = solution_row(live.x, live.P, self.par, row)
        return row if good else None

    def bridge(self, t_ns: int, dt: float) -> None:
        """Updates over the ``dt`` seconds up to ``t_ns``, in which nothing was measured.

        They are short, so that an aid within the silence meets the state of its own time.
        """
        pieces = math.ceil(dt / _BRIDGE_S)
        live = self.live
        for left in reversed(range(pieces)):
            t = t_ns - round(left * dt / pieces * 1e9)
            self._next(t, dt / pieces, dt, 1.0, 1)
            replay(
                live.x, live.P, self.par, self._scratch, self._ring, self._times, live.u, live.u + 1, 2**62
            )
            live.u += 1
            self.t_ns = t
            if not self.behind:
                self._apply_due(live, t)

    def _next(self, t_ns: int, dt: float, gap: float, noise: float, samples: int) -> int:
        live = self.live
        if live.u % STRIDE == 0 and not self.behind:
            self._snapshots.take(live)
            self._prune()
        place = (live.u + 1) % CAPACITY
        row = self._rows[place]
        row[ROW_DT] = dt
        row[ROW_GAP] = gap
        row[ROW_NOISE] = noise
        row[ROW_N] = samples
        row[ROW_WALK:ROW_D] = self.walk
        self._feed.fill(row, t_ns, dt)
        self._times[place] = t_ns
        return place

    def _prune(self) -> None:
        # what is older than the oldest snapshot cannot be reached any more
        oldest = max(0, (self.live.u - CAPACITY) // STRIDE * STRIDE + 2 * STRIDE)
        count = bisect_left(self._keys, (int(self._times[oldest % CAPACITY]),))
        if count > 64:
            del self._log[:count]
            del self._keys[:count]
            self.live.cursor -= count

    # ---- measurements --------------------------------------------------------------------------

    def measure(self, kind: str, t_ns: int, z: Vector) -> bool:
        """Enter a measurement of ``kind`` made at ``t_ns``; False when that is too long ago.

        ``z`` as the kernel of `MEASUREMENTS` wants it, with ``z[0]`` left free.
        """
        m = MEASUREMENTS[kind]
        return self._enter(t_ns, m.rank, m, z, None)

    def act(self, t_ns: int, action: Callable[[Filter], None]) -> bool:
        """Enter something to be done to the filter at ``t_ns``, after the measurements of that time."""
        return self._enter(t_ns, 100, None, np.zeros(1), action)

    def external_height(self, t_ns: int, height: float, sigma: float) -> bool:
        """Feed a height (m, one sigma m) to the height channel, from the next update on; False: stale.

        Whatever the first one differs by from the navigated height is taken to be the barometer's bias.
        """
        feed = self._feed
        if feed.t_ns is None:
            # not into a filter that is about to be replaced
            if self.behind:
                return True
            age = (self.t_ns - t_ns) * 1e-9
            self.act(self.t_ns, lambda f: take_offset(f.x, f.P, height, sigma, age))
        elif t_ns <= feed.t_ns:
            return False
        feed.take(t_ns, height, sigma)
        return True

    def restart_path(self, t_ns: int) -> bool:
        """End the path integral of the odometer point at ``t_ns`` and start the next one."""

        def action(f: Filter) -> None:
            restart_path(f.x, self.par, (int(self._times[f.u % CAPACITY]) - t_ns) * 1e-9)
            f.path_ns = t_ns

        return self.act(t_ns, action)

    def _enter(
        self,
        t_ns: int,
        rank: int,
        measurement: Measurement | None,
        z: Vector,
        action: Callable[[Filter], None] | None,
    ) -> bool:
        self._serial += 1
        record = Record(t_ns, rank, self._serial, measurement, z, action)
        place = bisect_right(self._keys, record.key)
        live = self.live
        if t_ns > self.t_ns:
            self._insert(place, record)
            return True
        if (
            not self.behind
            and place == live.cursor
            and t_ns > self._times[(live.u - 1) % CAPACITY]
            and live.u > 0
        ):
            self._insert(place, record)
            self._apply_due(live, self.t_ns)
            return True
        if self.behind and place >= self._work.cursor and t_ns > self._times[self._work.u % CAPACITY]:
            self._insert(place, record)
            return True
        start = self._snapshot_before(t_ns)
        if start < 0:
            return False
        self._insert(place, record)
        self._go_back(start)
        return True

    def _insert(self, place: int, record: Record) -> None:
        self._keys.insert(place, record.key)
        self._log.insert(place, record)

    def _snapshot_before(self, t_ns: int) -> int:
        """Newest valid snapshot's update before ``t_ns``, -1 when there is none."""
        newest = self._work.u if self.behind else self.live.u
        u = newest // STRIDE * STRIDE
        oldest = max(0, self.live.u + STRIDE - CAPACITY)
        while u >= oldest:
            if self._snapshots.holds(u) and self._times[u % CAPACITY] < t_ns:
                return u
            u -= STRIDE
        return -1

    def _go_back(self, u: int) -> None:
        work = self._work
        self._snapshots.restore(u, work)
        work.cursor = bisect_left(self._keys, (int(self._times[u % CAPACITY]) + 1,))
        self.behind = True

    def catch_up(self) -> None:
        """Work off stored updates, at most the budget; at the end the copy becomes the live one."""
        work, live = self._work, self.live
        budget = self._budget
        while work.u < live.u and budget > 0:
            if work.u % STRIDE == 0:
                self._snapshots.take(work)
            last = min(live.u, work.u + budget, work.u // STRIDE * STRIDE + STRIDE)
            stop = self._log[work.cursor].t_ns if work.cursor < len(self._log) else 2**62
            reached = replay(
                work.x, work.P, self.par, self._scratch, self._ring, self._times, work.u, last, stop
            )
            budget -= reached - work.u
            work.u = reached
            now = int(self._times[reached % CAPACITY])
            if stop <= now:
                self._apply_due(work, now)
                budget -= 1
        if work.u == live.u:
            self.live, self._work = work, live
            self.behind = False

    def solution(self) -> Vector | None:
        """The solution row (S.SIZE,) of the live filter as it is now, None when it is not finite."""
        row = np.empty(S.SIZE)
        good = solution_row(self.live.x, self.live.P, self.par, row)
        return row if good else None

    def _apply_due(self, f: Filter, now_ns: int) -> None:
        log = self._log
        while f.cursor < len(log) and log[f.cursor].t_ns <= now_ns:
            record = log[f.cursor]
            f.cursor += 1
            if record.measurement is not None:
                self._apply(f, record, record.measurement, now_ns)
            elif record.action is not None:
                record.action(f)

    def _apply(self, f: Filter, record: Record, m: Measurement, now_ns: int) -> None:
        z, out, t_ns = record.z, self._out, record.t_ns
        tau = (now_ns - t_ns) * 1e-9
        z[0] = tau
        if m.path and (abs(f.path_ns - t_ns + round(z.item(1) * 1e9)) > _JOIN_NS or f.x.item(X_PT) <= tau):
            return
        nis = m.kernel(f.x, f.P, self.par, z, m.gate, out)
        values = out.tolist()
        residual = values[: m.rows]
        accepted = nis <= m.gate
        if accepted:
            record.refused = None
            f.books[m.name] = t_ns, 0, NEVER
        else:
            record.refused = residual
            _, count, since = f.books[m.name]
            since = t_ns if since == NEVER else since
            f.books[m.name] = f.books[m.name][0], count + 1, since
            shut = t_ns - since
            if count >= 2 and shut >= self._lockout_ns and self._believed(f, m, shut):
                inflate(f.P, m, out[: m.rows], shut * 1e-9)
                m.kernel(f.x, f.P, self.par, z, _OPEN, out)
                f.books[m.name] = t_ns, 0, NEVER
                values = out.tolist()
                if not record.recovered:
                    record.recovered = True
                    text = f"{m.name}: refused for {shut * 1e-9:.0f} s; covariance inflated, measurement used"
                    self.events.append(Notice(t_ns, text))
        if not record.reported:
            record.reported = True
            shown, sigma = tuple(values[: m.rows]), tuple(values[6 : 6 + m.rows])
            self.events.append(Innovation(t_ns, m.name, shown, sigma, float(nis), accepted))

    def _believed(self, f: Filter, m: Measurement, shut_ns: int) -> bool:
        if contradicted(m, f.books):
            return False
        log = self._log[: f.cursor]
        since = f.books[m.name][2]
        refused = [r.refused for r in log if r.measurement is m and r.t_ns >= since and r.refused is not None]
        return shut_ns >= PATIENCE * self._lockout_ns or agree(np.array(refused))
