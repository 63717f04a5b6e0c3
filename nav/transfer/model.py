"""The error model of transfer alignment: what is known at first, and what messages of the master show.

The textbook chapter "Inertial navigation", section 2.5.3, compares Euler angles, eqs. (2-169) to (2-174);
here the rotation vector between the two attitudes is compared, the same to first order (``T_b lambda - phi``)
and regular everywhere. The slave sits at the end of an arm that turns with it, so that its own gyros tell
the velocity that the arm makes: no rates of the master are needed, and flexure is in it.

Rows of H are written by columns: what an error of one along each axis does to the residual.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig, TransferConfig
from nav.earth import EARTH_RATE, geodetic_to_xyz
from nav.jit import in_place, kernel
from nav.rotation import exponential, logarithm, multiply, quat_from_dcm, rotate
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V, cross
from nav.transfer.covariance import MARKOV
from nav.transfer.instant import I_GAINED, I_RATES, I_SIGMA, I_SPREAD, I_TURNS, I_W, I_WAY
from nav.transfer.states import (
    ACCEL_BIAS,
    DELAY,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_AXES,
    GYRO_BIAS,
    LEVER,
    MOUNTING,
    PHI,
    POSITION,
    SIZE,
    VELOCITY,
    place,
)
from nav.types import MasterState

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Three = tuple[float, float, float]

CURVED: Final = 0.03
"""Of what the delay's uncertainty does to a row: more that is no straight line makes it useless."""
CHANCE: Final = 16.3
"""Chi-square of three that noise exceeds in one of a thousand."""

# Places in what `master` makes of a message.
A_PLACE: Final = 0  # lat, lon (rad), height (m)
A_V: Final = 3  # v_g, 3
A_Q: Final = 6  # q_ga, 4; zero where it does not tell
A_W: Final = 10  # w_ia_a, 3
A_SIZE: Final = 13

# Places in what `told` makes of the configuration.
T_POSITION: Final = 0  # sigmas of a message
T_VELOCITY: Final = 1
T_ATTITUDE: Final = 2
T_RATE: Final = 3
T_OWN: Final = 4  # sigma of what the slave turns by alone, rad/s an axis: flexure, and the noise of rates
T_Q: Final = 5  # q_ba as built, 4
T_LEVER: Final = 9  # 3

# Places in a scene, which the rows of a message share.
E_BA: Final = 0  # q_ba by the mounting estimated, 4
E_FA: Final = 4  # the same, by flexure besides
E_NA: Final = 8  # q_na, by the master where it tells
E_TURN: Final = 12  # cosine and sine of the turn of n about the vertical from east-north-up there
E_LEVER: Final = 14  # arm in a, m, 3
E_ARM: Final = 17  # arm in b, 3
E_W: Final = 20  # rate against the Earth in b, rad/s, 3
E_SIZE: Final = 23

_P: Final = POSITION.start
_V: Final = VELOCITY.start
_PHI: Final = PHI.start
_GYRO: Final = GYRO_BIAS.start
_AXES: Final = GYRO_AXES.start
_MOUNTING: Final = MOUNTING.start
_FLEXURE: Final = FLEXURE.start
_RATE: Final = FLEXURE_RATE.start
_LEVER: Final = LEVER.start
_X_MOUNTING: Final = place(MOUNTING).start
_X_FLEXURE: Final = place(FLEXURE).start
_X_RATE: Final = place(FLEXURE_RATE).start
_X_LEVER: Final = place(LEVER).start


def initial_covariance(config: AlignConfig, transfer: TransferConfig) -> Matrix:
    """P (SIZE, SIZE) before anything of the master was taken over: sensors, mounting, flexure, arm, delay."""
    d = np.zeros(SIZE)
    d[GYRO_BIAS], d[ACCEL_BIAS] = config.gyro_bias, config.accel_bias
    diagonal = np.eye(3).ravel() > 0.0
    d[GYRO_AXES] = np.where(diagonal, config.gyro_scale, config.gyro_axes)
    d[GYRO_AXES.stop : MOUNTING.start] = np.where(diagonal, config.accel_scale, config.accel_axes)
    d[MOUNTING] = transfer.sigma_mounting
    if transfer.flexure is not None:
        d[FLEXURE] = transfer.flexure
        d[FLEXURE_RATE] = transfer.flexure * MARKOV / transfer.flexure_time
    d[LEVER] = transfer.sigma_lever_arm
    d[DELAY] = transfer.latency
    return np.diag(d**2)


