"""The size effect: accelerometers that do not sit in one point feel the rotation of the unit.

With U the sensitive axis of an accelerometer and r its place from the origin of b, Yan Gongmin 2008, eqs.
(5-19), (5-20), it feels in excess of what it would in the origin

    U . [w x (w x r) + dw/dt x r],

which neither its scale nor its bias has to do with: what is taken off here comes after the compensation of
pulses (`nav.imu.pulses`) and is the same whatever they are. Eq. (5-23) then leads from the sensors' axes to b
by the inverse of the matrix whose rows are the U (the text prints its transpose, which is right for
orthogonal axes alone).

Between samples the rate at their ends is what a parabola through the last three increments says. The angular
acceleration enters as the difference of these rates, so what is put on at one sample is taken off at another
and no velocity is made; the centripetal part is integrated along the line between them.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from nav.imu.pulses import Calibration
from nav.jit import in_place
from nav.rotation import skew
from nav.types import Vector

_SAMPLES, _D1, _D2, _W = 0, 1, 4, 7
_SIZE: Final = 10


def felt(axes: Vector, arms: Vector, rate: Vector, acceleration: Vector) -> Vector:
    """What each of n accelerometers feels in excess of the origin, (n,) m/s^2.

    ``axes`` (n, 3), ``arms`` (n, 3) m by rows, ``rate`` and ``acceleration`` (3,) of b against inertial
    space, rad/s and rad/s^2: Yan Gongmin 2008, eq. (5-20). Where the arms lie along the axes of
    b, this is (5-17).
    """
    turn = skew(rate) @ skew(rate) + skew(acceleration)
    return np.asarray(np.sum(axes * (arms @ turn.T), axis=1), dtype=np.float64)


def in_origin(axes: Vector, arms: Vector, read: Vector, rate: Vector, acceleration: Vector) -> Vector:
    """Specific force (3,) of the origin, in b, of what n >= 3 accelerometers ``read`` (n,): eq. (5-23)."""
    own = read - felt(axes, arms, rate, acceleration)
    return np.asarray(np.linalg.lstsq(axes, own, rcond=None)[0], dtype=np.float64)


def meeting_point(axes: Vector, arms: Vector) -> Vector:
    """The point (3,) m nearest to the lines along all sensitive axes.

    With the origin there, the angular acceleration has the least to say. Raises ValueError for parallel axes.
    """
    along = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e9:
        raise ValueError("all sensitive axes are parallel: no point is nearest to them")
    return np.linalg.solve(total, np.einsum("nij,nj->i", across, arms))


def levers(calibration: Calibration) -> Vector:
    """What `excess` must know of a unit, (3, 3, 3): axis of b, and the two indices of the turn."""
    c = calibration
    return np.asarray(np.einsum("ji,ia,ib->jab", np.linalg.inv(c.accel_axes), c.accel_axes, c.accel_arms))


def fresh() -> Vector:
    """The state before anything is known."""
    return np.zeros(_SIZE)


@in_place
def excess(levers: Vector, state: Vector, dtheta: Vector, tau: float, out: Vector) -> None:
    """Velocity (3,) m/s, in b, that the arms add over one sample; it goes to ``out``.

    ``levers`` from `levers`; ``state`` from `fresh`, carried from sample to sample of equal length ``tau`` s;
    ``dtheta`` (3,) rad the increment over it. Twin of `excess_readable`.
    """
    s = state[_SAMPLES]
    mean0, mean1, mean2 = dtheta[0] / tau, dtheta[1] / tau, dtheta[2] / tau
    turned = out  # first the change of the rate
    for i in range(3):
        d0, d1, d2 = dtheta[i], state[_D1 + i], state[_D2 + i]
        if s >= 2.0:
            end = (11.0 * d0 - 7.0 * d1 + 2.0 * d2) / (6.0 * tau)
        elif s == 1.0:
            end = (3.0 * d0 - d1) / (2.0 * tau)
        else:
            end = d0 / tau
        turned[i] = end - state[_W + i] if s > 0.0 else 0.0
        state[_W + i] = end
        state[_D2 + i], state[_D1 + i] = d1, d0
    state[_SAMPLES] = min(s + 1.0, 2.0)
    x, y, z = turned[0], turned[1], turned[2]
    k = tau / 12.0
    xx, yy, zz = (
        tau * mean0 * mean0 + k * x * x,
        tau * mean1 * mean1 + k * y * y,
        tau * mean2 * mean2 + k * z * z,
    )
    xy, xz, yz = (
        tau * mean0 * mean1 + k * x * y,
        tau * mean0 * mean2 + k * x * z,
        tau * mean1 * mean2 + k * y * z,
    )
    for j in range(3):
        out[j] = (
            -levers[j, 0, 0] * (yy + zz)
            - levers[j, 1, 1] * (xx + zz)
            - levers[j, 2, 2] * (xx + yy)
            + levers[j, 0, 1] * (xy - z)
            + levers[j, 1, 0] * (xy + z)
            + levers[j, 0, 2] * (xz + y)
            + levers[j, 2, 0] * (xz - y)
            + levers[j, 1, 2] * (yz - x)
            + levers[j, 2, 1] * (yz + x)
        )


def excess_readable(calibration: Calibration, increments: Vector, tau: float) -> Vector:
    """The same of the last of ``increments`` (n, 3), rad, one to four of the samples without a gap."""
    at = np.asarray(tau * (np.arange(len(increments)) - len(increments) + 1.0))
    last = _rate_at_end(at[-3:], increments[-3:], tau)
    change = 0.0 * last
    if len(increments) > 1:
        change = last - _rate_at_end(at[-4:-1], increments[-4:-1], tau)
    mean = skew(increments[-1] / tau)
    # of a rate on a line the mean of the square is that of the mean and a twelfth of that of the change
    turn = tau * (mean @ mean + skew(change) @ skew(change) / 12.0) + skew(change)
    c = calibration
    return np.asarray(np.linalg.inv(c.accel_axes) @ np.sum(c.accel_axes * (c.accel_arms @ turn.T), axis=1))


def _rate_at_end(at: Vector, increments: Vector, tau: float) -> Vector:
    """Derivative of the polynomial through all angles at the last of the samples' ends, ``at`` (n,) s."""
    angles = np.vstack([np.zeros(3), np.cumsum(increments, axis=0)])
    t = np.append(at[0] - tau, at) - at[-1]
    return np.array([np.polyder(np.poly1d(np.polyfit(t, angles[:, i], len(at))))(0.0) for i in range(3)])


class SizeEffect:
    """What the arms of one unit add, from sample to sample."""

    def __init__(self, calibration: Calibration) -> None:
        self._levers = levers(calibration)
        self._state = fresh()
        self._out = np.zeros(3)

    def restart(self) -> None:
        """Forget: samples before the next one are missing, or it is of another length."""
        self._state = fresh()

    def take_off(self, dtheta: Vector, dv: Vector, tau: float) -> None:
        """Bring ``dv`` (3,) m/s, compensated, to the origin of b; see `excess`."""
        excess(self._levers, self._state, dtheta, tau, self._out)
        dv -= self._out
