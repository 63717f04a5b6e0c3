"""The constant rotation between two inertial frames, with what disturbs it: one linear filter.

Apparent velocity in b0 is C_b0i0 times what gravity and motion ask for in i0 (Yan Gongmin 2008, eqs. (3-20),
(3-25), (3-37b)). The nine elements of that constant matrix, free of each other, enter linearly; so do
sensor biases, their noise and the velocity at the start, because everything they act on is measured in b0.
A Kalman filter therefore solves the whole problem from no attitude at all and exactly, epoch after
epoch, with nothing to linearise and no data to keep. That the nine are a rotation is used afterwards, by
`two_vectors` (eq. (3-22)) or by `attitude_of_all` (Wahba's problem), and what they miss of a rotation
says whether the data belong to this latitude and these sensors.

Errors are true minus estimate. True C_b0b = (I + [theta x]) C_b0b by the gyros; true integrals of specific
force = those measured + s, + p.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.apparent import Change, cross_matrix
from nav.align.match_filter import Indices, own_errors
from nav.align.types import AlignConfig
from nav.rotation import dcm_from_quat, quat_from_rotvec, skew
from nav.types import Vector

MAT: Final = slice(0, 9)  # C_b0i0 by rows
EPS: Final = slice(9, 12)  # rad/s, gyro bias in b
NAB: Final = slice(12, 15)  # m/s^2, accelerometer bias in b
THETA: Final = slice(15, 18)  # rad, in b0
VEL: Final = slice(18, 21)  # m/s, in b0
POS: Final = slice(21, 24)  # m, in b0
START: Final = slice(24, 27)  # m/s, velocity over the Earth at the beginning, in b0
OFFSET: Final = slice(27, 30)  # m, in b0: place at the beginning, what a reference wanders off
WHEEL: Final = slice(30, 33)  # 1, rad, rad: odometer scale, mounting in heading and in pitch
LEVER: Final = WHEEL  # m, in b: from the point about which a base sways, which has no wheels, to the IMU
SIZE: Final = 33
OWN: Final = slice(SIZE, None)  # entries of M_g, M_a: errors of scale and axes, as many as an estimate has
FREE: Final = 1.0 / 3.0  # variance of an element of any rotation
MISFIT: Final = 50.0  # chi-square of twelve degrees of freedom that no run of the mill data reach
UNKNOWN: Final = 0.2  # rad: less is known of the rotation than its covariance can say
_NONE: Final = np.zeros(0, np.intp)
_EYE: Final = np.eye(3)
_CROSS: Final = skew(_EYE)  # [e_k x]


class Estimate(NamedTuple):
    """State (n,) and covariance of the filter, the first `SIZE` of which are always there.

    ``feigned`` (9, 9) is what of their information about the elements is none: that they are zero. The filter
    begins with it, and noise in a vector that they multiply adds to it, epoch by epoch.

    From `OWN` on are the errors of scale and axes that there are: ``own_g`` and ``own_a`` say which entries
    of M_g and of M_a, row by row, by which in b a rate w is off by M_g w, and a specific force f by
    M_a (f - ``force``). `NAB` holds at that (3,) m/s^2.
    """

    x: Vector
    P: Vector
    feigned: Vector = np.eye(9) / FREE
    own_g: Indices = _NONE
    own_a: Indices = _NONE
    force: Vector = np.zeros(3)


def begin(
    config: AlignConfig, start: float, offset: float, wheel: Vector, force: Vector | None = None
) -> Estimate:
    """Nothing known of the rotation; ``start`` m/s, ``offset`` m and ``wheel`` (3,) standard deviations.

    A base that turns shows errors of scale and axes. Where it does, ``force`` (3,) m/s^2 in b is what is felt
    at the beginning, gravity for the most part: what these errors make of that is in the constant ones.
    """
    P = np.zeros(SIZE)
    P[MAT] = FREE
    P[EPS], P[NAB] = config.gyro_bias**2, config.accel_bias**2
    P[START], P[OFFSET] = start**2, offset**2
    P[WHEEL] = wheel**2
    _turned(_EYE, np.zeros(3))  # compiles what the first solution needs
    e = Estimate(np.zeros(SIZE), np.diag(P))
    if force is None:
        return e
    own_g, own_a, own = own_errors(config)
    P = np.concatenate([P, own])
    return e._replace(x=np.zeros(len(P)), P=np.diag(P), own_g=own_g, own_a=own_a, force=force)


def transition(c: Change, forget_s: float = math.inf) -> Vector:
    """The state after a change of the rows, by that before, (SIZE, SIZE); the offset lasts ``forget_s``."""
    F = np.eye(SIZE)
    force = cross_matrix(c.dv)
    F[THETA, EPS] = -c.A
    F[VEL, THETA], F[VEL, EPS], F[VEL, NAB] = -force, c.B, -c.A
    F[POS, VEL], F[POS, THETA] = _EYE * c.dt, -cross_matrix(c.dp)
    F[POS, EPS], F[POS, NAB] = c.D, -c.E
    F[OFFSET, OFFSET] *= math.exp(-c.dt / forget_s)
    return F


def _by_own(e: Estimate, c: Change) -> Vector:
    """What errors of scale and axes do to the state over a change of the rows, (SIZE, m)."""
    F = np.zeros((SIZE, len(e.x) - SIZE))
    gyro, accel = slice(0, len(e.own_g)), slice(len(e.own_g), None)
    # mean axes by mean rates and forces: from epoch to epoch it turns by little
    tilt = -c.A[:, e.own_g // 3] * (c.turn / c.dt)[e.own_g % 3]
    push = (c.A.T @ c.dv / c.dt**2 - e.force)[e.own_a % 3]
    F[THETA, gyro] = tilt
    F[VEL, gyro] = -0.5 * cross_matrix(c.dv) @ tilt
    F[POS, gyro] = -cross_matrix(c.dp) @ tilt / 3.0
    F[VEL, accel] = -c.A[:, e.own_a // 3] * push
    F[POS, accel] = -c.E[:, e.own_a // 3] * push
    return F


def meanwhile(c: Change) -> Vector:
    """Error of the mean velocity over a change of the rows by the state after it, (3, SIZE)."""
    before = np.linalg.inv(transition(c))
    return np.asarray((np.eye(SIZE)[POS] - before[POS]) / c.dt)


def predict(
    e: Estimate, c: Change, config: AlignConfig, walk: Vector, forget_s: float = math.inf
) -> Estimate:
    """Over a change of the rows; ``walk`` (3, 3) m^2/s drives the offset, which lasts ``forget_s``."""
    n = len(e.x)
    F, force = np.eye(n), cross_matrix(c.dv)
    F[:SIZE, :SIZE] = transition(c, forget_s)
    if n > SIZE:
        F[:SIZE, OWN] = _by_own(e, c)
    Q = np.zeros((n, n))
    Q[EPS, EPS] = config.gyro_walk**2 * c.dt * _EYE
    Q[NAB, NAB] = config.accel_walk**2 * c.dt * _EYE
    turn, push = config.angle_random_walk**2 * c.dt, config.velocity_random_walk**2 * c.dt
    Q[THETA, THETA] = turn * _EYE
    # the attitude that walks within the change turns the force: integrals of a random walk
    Q[VEL, THETA] = -0.5 * turn * force
    Q[THETA, VEL] = Q[VEL, THETA].T
    Q[VEL, VEL] = push * _EYE + turn / 3.0 * force @ force.T
    Q[POS, VEL] = Q[VEL, POS] = 0.5 * push * c.dt * _EYE
    Q[POS, POS] = push * c.dt**2 / 3.0 * _EYE
    Q[OFFSET, OFFSET] = walk * c.dt
    return e._replace(x=F @ e.x, P=F @ e.P @ F.T + Q)


def design(u: Vector, further: Vector | None = None, axis: Vector | None = None) -> Vector:
    """H (3, SIZE) of C_b0i0 ``u`` (3,), and of ``further`` (3, 3) C_b0i0 ``axis`` (3,)."""
    H = np.zeros((3, SIZE))
    for i in range(3):
        H[i, 3 * i : 3 * i + 3] = u
    if further is not None and axis is not None:
        H[:, MAT] += np.kron(further, axis)
    return H


class Innovation(NamedTuple):
    """What an epoch says against what was expected of it: (3,), and its covariance."""

    nu: Vector
    S: Vector

    @property
    def chi2(self) -> float:
        """Normalised square, three degrees of freedom."""
        return float(self.nu @ np.linalg.solve(self.S, self.nu))


def innovation(e: Estimate, H: Vector, z: Vector, R: Vector) -> Innovation:
    """Of ``z`` (3,) = H x + noise of covariance ``R`` (3, 3)."""
    return Innovation(z - H @ e.x[:SIZE], H @ e.P[:SIZE, :SIZE] @ H.T + R)


def update(e: Estimate, H: Vector, z: Vector, R: Vector, noise: Vector | None = None) -> Estimate:
    """Take the epoch into the estimate. Joseph's form: positions are large against what they tell.

    ``noise`` (3, 3): covariance in i0 of the vector in ``H``, where R is due to that. The squares of such
    noise look as if the elements had been seen to be smaller.
    """
    nu, S = innovation(e, H, z, R)
    K = np.linalg.solve(S, H @ e.P[:SIZE]).T
    keep = np.eye(len(e.x))
    keep[:, :SIZE] -= K @ H
    P = keep @ e.P @ keep.T + K @ R @ K.T
    feigned = e.feigned if noise is None else e.feigned + np.kron(np.linalg.inv(R), noise)
    return e._replace(x=e.x + K @ nu, P=0.5 * (P + P.T), feigned=feigned)


class Solved(NamedTuple):
    """The rotation: C_b0i0 (3, 3), the rest of the state, and the joint covariance.

    The first three places of ``P`` (n - 6, n - 6) are psi, true C_b0i0 = (I + [psi x]) C; the others
    follow the state's from `EPS` on, six places earlier. ``misfit``: chi-square of six degrees of freedom
    that the nine elements miss a rotation by.
    """

    C: Vector
    x: Vector
    P: Vector
    misfit: float


def _by_elements(C: Vector) -> Vector:
    """d vec(C) / d psi (9, 3)."""
    return np.ascontiguousarray((_CROSS @ C).reshape(3, 9).T)


def _q_method(B: Vector) -> Vector:
    """C that maximises tr(C B^T): the quaternion is an eigenvector. Davenport's q-method; Wahba 1965."""
    # of the rotation i0 to b0: B = sum of w v u^T
    z = np.array([B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]])
    trace = float(np.trace(B))
    K = np.empty((4, 4))
    K[0, 0] = trace
    K[0, 1:] = K[1:, 0] = z
    K[1:, 1:] = B + B.T - trace * _EYE
    return np.asarray(dcm_from_quat(np.linalg.eigh(K)[1][:, -1]))


