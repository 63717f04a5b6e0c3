"""What can be measured, and how each measurement meets the state: the table MEASUREMENTS.

Every kernel has one signature: ``kernel(x, P, par, z, gate, out) -> nis``. ``z`` is the measurement as
documented per kernel; ``z[0]`` is always the time from the measurement to the state, s (a fraction of
one update): the prediction is taken back by it. Residuals are computed minus measured. ``out`` (12,)
receives residuals in 0..5 and their predicted sigmas in 6..11. When the NIS is above ``gate`` nothing
changes. A covariance in ``z`` is xx, xy, xz, yy, yz, zz, in Earth-fixed axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.earth import E2, EARTH_RATE, curvature, radii
from nav.filter.kalman import GATES, correct, update_gain
from nav.filter.motion import attitude_ago, eb_rate, matrix, mean_velocity, vehicle_row, vehicle_velocity
from nav.filter.states import (
    ALL,
    FULL,
    P_ARW,
    P_LG,
    P_Q,
    P_SLIP,
    X_A,
    X_BB,
    X_BG,
    X_GB,
    X_KO,
    X_QV,
    X_TICK,
    X_TICK_COV,
    X_TICK_VAR,
    X_W,
)
from nav.jit import kernel
from nav.rotation import rotate
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
MeasurementKernel = Callable[[Vector, Matrix, Vector, Vector, float, Vector], float]


@kernel
def _finish(
    x: Vector, P: Matrix, H: Matrix, r: Vector, R: Matrix, X: Matrix, gate: float, out: Vector
) -> float:
    m = r.shape[0]
    n = P.shape[0]
    S = np.zeros((m, m))
    K = np.zeros((m, n))
    dx = np.zeros(n)
    nis = update_gain(P, H, r, R, X, gate, dx, S, K)
    for a in range(m):
        out[a] = r[a]
        out[6 + a] = np.sqrt(S[a, a])
    if nis <= gate:
        correct(x, dx)
        # the errors change, and the part of a tick that they have to do with does not
        for a in range(m):
            seen = 0.0
            for c in range(n):
                seen += H[a, c] * x[X_TICK_COV + c]
            S[a, 0] = seen
        for a in range(m):
            for c in range(n):
                x[X_TICK_COV + c] -= K[a, c] * S[a, 0]
    return nis


@kernel
def _noise_in_n(C: Vector, e: Vector) -> Matrix:
    """Covariance in n (3, 3) from its six elements xx, xy, xz, yy, yz, zz in Earth-fixed axes."""
    M = np.empty((3, 3))
    for j in range(3):
        a, b, c = C[j], C[3 + j], C[6 + j]
        M[0, j] = e[0] * a + e[1] * b + e[2] * c
        M[1, j] = e[1] * a + e[3] * b + e[4] * c
        M[2, j] = e[2] * a + e[4] * b + e[5] * c
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            R[i, j] = C[i] * M[0, j] + C[3 + i] * M[1, j] + C[6 + i] * M[2, j]
            R[j, i] = R[i, j]
    return R


@kernel
def gnss_position(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Antenna position. ``z``: tau, Earth-fixed x, y, z (m), covariance of what is white in it.

    Residual in n. Groves, eqs. (14.103) and (14.109) in the wander frame, with the lever arm.
    """
    n = P.shape[0]
    C = x[X_C : X_C + 9]
    _, r_n = radii(C[8])
    h = x[X_H]
    ex = (r_n + h) * C[2] - z[1]
    ey = (r_n + h) * C[5] - z[2]
    ez = ((1.0 - E2) * r_n + h) * C[8] - z[3]
    tau = z[0]
    qw, qx, qy, qz = attitude_ago(x, tau)
    lx, ly, lz = rotate(qw, qx, qy, qz, par[P_LG], par[P_LG + 1], par[P_LG + 2])
    back = 0.5 * tau * tau
    r = np.empty(3)
    r[0] = C[0] * ex + C[3] * ey + C[6] * ez + lx - x[X_V] * tau + x[X_A] * back
    r[1] = C[1] * ex + C[4] * ey + C[7] * ez + ly - x[X_V + 1] * tau + x[X_A + 1] * back
    r[2] = C[2] * ex + C[5] * ey + C[8] * ez + lz - x[X_V + 2] * tau + x[X_A + 2] * back
    H = np.zeros((3, n))
    for i in range(3):
        H[i, i] = 1.0
        H[i, 3 + i] = -tau
    H[0, 7], H[0, 8] = -lz, ly
    H[1, 6], H[1, 8] = lz, -lx
    H[2, 6], H[2, 7] = -ly, lx
    if n > FULL:
        for i in range(3):
            r[i] += x[X_GB + i]
            H[i, FULL + i] = 1.0
    return _finish(x, P, H, r, _noise_in_n(C, z[4:10]), np.zeros((n, 3)), gate, out)


