"""The straight line through the angle of a vehicle that stands: its mean rate, and what moved it beside that.

Angles are averaged over some seconds before a line is laid through them: an engine or the wind turns a
vehicle to and fro by more than the gyros' noise, and the difference of two angles would hold that in full.
What is left about the line tells how far its slope is to be trusted: of a random walk of density q the mean
square about the line over T is q T / 15, and the variance of the slope 1.2 q / T. A vehicle that was tilted
once, by an angle that no threshold sees, leaves so much about the line that the slope is wrong by no more
than 1.4 of its standard deviations.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from nav.types import Vector

LONGEST: Final = 3  # blocks to an average
FEWEST: Final = 5  # averages before the scatter about a line means something
CHANCE: Final = 6.0  # times what is expected of the gyros' own random walk; 99.9 % of cases are below
_ZERO: Final = np.zeros(3)
_SQUARES: Final = np.zeros((3, 3))


class Turn(NamedTuple):
    """A block of ``dt`` s: its angle (3,) rad since it began, at its end and integrated (rad s).

    ``late`` (3,) is the integral weighted by time, from 0 when it began to 1 at its end.
    """

    dt: float
    angle: Vector
    area: Vector
    late: Vector


class Line(NamedTuple):
    """Sums for a line through averaged angles; rad, s. ``theta`` is the angle beyond ``first`` times time."""

    first: Vector | None = None  # rad/s, of the first block
    theta: Vector = _ZERO  # at the end of the last block
    seconds: float = 0.0
    late: Vector = _ZERO  # of the last block, for the average that fades in over it and out over the next
    dt: float = 0.0
    area: Vector = _ZERO  # sums of such averages, not yet in those below; their weights, and times these
    weight: float = 0.0
    when: float = 0.0
    open: int = 0
    averages: int = 0
    times: tuple[float, float] = (0.0, 0.0)  # sums of the times, and of their squares
    sums: Vector = _ZERO  # of the averages
    moments: Vector = _ZERO  # of these times time
    squares: Vector = _SQUARES


class Drift(NamedTuple):
    """What a line says: rate (3,) rad/s, angle (3,) rad at the end beyond that at the middle, walk (3, 3).

    ``walk`` rad^2/s is the density of a random walk that would scatter the angles so.
    """

    rate: Vector
    now: Vector
    walk: Vector


def average(coarse_s: float, block_s: float) -> int:
    """Blocks to an average in an alignment whose coarse stage takes ``coarse_s``."""
    return max(1, min(LONGEST, int(coarse_s / (FEWEST + 1) / block_s)))


def follow(line: Line, turn: Turn, blocks: int) -> Line:
    """Add a block, ``blocks`` to an average."""
    dt = turn.dt
    first = turn.angle / dt if line.first is None else line.first
    whole = line.theta * dt + turn.area - 0.5 * dt * dt * first
    late = 0.5 * line.theta * dt + turn.late - dt * dt / 3.0 * first
    area, weight, when, count = line.area, line.weight, line.when, line.open
    if line.dt > 0.0:
        both = 0.5 * (line.dt + dt)
        area = area + line.late + whole - late
        weight, when, count = weight + both, when + both * line.seconds, count + 1
    line = line._replace(
        first=first,
        theta=line.theta + turn.angle - first * dt,
        seconds=line.seconds + dt,
        late=late,
        dt=dt,
        area=area,
        weight=weight,
        when=when,
        open=count,
    )
    if count < blocks:
        return line
    t, mean = when / weight, area / weight
    return line._replace(
        area=_ZERO,
        weight=0.0,
        when=0.0,
        open=0,
        averages=line.averages + 1,
        times=(line.times[0] + t, line.times[1] + t * t),
        sums=line.sums + mean,
        moments=line.moments + t * mean,
        squares=line.squares + mean[:, None] * mean,
    )


def fitted(line: Line, angle_random_walk: float) -> Drift:
    """Of all blocks so far; ``angle_random_walk`` rad/sqrt(s) is the least that angles scatter."""
    floor = np.eye(3) * angle_random_walk**2
    first = _ZERO if line.first is None else line.first
    n = line.averages
    if n < FEWEST:
        return Drift(first + line.theta / max(line.seconds, 1e-9), _ZERO, floor)
    t, mean = line.times[0] / n, line.sums / n
    spread = line.times[1] - n * t * t
    slope = (line.moments - t * line.sums) / spread
    now = line.theta - mean - slope * (line.seconds - t)
    left = line.squares - n * mean[:, None] * mean - spread * slope[:, None] * slope
    size, axes = np.linalg.eigh(left * (15.0 / ((n - 2.3) * line.seconds)))
    size = np.where(size > CHANCE * angle_random_walk**2, size, angle_random_walk**2)
    return Drift(first + slope, now, np.asarray(axes * size @ axes.T, dtype=np.float64))
