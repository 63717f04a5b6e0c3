"""Apparent velocity: specific force seen from an inertial frame that the gyros hold still.

b0 is the body frame when an alignment begins, kept fixed in inertial space. Its attitude follows from the
gyros alone, and the specific force turned into it and integrated once and twice (Yan Gongmin 2008, eqs.
(3-10), (3-21a), (3-26a), (3-38a)) does not know about Earth, place or heading. A *row* (`A_SIZE`,) holds
these integrals since the beginning, with what a constant error of the sensors does to them. The difference of
two rows is the motion between them, so an epoch may lie anywhere, also between samples and in the past.

i0 is the other side: east-north-up of the start, kept fixed in inertial space as well (eq. (3-8) but for a
constant turn, which keeps what gravity tells at once apart from what only its drift does).
`gravity_integrals` and `Inertial` give what a body at known place must feel there.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.earth import EARTH_RATE, ecef, gravity_g, position_matrix
from nav.jit import kernel
from nav.rotation import exponential, multiply, quat_conjugate, quat_multiply, rotvec_from_quat
from nav.strapdown.kernels import increments
from nav.types import Vector

A_T: Final = 0  # s since the beginning
A_Q: Final = 1  # q_b0b, 4
A_V: Final = 5  # integral of f in b0, 3, m/s
A_P: Final = 8  # integral of that, 3, m
A_A: Final = 11  # integral of C_b0b by rows, 9, s: b0 turns by minus this per rad/s of gyro bias
A_B: Final = 20  # integral of [f x] A, 9, m: velocity per rad/s of gyro bias
A_E: Final = 29  # integral of A, 9, s^2: position per m/s^2 of accelerometer bias, minus
A_D: Final = 38  # integral of B, 9, m s: position per rad/s of gyro bias
A_SIZE: Final = 47
Times = NDArray[np.int64]

RING: Final = 1024  # rows remembered: two seconds at 1 kHz


class Tracker(NamedTuple):
    """The row of the present, and those of the last seconds with their times; arrays are used up."""

    row: Vector
    d: Vector  # (12,) samples that wait for the second of a pair
    waiting: Vector  # (2,): how many, and their seconds
    ring: Vector  # (RING, A_SIZE)
    times: Times  # (RING,)
    written: Times  # (1,), rows so far


def tracker(t_ns: int) -> Tracker:
    """A tracker that begins at ``t_ns``."""
    row = np.zeros(A_SIZE)
    row[A_Q] = 1.0
    ring = np.zeros((RING, A_SIZE))
    ring[0] = row
    times = np.zeros(RING, np.int64)
    times[0] = t_ns
    track = Tracker(row, np.zeros(12), np.zeros(2), ring, times, np.ones(1, np.int64))
    # the kernels that are needed much later are compiled now: nothing may pause the loop then
    present(track, row, row[A_Q : A_Q + 4], np.zeros(3), np.zeros(3))
    at(track, t_ns)
    return track


@kernel
def add(
    row: Vector,
    d: Vector,
    waiting: Vector,
    ring: Vector,
    times: Times,
    count: Times,
    dtheta: Vector,
    dv: Vector,
    dt: float,
    t_ns: int,
    flush: bool,
) -> None:
    """Take one inertial sample; pairs are worked in together (coning and sculling), or at once by ``flush``.

    The first six are the arrays of a `Tracker`; ``dtheta`` (3,) rad and ``dv`` (3,) m/s in b over ``dt`` s.
    """
    if waiting[0] == 0.0:
        d[0:3] = dtheta
        d[3:6] = dv
        waiting[0], waiting[1] = 1.0, dt
        if not flush:
            return
        n = 1
    else:
        d[6:9] = d[3:6]
        d[3:6] = dtheta
        d[9:12] = dv
        waiting[1] += dt
        n = 2
    inc = np.empty(6)
    increments(d, n, inc)
    _advance(row, inc, waiting[1])
    waiting[:] = 0.0
    place = count[0] % ring.shape[0]
    ring[place] = row
    times[place] = t_ns
    count[0] += 1


@kernel
def _matrix(w: float, x: float, y: float, z: float, c: Vector) -> None:
    c[0], c[1], c[2] = w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    c[3], c[4], c[5] = 2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)
    c[6], c[7], c[8] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z


@kernel
def _advance(row: Vector, inc: Vector, dt: float) -> None:
    """One update of ``row`` by the rotation vector and velocity increment ``inc`` (6,) over ``dt`` s."""
    before, after = np.empty(9), np.empty(9)
    qw, qx, qy, qz = row[1], row[2], row[3], row[4]
    _matrix(qw, qx, qy, qz, before)
    bw, bx, by, bz = exponential(inc[0], inc[1], inc[2])
    qw, qx, qy, qz = multiply(qw, qx, qy, qz, bw, bx, by, bz)
    norm = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    row[1], row[2], row[3], row[4] = qw * norm, qx * norm, qy * norm, qz * norm
    _matrix(row[1], row[2], row[3], row[4], after)
    u = np.empty(3)
    for i in range(3):
        u[i] = before[3 * i] * inc[3] + before[3 * i + 1] * inc[4] + before[3 * i + 2] * inc[5]
        row[8 + i] += (row[5 + i] + 0.5 * u[i]) * dt
        row[5 + i] += u[i]
    # trapezoids: these are sensitivities
    for j in range(9):
        step = 0.5 * (before[j] + after[j]) * dt
        row[29 + j] += (row[11 + j] + 0.5 * step) * dt
        before[j] = row[11 + j] + 0.5 * step  # A in the middle
        row[11 + j] += step
    for j in range(3):
        bx = u[1] * before[6 + j] - u[2] * before[3 + j]
        by = u[2] * before[j] - u[0] * before[6 + j]
        bz = u[0] * before[3 + j] - u[1] * before[j]
        row[38 + j] += (row[20 + j] + 0.5 * bx) * dt
        row[41 + j] += (row[23 + j] + 0.5 * by) * dt
        row[44 + j] += (row[26 + j] + 0.5 * bz) * dt
        row[20 + j] += bx
        row[23 + j] += by
        row[26 + j] += bz
    row[0] += dt


def present(track: Tracker, then: Vector, q_gb: Vector, w_ie_g: Vector, moved: Vector) -> Vector:
    """q_gb (4,) now, from ``q_gb`` at the row ``then`` and the gyros since.

    ``w_ie_g`` (3,) rad/s; ``moved`` (3,) rad: how far g has turned since by moving over the Earth.
    """
    out = np.empty(4)
    _present(track.row, track.d, track.waiting, then, q_gb, w_ie_g, moved, out)
    return out


@kernel
def _present(
    row: Vector,
    d: Vector,
    waiting: Vector,
    then: Vector,
    q_gb: Vector,
    w_ie_g: Vector,
    moved: Vector,
    out: Vector,
) -> None:
    dt = row[0] + waiting[1] - then[0]
    w, x, y, z = exponential(
        -w_ie_g[0] * dt - moved[0], -w_ie_g[1] * dt - moved[1], -w_ie_g[2] * dt - moved[2]
    )
    w, x, y, z = multiply(w, x, y, z, q_gb[0], q_gb[1], q_gb[2], q_gb[3])
    w, x, y, z = multiply(w, x, y, z, then[1], -then[2], -then[3], -then[4])
    w, x, y, z = multiply(w, x, y, z, row[1], row[2], row[3], row[4])
    if waiting[0] > 0.0:
        bw, bx, by, bz = exponential(d[0], d[1], d[2])
        w, x, y, z = multiply(w, x, y, z, bw, bx, by, bz)
    norm = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    out[0], out[1], out[2], out[3] = w * norm, x * norm, y * norm, z * norm


def at(track: Tracker, t_ns: int) -> Vector | None:
    """The row (A_SIZE,) at ``t_ns``, between its neighbours; None when it is not there yet or any more."""
    out = np.empty(A_SIZE)
    return out if _at(track.ring, track.times, int(track.written[0]), t_ns, out) else None


@kernel
def _at(ring: Vector, times: Times, count: int, t_ns: int, out: Vector) -> bool:
    size = ring.shape[0]
    k = count - 1
    oldest = max(0, count - size)
    if times[k % size] < t_ns or times[oldest % size] > t_ns:
        return False
    while k > oldest and times[(k - 1) % size] >= t_ns:
        k -= 1
    b = ring[k % size]
    if k == oldest or times[k % size] == t_ns:
        out[:] = b
        return True
    a = ring[(k - 1) % size]
    x = (t_ns - times[(k - 1) % size]) / (times[k % size] - times[(k - 1) % size])
    for i in range(a.shape[0]):
        out[i] = a[i] + x * (b[i] - a[i])
    # position follows the velocity; the quaternions are neighbours, so nothing is lost between them
    h = out[0] - a[0]
    for i in range(3):
        out[8 + i] = a[8 + i] + 0.5 * h * (a[5 + i] + out[5 + i])
    norm = math.sqrt(out[1] ** 2 + out[2] ** 2 + out[3] ** 2 + out[4] ** 2)
    out[1:5] /= norm
    return True


def before(track: Tracker) -> Vector:
    """The row before the last; at the beginning there is one already."""
    return np.asarray(track.ring[(int(track.written[0]) - 2) % RING])


class Change(NamedTuple):
    """What happened between two rows, in b0: seconds, integrals of force, sensitivities as in a row.

    ``turn`` (3,) rad is that of b, in its own axes.
    """

    dt: float
    dv: Vector
    dp: Vector
    A: Vector
    B: Vector
    E: Vector
    D: Vector
    turn: Vector


def change(a: Vector, b: Vector) -> Change:
    """The change from row ``a`` to row ``b``."""
    dt = float(b[A_T] - a[A_T])
    v_a, A_a, B_a = a[A_V : A_V + 3], a[A_A:A_B].reshape(3, 3), a[A_B:A_E].reshape(3, 3)
    dv = b[A_V : A_V + 3] - v_a
    dp = b[A_P : A_P + 3] - a[A_P : A_P + 3] - v_a * dt
    return Change(
        dt=dt,
        dv=dv,
        dp=dp,
        A=b[A_A:A_B].reshape(3, 3) - A_a,
        B=b[A_B:A_E].reshape(3, 3) - B_a - cross_matrix(dv) @ A_a,
        E=(b[A_E:A_D] - a[A_E:A_D]).reshape(3, 3) - A_a * dt,
        D=(b[A_D:A_SIZE] - a[A_D:A_SIZE]).reshape(3, 3) - B_a * dt - cross_matrix(dp) @ A_a,
        turn=rotvec_from_quat(quat_multiply(quat_conjugate(a[A_Q:A_V]), b[A_Q:A_V])),
    )


def swung(row: Vector) -> Vector:
    """Displacement (3,) m in b0 of a row, and its C_b0b (9,) by rows, of one piece (12,)."""
    out = np.empty(12)
    _swung(row, out)
    return out


@kernel
def _swung(row: Vector, out: Vector) -> None:
    out[0:3] = row[A_P : A_P + 3]
    _matrix(row[1], row[2], row[3], row[4], out[3:12])


def attitude(row: Vector) -> Vector:
    """C_b0b (3, 3) of a row."""
    C = np.empty(9)
    _matrix(row[1], row[2], row[3], row[4], C)
    return C.reshape(3, 3)


def cross_matrix(v: Vector) -> Vector:
    """[v x] (3, 3) of one vector (3,): `nav.rotation.skew` without its leading axes."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def spin(r: Vector) -> Vector:
    """w_ie x r (3,) in Earth-fixed axes, or in those they were at the beginning."""
    return np.array([-EARTH_RATE * float(r[1]), EARTH_RATE * float(r[0]), 0.0])