def attitude_of_all(e: Estimate) -> Solved | None:
    """Wahba's problem with all the data: the rotation nearest to the nine elements, by their covariance.

    The weights are the inverse covariance that sensor noise, biases and disturbances give the elements, less
    what is feigned. The q-method solves it with the mean of them over the axes of b0, which is exact where
    nothing prefers an axis; a few Gauss-Newton steps put in what differs. None while it is not known to
    `UNKNOWN`.
    """
    try:
        weight = np.linalg.inv(e.P[MAT, MAT])
    except np.linalg.LinAlgError:
        return None
    m, true = e.x[MAT], weight - e.feigned
    told = weight @ m
    C = _q_method(m.reshape(3, 3) @ np.einsum("iaib->ab", weight.reshape(3, 3, 3, 3)))
    for _ in range(6):
        J = _by_elements(C)
        A = J.T @ true @ J
        if float(np.linalg.eigvalsh(A)[0]) <= 1.0 / UNKNOWN**2:
            return None
        psi = np.asarray(np.linalg.solve(A, J.T @ (told - true @ C.ravel())), np.float64)
        C = _turned(C, psi)
        if float(np.abs(psi).max()) < 1e-10:
            break
    J = _by_elements(C)
    sigma = np.asarray(np.linalg.inv(J.T @ true @ J), np.float64)
    if float(np.trace(sigma)) > UNKNOWN**2:
        return None
    gain = e.P[:, MAT] @ weight
    spread = gain @ J
    x = e.x - gain @ (m - C.ravel())
    rest = e.P - gain @ e.P[MAT, :] + spread @ sigma @ spread.T
    misfit = _misfit(told - true @ C.ravel(), true, e.feigned, C)
    return _joint(C, x, sigma, sigma @ spread[9:].T, rest, misfit)