@kernel
def gnss_velocity(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Antenna velocity. ``z``: tau, Earth-fixed x, y, z (m/s), its covariance.

    Groves, eq. (14.104) with the lever arm's velocity. The axes of n are those of the computed place: an
    error of position turns what was measured.
    """
    n = P.shape[0]
    C = x[X_C : X_C + 9]
    mx = C[0] * z[1] + C[3] * z[2] + C[6] * z[3]
    my = C[1] * z[1] + C[4] * z[2] + C[7] * z[3]
    mz = C[2] * z[1] + C[5] * z[2] + C[8] * z[3]
    kxx, kxy, kyy = curvature(C[6], C[7], C[8], x[X_H])
    px, py, pz = par[P_LG], par[P_LG + 1], par[P_LG + 2]
    tau = z[0]
    wx, wy, wz = eb_rate(x, tau)
    qw, qx, qy, qz = attitude_ago(x, tau)
    ux, uy, uz = rotate(qw, qx, qy, qz, wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px)
    r = np.empty(3)
    r[0] = x[X_V] + ux - x[X_A] * tau - mx
    r[1] = x[X_V + 1] + uy - x[X_A + 1] * tau - my
    r[2] = x[X_V + 2] + uz - x[X_A + 2] * tau - mz
    B = matrix(x[X_Q : X_Q + 4])
    H = np.zeros((3, n))
    for i in range(3):
        H[i, 3 + i] = 1.0
        # C [l x]: a bias turns the lever arm
        H[i, 9] = B[i, 1] * pz - B[i, 2] * py
        H[i, 10] = B[i, 2] * px - B[i, 0] * pz
        H[i, 11] = B[i, 0] * py - B[i, 1] * px
    # dtheta x m, where n is turned by dtheta = up x (k dp)
    H[0, 0], H[0, 1] = kxx * mz, kxy * mz
    H[1, 0], H[1, 1] = kxy * mz, kyy * mz
    H[2, 0], H[2, 1] = -kxy * my - kxx * mx, -kyy * my - kxy * mx
    H[0, 7], H[0, 8] = -uz, uy
    H[1, 6], H[1, 8] = uz, -ux
    H[2, 6], H[2, 7] = -uy, ux
    return _finish(x, P, H, r, _noise_in_n(C, z[4:10]), np.zeros((n, 3)), gate, out)


@kernel
def _bent(P: Matrix, speed: float) -> float:
    """Variance (m/s)^2 of what a linear model of a turned velocity leaves out: (speed phi^2 / 2)^2.

    It is nothing while attitude is known, and keeps an exact wheel from fixing a wrong attitude to a wrong
    velocity after a gap. Bar-Shalom, Li and Kirubarajan, section 10.3.2 (second-order filter).
    """
    second = 0.5 * speed * (P[6, 6] + P[7, 7] + P[8, 8])
    return float(second * second)


@kernel
def odometer(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Distance since the last odometer epoch.

    ``z``: tau, duration (s), distance (m), sigma (m) of what is white in it, of the part of a tick that any
    count leaves out (m), and 1 where nothing is known of that part at the beginning, 0 where it is what the
    last interval left out.

    What the count leaves out at the end of an interval is missing in the next one: the parts at both ends
    enter, and the one at the beginning is correlated with the state that was corrected with it. It is
    carried as a mean, a variance and a covariance with the state, which measurements that do not see it
    leave as it is. Bar-Shalom, Li and Kirubarajan, section 8.4 (autocorrelated noise, augmented state).
    """
    n = P.shape[0]
    if z[5] != 0.0 or x[X_TICK_VAR] < 0.0:
        _fresh_tick(x, z[4])
    u = mean_velocity(x, par, z[0])
    speed = z[2] / z[1]
    per_s = 1.0 / z[1]
    end = z[4] * z[4]
    r = np.empty(1)
    r[0] = u[1] - (1.0 + x[X_KO]) * speed + per_s * x[X_TICK]
    H = np.zeros((1, n))
    vehicle_row(x, par, 1, u, 0.5 * z[1] + z[0], H, 0)
    H[0, 15] = -speed
    R = np.full((1, 1), per_s * per_s * (z[3] * z[3] + end + x[X_TICK_VAR]) + _bent(P, u[1]))
    X = np.zeros((n, 1))
    W = np.zeros(n)
    for c in range(n):
        X[c, 0] = -per_s * x[X_TICK_COV + c]
        W[c] = X[c, 0]
        for k in range(n):
            W[c] += P[c, k] * H[0, k]
    nis = _finish(x, P, H, r, R, X, gate, out)
    if not nis <= gate:
        _fresh_tick(x, z[4])
        return nis
    # the part at this end: unknown before, and now seen through the residual
    gain = per_s * end / (out[6] * out[6])
    x[X_TICK] = gain * r[0]
    x[X_TICK_VAR] = end * (1.0 - gain * per_s)
    for c in range(n):
        x[X_TICK_COV + c] = -gain * W[c]
    return nis


@kernel
def _fresh_tick(x: Vector, sigma: float) -> None:
    """Nothing is known of the part of a tick that the count has left out."""
    x[X_TICK] = 0.0
    x[X_TICK_VAR] = sigma * sigma
    for c in range(ALL):
        x[X_TICK_COV + c] = 0.0


@kernel
def speed(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Forward speed at one instant. ``z``: tau, speed (m/s), sigma (m/s)."""
    n = P.shape[0]
    u = vehicle_velocity(x, par, z[0])
    r = np.empty(1)
    r[0] = u[1] - (1.0 + x[X_KO]) * z[1]
    H = np.zeros((1, n))
    vehicle_row(x, par, 1, u, z[0], H, 0)
    H[0, 15] = -z[1]
    R = np.full((1, 1), z[2] * z[2])
    return _finish(x, P, H, r, R, np.zeros((n, 1)), gate, out)


@kernel
def non_holonomic(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Wheels neither slide sideways nor leave the road. ``z``: tau, duration (s), sigma (m/s), sigma (m).

    Mean velocity of the odometer point along right and up of v is zero, but for the first sigma. A vehicle
    that heads off its path a little, now to one side and now to the other, walks sideways: ``z[3]`` is by
    how much over one metre. In a turn the sigma across grows with lateral acceleration (tyres slip). Both
    are along the road, which is taken to be level across: a body that leans sees part of them upward. What
    the accelerometers' noise did within the interval is in the velocity at its end and only partly in the
    mean. Groves, sections 15.4.1 and 3.4.
    """
    n = P.shape[0]
    u = mean_velocity(x, par, z[0])
    r = np.empty(2)
    r[0] = u[0]
    r[1] = u[2]
    H = np.zeros((2, n))
    vehicle_row(x, par, 0, u, 0.5 * z[1] + z[0], H, 0)
    vehicle_row(x, par, 2, u, 0.5 * z[1] + z[0], H, 1)
    _, _, wz = rotate(x[X_QV], x[X_QV + 1], x[X_QV + 2], x[X_QV + 3], x[X_W], x[X_W + 1], x[X_W + 2])
    slip = par[P_SLIP] * u[1] * wz
    along = slip * slip + z[3] * z[3] * abs(u[1]) / z[1]
    # the level line across the vehicle, along right and up of v
    right, up = H[1, 5], -H[0, 5]
    norm = 1.0 / np.sqrt(right * right + up * up)
    right, up = norm * right, norm * up
    walk = par[P_Q + 5] * z[1]
    own = z[2] * z[2] + _bent(P, u[1]) + walk / 3.0
    R = np.zeros((2, 2))
    R[0, 0] = own + along * right * right
    R[0, 1] = R[1, 0] = along * right * up
    R[1, 1] = own + along * up * up
    X = np.zeros((n, 2))
    for i in range(3, 6):
        X[i, 0], X[i, 1] = -0.5 * walk * H[0, i], -0.5 * walk * H[1, i]
    return _finish(x, P, H, r, R, X, gate, out)


@kernel
def zero_velocity(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """The vehicle stands. ``z``: tau, sigma (m/s). Groves, section 15.3.1."""
    n = P.shape[0]
    r = np.empty(3)
    H = np.zeros((3, n))
    R = np.zeros((3, 3))
    for i in range(3):
        r[i] = x[X_V + i]
        H[i, 3 + i] = 1.0
        R[i, i] = z[1] * z[1]
    return _finish(x, P, H, r, R, np.zeros((n, 3)), gate, out)


@kernel
def zero_rate(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """The vehicle does not turn. ``z``: tau, duration (s), mean raw rate in b (3, rad/s), sigma (rad/s).

    The mean gyro rate less Earth rate is bias and noise; the same noise turned the attitude, so the
    residual's noise is correlated with phi: its covariance is minus C_nb times the random walk squared.
    """
    n = P.shape[0]
    B = matrix(x[X_Q : X_Q + 4])
    ex, ey, ez = EARTH_RATE * x[X_C + 6], EARTH_RATE * x[X_C + 7], EARTH_RATE * x[X_C + 8]
    walk = par[P_ARW] * par[P_ARW]
    r = np.empty(3)
    H = np.zeros((3, n))
    R = np.zeros((3, 3))
    X = np.zeros((n, 3))
    for i in range(3):
        r[i] = z[2 + i] - x[X_BG + i] - (B[0, i] * ex + B[1, i] * ey + B[2, i] * ez)
        H[i, 6] = B[1, i] * ez - B[2, i] * ey
        H[i, 7] = B[2, i] * ex - B[0, i] * ez
        H[i, 8] = B[0, i] * ey - B[1, i] * ex
        H[i, 9 + i] = -1.0
        R[i, i] = walk / z[1] + z[5] * z[5]
        for k in range(3):
            X[6 + k, i] = -B[k, i] * walk
    return _finish(x, P, H, r, R, X, gate, out)


@kernel
def barometer(x: Vector, P: Matrix, par: Vector, z: Vector, gate: float, out: Vector) -> float:
    """Pressure altitude, with a bias that wanders with the weather. ``z``: tau, altitude (m), sigma (m)."""
    n = P.shape[0]
    r = np.empty(1)
    r[0] = x[X_H] - x[X_V + 2] * z[0] + x[X_BB] - z[1]
    H = np.zeros((1, n))
    H[0, 2] = 1.0
    H[0, 5] = -z[0]
    H[0, 18] = 1.0
    R = np.full((1, 1), z[2] * z[2])
    return _finish(x, P, H, r, R, np.zeros((n, 1)), gate, out)


@dataclass(frozen=True, slots=True)
class Measurement:
    """One kind of measurement.

    ``rank`` orders measurements of one instant, ``rows`` is the number of its residuals. When its gate
    has been shut for too long, the variances of ``recover`` states grow (see `nav.filter.recovery`). One with
    ``path`` is compared with the path since the last odometer epoch, which must cover its duration ``z[1]``.
    An assumption ``yields`` to the kinds of measurements that agree with the filter meanwhile.
    """

    name: str
    rank: int
    rows: int
    kernel: MeasurementKernel
    recover: tuple[slice, ...]
    path: bool = False
    yields: tuple[str, ...] = ()
    gate: float = field(init=False)
    """Largest NIS that is accepted."""

    def __post_init__(self) -> None:
        """Set the gate for the number of residuals."""
        object.__setattr__(self, "gate", GATES[self.rows])


_P, _V, _PHI = slice(0, 3), slice(3, 6), slice(6, 9)
_FIXES: Final = ("gnss_position", "gnss_velocity")

MEASUREMENTS: Final[dict[str, Measurement]] = {
    m.name: m
    for m in (
        Measurement("gnss_position", 0, 3, gnss_position, (_P,)),
        Measurement("gnss_velocity", 1, 3, gnss_velocity, (_V, slice(8, 9))),
        Measurement("barometer", 2, 1, barometer, (slice(18, 19),)),
        Measurement("odometer", 3, 1, odometer, (slice(15, 16),), path=True),
        Measurement("speed", 4, 1, speed, (slice(15, 16),)),
        Measurement("non_holonomic", 5, 2, non_holonomic, (slice(16, 18),), path=True, yields=_FIXES),
        Measurement("zero_velocity", 6, 3, zero_velocity, (_V,)),
        Measurement("zero_rate", 7, 3, zero_rate, (slice(9, 12),)),
    )
}