def told(transfer: TransferConfig) -> Vector:
    """What rows must know of the configuration, by places T_."""
    bends = 0.0 if transfer.flexure is None else float(np.max(transfer.flexure / transfer.flexure_time))
    own = math.hypot(transfer.sigma_rate, MARKOV * bends)
    sigmas = (transfer.sigma_position, transfer.sigma_velocity, transfer.sigma_attitude, transfer.sigma_rate)
    return np.array([*sigmas, own, *quat_from_dcm(transfer.C_ab.T), *transfer.lever_arm])


def master(m: MasterState) -> Vector:
    """What rows must know of a message (A_SIZE,)."""
    out = np.zeros(A_SIZE)
    out[0], out[1], out[2] = m.lat, m.lon, m.height
    out[A_V:A_Q] = m.v_g
    if m.q_ga is not None:
        out[A_Q:A_W] = m.q_ga
    if m.w_ia_a is not None:
        out[A_W:] = m.w_ia_a
    return out


@in_place
def _turn(q: Vector, at: int, x: float, y: float, z: float) -> Three:
    """A vector turned by the quaternion at a place."""
    return rotate(q[at], q[at + 1], q[at + 2], q[at + 3], x, y, z)


@in_place
def _unit(k: int) -> Three:
    return 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0


@in_place
def _put(H: Matrix, column: int, factor: float, v: Three) -> None:
    H[0, column], H[1, column], H[2, column] = factor * v[0], factor * v[1], factor * v[2]


@in_place
def _azimuth(x: Vector, lat: float, lon: float) -> tuple[float, float]:
    """Cosine and sine of the turn of n about the vertical from east-north-up at ``lat``, ``lon`` (rad)."""
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    o = X_C
    xx, yx = x[o + 3] * cl - x[o] * sl, x[o + 4] * cl - x[o + 1] * sl
    xy = c * x[o + 6] - s * (cl * x[o] + sl * x[o + 3])
    yy = c * x[o + 7] - s * (cl * x[o + 1] + sl * x[o + 4])
    u, v = xx + yy, yx - xy
    size = math.sqrt(u * u + v * v)
    return u / size, v / size


@kernel
def scene(x: Vector, now: Vector, m: Vector, t: Vector) -> Vector:
    """What the rows of a message share (E_SIZE,).

    ``x`` (X_SIZE,) the nominal state at its time, ``now`` (I_SIZE,) of `nav.transfer.instant`, ``m``
    (A_SIZE,) of `master`, ``t`` of `told`.
    """
    s = np.empty(E_SIZE)
    i = _X_MOUNTING
    a, b, c, d = exponential(-x[i], -x[i + 1], -x[i + 2])
    a, b, c, d = multiply(t[T_Q], t[T_Q + 1], t[T_Q + 2], t[T_Q + 3], a, b, c, d)
    s[E_BA], s[E_BA + 1], s[E_BA + 2], s[E_BA + 3] = a, b, c, d
    i = _X_FLEXURE
    e, f, g, h = exponential(-x[i], -x[i + 1], -x[i + 2])
    a, b, c, d = multiply(a, b, c, d, e, f, g, h)
    s[E_FA], s[E_FA + 1], s[E_FA + 2], s[E_FA + 3] = a, b, c, d
    cosine, sine = _azimuth(x, m[A_PLACE], m[A_PLACE + 1])
    s[E_TURN], s[E_TURN + 1] = cosine, sine
    i = A_Q
    if m[i] == 0.0 and m[i + 1] == 0.0 and m[i + 2] == 0.0 and m[i + 3] == 0.0:
        a, b, c, d = multiply(x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3], a, b, c, d)
    else:
        half = 0.5 * math.atan2(sine, cosine)
        a, b, c, d = multiply(math.cos(half), 0.0, 0.0, math.sin(half), m[i], m[i + 1], m[i + 2], m[i + 3])
    s[E_NA], s[E_NA + 1], s[E_NA + 2], s[E_NA + 3] = a, b, c, d
    for k in range(3):
        s[E_LEVER + k] = t[T_LEVER + k] + x[_X_LEVER + k]
    s[E_ARM], s[E_ARM + 1], s[E_ARM + 2] = _turn(s, E_BA, s[E_LEVER], s[E_LEVER + 1], s[E_LEVER + 2])
    earth = rotate(x[X_Q], -x[X_Q + 1], -x[X_Q + 2], -x[X_Q + 3], x[X_C + 6], x[X_C + 7], x[X_C + 8])
    for k in range(3):
        s[E_W + k] = now[I_W + k] - EARTH_RATE * earth[k]
    return s