def C_i0g(start_lat: float, lat: float, lon_since: float, seconds: float) -> Vector:
    """C_i0g (3, 3) of a place ``lon_since`` rad east of the start, ``seconds`` after it; eq. (3-8)."""
    return np.asarray(
        position_matrix(start_lat, 0.0).T @ position_matrix(lat, lon_since + EARTH_RATE * seconds)
    )


def polar_axis(start_lat: float) -> Vector:
    """The Earth's axis (3,) in i0."""
    return np.array([0.0, math.cos(start_lat), math.sin(start_lat)])


def gravity_integrals(lat: float, height: float, seconds: float) -> tuple[Vector, Vector]:
    """Minus gravity of a fixed place, in i0, integrated once and twice (3,) over ``seconds`` from 0.

    Yan Gongmin 2008, eqs. (3-21b), (3-38b) and their integral: velocity (m/s) and position (m) that an
    IMU at rest would seem to gain.
    """
    C_eg = position_matrix(lat, 0.0)
    x, y, z = C_eg @ -gravity_g(lat, height)
    w, a = EARTH_RATE, EARTH_RATE * seconds
    # 1 - cos by the half angle, and a - sin by its series: nothing cancels in the first seconds
    s1, c1 = math.sin(a) / w, 2.0 * math.sin(0.5 * a) ** 2 / w
    c2 = c1 / w
    s2 = _angle_minus_sine(a) / (w * w)
    once = np.array([s1 * x - c1 * y, c1 * x + s1 * y, seconds * z])
    twice = np.array([c2 * x - s2 * y, s2 * x + c2 * y, 0.5 * seconds * seconds * z])
    return C_eg.T @ once, C_eg.T @ twice


