"""The error model of transfer alignment: what is known at first, and what messages of the master show.

The textbook chapter "Inertial navigation", section 2.5.3, compares Euler angles, eqs. (2-169) to (2-174);
here the rotation vector between the two attitudes is compared, the same to first order (``T_b lambda - phi``)
and regular everywhere. The slave sits at the end of an arm that turns with it, so that its own gyros tell
the velocity that the arm makes: no rates of the master are needed, and flexure is in it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav.align.types import AlignConfig, TransferConfig
from nav.earth import EARTH_RATE, ecef, position_matrix
from nav.rotation import cross, dcm_from_quat, quat_from_dcm, quat_from_rotvec, rotvec_from_quat, skew
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.transfer.covariance import MARKOV
from nav.transfer.states import (
    ACCEL_BIAS,
    DELAY,
    FLEXURE,
    FLEXURE_RATE,
    GYRO_AXES,
    GYRO_BIAS,
    LEVER,
    MOUNTING,
    MOVED,
    PHI,
    POSITION,
    SIZE,
    VELOCITY,
    X_ERRORS,
)
from nav.types import MasterState

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

CURVED: Final = 0.03
"""Of what the delay's uncertainty does to a row: more that is no straight line makes it useless."""
CHANGE_S: Final = 0.02
"""Over which the change of the rate at an instant is taken."""
CHANCE: Final = 16.3
"""Chi-square of three that noise exceeds in one of a thousand."""
_EYE: Final = np.eye(3)
_ZERO: Final = np.zeros(3)


class Instant(NamedTuple):
    """How the slave moves at a message's time: in b rate ``w_b`` and its change ``dw_b``, in n acceleration.

    ``w_b`` (3,) rad/s with respect to inertial space, corrected; ``dw_b`` rad/s^2; ``a_n`` (3,) m/s^2 rate of
    v_n. ``sigma_w`` rad/s is the noise of w_b. ``spread`` s is sqrt(3) sigma of the delay; of as long before
    and after: ``turns`` (2, 3) rad turned in between, and ``rates`` (2, 3) rad/s there, less w_b.
    """

    w_b: Vector
    dw_b: Vector
    a_n: Vector
    sigma_w: float
    spread: float
    turns: Matrix
    rates: Matrix


def place(states: slice) -> slice:
    """Where the nominal values of ``states`` (from `GYRO_BIAS` on) stand in the nominal state."""
    return slice(X_ERRORS + states.start - MOVED, X_ERRORS + states.stop - MOVED)


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


def azimuth(x: Vector, lat: float, lon: float) -> Matrix:
    """C_ng (3, 3): turn of n about the vertical from east-north-up at ``lat``, ``lon`` (rad)."""
    M = x[X_C : X_C + 9].reshape(3, 3).T @ position_matrix(lat, lon)
    angle = math.atan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Rows(NamedTuple):
    """Rows in n (rates: in b): ``r`` (3,) computed minus measured, ``H`` (3, SIZE), ``R`` (3, 3).

    Not ``straight``: they depend on the delay by no straight line over what is known of it, and are useless.
    Only ``share`` of the gain that they have for the delay is used.
    """

    r: Vector
    H: Matrix
    R: Matrix
    straight: bool = True
    share: float = 1.0


class Line(NamedTuple):
    """What a delay does to a row: its ``slope`` (3,) per second, and ``bend`` (3,) from a straight line."""

    slope: Vector
    bend: Vector

    def rows(self, r: Vector, H: Matrix, sigma: float, spread: float, own: float) -> Rows:
        """Rows with noise ``sigma``: the best line over three sigma points, and what bends away from it.

        ``own``: sigma an axis of the slope by what the slave alone does: it bends, vibrates, its gyros are
        noisy. A slope that may be nothing else tells no delay, and to take it for one would find a wrong one
        ever more surely; then the delay is considered, but not corrected by the row. It is no noise of the
        row: that would fade over messages, and a delay is the same in all of them.
        """
        size = float(self.slope @ self.slope)
        share = max(0.0, 1.0 - CHANCE * own**2 / size) if size > 0.0 else 0.0
        H[:, DELAY] = -self.slope
        bend = math.sqrt(2.0) / 3.0 * float(np.linalg.norm(self.bend))
        straight = bend < max(sigma, CURVED * spread * float(np.linalg.norm(self.slope)))
        R = _EYE * sigma**2 + 2.0 / 9.0 * np.outer(self.bend, self.bend)
        return Rows(r - self.bend / 3.0, H, R, straight, share)


def line(before: Vector, after: Vector, spread: float) -> Line:
    """Of what a row gains (3,) where the message is older by ``spread`` s, and where it is younger."""
    return Line(0.5 * (before - after) / spread, 0.5 * (before + after))


class Scene(NamedTuple):
    """What the rows of a message share: matrices (3, 3), vectors (3,).

    ``C`` C_nb, ``C_ng``, ``C_na`` by the master where it tells; ``C_ba`` by the mounting estimated and
    ``C_fa``, the same, by flexure besides; the arm ``l_a`` m; ``w_eb`` rad/s the rate against the Earth in b.
    """

    x: Vector
    now: Instant
    master: MasterState
    transfer: TransferConfig
    C: Matrix
    C_ng: Matrix
    C_na: Matrix
    C_ba: Matrix
    C_fa: Matrix
    l_a: Vector
    w_eb: Vector

    @property
    def own_rate(self) -> float:
        """Sigma of what the slave turns by alone, rad/s an axis: flexure, and what is in the rates' noise."""
        transfer = self.transfer
        bends = 0.0 if transfer.flexure is None else float(np.max(transfer.flexure / transfer.flexure_time))
        return math.hypot(transfer.sigma_rate, MARKOV * bends)

    @property
    def own_change(self) -> float:
        """Sigma of how fast that changes, rad/s^2, as it is seen over the spread of the delay."""
        return self.own_rate / (math.sqrt(2.0) * (self.now.spread or 0.5 * CHANGE_S))


