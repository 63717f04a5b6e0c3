"""Where the accelerometers of a unit sit, from what they read while a table turns it.

The reverse of `nav.imu.size_effect`: Yan Gongmin 2008, section 5.4, finds the arms by trial from the drift of
a navigation; here they are the unknowns of a linear least-squares fit to the increments themselves. Gravity
in the frame of the start, which the Earth turns, and the biases are unknowns beside them, so neither the
table's levelling nor its north has to be known. What is found is counted from the point about which the table
turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from nav.imu.size_effect import meeting_point
from nav.jit import in_place
from nav.rotation import exponential, multiply, quat_rotate
from nav.types import Vector

_GRAVITY_TERMS: Final = 4
"""Powers of time for gravity in the start's frame: the Earth turns by 0.04 rad in ten minutes."""
_EDGE: Final = 2  # samples at either end whose rates have no neighbours on both sides
_FAINT: Final = 1e-9  # singular values below this share of the largest one are none
_SEEN: Final = 1e-5
_CLEAR: Final = 100.0
"""How much stronger than what noise of the gyros makes of it an arm's own signal has to be, squared."""
_ALONG: Final = ("right", "forward", "up")


class Arms(NamedTuple):
    """Places of n accelerometers and how well they are known.

    ``arms`` (n, 3) m, ``covariance`` (3 n, 3 n) m^2 in the same order; ``residual`` m/s is what is left of a
    sample, rms.
    """

    arms: Vector
    covariance: Vector
    residual: float

    def from_meeting_point(self, axes: Vector) -> Arms:
        """The same from the point nearest to all sensitive ``axes`` (n, 3), found with the arms."""
        n = len(axes)
        unit = np.eye(3 * n).reshape(3 * n, n, 3)
        away = np.stack([one - meeting_point(axes, one) for one in unit])
        back = away.reshape(3 * n, 3 * n).T
        arms = (back @ self.arms.ravel()).reshape(n, 3)
        return Arms(arms, back @ self.covariance @ back.T, self.residual)

    def sigma(self) -> Vector:
        """Standard deviations (n, 3), m."""
        return np.sqrt(np.diag(self.covariance)).reshape(self.arms.shape)


def fit_arms(axes: Vector, turns: Sequence[tuple[Vector, Vector]], tau: float) -> Arms:
    """Arms of n accelerometers from the samples of turns about a point that stays where it is.

    ``axes`` (n, 3) sensitive axes by rows. Of every turn the angles (samples, 3) rad, compensated, and what
    each accelerometer says along its own axis, (samples, n) m/s, its scale compensated; ``tau`` s. Gravity is
    an unknown of every turn, arms and biases are the same in all. Their noise is taken as white and equal.
    Raises ValueError where the turns do not show a coefficient, or show it no better than noise of the gyros
    would, naming it, or where the samples are fewer than the unknowns.
    """
    n = len(axes)
    counts = [len(dtheta) - 2 * _EDGE for dtheta, _ in turns]
    unknowns = 4 * n + 3 * _GRAVITY_TERMS * len(turns)
    if n * sum(counts) <= unknowns or min(counts) < 1:
        raise ValueError(f"{sum(counts)} samples of {n} accelerometers are too few for {unknowns} unknowns")
    parts = []
    for place, ((dtheta, _), rows) in enumerate(zip(turns, counts, strict=True)):
        inner = slice(_EDGE, _EDGE + rows)
        # rates at the ends of the inner samples: cubics through four samples' angles, in their middle
        rate = (7.0 * (dtheta[1:-2] + dtheta[2:-1]) - dtheta[:-3] - dtheta[3:]) / (12.0 * tau)
        change = np.diff(rate, axis=0)
        turn = _turns(dtheta[inner], change, tau)
        weigh = _gravity(dtheta, change, tau)
        time = (np.arange(len(dtheta)) + 0.5)[inner] / len(dtheta)
        design = np.zeros((n, rows, unknowns))
        for i in range(n):
            design[i, :, 3 * i : 3 * i + 3] = np.einsum("a,kab->kb", axes[i], turn)
            design[i, :, 3 * n + i] = tau
            along = np.einsum("a,kab->kb", axes[i], weigh)
            for power in range(_GRAVITY_TERMS):
                first = 4 * n + 3 * (_GRAVITY_TERMS * place + power)
                design[i, :, first : first + 3] = time[:, None] ** power * along
        parts.append(design.reshape(n * rows, unknowns))
    A = np.concatenate(parts)
    y = np.concatenate([read[_EDGE:-_EDGE].T.ravel() for _, read in turns])
    noise = sum(rows * _noise(axes, dtheta, tau) for (dtheta, _), rows in zip(turns, counts, strict=True))
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    Q, R = np.linalg.qr(A / size)
    U, s, Vt = np.linalg.svd(R)
    kept = s > _FAINT * s[0]
    root = Vt[kept].T / s[kept] / size[:, None]
    unseen = np.linalg.norm(Vt[~kept, : 3 * n], axis=0) > _SEEN
    # what noise alone would show is weighed down by the noise, and looks as if it were known
    signal = 1.0 / np.maximum(np.sum(root[: 3 * n] ** 2, axis=1), np.finfo(float).tiny)
    unseen |= signal < _CLEAR * noise
    if unseen.any():
        names = [f"accelerometer {k // 3 + 1} {_ALONG[k % 3]}" for k in np.flatnonzero(unseen)]
        raise ValueError(f"the turns do not show the arm of {', '.join(names)}: turn about other axes too")
    x = (Vt[kept].T @ (U[:, kept].T @ (Q.T @ y) / s[kept])) / size
    left = y - A @ x
    variance = float(left @ left) / (len(y) - int(kept.sum()))
    covariance = variance * (root @ root.T)
    return Arms(x[: 3 * n].reshape(n, 3), covariance[: 3 * n, : 3 * n], float(np.sqrt(variance)))