def _angle_minus_sine(a: float) -> float:
    if abs(a) > 0.3:
        return a - math.sin(a)
    a2 = a * a
    return a * a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0 * (1.0 - a2 / 72.0 * (1.0 - a2 / 110.0))))


def turn(seconds: float) -> Vector:
    """Earth-fixed axes to those they were at the beginning (3, 3)."""
    a = EARTH_RATE * seconds
    return np.array([[math.cos(a), -math.sin(a), 0.0], [math.sin(a), math.cos(a), 0.0], [0.0, 0.0, 1.0]])


class Inertial(NamedTuple):
    """A known motion over the Earth: position at the start and gravitation integrated since.

    Eq. (3-26b) integrated by parts: velocities enter where they are measured, never their derivatives. The
    axes are Earth-fixed ones of the start, x in its meridian, which `felt` turns into i0.
    """

    lat: float  # of the start, rad
    lon: float
    r_0: Vector  # m
    seconds: float
    attraction: Vector  # gravitation at the last epoch, m/s^2
    once: Vector  # its integrals, m/s and m
    twice: Vector


def inertial(lat: float, lon: float, height: float) -> Inertial:
    """Begin at a place (rad, rad, m)."""
    r_0 = ecef(lat, 0.0, height)
    return Inertial(lat, lon, r_0, 0.0, _attraction(lat, 0.0, height, r_0, 0.0), np.zeros(3), np.zeros(3))


