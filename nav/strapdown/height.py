"""The height channel: an inertial height runs away, and an external one holds it.

Gravity falls with height, so that an error dh of the height is an error 2 g/R dh of the vertical
acceleration, which drives it further off: e-fold in 9.5 minutes. Feedback of the difference to an external
height (see `nav.strapdown.control`: k1 to the height's rate, k2 to acceleration, k3 to an integral taken off
acceleration) makes it stable. Without k3 a bias of the vertical accelerometer leaves an offset of itself
over k2; with k3 it leaves none, and the height follows the barometer's in a ramp too.

Source: textbook chapter "Inertial navigation", section on the height channel, eqs. (2-61) to (2-64).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import GRAVITY_EQUATOR, SEMI_MAJOR

Matrix = NDArray[np.float64]

GRADIENT: Final = 2.0 * GRAVITY_EQUATOR / SEMI_MAJOR
"""2 g/R at the equator, 1/s^2, which third-order gains take into account."""

ORDERS: Final = (2, 3)


def height_gains(order: int, time_constant: float) -> tuple[float, float, float]:
    """Gains k1 (1/s), k2 (1/s^2), k3 (1/s^3) of a height channel with ``time_constant`` T in s.

    Second order: 2/T and 1/T^2, as if gravity were constant; its gradient takes the damping ratio from 1 to
    1 + g T^2/R (1.0014 at 30 s). Third order: three poles at -1/T, gradient included. Raises ValueError for
    another order, and for a time in which feedback would not hold the height.
    """
    if order not in ORDERS:
        raise ValueError(f"a height channel of order {order}, expected one of {', '.join(map(str, ORDERS))}")
    if not 0.0 < time_constant < GRADIENT**-0.5:
        raise ValueError(f"time constant {time_constant} s, expected more than 0 and less than 9 minutes")
    rate = 1.0 / time_constant
    if order == 2:
        return 2.0 * rate, rate**2, 0.0
    return 3.0 * rate, 3.0 * rate**2 + GRADIENT, rate**3


def height_dynamics(gains: tuple[float, float, float], gradient: float = GRADIENT) -> Matrix:
    """Matrix (3, 3) of ``d(e)/dt`` of the errors of height, vertical velocity and acceleration correction.

    Eq. (2-62) with the integral added; with k3 = 0 the third stays what it is. ``gradient`` is 2 g/R, 1/s^2.
    """
    k1, k2, k3 = gains
    return np.array([[-k1, 1.0, 0.0], [gradient - k2, 0.0, -1.0], [k3, 0.0, 0.0]])