@in_place
def dated(
    slope: Three,
    bend: Three,
    sigma: float,
    spread: float,
    own: float,
    lasts: bool,
    r: Vector,
    H: Matrix,
    R: Matrix,
) -> tuple[bool, float]:
    """Put what the delay does into rows with noise ``sigma``: the best line over three sigma points of it.

    ``slope`` (3,) is what a row gains per second that the message is older by, ``bend`` (3,) how far from a
    straight line it is at ``spread`` s, sqrt(3) sigmas of the delay, before and after; that is noise.
    ``own``: sigma an axis of the slope by what the slave alone does: it bends, vibrates, its gyros are noisy.

    Returns whether the rows are of use, being near enough to a line over what is known of the delay, and the
    share of the gain that they have for the delay. A slope that may be nothing else than the slave's own
    tells no delay, and to take it for one would find a wrong one ever more surely; then the delay is
    considered, but not corrected by the row, where the slope ``lasts`` as a turn or an acceleration does. It
    is no noise of the row: that would fade over messages, and a delay is the same in all of them. A change of
    the rate does not last: over a manoeuvre it comes to nothing, and what vibrates is in every message.
    """
    size = slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2]
    share = max(0.0, 1.0 - CHANCE * own * own / size) if size > 0.0 else 0.0
    bent = math.sqrt(2.0 / 9.0 * (bend[0] * bend[0] + bend[1] * bend[1] + bend[2] * bend[2]))
    for i in range(3):
        r[i] -= bend[i] / 3.0
        H[i, DELAY] = -slope[i] if lasts or share > 0.0 else 0.0
        for j in range(3):
            R[i, j] = 2.0 / 9.0 * bend[i] * bend[j] + (sigma * sigma if i == j else 0.0)
    return bent < max(sigma, CURVED * spread * math.sqrt(size)), share


@in_place
def _own_change(now: Vector, t: Vector) -> float:
    """Sigma of how fast the slave's own rate changes, rad/s^2, as it is seen over the spread of the delay."""
    return float(t[T_OWN] / (math.sqrt(2.0) * now[I_WAY]))


@in_place
def _line(before: Three, after: Three, now: Vector) -> tuple[Three, Three]:
    """Slope and bend for `dated` of what rows gain, were the message a way earlier and a way later."""
    half = 0.5 / now[I_WAY]
    share = now[I_SPREAD] / now[I_WAY]
    k = 0.5 * share * share
    slope = half * (before[0] - after[0]), half * (before[1] - after[1]), half * (before[2] - after[2])
    return slope, (k * (before[0] + after[0]), k * (before[1] + after[1]), k * (before[2] + after[2]))


