"""What a filter does when a redundant unit goes on with other sensors than before.

Before a fault is found it has moved attitude and velocity by what the unit then says it owes. Without aids
all of that is still there, and is put right. Aids have taken out more or less of it, nobody knows how much:
putting it right again would be as wrong, so the state stays and its covariance grows by it. And what aids do
not let velocity show goes into tilt, or into biases, which miss it from now on: as much as the fault has come
to, which of one that grows is twice its mean. The place is off by what such a velocity makes of it meanwhile.
The biases of what is fused are other ones in any case: the weights of the sensors have changed. And so is its
noise, (H^T R^-1 H)^-1 of sensors H with variances R, which grows along the axes of those that are gone: the
filter has it from the first sample on that is made of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from nav.filter import states as st
from nav.filter.records import Filter
from nav.filter.settings import ImuErrors
from nav.rotation import dcm_from_quat, quat_from_rotvec, quat_multiply, quat_normalize
from nav.strapdown.kernels import X_Q, X_V
from nav.types import ImuChange, Vector

_GROWN: Final = 2.0
_GRAVITY: Final = 9.8  # m/s^2
_LEVEL: Final = np.array([1.0, 1.0, 0.0])


def reconfigured(change: ImuChange, blind: bool) -> Callable[[Filter], None]:
    """The action that a filter answers ``change`` with; ``blind``: it has had no aids of late."""

    def action(f: Filter) -> None:
        turned, pushed = change.owed
        q, v = f.x[X_Q : X_Q + 4], f.x[X_V : X_V + 3]
        if blind:
            v += dcm_from_quat(q) @ pushed
            q[:] = quat_normalize(quat_multiply(q, quat_from_rotvec(turned)))
        else:
            # in every direction: over the seconds in question the unit may have turned
            push, turn = pushed @ pushed, turned @ turned
            rate = (_GROWN / change.over) ** 2
            _widen(f, st.POSITION, np.full(3, push * (0.5 * change.over) ** 2))
            _widen(f, st.VELOCITY, np.full(3, push))
            _widen(f, st.PHI, np.full(3, turn) + rate * push / _GRAVITY**2 * _LEVEL)
            _widen(f, st.GYRO_BIAS, np.full(3, rate * turn))
            _widen(f, st.ACCEL_BIAS, np.full(3, rate * push))
        _widen(f, st.GYRO_BIAS, change.bias[0] ** 2)
        _widen(f, st.ACCEL_BIAS, change.bias[1] ** 2)

    return action


def more_walk(change: ImuChange, imu: ImuErrors) -> Vector:
    """By what the unit's noise exceeds the configured one: densities in b of phi, then of velocity, (18,).

    A configuration may tell the noise of one sensor or of all; in no direction is less assumed than it says.
    """
    more = []
    for walk, told in zip(change.walk, (imu.angle_random_walk, imu.velocity_random_walk), strict=True):
        values, axes = np.linalg.eigh(walk)
        more.append((axes * np.maximum(values - told**2, 0.0)) @ axes.T)
    return np.ravel(more)


def _widen(f: Filter, part: slice, variance: Vector) -> None:
    f.P[part, part] += np.diag(variance)
