"""The way that wheels have counted, and the velocity that an IMU on them has by it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align.store import Piece, Times, Track
from nav.align.types import AlignConfig
from nav.jit import kernel
from nav.rotation import exponential, multiply
from nav.types import Vector

SMOOTH_NS: Final = 500_000_000  # on either side: ticks are averaged to a velocity
ADD, TAKE, PUT = 0, 1, -1


def way_at(path: Track, t_ns: Times) -> Vector:
    """Way (k,) m at ascending times (k,) int64 ns, between those of the odometer by straight lines."""
    place = max(path.first, path.number(int(t_ns[0])) - 1)
    times, ways = [], []
    while place < path.count:
        piece = path.ahead(place, path.count - place)
        stop = min(len(piece.t_ns), int(np.searchsorted(piece.t_ns, t_ns[-1])) + 1)
        times.append(piece.t_ns[:stop])
        ways.append(piece.rows[:stop, 0])
        place += stop
        if piece.t_ns[stop - 1] >= t_ns[-1]:
            break
    zero = int(t_ns[0])
    known = (np.concatenate(times) - zero).astype(np.float64)
    return np.asarray(np.interp((t_ns - zero).astype(np.float64), known, np.concatenate(ways)))


def speeds(path: Track, piece: Piece) -> Vector:
    """Mean speed (k,) m/s around each sample of a piece: the ticks of a second, half of it on either side."""
    low = np.maximum(piece.t_ns - SMOOTH_NS, _first_ns(path))
    high = np.minimum(piece.t_ns + SMOOTH_NS, path.last_ns)
    rolled = way_at(path, high) - way_at(path, low)
    return np.asarray(rolled / np.maximum((high - low) * 1e-9, 1e-3))


def _first_ns(path: Track) -> int:
    return int(path.ahead(path.first, 1).t_ns[0])


def velocities(config: AlignConfig, path: Track, piece: Piece) -> Vector:
    """Velocity (k, 3) m/s of the IMU in b: the odometer's point rolls forward, the arm turns about it."""
    assert config.C_vb is not None
    rates = piece.rows[:, 0:3] / piece.dt[:, None]
    turning = np.cross(rates, config.odometer_lever_arm)
    return np.asarray(speeds(path, piece)[:, None] * config.C_vb[1] - turning)


@kernel
def turn(q: Vector, rows: Vector, how: int) -> None:
    """Change ``q`` (4,), which takes b at the end of some samples to b at their beginning, in place.

    The ``rows`` (k, 6), in the order of time, come behind the samples (``ADD``), are taken off their
    beginning (``TAKE``) or put before it (``PUT``).
    """
    n = rows.shape[0]
    for k in range(n):
        row = rows[n - 1 - k] if how == PUT else rows[k]
        sign = -1.0 if how == TAKE else 1.0
        w, x, y, z = exponential(sign * row[0], sign * row[1], sign * row[2])
        if how == ADD:
            w, x, y, z = multiply(q[0], q[1], q[2], q[3], w, x, y, z)
        else:
            w, x, y, z = multiply(w, x, y, z, q[0], q[1], q[2], q[3])
        scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        q[0], q[1], q[2], q[3] = scale * w, scale * x, scale * y, scale * z


@kernel
def carried(q_nb: Vector, q: Vector, turned_n: Vector) -> Vector:
    """Attitude (4,) at the end of the samples of ``q`` from that at their beginning.

    ``turned_n`` (3,) rad is what n turned by meanwhile.
    """
    w, x, y, z = exponential(-turned_n[0], -turned_n[1], -turned_n[2])
    w, x, y, z = multiply(w, x, y, z, q_nb[0], q_nb[1], q_nb[2], q_nb[3])
    w, x, y, z = multiply(w, x, y, z, q[0], q[1], q[2], q[3])
    return np.array([w, x, y, z])
