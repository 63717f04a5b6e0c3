"""What disturbs apparent velocity: sway averaged out, and how rough the rest is."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.jit import kernel
from nav.types import Vector

EPOCHS: Final = 16  # differences that count as the present
NEAR, FAR = 2, 4  # epochs between those that a difference takes
FEWEST: Final = 4
BACK: Final = EPOCHS + 4 * FAR  # epochs that the present has to do with
CHANCE: Final = 2.0
GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)


class Roughness(NamedTuple):
    """The last epochs, and the mean squares of the last fourth differences of them.

    A cubic has none, so neither gravity, its drift nor a bias shows, only what is different from epoch to
    epoch and not explained by what stands beside them. They are taken between every `NEAR`-th epoch, since
    neighbours overlap, and between every `FAR`-th, which sees a slower sway. ``walk`` m/s/sqrt(s): the
    accelerometers' noise, which shows as well, integrated once or ``twice``, and is none of the epochs'. Nor
    is what a reference has wandered off by each of them: ``wandered`` m^2, variance of a component.
    """

    walk: float
    twice: bool = True
    t: tuple[float, ...] = ()
    z: tuple[Vector, ...] = ()
    wandered: tuple[float, ...] = ()
    near: tuple[Fourth, ...] = ()
    far: tuple[Fourth, ...] = ()

    @property
    def sigma(self) -> float | None:
        """Standard deviation of one component of an epoch, or None while there are too few."""
        if len(self.near) < FEWEST:
            return None
        return math.sqrt(max(_beyond(self.near), _beyond(self.far) if len(self.far) >= FEWEST else 0.0))


class Fourth(NamedTuple):
    """A fourth difference (3, 1 + n) as large as the noise of an epoch, and the walk's variance in it."""

    told: Vector
    walk: float


def _beyond(fourths: tuple[Fourth, ...]) -> float:
    """Mean square beyond the walk's, where it is more than chance."""
    told = np.concatenate([one.told for one in fourths])
    walk = sum(one.walk for one in fourths) / len(fourths)
    left, free = told[:, 0], len(told)
    if told.shape[1] > 1:
        fitted, _, rank, _ = np.linalg.lstsq(told[:, 1:], left, rcond=1e-6)
        left, free = left - told[:, 1:] @ fitted, free - int(rank)
    seen = float(left @ left) / free
    return seen - walk if seen > CHANCE * walk else 0.0


def follow(rough: Roughness, t: float, z: Vector, wandered: float = 0.0) -> Roughness:
    """Add the epoch ``z`` (3,) at ``t`` s; or (3, 1 + n): beside it, what explains it linearly.

    ``wandered`` m^2 is the variance by which a reference has wandered off since the epoch before.
    """
    many = 4 * FAR + 1
    times, values = (*rough.t, t)[-many:], (*rough.z, z)[-many:]
    off = (*rough.wandered, (rough.wandered[-1] if rough.wandered else 0.0) + wandered)[-many:]
    near, far = rough.near, rough.far
    if len(times) > 4 * NEAR:
        last = slice(None, -4 * NEAR - 2, -NEAR)
        near = (*near, _fourth(rough, times[last], values[last], off[last]))[-EPOCHS:]
    if len(times) > 4 * FAR:
        every = slice(None, None, FAR)
        far = (*far, _fourth(rough, times[every], values[every], off[every]))[-EPOCHS:]
    return rough._replace(t=times, z=values, wandered=off, near=near, far=far)


def _fourth(
    rough: Roughness, times: tuple[float, ...], values: tuple[Vector, ...], wandered: tuple[float, ...]
) -> Fourth:
    """The fourth divided difference, and the mean square that the walks give a component of it."""
    t = np.array(times) - min(times)
    apart = t[:, None] - t + np.eye(5)
    weights = 1.0 / np.prod(apart, axis=1)
    first, last = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    # covariance of white noise, integrated: Brownian motion and its integral
    walk = rough.walk**2 * (first**2 * (3.0 * last - first) / 6.0 if rough.twice else first)
    off = np.array(wandered) - min(wandered)
    walk = walk + np.minimum(off[:, None], off)
    size = float(weights @ weights)
    told = np.tensordot(weights, np.array(values), 1) / math.sqrt(size)
    return Fourth(told.reshape(3, -1), float(weights @ walk @ weights) / size)


class Window(NamedTuple):
    """Weighted sums over an epoch, a squared sine long: what swings faster than twice in it averages out.

    ``sums`` (3 + n,): weights, weighted seconds since the middle, their squares, and weighted values (n,).
    """

    begin: float  # s
    length: float
    sums: Vector

    @property
    def middle(self) -> float:
        """Its middle, s."""
        return self.begin + 0.5 * self.length

    def mean(self) -> tuple[float, float, Vector]:
        """Mean and mean square of the seconds since the middle, mean of the values (n,)."""
        w = float(self.sums[0])
        return float(self.sums[1]) / w, float(self.sums[2]) / w, self.sums[3:] / w


def window(begin: float, length: float, n: int) -> Window:
    """An empty one for values (n,)."""
    return Window(begin, length, np.zeros(3 + n))


def spread(index: int, mean: float, width: float) -> float:
    """Seconds between epochs: all are different, else a sway of their rate would look like a drift."""
    return mean + width * ((index * GOLDEN) % 1.0 - 0.5)


@kernel
def weigh(sums: Vector, begin: float, length: float, t: float, values: Vector) -> None:
    """Add ``values`` (n,) at ``t`` s to the sums of a `Window`."""
    x = (t - begin) / length
    if x <= 0.0 or x >= 1.0:
        return
    w = math.sin(math.pi * x) ** 2
    since = t - begin - 0.5 * length
    sums[0] += w
    sums[1] += w * since
    sums[2] += w * since * since
    for i in range(values.shape[0]):
        sums[3 + i] += w * values[i]