@kernel
def position_rows(
    x: Vector, now: Vector, m: Vector, t: Vector, s: Vector, r: Vector, H: Matrix, R: Matrix
) -> tuple[bool, float]:
    """The slave's position against the master's and the arm, m.

    Here and below arguments as `scene`, which makes ``s``. Put residual ``r`` (3,), computed minus measured,
    ``H`` (3, SIZE), ``R`` (3, 3), in n (rates: in b); the rest as `dated` returns it.
    """
    H[:] = 0.0
    R[:] = 0.0
    lat = math.asin(min(1.0, max(-1.0, x[X_C + 8])))
    ax, ay, az = geodetic_to_xyz(lat, math.atan2(x[X_C + 5], x[X_C + 2]), x[X_H])
    bx, by, bz = geodetic_to_xyz(m[A_PLACE], m[A_PLACE + 1], m[A_PLACE + 2])
    ax, ay, az = ax - bx, ay - by, az - bz
    lx, ly, lz = s[E_LEVER], s[E_LEVER + 1], s[E_LEVER + 2]
    arm = _turn(x, X_Q, s[E_ARM], s[E_ARM + 1], s[E_ARM + 2])
    for k in range(3):
        r[k] = x[X_C + k] * ax + x[X_C + 3 + k] * ay + x[X_C + 6 + k] * az - arm[k]
        e, f, g = _unit(k)
        H[k, _P + k] = 1.0
        _put(H, _PHI + k, -1.0, cross(arm[0], arm[1], arm[2], e, f, g))
        ux, uy, uz = _turn(s, E_BA, e, f, g)
        _put(H, _LEVER + k, -1.0, _turn(x, X_Q, ux, uy, uz))
        ux, uy, uz = cross(lx, ly, lz, e, f, g)
        ux, uy, uz = _turn(s, E_BA, ux, uy, uz)
        _put(H, _MOUNTING + k, -1.0, _turn(x, X_Q, ux, uy, uz))
        H[k, DELAY] = -x[X_V + k]
        R[k, k] = t[T_POSITION] * t[T_POSITION]
    return True, 1.0


@kernel
def velocity_rows(
    x: Vector, now: Vector, m: Vector, t: Vector, s: Vector, r: Vector, H: Matrix, R: Matrix
) -> tuple[bool, float]:
    """The slave's velocity against the master's and what the arm makes of rotation, m/s."""
    H[:] = 0.0
    lx, ly, lz = s[E_LEVER], s[E_LEVER + 1], s[E_LEVER + 2]
    bx, by, bz = s[E_ARM], s[E_ARM + 1], s[E_ARM + 2]
    wx, wy, wz = s[E_W], s[E_W + 1], s[E_W + 2]
    px, py, pz = cross(wx, wy, wz, bx, by, bz)
    swing = _turn(x, X_Q, px, py, pz)
    cosine, sine = s[E_TURN], s[E_TURN + 1]
    r[0] = x[X_V] - (cosine * m[A_V] - sine * m[A_V + 1]) - swing[0]
    r[1] = x[X_V + 1] - (sine * m[A_V] + cosine * m[A_V + 1]) - swing[1]
    r[2] = x[X_V + 2] - m[A_V + 2] - swing[2]
    for k in range(3):
        e, f, g = _unit(k)
        H[k, _V + k] = 1.0
        _put(H, _PHI + k, -1.0, cross(swing[0], swing[1], swing[2], e, f, g))
        ux, uy, uz = cross(bx, by, bz, e, f, g)
        lag = _turn(x, X_Q, ux, uy, uz)
        _put(H, _GYRO + k, -1.0, lag)
        for j in range(3):
            _put(H, _AXES + 3 * k + j, -now[I_W + j], lag)
        ux, uy, uz = _turn(s, E_BA, e, f, g)
        ux, uy, uz = cross(wx, wy, wz, ux, uy, uz)
        _put(H, _LEVER + k, -1.0, _turn(x, X_Q, ux, uy, uz))
        ux, uy, uz = cross(lx, ly, lz, e, f, g)
        ux, uy, uz = _turn(s, E_BA, ux, uy, uz)
        ux, uy, uz = cross(wx, wy, wz, ux, uy, uz)
        _put(H, _MOUNTING + k, -1.0, _turn(x, X_Q, ux, uy, uz))
    # of the master's point: without what the arm adds
    gains = np.empty((2, 3))
    for n in range(2):
        sign, i, j = 1.0 if n == 1 else -1.0, I_TURNS + 3 * n, I_RATES + 3 * n
        ux, uy, uz = cross(wx + now[j], wy + now[j + 1], wz + now[j + 2], bx, by, bz)
        a, b, c, d = exponential(sign * now[i], sign * now[i + 1], sign * now[i + 2])
        ux, uy, uz = rotate(a, b, c, d, ux, uy, uz)
        swung = _turn(x, X_Q, ux, uy, uz)
        for k in range(3):
            gains[n, k] = swung[k] - swing[k] - now[I_GAINED + 3 * n + k]
    slope, bend = _line((gains[0, 0], gains[0, 1], gains[0, 2]), (gains[1, 0], gains[1, 1], gains[1, 2]), now)
    own = _own_change(now, t) * math.sqrt(bx * bx + by * by + bz * bz)
    straight, share = dated(slope, bend, t[T_VELOCITY], now[I_SPREAD], own, True, r, H, R)
    noise = now[I_SIGMA] * now[I_SIGMA]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                R[i, j] += noise * H[i, _GYRO + k] * H[j, _GYRO + k]
    return straight, share


