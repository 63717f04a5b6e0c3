"""What came since an alignment began, kept so that a stage can go over it again, forwards and backwards.

A `Store` has one `Track` for each kind of sample. Samples are numbered from 0 in the order of arrival and
keep their numbers; what is older than the store may hold is dropped, which shows in `Track.first`. Tracks
are lists of blocks, so that adding a sample never copies what is there and takes the same time always.

A stage that goes over its data keeps a `Sweep` beside the store and asks `portion` once in every step for
the next few samples; while it does, the samples that arrive are stored, and the last pass leads through
them up to the present:

    store.add(sample)
    if is_lost(store.imu, sweep): ... refuse: it took longer than the store may hold ...
    piece, ahead, sweep = portion(store.imu, sweep, config.replay_samples)
    ... work through piece.rows, from the last one down where not ahead ...
    behind = is_behind(store.imu, sweep)

A store is changed by `Store.add`: it belongs to one stage's state, and goes from one to the next.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.types import GnssFix, ImuSample, OdoSample, Sample, SpeedSample, Vector

Times = NDArray[np.int64]

BLOCK: Final = 3840  # samples; divisible by 1 to 6, so that updates of as many samples do not straddle
_BEFORE: Final = -(2**63)


class F:
    """Columns of the rows of `Store.gnss`; velocity is NaN where the receiver gives none."""

    POSITION: Final = slice(0, 3)  # lat rad, lon rad, height m
    SIGMA_POSITION: Final = slice(3, 6)  # m east, north, up
    VELOCITY: Final = slice(6, 9)  # m/s east, north, up
    SIGMA_VELOCITY: Final = slice(9, 12)  # m/s
    SIZE: Final = 12


class Piece(NamedTuple):
    """Neighbouring samples of a track, in the order of time: views, for reading.

    ``t_ns`` (k,) int64, ``dt`` (k,) s, ``rows`` (k, width), all C-contiguous.
    """

    t_ns: Times
    dt: Vector
    rows: Vector


class Track:
    """Samples of one kind; see the module."""

    def __init__(self, width: int, block: int) -> None:
        self.first = 0  # number of the oldest sample kept
        self.count = 0  # number that the next sample gets
        self.last_ns = _BEFORE  # time of the newest
        self._width = width
        self._block = block
        self._blocks: deque[Piece] = deque()
        self._free = 0  # rows left in the newest block

    def __len__(self) -> int:
        return self.count - self.first

    def row(self, t_ns: int, dt: float) -> Vector:
        """A new sample's row (width,), to be filled by the caller."""
        if self._free == 0:
            n = self._block
            piece = Piece(np.empty(n, dtype=np.int64), np.empty(n), np.empty((n, self._width)))
            self._blocks.append(piece)
            self._free = n
        block = self._blocks[-1]
        k = self._block - self._free
        block.t_ns[k] = t_ns
        block.dt[k] = dt
        self._free -= 1
        self.count += 1
        self.last_ns = t_ns
        row: Vector = block.rows[k]
        return row

    def forget(self, t_ns: int) -> None:
        """Drop blocks whose samples are all older than ``t_ns``."""
        blocks = self._blocks
        while len(blocks) > 1 and int(blocks[0].t_ns[-1]) < t_ns:
            blocks.popleft()
            self.first += self._block

    def ahead(self, place: int, most: int) -> Piece:
        """Samples from number ``place`` on, at most ``most``; fewer at the end of a block or of the track.

        Raises IndexError for samples that are not kept any more.
        """
        if place >= self.count or most <= 0:
            return _nothing(self._width)
        at, k = self._find(place)
        return _cut(self._blocks[at], k, min(k + most, k + self.count - place, self._block))

    def back(self, place: int, most: int) -> Piece:
        """Samples before number ``place``, at most ``most``, in the order of time; fewer as in `ahead`."""
        if place <= self.first:
            return _nothing(self._width)
        at, k = self._find(place - 1)
        return _cut(self._blocks[at], max(0, k + 1 - most), k + 1)

    def number(self, t_ns: int) -> int:
        """Number of the first sample kept that is later than ``t_ns``; ``count`` where there is none."""
        low = self.first
        for block in self._blocks:
            n = min(self._block, self.count - low)
            if block.t_ns[n - 1] > t_ns:
                return low + int(np.searchsorted(block.t_ns[:n], t_ns, side="right"))
            low += n
        return self.count

    def _find(self, place: int) -> tuple[int, int]:
        if not self.first <= place < self.count:
            raise IndexError(f"sample {place} is not among {self.first} to {self.count}")
        return divmod(place - self.first, self._block)