def _attraction(lat: float, lon_since: float, height: float, r: Vector, seconds: float) -> Vector:
    """Gravitation: gravity without what turning with the Earth takes off."""
    g = position_matrix(lat, lon_since + EARTH_RATE * seconds) @ gravity_g(lat, height)
    return np.asarray(g + spin(spin(r)))


def reach(path: Inertial, lat: float, lon: float, height: float, seconds: float) -> tuple[Inertial, Vector]:
    """Go on to a place (rad, rad, m) at ``seconds``: the path and the place's position, m."""
    since = math.remainder(lon - path.lon, 2.0 * math.pi)
    r = turn(seconds) @ ecef(lat, since, height)
    pull = _attraction(lat, since, height, r, seconds)
    dt = seconds - path.seconds
    # gravitation changes along a straight line
    once = path.once + 0.5 * dt * (path.attraction + pull)
    twice = path.twice + dt * path.once + dt * dt / 6.0 * (2.0 * path.attraction + pull)
    return Inertial(path.lat, path.lon, path.r_0, seconds, pull, once, twice), r


def felt(path: Inertial, r: Vector, v_i: Vector | None) -> tuple[Vector, Vector]:
    """Integrals of specific force (3,) m/s and (3,) m since the start, counted from rest on the Earth.

    In i0; ``r`` (3,) and ``v_i`` (3,) position and inertial velocity in the path's axes at its last epoch;
    without a velocity that of the Earth is taken.
    """
    start = spin(path.r_0)
    v = spin(r) if v_i is None else v_i
    C_i0e = position_matrix(path.lat, 0.0).T
    return C_i0e @ (v - start - path.once), C_i0e @ (r - path.r_0 - start * path.seconds - path.twice)
