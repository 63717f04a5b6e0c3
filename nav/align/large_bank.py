"""A bank of unscented filters that finds the attitude of a standing IMU from any azimuth.

Each member is a damped navigator of its own (`nav.strapdown.kernels`; its velocity and position are put back
to the known ones after every block) with an unscented filter of its Euler angles, level velocity and gyro
drifts beside it: Yan Gongmin 2008, section 4.5, with the estimate fed back. The printed filter, one of them
with an azimuth that may be anything, nearly always goes astray: a Gaussian of that width is no picture of
a circle. So members start round the circle, each with the part of it that is nearest, and their
likelihoods say which are right (Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums",
Automatica 7, 1971).

Gyro drifts are states from the beginning, against the report's advice: a tilt that grows by a drift would
be taken for one that grows by azimuth. An accelerometer's constant error is not seen beside the level, of
which it becomes a part; the vertical velocity, which shows one, is left out.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.earth import earth_rate_g, normal_gravity, position_matrix
from nav.errors.large import angles, attitude_rate, misalignment, standing_velocity_rate
from nav.filter.ukf import Points, predict, update
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, rotvec_from_quat
from nav.strapdown.control import control
from nav.strapdown.kernels import M_SIZE, X_C, X_H, X_HEAD, X_Q, X_V, strapdown
from nav.types import Vector

MEMBERS: Final = 16  # at 8 the curvature within a member's part of the circle still shows in the level
FORGOTTEN: Final = 1e-6  # weight of a member that is dropped
ALPHA: Final = slice(0, 3)
VEL: Final = slice(3, 5)  # level, computed minus true
DRIFT: Final = slice(5, 8)  # of the gyros, in b
SIZE: Final = 8
_H: Final = np.eye(SIZE)[VEL]
_FLOOR: Final = 1e-12  # rad/s: a covariance of no drift at all has no root


class Noise(NamedTuple):
    """What the filters are told: drift rad/s, random walks as in `AlignConfig`, sway m/s."""

    drift: float
    angle: float
    velocity: float
    sway: float


class Bank(NamedTuple):
    """Members that are still in question, and where they stand."""

    place: tuple[float, float, float]  # lat rad, lon rad, height m
    noise: Noise
    points: Points
    heads: Vector  # (M, X_HEAD): the navigators
    x: Vector  # (M, SIZE)
    P: Vector  # (M, SIZE, SIZE)
    weight: Vector  # (M,), sum 1


class Mean(NamedTuple):
    """All members as one: C_gb (3, 3), level velocity (2,), drifts (3,), P (SIZE, SIZE) of phi and these.

    True C_gb = (I + [phi x]) C; the velocity's error is computed minus true, the drift's true minus estimate.
    """

    C: Vector
    velocity: Vector
    drift: Vector
    P: Vector


def levelled(C_gb: Vector, dv: Vector) -> Vector:
    """``C_gb`` (3, 3) turned by the least angle that has the velocity increment ``dv`` (3,) in b point up.

    Two or three angles of 30 deg are beyond an unscented filter: its points, on one line per state, do not
    see that a sine is bent, and it believes a level that is wrong by degrees.
    """
    x, y, z = C_gb @ dv / np.linalg.norm(dv)
    q = np.array([1.0 + z, y, -x, 0.0])
    n = float(np.linalg.norm(q))
    return dcm_from_quat(q / n if n > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])) @ C_gb


def start(
    place: tuple[float, float, float],
    C_gb: Vector,
    tilt: float,
    noise: Noise,
    points: Points,
    members: int = MEMBERS,
) -> Bank:
    """Begin from an attitude (3, 3) whose level is good to ``tilt`` rad and whose azimuth says nothing.

    ``points`` are those of SIZE states.
    """
    lat, lon, height = place
    heads = np.zeros((members, X_HEAD))
    heads[:, X_C : X_C + 9] = position_matrix(lat, lon).ravel()
    heads[:, X_H] = height
    step = 2.0 * math.pi / members
    for k in range(members):
        heads[k, X_Q : X_Q + 4] = quat_from_dcm(misalignment([0.0, 0.0, k * step]) @ C_gb)
    sigma = np.array([tilt, tilt, 0.5 * step, *(noise.sway,) * 2, *(math.hypot(noise.drift, _FLOOR),) * 3])
    P = np.repeat(np.diag(sigma**2)[None], members, axis=0)
    weight = np.full(members, 1.0 / members)
    return Bank(place, noise, points, heads, np.zeros((members, SIZE)), P, weight)


def step(bank: Bank, turn: Vector, dv: Vector, dt: float) -> tuple[Bank, Vector, Vector]:
    """One block at rest: rotation vector ``turn`` (3,) and velocity increment ``dv`` (3,) in b at its start.

    Returns the innovation (2,) m/s of the member that it surprises least too, and its covariance (2, 2).
    """
    lat, lon, height = bank.place
    w, gravity = earth_rate_g(lat), normal_gravity(math.sin(lat), height)
    D = misalignment(bank.x[:, ALPHA])  # what is fed back
    heads = bank.heads.copy()
    C_pb = np.empty((len(heads), 3, 3))
    inc, u, mid = np.concatenate([turn, dv]), control(), np.empty(M_SIZE)
    home = position_matrix(lat, lon).ravel()
    for k, head in enumerate(heads):
        # the member's estimate becomes its navigator's attitude; velocity and position are the known ones
        head[X_Q : X_Q + 4] = quat_from_dcm(D[k].T @ dcm_from_quat(head[X_Q : X_Q + 4]))
        head[X_V : X_V + 2] -= bank.x[k, VEL]
        head[X_V + 2] = 0.0
        head[X_C : X_C + 9], head[X_H] = home, height
        strapdown(head, inc, dt, u, mid)
        C_pb[k] = mid[0:9].reshape(3, 3)

    fed = np.swapaxes(D, -1, -2)[:, None]  # (M, 1, 3, 3): from the navigator before to the one after

    def through(chi: Vector) -> Vector:
        out = chi.copy()
        alpha = angles(fed @ misalignment(chi[..., ALPHA]))
        drift = np.einsum("mij,mpj->mpi", C_pb, chi[..., DRIFT])
        middle = alpha + 0.5 * dt * attitude_rate(alpha, w, np.zeros(3), drift)
        out[..., ALPHA] = alpha + dt * attitude_rate(middle, w, np.zeros(3), drift)
        pull = standing_velocity_rate(middle, gravity, np.zeros(3))
        out[..., VEL] = chi[..., VEL] - bank.x[:, None, VEL] + dt * pull[..., 0:2]
        return out

    x, P = predict(bank.points, bank.x, bank.P, through, _noise(bank.noise, gravity, dt))
    z = heads[:, X_V : X_V + 2]
    x, P, innovation, S = update(x, P, z, _H, np.eye(2) * bank.noise.sway**2)
    square = np.einsum("mi,mi->m", innovation, np.linalg.solve(S, innovation[..., None])[..., 0])
    log = np.log(bank.weight) - 0.5 * (square + np.linalg.slogdet(S)[1])
    weight = np.exp(log - np.max(log))
    weight /= np.sum(weight)
    best = int(np.argmin(square))
    keep = weight > FORGOTTEN
    bank = bank._replace(heads=heads[keep], x=x[keep], P=P[keep], weight=weight[keep] / np.sum(weight[keep]))
    return bank, innovation[best], S[best]


def _noise(noise: Noise, gravity: float, dt: float) -> Vector:
    """g Q g^T (SIZE, SIZE) of a block: fed back, the Euler rates are those of the platform."""
    Q = np.zeros((SIZE, SIZE))
    walk = noise.angle**2 * dt
    Q[ALPHA, ALPHA] = np.eye(3) * walk
    # the tilt that walks within the block moves the velocity
    Q[VEL, VEL] = np.eye(2) * (noise.velocity**2 * dt + walk * (gravity * dt) ** 2 / 3.0)
    Q[3, 1] = Q[1, 3] = -0.5 * gravity * dt * walk
    Q[4, 0] = Q[0, 4] = 0.5 * gravity * dt * walk
    return Q


def mean(bank: Bank) -> Mean:
    """The members as one, weighted."""
    w, best = bank.weight, int(np.argmax(bank.weight))
    heads = dcm_from_quat(bank.heads[:, X_Q : X_Q + 4])
    C = np.swapaxes(misalignment(bank.x[:, ALPHA]), -1, -2) @ heads
    off = np.empty((len(w), SIZE))
    off[:, ALPHA] = rotvec_from_quat(np.stack([quat_from_dcm(turn) for turn in C @ C[best].T]))
    off[:, VEL] = bank.x[:, VEL] - bank.heads[:, X_V : X_V + 2]
    off[:, DRIFT] = bank.x[:, DRIFT]
    middle = w @ off
    off -= middle
    P = np.einsum("m,mij->ij", w, bank.P + off[:, :, None] * off[:, None, :])
    return Mean(dcm_from_quat(quat_from_rotvec(middle[ALPHA])) @ C[best], -middle[VEL], middle[DRIFT], P)
