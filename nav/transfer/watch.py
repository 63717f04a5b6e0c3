"""Whether master and slave agree, and in words why not.

Each kind of rows passes a chi-square gate by itself. After a refusal several must pass before one is used
again: what is wrong throughout passes by chance now and then. What is wrong by less than a gate shows in what
the innovations have in common, which should be nothing.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import permutations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.transfer.states import DELAY, LEVER, PHI
from nav.types import MasterState

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

CAUSES: Final = [DELAY, *range(LEVER.start, LEVER.stop), *range(PHI.start, PHI.stop)]
"""States that may be far more wrong than was said; phi: growing, by a gyro that is wrong."""
LOOK: Final = 20  # messages of a kind
REFUSED: Final = 10  # of them that end it
TRUST: Final = 4  # must pass after a refusal
AGREE: Final = 0.97  # share of a kind that must have passed for an answer
LEAN: Final = 30.0  # messages over which what innovations have in common fades
LEANS: Final = (0.0, 33.4, 37.3, 40.5)  # chi-square that noise exceeds in one of 10^8, per degrees of freedom
FROZEN_S: Final = 0.5
_EXPLAINS: Final = 0.75  # share of the squares of what was refused
_JUMP_S: Final = 0.03
_WILD: Final = 0.003  # rad/s, of a gyro that is wrong
_TURN: Final = 1e-5  # rad^2 of turning that tells axes by itself


class Seen(NamedTuple):
    """Rows of one kind of a message: whitened residual (m,) and whitened columns `CAUSES` of H."""

    t_ns: int
    passed: bool
    r: Vector
    columns: Matrix


class Kind:
    """What was seen of one kind of rows."""

    def __init__(self, size: int) -> None:
        self.seen: deque[Seen] = deque(maxlen=400)
        self.passes = TRUST  # since the last refusal
        self.lean = np.zeros(size)
        self.weight = 0.0

    def see(self, t_ns: int, passed: bool, whitened: Matrix) -> bool:
        """Note rows; whether they are to be used."""
        r = whitened[:, 0]
        self.seen.append(Seen(t_ns, passed, r, whitened[:, 1:]))
        self.passes = self.passes + 1 if passed else 0
        if passed:
            self.lean += (r - self.lean) / LEAN
            self.weight += (1.0 - self.weight) / LEAN
        return self.passes > TRUST

    @property
    def leans(self) -> bool:
        """Whether the innovations have something in common."""
        if self.weight < 0.3:
            return False
        variance = (1.0 - (1.0 - self.weight) ** 2) / (2.0 * LEAN - 1.0)
        return float(self.lean @ self.lean) > variance * LEANS[len(self.lean)]

    @property
    def refuses(self) -> bool:
        """Whether half of the last were refused."""
        return sum(not one.passed for one in list(self.seen)[-LOOK:]) >= REFUSED

    def share(self, since_ns: int) -> float:
        """Of those since then that passed; one that was refused by chance is let off."""
        refused = [not one.passed for one in self.seen if one.t_ns > since_ns]
        return 1.0 - max(0, sum(refused) - 1) / len(refused) if refused else 0.0


class Watch:
    """What was seen of the messages.

    ``white``: the filter estimates all that matters, so that its innovations have nothing in common.
    """

    def __init__(self, lockout: float, white: bool) -> None:
        self._lockout_ns = round(lockout * 1e9)
        self._white = white
        self.kinds: dict[str, Kind] = {}
        self._turns = np.zeros((3, 3))
        self._forces = np.zeros((3, 3))
        self._ages: deque[float] = deque(maxlen=LOOK)
        self._jump = 0.0  # of the age of messages, s
        self._fresh_ns: int | None = None  # the last time that the master said something new
        # the last time that it said anything of use, or the first that it did not
        self._heard_ns: int | None = None
        self._missing = "message"  # what there has been none of since then
        self._last: MasterState | None = None

    def hear(self, m: MasterState, now_ns: int) -> bool:
        """Note a message that arrives when the newest inertial sample is of ``now_ns``; whether it is new."""
        last, self._last = self._last, m
        self._heard_ns, self._missing = now_ns, "message"
        self._ages.append((now_ns - m.t_ns) * 1e-9)
        if len(self._ages) == LOOK:
            ages = list(self._ages)
            jump = float(np.median(ages[-3:]) - np.median(ages[:-3]))
            if abs(jump) > max(_JUMP_S, abs(self._jump)):
                self._jump = jump
        new = last is None or not _same(last, m)
        if new:
            self._fresh_ns = now_ns
        return new

    def turn_away(self, expected: str, now_ns: int) -> None:
        """Note a message that arrives at ``now_ns`` and is not what is ``expected``."""
        self._missing = expected
        if self._heard_ns is None:
            self._heard_ns = now_ns

    def see(self, kind: str, t_ns: int, passed: bool, whitened: Matrix) -> bool:
        """Note rows: whitened residual, then columns `CAUSES` of H, (m, 1 + 7); whether to use them."""
        if kind not in self.kinds:
            self.kinds[kind] = Kind(len(whitened))
        return self.kinds[kind].see(t_ns, passed, whitened)

    def moved(self, turn: Vector, turned: Vector, force: Vector, felt: Vector) -> None:
        """Note between two messages, in b as built: turn (rad) and force by the master, and by the slave."""
        self._turns += np.outer(turn, turned)
        self._forces += np.outer(force, felt)

    def quality(self, now_ns: int) -> float:
        """Least share of a kind that passed lately; 0 without messages."""
        since = now_ns - self._lockout_ns
        return min((kind.share(since) for kind in self.kinds.values()), default=0.0)

    def cause(self, now_ns: int) -> str | None:
        """Why it cannot go on, or None."""
        heard, fresh = self._heard_ns, self._fresh_ns
        if heard is None:
            return None
        if now_ns - heard > self._lockout_ns:
            return f"no {self._missing} of the master for {(now_ns - heard) * 1e-9:.1f} s"
        if fresh is None:
            return None
        if heard - fresh > FROZEN_S * 1e9:
            return f"the master is frozen: it has said the same for {(heard - fresh) * 1e-9:.1f} s"
        refused = [name for name, kind in self.kinds.items() if kind.refuses]
        leaning = [name for name, kind in self.kinds.items() if self._white and kind.leans]
        unused = [n for n, kind in self.kinds.items() if now_ns - kind.seen[-1].t_ns > self._lockout_ns]
        if not refused and not leaning and not unused:
            return None
        what = " and ".join(refused or leaning or unused)
        return self._jumped() or self._axes() or self._explained() or f"master and slave disagree in {what}"

    def _jumped(self) -> str | None:
        return f"the master's time jumped by {-self._jump:.2f} s" if self._jump else None

    def _axes(self) -> str | None:
        """Whether the slave turns, or feels force, about other axes than its master."""
        M = self._forces / max(float(np.linalg.norm(self._forces)), 1e-9)
        turns = float(np.linalg.norm(self._turns))
        M = M + self._turns / max(turns, _TURN)
        best, name = float(np.trace(M)) + 0.5, ""
        for order in permutations(range(3)):
            for signs in np.ndindex(2, 2, 2):
                factors = 1.0 - 2.0 * np.array(signs)
                score = float(np.sum(factors * M[range(3), order]))
                if score > best + 1e-6:
                    best = score
                    name = ", ".join(f"{'-' if signs[i] else ''}{'xyz'[order[i]]}" for i in range(3))
        return f"the slave's axes are not as configured: x, y, z seem to be {name}" if name else None

    def _explained(self) -> str | None:
        """What single thing the disagreement may come from: a delay, the lever arm, a gyro."""
        every = [one for kind in self.kinds.values() for one in kind.seen]
        last = max(one.t_ns for one in every)
        late = [one for one in every if one.t_ns > last - self._lockout_ns]
        refused = [one for one in late if not one.passed]
        # what was refused shows it best; what only leans was never
        late = refused if len(refused) >= TRUST else late
        y = np.concatenate([one.r for one in late])
        A = np.concatenate([one.columns for one in late])
        t = np.concatenate([np.full(len(one.r), (one.t_ns - last) * 1e-9) for one in late])
        excess = float(y @ y) - len(y)
        starts = np.linspace(float(t.min()), 0.0, 8, endpoint=False)
        ramps = [A[:, 4:] * np.maximum(0.0, t - start)[:, None] for start in starts]
        # a gyro that may be wrong by anything from any time on explains much, and is asked last
        for candidates in (
            [
                ("the delay of the master's messages is off by {0:.0f} ms", A[:, :1], 0.1),
                ("the lever arm is wrong by {1:.2f} m", A[:, 1:4], 0.5),
            ],
            [("a gyro of the slave is wrong by {2:.0f} deg/h", ramp, _WILD) for ramp in ramps],
        ):
            gained, size, text, usual = max(
                (*_fit(B, y, usual), text, usual) for text, B, usual in candidates
            )
            if gained > _EXPLAINS * excess and size < 10.0 * usual:
                return text.format(1e3 * size, size, math.degrees(size) * 3600.0)
        return None


def _fit(B: Matrix, y: Vector, usual: float) -> tuple[float, float]:
    """By how much what is fitted, of ``usual`` size, lowers the squares of ``y``; and its length."""
    n = B.shape[1]
    A = np.concatenate([B, np.eye(n) / usual])
    z = np.concatenate([y, np.zeros(n)])
    found = np.linalg.lstsq(A, z, rcond=None)[0]
    return float(z @ z) - float(np.sum((z - A @ found) ** 2)), float(np.linalg.norm(found))


def _same(a: MasterState, b: MasterState) -> bool:
    if (a.lat, a.lon, a.height) != (b.lat, b.lon, b.height) or not np.array_equal(a.v_g, b.v_g):
        return False
    return a.q_ga is None or b.q_ga is None or np.array_equal(a.q_ga, b.q_ga)
