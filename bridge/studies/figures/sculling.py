"""Coning and sculling together, through the whole strapdown kernel.

A body is shaken in a level circle while its vertical axis goes round a cone at the same frequency: velocity
and tilt are in phase, which is what sculling rectifies most. Coning shows as a turn about the vertical,
sculling as vertical velocity. Gravity sculls too: the tilting body feels it as a force that goes round.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.studies.figures.exact_increments import direction, integrals
from bridge.studies.figures.flights import small_turn
from nav import rotation as rot
from nav.strapdown.coning import coning_coefficients
from nav.strapdown.control import control
from nav.strapdown.kernels import X_C, X_HEAD, X_Q, X_V, integrate
from virtual_bus.ellipsoid import G0, OMEGA, gravity

Array = NDArray[np.float64]

ALPHA: Final = math.radians(1.0)
FREQUENCY: Final = 10.0  # Hz
SAMPLE: Final = 0.005  # s
SHAKE: Final = G0  # m/s^2
SECONDS: Final = 60
_RATE: Final = 2.0 * math.pi * FREQUENCY
_LAT_DEG: Final = 45.0
_NODES: Final = 24
_PIECE: Final = 10  # samples that one polynomial spans, half a round of the cone


class Shaken:
    """The motion in axes t: east, north, up at one place. ``C_et`` (3, 3) takes them to Earth-fixed ones."""

    def __init__(self) -> None:
        self.C_et = np.stack(direction(_LAT_DEG, 0.0), axis=-1)
        north, up = gravity(np.radians(_LAT_DEG), np.zeros(()))
        self.gravity_t = np.array([0.0, float(north), float(up)])
        self.w_ie_t = OMEGA * self.C_et[2]

    def attitude(self, t: Array) -> Array:
        """C_tb (n, 3, 3): tilted by alpha about a level axis that goes round."""
        c, s = np.cos(_RATE * t), np.sin(_RATE * t)
        return rot.dcm_from_quat(rot.quat_from_rotvec(ALPHA * np.stack((c, s, 0.0 * c), axis=-1)))

    def velocity(self, t: Array) -> Array:
        """v_t (n, 3), m/s."""
        c, s = np.cos(_RATE * t), np.sin(_RATE * t)
        return SHAKE / _RATE * np.stack((c, s, 0.0 * c), axis=-1)

    def rates(self, t: Array) -> Array:
        """w_ib_b (rad/s) and f_b (m/s^2), (n, 6)."""
        c, s = np.cos(_RATE * t), np.sin(_RATE * t)
        C_tb = self.attitude(t)
        # Yan Gongmin 2008, eq. (6-3): a cone about the third axis
        sin_alpha, axis = math.sin(ALPHA), -2.0 * math.sin(0.5 * ALPHA) ** 2
        w_tb_b = _RATE * np.stack((-sin_alpha * s, sin_alpha * c, np.full_like(c, axis)), axis=-1)
        accel = SHAKE * np.stack((-s, c, 0.0 * c), axis=-1)
        # over millimetres gravity is constant
        force = accel + 2.0 * np.cross(self.w_ie_t, self.velocity(t)) - self.gravity_t
        return np.concatenate((w_tb_b + self.w_ie_t @ C_tb, np.einsum("nij,ni->nj", C_tb, force)), axis=-1)


def drift(samples: int) -> tuple[float, float]:
    """Turn about the vertical (rad) and vertical velocity (m/s) after a minute, true minus computed."""
    motion = Shaken()
    begin, end = np.zeros(1), np.array([float(SECONDS)])
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = rot.quat_from_dcm(motion.attitude(begin)[0])
    x[X_V : X_V + 3] = motion.velocity(begin)[0]
    x[X_C : X_C + 9] = motion.C_et.ravel()
    pieces = round(SECONDS / SAMPLE) // _PIECE
    counts = np.concatenate(list(integrals(motion.rates, SAMPLE, pieces, _PIECE, _NODES)))
    integrate(x, counts, SAMPLE, samples, control(), 1, np.empty((0, X_HEAD)))
    # level axes of where the vibration has led, which are those of the beginning but for wander of 1e-10 rad
    C_tn = motion.C_et.T @ x[X_C : X_C + 9].reshape(3, 3)
    C_tb = C_tn @ rot.dcm_from_quat(x[X_Q : X_Q + 4])
    turn = small_turn(motion.attitude(end), C_tb[None])[0, 2]
    return float(turn), float(motion.velocity(end)[0, 2] - (C_tn @ x[X_V : X_V + 3])[2])


def sculling(samples: int) -> float:
    """Closed form of the vertical velocity of `drift`, m/s, to second order in the tilt.

    In an update of x = N lambda the axis of the body goes from e_0 to e_N, unit vectors on a circle. Sample i
    counts the angles alpha (e_i - e_i-1), a = 2 sin(lambda/2) long and along the tangent of its middle,
    and of the level force, shake and gravity on the tilted body B = A + alpha g, B/Omega times the same.
    Sums are over j, the samples from the last one back, with the coefficients k_j. True minus computed
    velocity of an update, times Omega, is made of

    - sculling proper, the dual of coning with tilt and velocity in the place of the tilt twice:
      2 alpha B [(x - sin x)/2 - sum k_j a^2 sin(j lambda)];
    - the turn of gravity as if the rate were constant: alpha^2 g times sin x - x + x (1 - cos x)/3, which
      is -x^5/180 to lowest order;
    - from three samples on the kernel's third-order term (`nav.strapdown.coning.velocity_increment`). Of
      gravity, the one increment of order zero, its brackets are -|s|^2/240 and S.b/360 with the whole turn
      S = 2 sin(x/2), slope s and bend b as there: -alpha^2 g x times their sum, +x^5/180 to lowest order;
    - what the coefficients leave of the level velocity that gravity gains, lifted by the tilt at the start
      of the update: -alpha^2 g cos(x/2) times
      2 sin(x/2) - x cos(x/2) - lambda a sum k_j (sin d - sin(d - j lambda)), d = (N - 1) lambda/2.
    """
    lam = _RATE * SAMPLE
    x, d, a = samples * lam, 0.5 * (samples - 1) * lam, 2.0 * math.sin(0.5 * lam)
    g = float(-gravity(np.radians(_LAT_DEG), np.zeros(()))[1])
    k = [float(one) for one in coning_coefficients(samples)] if samples > 1 else []
    pairs = sum(k_j * a * a * math.sin(j * lam) for j, k_j in enumerate(k, 1))
    moments = sum(k_j * a * (math.sin(d) - math.sin(d - j * lam)) for j, k_j in enumerate(k, 1))
    dual = 2.0 * ALPHA * (SHAKE + ALPHA * g) * (0.5 * (x - math.sin(x)) - pairs)
    rotation = math.sin(x) - x + x * (1.0 - math.cos(x)) / 3.0
    lifted = math.cos(0.5 * x) * (2.0 * math.sin(0.5 * x) - x * math.cos(0.5 * x) - lam * moments)
    third = x * _brackets(samples, lam) if samples > 2 else 0.0
    return (dual + ALPHA**2 * g * (rotation - third - lifted)) / _RATE * SECONDS / (samples * SAMPLE)


def _brackets(samples: int, lam: float) -> float:
    """S.b/360 - |s|^2/240 of the angles of `sculling`, over alpha^2.

    Slope and bend are those of a parabola through the samples' angles: first to last, and first and last
    against the two in the middle (twice the one there), each scaled to the update.
    """
    at = lam * (np.arange(samples) - 0.5 * (samples - 1))
    steps = 2.0 * math.sin(0.5 * lam) * np.stack((np.cos(at), np.sin(at)), axis=-1)
    places = np.arange(samples) - 0.5 * (samples - 1)
    slope = (steps[-1] - steps[0]) * samples**2 / (samples - 1)
    low, high = (samples - 1) // 2, samples // 2
    outer, inner = places[0] ** 2 + places[-1] ** 2, places[low] ** 2 + places[high] ** 2
    bend = (steps[0] + steps[-1] - steps[low] - steps[high]) * samples**3 / (outer - inner)
    return float(steps.sum(axis=0) @ bend / 360.0 - slope @ slope / 240.0)
