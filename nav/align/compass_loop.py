"""The gyrocompass loops: a control law around the strapdown kernel, forwards and backwards in time.

Before every navigation update the law looks at the velocity that the kernel has computed, takes off what
the vehicle really does (nothing at rest, what the odometer says on the move) and hands the kernel a control
rate and damping gains. Yan Gongmin 2008, eqs. (2-19) to (2-22), with the strapdown kernel in place of (2-22);
on the move eqs. (2-28) to (2-30) with the correction that the velocity turns with the platform,
``-w_c x v``, which is in the kernel.

Backwards the intervals are negative and the gains those of a negative sigma (`nav.align.compass_theory`), so
velocity, integrators and control rate keep their meaning and their values where a pass turns round.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from nav.align.compass_theory import AzimuthGains, LevelGains, Place
from nav.earth import position_matrix
from nav.jit import kernel
from nav.rotation import rotate
from nav.strapdown.control import U_KV, U_SIZE, U_V, U_WC
from nav.strapdown.kernels import M_SIZE, X_C, X_H, X_HEAD, X_Q, X_V, increments, strapdown, take
from nav.strapdown.reverse import invert
from nav.types import Vector

SAMPLES: Final = 2  # an update

# Places of the law's vector (L_SIZE,): gains, then the two integrators and the azimuth control rate.
_EAST: Final = slice(0, 3)  # K_1, (1 + K_2)/R less the curvature, K_3
_NORTH: Final = slice(3, 6)
_TURN: Final = slice(6, 8)  # K_U3 / w_N, K_U4
_UP: Final = 8  # damping of the vertical velocity, 1/s
L_P: Final = slice(9, 12)  # p_E, p_N, w_cU, rad/s
L_SIZE: Final = 12


def head(q_nb: Vector, v_n: Vector, lat: float, lon: float, height: float) -> Vector:
    """State (X_HEAD,) of the kernel at a place (rad, rad, m), n being east, north, up there."""
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = q_nb
    x[X_V : X_V + 3] = v_n
    x[X_C : X_C + 9] = position_matrix(lat, lon).ravel()
    x[X_H] = height
    return x


def set_gains(law: Vector, at: Place, level: LevelGains, azimuth: AzimuthGains | None) -> None:
    """Put gains into a law (L_SIZE,); its integrators stay. Without ``azimuth`` heading is left alone.

    The kernel turns n by the transport rate of the whole velocity, so the curvature is taken off (1 + K_2)/R.
    """
    law[_EAST] = level.k1, level.k2 - at.along_east, level.k3
    law[_UP] = level.k1
    if azimuth is None:
        law[_NORTH] = level.k1, level.k2 - at.along_north, level.k3
        law[_TURN] = 0.0
        law[11] = 0.0
    else:
        law[_NORTH] = azimuth.k1, azimuth.k2 - at.along_north, 0.0
        law[_TURN] = azimuth.k3 / at.north, azimuth.k4
        law[10] = 0.0


def set_free(law: Vector, up: float) -> None:
    """No control at all but damping of the vertical velocity, ``up`` 1/s."""
    law[:] = 0.0
    law[_UP] = up


@kernel
def run(
    x: Vector, law: Vector, rows: Vector, dt: Vector, velocity: Vector, n: int, ahead: bool, u: Vector
) -> None:
    """Lead the state ``x`` (X_HEAD,) through samples under a ``law`` (L_SIZE,), both in place.

    ``rows`` (k, 6) angle and velocity increments over ``dt`` (k,) s, in the order of time either way; ``n``
    of them make an update, a rest makes updates of one. ``velocity`` (k, 3) m/s is the reference, the mean
    over each sample, in b. ``u`` (U_SIZE,) is room for the control vector.
    """
    d = np.empty(6 * n)
    inc = np.empty(6)
    mid = np.empty(M_SIZE)
    u[:] = 0.0
    left = rows.shape[0]
    first = 0
    while left > 0:
        m = n if left >= n else 1
        i = first if ahead else left - m
        first += m
        left -= m
        take(rows, i, m, d)
        increments(d, m, inc)
        step = 0.0
        ax, ay, az = 0.0, 0.0, 0.0
        for j in range(i, i + m):
            step += dt[j]
            ax += velocity[j, 0]
            ay += velocity[j, 1]
            az += velocity[j, 2]
        if not ahead:
            invert(inc)
            step = -step
        rx, ry, rz = rotate(x[0], x[1], x[2], x[3], ax / m, ay / m, az / m)
        east, north = x[X_V] - rx, x[X_V + 1] - ry
        law[9] += law[2] * east * step
        law[10] += law[5] * north * step
        law[11] = (law[11] + law[6] * north * step) / (1.0 + law[7] * step)
        u[U_WC] = -law[4] * north - law[10]
        u[U_WC + 1] = law[1] * east + law[9]
        u[U_WC + 2] = law[11]
        # the kernel has one gain for both level axes: the east one is met through the reference
        u[U_KV], u[U_KV + 1] = law[3], law[8]
        ratio = law[0] / law[3] if law[3] != 0.0 else 1.0
        u[U_V], u[U_V + 1], u[U_V + 2] = x[X_V] - ratio * east, ry, rz
        strapdown(x, inc, step, u, mid)


def lead(x: Vector, law: Vector, rows: Vector, dt: Vector, velocity: Vector, ahead: bool) -> None:
    """`run` with the usual number of samples an update."""
    if len(rows):
        run(x, law, rows, dt, velocity, SAMPLES, ahead, np.empty(U_SIZE))