def _cut(block: Piece, low: int, high: int) -> Piece:
    return Piece(block.t_ns[low:high], block.dt[low:high], block.rows[low:high])


def _nothing(width: int) -> Piece:
    return Piece(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, width)))


class Store:
    """Samples of the last ``store_s`` seconds, by inertial time, and up to a block more.

    ``imu``: rows (6,) of angle increments (rad) and velocity increments (m/s) in b over ``dt``;
    ``odometer``: distance (m) over ``dt``; ``speed``: speed and sigma (m/s); ``gnss``: columns `F`.
    Samples without a place here are ignored; so are aids that are not later than the last of their kind.
    """

    def __init__(self, store_s: float) -> None:
        self.imu = Track(6, BLOCK)
        self.odometer = Track(1, BLOCK)
        self.speed = Track(2, BLOCK // 8)
        self.gnss = Track(F.SIZE, BLOCK // 8)
        self._store_ns = round(store_s * 1e9)

    def add(self, sample: Sample) -> None:
        """Take a sample, in the order of arrival."""
        if type(sample) is ImuSample:
            row = self.imu.row(sample.t_ns, sample.dt)
            row[0:3] = sample.dtheta
            row[3:6] = sample.dv
            if self.imu.count % BLOCK == 0:
                since_ns = sample.t_ns - self._store_ns
                for track in (self.imu, self.odometer, self.speed, self.gnss):
                    track.forget(since_ns)
        elif isinstance(sample, OdoSample):
            if sample.t_ns > self.odometer.last_ns:
                self.odometer.row(sample.t_ns, sample.dt)[0] = sample.distance
        elif isinstance(sample, SpeedSample):
            if sample.t_ns > self.speed.last_ns:
                self.speed.row(sample.t_ns, 0.0)[:] = sample.speed, sample.sigma
        elif isinstance(sample, GnssFix) and sample.t_ns > self.gnss.last_ns:
            row = self.gnss.row(sample.t_ns, 0.0)
            row[F.POSITION] = sample.lat, sample.lon, sample.height
            row[F.SIGMA_POSITION] = sample.sigma_position
            row[F.VELOCITY] = np.nan if sample.v_g is None else sample.v_g
            row[F.SIGMA_VELOCITY] = np.nan if sample.sigma_velocity is None else sample.sigma_velocity


class Sweep(NamedTuple):
    """Where a stage is on its way through a track, and how often it still turns back.

    Passes run between sample numbers ``low`` and ``high`` (one after the last to use). ``place`` is the
    number of the next sample ahead; on the way back the next one is the one before it. At ``high`` the way
    turns back ``turns`` times, at ``low`` it always turns ahead; with no turns left it leads on from
    ``high`` to the present.
    """

    place: int
    low: int
    high: int
    turns: int
    ahead: bool = True


def portion(track: Track, sweep: Sweep, most: int, multiple: int = 1) -> tuple[Piece, bool, Sweep]:
    """The next samples of a pass, at most ``most``, whether it goes ahead, and the sweep after them.

    The samples are in the order of time either way. Their number is divisible by ``multiple`` (1 to 6,
    for updates of several samples), as ``low`` and ``high`` have to be; ahead at the present the rest waits.
    Raises IndexError for samples that are not kept any more.
    """
    most -= most % multiple
    place, low, high, turns, ahead = sweep
    if ahead:
        bound = high if turns else track.count - track.count % multiple
        piece = track.ahead(place, max(0, min(most, bound - place)))
        place += len(piece.t_ns)
        if turns and place == high:
            return piece, True, Sweep(place, low, high, turns - 1, False)
        return piece, True, Sweep(place, low, high, turns, True)
    piece = track.back(place, min(most, place - low))
    place -= len(piece.t_ns)
    return piece, False, Sweep(place, low, high, turns, place == low)


def is_behind(track: Track, sweep: Sweep, multiple: int = 1) -> bool:
    """Whether passes are left to make or samples to go through before the present is reached.

    A rest of fewer samples than ``multiple`` counts as the present.
    """
    return sweep.turns > 0 or not sweep.ahead or track.count - sweep.place >= multiple


def is_lost(track: Track, sweep: Sweep) -> bool:
    """Whether samples that the passes still need have been dropped."""
    return track.first > (sweep.low if sweep.turns > 0 or not sweep.ahead else sweep.place)
