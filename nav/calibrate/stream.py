"""Counts of a unit over time, and the motion that a rough calibration makes of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from nav import rotation
from nav.calibrate.encoder import Encoder
from nav.imu.pulses import Calibration
from nav.types import Vector

BLOCK_S: Final = 0.1
MOVING: Final = np.radians(0.5)  # rad/s: a table that turns slower than this rests
SLOWEST: Final = np.radians(1.0)  # rad/s: of rotations; what is less all the time is bias


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """What a unit of n gyros and m accelerometers is about, before its calibration.

    ``axes`` (n + m, 3) is what each sensor sees of a unit input along each axis of b, ``scale`` (n + m,) rad
    or m/s per pulse, ``bias`` (n + m,) rad/s or m/s^2; the first ``gyros`` are gyros.
    """

    gyros: int
    axes: Vector
    scale: Vector
    bias: Vector

    @classmethod
    def of(cls, c: Calibration) -> Nominal:
        """The coefficients of a calibration of three gyros and three accelerometers, but for small terms."""
        return cls(
            3,
            np.vstack((c.gyro_axes, c.accel_axes)),
            np.concatenate((c.gyro_scale_plus, c.accel_scale_plus)),
            np.concatenate((c.gyro_bias, c.accel_bias)),
        )

    def motion(self, counts: Vector, dt: Vector) -> tuple[Vector, Vector]:
        """Angles (k, 3) rad and velocities (k, 3) m/s in b, least squares over the sensors."""
        amount = counts * self.scale - self.bias * dt[:, None]
        g = self.gyros
        return (
            amount[:, :g] @ np.linalg.pinv(self.axes[:g]).T,
            amount[:, g:] @ np.linalg.pinv(self.axes[g:]).T,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Samples of one capture in order: ``begin`` s, intervals ``dt`` (k,) s, ``counts`` (k, n + m) pulses.

    ``bad`` names what is wrong with samples: from a word to the places (k,) where it holds. ``name`` is for
    people. ``temperature`` (k,) degC is empty where the unit did not tell it; ``encoder`` is what the table
    told of itself, where it did.
    """

    name: str
    begin: float
    dt: Vector
    counts: Vector
    bad: dict[str, Vector]
    temperature: Vector = field(default_factory=lambda: np.zeros(0))
    encoder: Encoder | None = None

    def time(self, place: int) -> float:
        """When sample number ``place`` begins, s of the unit's clock since the stream's beginning."""
        return float(self.dt[:place].sum())


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """A time without motion: samples ``first`` to ``last`` (not included) of a stream, and how it got there.

    ``force`` (3,) is the mean specific force in b; ``turned`` (4,) the rotation since the rest before, which
    takes b now to b then, ``swept`` (3,) rad the sum of all angles on the way.
    """

    stream: Stream
    first: int
    last: int
    seconds: float
    force: Vector
    turned: Vector
    swept: Vector


def rests(stream: Stream, nominal: Nominal, shortest: float) -> list[Rest]:
    """The rests of at least ``shortest`` s in a stream, in order."""
    time = np.concatenate((np.zeros(1), np.cumsum(stream.dt)))
    count = max(1, int(np.floor(time[-1] / BLOCK_S)))
    cuts = np.unique(np.searchsorted(time, np.linspace(0.0, time[-1], count + 1)))
    dtheta, dv = nominal.motion(stream.counts, stream.dt)
    angle, velocity = (np.add.reduceat(part, cuts[:-1], axis=0) for part in (dtheta, dv))
    length = np.diff(time[cuts])
    drift = np.median(angle / length[:, None], axis=0)
    if np.linalg.norm(drift) < SLOWEST:
        angle = angle - drift * length[:, None]
    still = np.linalg.norm(angle, axis=1) < MOVING * length
    found: list[Rest] = []
    since = 0  # block from which on the way to the next rest counts
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        seconds = float(length[begin:end].sum())
        if seconds < shortest:
            continue
        q = (1.0, 0.0, 0.0, 0.0)
        for x, y, z in angle[since:begin].tolist():
            q = rotation.multiply(*q, *rotation.exponential(x, y, z))
        found.append(
            Rest(
                stream,
                int(cuts[begin]),
                int(cuts[end]),
                seconds,
                velocity[begin:end].sum(axis=0) / seconds,
                np.array(q),
                angle[since:begin].sum(axis=0),
            )
        )
        since = end
    return found