def _noise(axes: Vector, dtheta: Vector, tau: float) -> Vector:
    """Variance that noise of the gyros gives the regressors of the arms, (3 n,), (m/s per m)^2."""
    # fourth differences see no smooth motion, and 70 times the variance of white noise
    white = np.mean(np.square(np.diff(dtheta, n=4, axis=0)), axis=0) / 70.0
    # of the change of the rate, (-1, 8, 0, -8, 1) / 12 tau of increments
    change = 130.0 / 144.0 * white / tau**2
    across = np.cross(np.eye(3)[None], axes[:, None])
    return np.asarray((across**2 @ change).ravel())


def _turns(dtheta: Vector, change: Vector, tau: float) -> Vector:
    """Integral of (w x)(w x) + dw/dt x over each sample, (n, 3, 3)."""
    mean = _skews(dtheta / tau)
    return np.asarray(tau * (mean @ mean + _skews(change) @ _skews(change) / 12.0) + _skews(change))


def _gravity(dtheta: Vector, change: Vector, tau: float) -> Vector:
    """Integral over each inner sample of the rotation from the frame of the start into b, (n, 3, 3)."""
    q = np.empty((len(dtheta), 4))
    _attitudes(dtheta, q)
    # columns are the axes of b at the beginning of the sample, in the start's frame
    inner = slice(_EDGE, len(dtheta) - _EDGE)
    C = np.stack([quat_rotate(q[inner], axis) for axis in np.eye(3)], axis=-1)
    angle = np.linalg.norm(dtheta[inner], axis=1)[:, None, None]
    turn = _skews(dtheta[inner])
    first = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    # (1 - sin/x)/x^2, by its series where it would cancel
    small = 1.0 / 6.0 - angle**2 / 120.0 + angle**4 / 5040.0
    safe = np.maximum(angle, 0.05)
    second = np.where(angle > 0.05, (1.0 - np.sin(safe) / safe) / safe**2, small)
    # a rate that grows leaves the angle behind that of a steady one, on average by a twelfth
    late = _skews(change * (tau / 12.0))
    inside = np.eye(3) - first * turn + second * (turn @ turn) + late
    return np.asarray(tau * inside @ np.swapaxes(C, 1, 2))


def _skews(v: Vector) -> Vector:
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.swapaxes(out, 1, 2)


@in_place
def _attitudes(dtheta: Vector, q: Vector) -> None:
    """Attitude at the beginning of each sample, from that of the first."""
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    for k in range(len(dtheta)):
        q[k, 0], q[k, 1], q[k, 2], q[k, 3] = w, x, y, z
        a, b, c, d = exponential(dtheta[k, 0], dtheta[k, 1], dtheta[k, 2])
        w, x, y, z = multiply(w, x, y, z, a, b, c, d)