def scene(x: Vector, now: Instant, master: MasterState, transfer: TransferConfig) -> Scene:
    """By the nominal state ``x`` (X_SIZE,) at the message's time."""
    C = dcm_from_quat(x[X_Q : X_Q + 4])
    C_ba = transfer.C_ab.T @ dcm_from_quat(quat_from_rotvec(-x[place(MOUNTING)]))
    C_fa = C_ba @ dcm_from_quat(quat_from_rotvec(-x[place(FLEXURE)]))
    C_ng = azimuth(x, master.lat, master.lon)
    C_na = C @ C_fa if master.q_ga is None else C_ng @ dcm_from_quat(master.q_ga)
    l_a = transfer.lever_arm + x[place(LEVER)]
    w_eb = now.w_b - C.T @ (EARTH_RATE * x[X_C + 6 : X_C + 9])
    return Scene(x, now, master, transfer, C, C_ng, C_na, C_ba, C_fa, l_a, w_eb)


def position_rows(s: Scene) -> Rows:
    """The slave's position against the master's and the arm, m."""
    x, m = s.x, s.master
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    lat = math.asin(min(1.0, max(-1.0, C_en[2, 2])))
    lon = math.atan2(C_en[1, 2], C_en[0, 2])
    between = C_en.T @ (ecef(lat, lon, float(x[X_H])) - ecef(m.lat, m.lon, m.height))
    C_na = s.C @ s.C_ba
    arm = C_na @ s.l_a
    H = np.zeros((3, SIZE))
    H[:, POSITION] = _EYE
    H[:, PHI] = -skew(arm)
    H[:, LEVER] = -C_na
    H[:, MOUNTING] = -C_na @ skew(s.l_a)
    H[:, DELAY] = -x[X_V : X_V + 3]
    return Rows(between - arm, H, _EYE * s.transfer.sigma_position**2)


def velocity_rows(s: Scene) -> Rows:
    """The slave's velocity against the master's and what the arm makes of rotation, m/s."""
    x, C, l_b = s.x, s.C, s.C_ba @ s.l_a
    swing = C @ cross(s.w_eb, l_b)
    turn = C @ skew(s.w_eb)
    lag = C @ skew(l_b)
    H = np.zeros((3, SIZE))
    H[:, VELOCITY] = _EYE
    H[:, PHI] = -skew(swing)
    H[:, GYRO_BIAS] = -lag
    H[:, GYRO_AXES] = -np.einsum("ij,k->ijk", lag, s.now.w_b).reshape(3, 9)
    H[:, LEVER] = -turn @ s.C_ba
    H[:, MOUNTING] = -turn @ s.C_ba @ skew(s.l_a)
    r = x[X_V : X_V + 3] - s.C_ng @ s.master.v_g - swing
    # of the master's point: without what the arm adds, whose rate may change in that time
    gained = s.now.a_n - turn @ cross(s.w_eb, l_b)
    if s.now.spread > 0.0:
        before, after = s.now.rates
        away = line(-lag @ before, -lag @ after, s.now.spread)
    else:
        away = Line(lag @ s.now.dw_b, _ZERO)
    rows = Line(gained + away.slope, away.bend).rows(
        r, H, s.transfer.sigma_velocity, s.now.spread, s.own_change * float(np.linalg.norm(l_b))
    )
    return rows._replace(R=rows.R + lag @ lag.T * s.now.sigma_w**2)


def attitude_rows(s: Scene) -> Rows:
    """The slave's attitude against the master's and the mounting: rotation vector, rad.

    Textbook chapter "Inertial navigation", eqs. (2-161) to (2-167).
    """
    assert s.master.q_ga is not None
    # from the master's idea of b to the slave's, in b
    D = s.C_fa @ s.C_na.T @ s.C
    H = np.zeros((3, SIZE))
    H[:, PHI] = -_EYE
    H[:, MOUNTING] = -s.C_na
    H[:, FLEXURE] = -s.C_na
    r = s.C @ rotvec_from_quat(quat_from_dcm(D))
    if s.now.spread > 0.0:
        earth = s.now.spread * (s.now.w_b - s.w_eb)
        before, after = s.now.turns
        away = line(s.C @ (before - earth), -s.C @ (after - earth), s.now.spread)
    else:
        away = Line(s.C @ s.w_eb, _ZERO)
    return away.rows(r, H, s.transfer.sigma_attitude, s.now.spread, s.own_rate)


def rate_rows(s: Scene) -> Rows:
    """The slave's rate against the master's, rad/s in b."""
    assert s.master.w_ia_a is not None
    w, w_a = s.now.w_b, s.master.w_ia_a
    turn = s.C_ba @ skew(w_a)
    H = np.zeros((3, SIZE))
    H[:, GYRO_BIAS] = -_EYE
    H[:, GYRO_AXES] = -np.kron(_EYE, w)
    H[:, MOUNTING] = -turn
    H[:, FLEXURE] = -turn
    H[:, FLEXURE_RATE] = -s.C_ba
    if s.now.spread > 0.0:
        before, after = s.now.rates
        away = line(-before, -after, s.now.spread)
    else:
        away = Line(s.now.dw_b, _ZERO)
    r = w - s.C_fa @ w_a - s.C_ba @ s.x[place(FLEXURE_RATE)]
    sigma = math.hypot(s.transfer.sigma_rate, s.now.sigma_w)
    return away.rows(r, H, sigma, s.now.spread, s.own_change)