def _misfit(off: Vector, true: Vector, feigned: Vector, C: Vector) -> float:
    """Chi-square of what the elements miss a rotation by, of those that are told by more than noise.

    What noise feigns scatters, and is not known better than the receiver's claims about itself.
    """
    size, axes = np.linalg.eigh(true)
    false = np.einsum("ik,ij,jk->k", axes, feigned, axes)
    claimed = axes.T @ feigned @ C.ravel()
    square = (axes.T @ off) ** 2 / (np.abs(size) + 2.0 * false + claimed**2)
    return float(np.sum(square[size > false]))


def unshrunk(e: Estimate, C: Vector) -> Vector:
    """The state, had what is feigned been that the elements are those of ``C`` (3, 3) instead of zero.

    Elements that data leave open are too small without.
    """
    return np.asarray(e.x + e.P[:, MAT] @ e.feigned @ C.ravel())


def two_vectors(e: Estimate, u_l: Vector, u_m: Vector) -> Solved | None:
    """Eq. (3-22): the rotation from the images of two vectors (3,) of i0, of which ``u_m`` counts fully."""
    found = attitude_of_all(e)
    if found is None:
        return None
    x = unshrunk(e, found.C)
    M = x[MAT].reshape(3, 3)
    v_l, v_m = M @ u_l, M @ u_m
    if float(np.linalg.norm(np.cross(v_m, v_l))) < 1e-12:
        return None
    C = _frame(v_m, v_l) @ _frame(u_m, u_l).T
    # psi of a small change of the images: v_m turns by two components, v_l gives the third
    a, b, c = _frame(v_m, v_l).T
    size_m, size_l = float(np.linalg.norm(v_m)), float(v_l @ np.cross(b, a))
    along = float(v_l @ a)
    # da = psi x a: components of dv_m across a; then what is left of dv_l out of the plane
    G_m = (np.outer(b, -c) + np.outer(c, b)) / size_m
    out_m, out_l = -along / (size_m * size_l) * b, b / size_l
    by_m, by_l = G_m + np.outer(a, out_m), np.outer(a, out_l)
    G = np.zeros((3, 9))
    for i in range(3):
        G[:, 3 * i : 3 * i + 3] = np.outer(by_m[:, i], u_m) + np.outer(by_l[:, i], u_l)
    cross = G @ e.P[MAT, 9:]
    sigma = G @ e.P[MAT, MAT] @ G.T
    if float(np.trace(sigma)) > UNKNOWN**2:
        return None
    return _joint(C, x, sigma, cross, e.P, found.misfit)


def _frame(first: Vector, second: Vector) -> Vector:
    """Columns: first, first x second, and their product, each of unit length; eq. (3-22)."""
    a = first / np.linalg.norm(first)
    b = np.cross(a, second)
    b /= np.linalg.norm(b)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def _turned(C: Vector, psi: Vector) -> Vector:
    angle = float(np.linalg.norm(psi))
    if angle > 0.5:
        psi = psi * (0.5 / angle)
    return np.asarray(dcm_from_quat(quat_from_rotvec(psi))) @ C


def _joint(C: Vector, x: Vector, sigma: Vector, cross: Vector, P: Vector, misfit: float) -> Solved:
    out = np.empty((len(P) - 6, len(P) - 6))
    out[:3, :3], out[:3, 3:], out[3:, :3], out[3:, 3:] = sigma, cross, cross.T, P[9:, 9:]
    return Solved(C, x, 0.5 * (out + out.T), misfit)