@kernel
def attitude_rows(
    x: Vector, now: Vector, m: Vector, t: Vector, s: Vector, r: Vector, H: Matrix, R: Matrix
) -> tuple[bool, float]:
    """The slave's attitude against the master's and the mounting: rotation vector, rad.

    Textbook chapter "Inertial navigation", eqs. (2-161) to (2-167).
    """
    H[:] = 0.0
    # from the master's idea of b to the slave's, in b
    i, j = E_FA, E_NA
    a, b, c, d = multiply(s[i], s[i + 1], s[i + 2], s[i + 3], s[j], -s[j + 1], -s[j + 2], -s[j + 3])
    a, b, c, d = multiply(a, b, c, d, x[X_Q], x[X_Q + 1], x[X_Q + 2], x[X_Q + 3])
    px, py, pz = logarithm(a, b, c, d)
    r[0], r[1], r[2] = _turn(x, X_Q, px, py, pz)
    for k in range(3):
        e, f, g = _unit(k)
        H[k, _PHI + k] = -1.0
        axis = _turn(s, E_NA, e, f, g)
        _put(H, _MOUNTING + k, -1.0, axis)
        _put(H, _FLEXURE + k, -1.0, axis)
    # the Earth's turn is the same before and after
    i, j, way = I_TURNS, I_TURNS + 3, now[I_WAY]
    ux, uy, uz = (
        way * (now[I_W] - s[E_W]),
        way * (now[I_W + 1] - s[E_W + 1]),
        way * (now[I_W + 2] - s[E_W + 2]),
    )
    before = _turn(x, X_Q, now[i] - ux, now[i + 1] - uy, now[i + 2] - uz)
    after = _turn(x, X_Q, ux - now[j], uy - now[j + 1], uz - now[j + 2])
    slope, bend = _line(before, after, now)
    return dated(slope, bend, t[T_ATTITUDE], now[I_SPREAD], t[T_OWN], True, r, H, R)


@kernel
def rate_rows(
    x: Vector, now: Vector, m: Vector, t: Vector, s: Vector, r: Vector, H: Matrix, R: Matrix
) -> tuple[bool, float]:
    """The slave's rate against the master's, rad/s in b."""
    H[:] = 0.0
    wx, wy, wz = m[A_W], m[A_W + 1], m[A_W + 2]
    i = _X_RATE
    there, bends = _turn(s, E_FA, wx, wy, wz), _turn(s, E_BA, x[i], x[i + 1], x[i + 2])
    for k in range(3):
        e, f, g = _unit(k)
        r[k] = now[I_W + k] - there[k] - bends[k]
        H[k, _GYRO + k] = -1.0
        for j in range(3):
            H[k, _AXES + 3 * k + j] = -now[I_W + j]
        _put(H, _RATE + k, -1.0, _turn(s, E_BA, e, f, g))
        ux, uy, uz = cross(wx, wy, wz, e, f, g)
        turn = _turn(s, E_BA, ux, uy, uz)
        _put(H, _MOUNTING + k, -1.0, turn)
        _put(H, _FLEXURE + k, -1.0, turn)
    i, j = I_RATES, I_RATES + 3
    slope, bend = _line((-now[i], -now[i + 1], -now[i + 2]), (-now[j], -now[j + 1], -now[j + 2]), now)
    sigma = math.hypot(t[T_RATE], now[I_SIGMA])
    return dated(slope, bend, sigma, now[I_SPREAD], _own_change(now, t), False, r, H, R)
