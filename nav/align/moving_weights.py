"""The last pass of the moving gyrocompass: weights by covariance in place of fixed gains.

The loops take a change of the accelerometers' errors in n for Earth's rate: in a turn the constant error of
an accelerometer turns with the vehicle, and eq. (2-17) says what that costs, 0.16 deg for 50 ug turned by
90 deg in 5 min. So the loops only lead up to a last pass over the stored data, in which the same
velocity is corrected by a Kalman filter that has the sensors' errors among its states: what turns with
the vehicle is an error of a sensor, what does not is tilt and heading.

The odometer counts the way, so the way is what is compared: a tick more or less is then an error of one
instant, where as a velocity it would be one of every second. States, true minus estimate: position (m)
and velocity (m/s) in n, phi (rad), gyro and accelerometer bias in b, odometer scale (1), mounting
about right and up of the vehicle (rad), way (m), level part of Earth's rate in n (rad/s).

Heading is none of them. n has some azimuth and keeps it, and what is not known of Earth's rate is two
constants of n, in which everything is linear: a filter that turns n by what it finds holds its earlier rows
against another north than they were made for, and so learns of heading what nobody measured (three times
too sure of it after a minute). North is where the level part of Earth's rate points in the end, and how long
that is, is known from the latitude (`Weights.north`). It takes the place of eq. (2-45) in a first pass, which
sees the rate only in the velocity at the end, beside every error of level that turns on the way made.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.compass_loop import SAMPLES
from nav.align.disturbance import spread
from nav.align.rolled import road
from nav.align.types import AlignConfig
from nav.jit import kernel
from nav.rotation import quat_from_rotvec, quat_multiply, skew
from nav.strapdown.control import U_SIZE, U_WC
from nav.strapdown.kernels import (
    M_C,
    M_EN,
    M_F,
    M_IE,
    M_K,
    M_SIZE,
    M_V,
    X_Q,
    X_V,
    increments,
    strapdown,
    take,
)
from nav.types import Vector

POS, VEL, TILT, EPS, NAB = (slice(k, k + 3) for k in range(0, 15, 3))
SCALE: Final = 15
PITCH: Final = 16
YAWED: Final = 17  # mounting about up
WAY: Final = 18
RATE: Final = slice(19, 21)
SIZE: Final = 21

BLOCK_S: Final = 1.0
WIDE_S: Final = (
    0.8  # by which blocks differ: at a steady speed ticks would else repeat themselves block by block
)
SIGMAS: Final = 6.0
DOUBT: Final = 4.0
OFTEN: Final = 0.1  # of the blocks: more than wheels slip
SLIPS: Final = 3  # in a row are too many
LEAN: Final = 1.0  # sigma of every innovation that is taken for chance
LEANING: Final = 20.0  # sigma in all beyond that: chance does not come to 6
UNSURE: Final = 1e-7  # rad/s: Earth's rate about north where latitude is off by a tenth of a degree
FIRST: Final = (0.3, math.radians(0.5))  # m/s, level: far wider than the loops
ANY: Final = 2.0  # of Earth's level rate: no azimuth is more likely than another
TURNS: Final = 8

# Sums over a block: C_nb dt, velocity of the odometer's point in v times dt, C_vn [v x] dt, f_n dt, w_in dt,
# transport tensor dt, seconds.
_S_C: Final = 0
_S_WAY: Final = 9
_S_TURN: Final = 12
_S_F: Final = 21
_S_IN: Final = 24
_S_CORIOLIS: Final = 27
_S_K: Final = 30
_S_DT: Final = 33
S_SIZE: Final = 34


@kernel
def track(
    x: Vector,
    rows: Vector,
    dt: Vector,
    bias: Vector,
    rate: Vector,
    C_vb: Vector,
    arm: Vector,
    n: int,
    sums: Vector,
) -> None:
    """Navigate freely through samples and add to the ``sums`` (S_SIZE,) of a block; ``x`` is the kernel's.

    ``rows`` (k, 6) and ``dt`` (k,) as in `nav.align.compass_loop.run`; ``bias`` (6,) of gyros and
    accelerometers is taken off, n turns by ``rate`` (2,) rad/s about its level axes beside; ``C_vb`` (3, 3),
    ``arm`` (3,) m from IMU to the odometer's point in b.
    """
    d = np.empty(6 * n)
    inc = np.empty(6)
    mid = np.empty(M_SIZE)
    u = np.zeros(U_SIZE)
    u[U_WC], u[U_WC + 1] = rate[0], rate[1]
    i = 0
    while i < rows.shape[0]:
        m = n if i + n <= rows.shape[0] else 1
        take(rows, i, m, d)
        step = 0.0
        for j in range(m):
            for k in range(3):
                d[3 * j + k] -= bias[k] * dt[i + j]
                d[3 * (m + j) + k] -= bias[3 + k] * dt[i + j]
            step += dt[i + j]
        i += m
        increments(d, m, inc)
        strapdown(x, inc, step, u, mid)
        vx, vy, vz = mid[M_V], mid[M_V + 1], mid[M_V + 2]
        # of twice Earth's rate the kernel has had a control rate once
        x[X_V] -= rate[1] * vz * step
        x[X_V + 1] += rate[0] * vz * step
        x[X_V + 2] -= (rate[0] * vy - rate[1] * vx) * step
        # velocity of the odometer's point in b: of the IMU, and what turning adds
        px = (inc[1] * arm[2] - inc[2] * arm[1]) / step
        py = (inc[2] * arm[0] - inc[0] * arm[2]) / step
        pz = (inc[0] * arm[1] - inc[1] * arm[0]) / step
        px += mid[M_C] * vx + mid[M_C + 3] * vy + mid[M_C + 6] * vz
        py += mid[M_C + 1] * vx + mid[M_C + 4] * vy + mid[M_C + 7] * vz
        pz += mid[M_C + 2] * vx + mid[M_C + 5] * vy + mid[M_C + 8] * vz
        for r in range(3):
            cx, cy, cz = C_vb[r, 0], C_vb[r, 1], C_vb[r, 2]
            sums[_S_WAY + r] += (cx * px + cy * py + cz * pz) * step
            # row of C_vn
            ex = cx * mid[M_C] + cy * mid[M_C + 1] + cz * mid[M_C + 2]
            ey = cx * mid[M_C + 3] + cy * mid[M_C + 4] + cz * mid[M_C + 5]
            ez = cx * mid[M_C + 6] + cy * mid[M_C + 7] + cz * mid[M_C + 8]
            sums[_S_TURN + 3 * r] += (ey * vz - ez * vy) * step
            sums[_S_TURN + 3 * r + 1] += (ez * vx - ex * vz) * step
            sums[_S_TURN + 3 * r + 2] += (ex * vy - ey * vx) * step
        for k in range(9):
            sums[_S_C + k] += mid[M_C + k] * step
        for k in range(3):
            sums[_S_F + k] += mid[M_F + k] * step
            sums[_S_IN + k] += (mid[M_IE + k] + mid[M_EN + k]) * step
            sums[_S_CORIOLIS + k] += (2.0 * mid[M_IE + k] + mid[M_EN + k]) * step
            sums[_S_K + k] += mid[M_K + k] * step
        sums[_S_DT] += step


class North(NamedTuple):
    """Where north is in n, and what the length of Earth's rate, which is known, says of everything else.

    ``angle`` rad by which n has to turn about up to be east and north, with its ``sigma``; ``by`` (2,) s is
    how an error of the rate changes it. ``felt`` rad/s is the length as it was felt, ``unsure`` its sigma and
    that of latitude. ``error`` (SIZE,) and ``P`` (SIZE, SIZE) are the filter's, with the length known.
    """

    angle: float
    sigma: float
    by: Vector
    felt: float
    unsure: float
    error: Vector
    P: Vector


class Weights:
    """The filter and the state ``x`` of the kernel that it corrects.

    ``x`` is the state at the start of the pass, ``way`` m what the odometer's path says there. ``level_rate``
    rad/s is the length of the level part of Earth's rate.
    """

    def __init__(self, config: AlignConfig, x: Vector, way: float, level_rate: float) -> None:
        self.config = config
        self.x = x
        self.bias = np.zeros(6)
        self.shift = np.zeros(3)  # m in n, correction of the place
        self.scale = 0.0
        self.mounting = np.zeros(2)
        self.way = 0.0  # since the start, by the inertial sensors
        self.start = way
        self.sums = np.zeros(S_SIZE)
        self.rate = np.zeros(2)  # beside what the kernel has where n is east and north
        self.level_rate = level_rate
        self._north: North | None = None  # by what is known since the last block
        self.slips = 0  # innovations refused in a row
        self.lean = np.zeros(2)  # to either side
        self.blocks = 0
        self.length = BLOCK_S  # of the open block, s
        self.slipped = 0  # times that the way was begun anew
        self.reason: str | None = None  # what was wrong with the way or the sensors
        C_vb = config.C_vb
        assert C_vb is not None
        self.C_vb = np.ascontiguousarray(C_vb)
        sigma = np.zeros(SIZE)
        sigma[VEL] = FIRST[0]
        sigma[TILT] = FIRST[1], FIRST[1], 0.0  # the azimuth of n is what it is
        sigma[RATE] = ANY * level_rate
        sigma[EPS], sigma[NAB] = config.gyro_bias, config.accel_bias
        sigma[SCALE] = config.odometer_scale
        sigma[PITCH] = sigma[YAWED] = config.sigma_mounting
        self.quantum = math.hypot(config.odometer_quantum / math.sqrt(12.0), 1e-3)
        sigma[WAY] = self.quantum
        self.P = np.diag(sigma**2)

    def go(self, rows: Vector, dt: Vector) -> None:
        """Navigate through samples (k, 6) over ``dt`` (k,) s, within a block."""
        arm = self.config.odometer_lever_arm
        track(self.x, rows, dt, self.bias, self.rate, self.C_vb, arm, SAMPLES, self.sums)

    @property
    def seconds(self) -> float:
        """Length of the open block."""
        return float(self.sums[_S_DT])

    def close(self, path: float | None) -> None:
        """End the block; ``path`` m by the odometer there, None: not known."""
        sums, tau = self.sums, self.seconds
        if tau == 0.0:
            return
        self.sums = np.zeros(S_SIZE)
        self._north = None
        C = sums[_S_C : _S_C + 9].reshape(3, 3)
        J = self.C_vb @ C.T  # C_vn dt
        M = sums[_S_TURN : _S_TURN + 9].reshape(3, 3)
        F = np.zeros((SIZE, SIZE))  # times tau
        F[POS, VEL] = np.eye(3) * tau
        F[VEL, VEL] = -skew(sums[_S_CORIOLIS : _S_CORIOLIS + 3])
        F[VEL, TILT] = -skew(sums[_S_F : _S_F + 3])
        F[VEL, NAB] = -C
        F[VEL, RATE] = 2.0 * tau * skew(self.x[X_V : X_V + 3])[:, 0:2]
        kxx, kxy, kyy = sums[_S_K : _S_K + 3]
        # an error of velocity, true minus estimate, turns n by less than it should
        F[TILT.start : TILT.start + 2, VEL.start : VEL.start + 2] = [[kxy, kyy], [-kxx, -kxy]]
        F[TILT, TILT] = -skew(sums[_S_IN : _S_IN + 3])
        F[TILT, EPS] = -C
        F[TILT.start, RATE.start] = F[TILT.start + 1, RATE.start + 1] = -tau
        F[WAY, VEL], F[WAY, TILT] = J[1], M[1]
        transition = np.eye(SIZE) + F + 0.5 * F @ F
        config = self.config
        q = np.zeros(SIZE)
        q[VEL], q[TILT] = config.velocity_random_walk**2, config.angle_random_walk**2
        level = math.hypot(sums[_S_F], sums[_S_F + 1]) / tau
        across, along = road(config.slip, config.odometer_walk, float(sums[_S_WAY + 1]) / tau, level)
        q[WAY] = along**2
        Q = np.diag(q * (0.5 * tau))
        self.P = transition @ (self.P + Q) @ transition.T + Q
        self.way += float(sums[_S_WAY + 1])
        if path is not None:
            self.blocks += 1
            self.length = spread(self.blocks, BLOCK_S, WIDE_S)
            noise = np.array([self.quantum, across / math.sqrt(tau), across / math.sqrt(tau)]) ** 2
            self._update(sums, tau, np.eye(SIZE) - 0.5 * F, J / tau, M / tau, path - self.start, noise)

    def _update(
        self, sums: Vector, tau: float, back: Vector, J: Vector, M: Vector, path: float, noise: Vector
    ) -> None:
        speed = float(sums[_S_WAY + 1]) / tau
        H = np.zeros((3, SIZE))
        H[0, WAY], H[0, SCALE] = 1.0, -path
        H[1, VEL], H[1, TILT], H[1, YAWED] = J[0], M[0], speed
        H[2, VEL], H[2, TILT], H[2, PITCH] = J[2], M[2], -speed
        H[1:] = H[1:] @ back
        z = np.array(
            [
                path * (1.0 + self.scale) - self.way,
                -sums[_S_WAY] / tau - speed * self.mounting[1],
                -sums[_S_WAY + 2] / tau + speed * self.mounting[0],
            ]
        )
        error = np.zeros(SIZE)
        refused = False
        for k in range(3):
            h = H[k]
            Ph = self.P @ h
            S = float(h @ Ph) + noise[k]
            innovation = float(z[k] - h @ error)
            if innovation * innovation > SIGMAS**2 * S:
                refused = True
                self._refuse(k, innovation, math.sqrt(S), speed, path)
                if k == 0:
                    continue
                # believed so far that it is at the edge: a filter that refuses all is lost
                S = innovation * innovation / SIGMAS**2
            if k == 0:
                self._lean(innovation / math.sqrt(S), speed)
            gain = Ph / S
            error += gain * innovation
            self.P -= np.outer(gain, Ph)
        if not refused:
            self.slips = 0
        else:
            self.lean[:] = 0.0
        self.P = 0.5 * (self.P + self.P.T)
        self._feed(error)

    def _lean(self, normed: float, speed: float) -> None:
        """Innovations of the way may each be chance, but not all to one side: a cumulative sum."""
        self.lean = np.maximum(0.0, self.lean + np.array([normed, -normed]) - LEAN)
        if self.reason is None and np.max(self.lean) > LEANING:
            self.reason = (
                "the wheels slip: for a while their way was a little off what the inertial sensors saw, "
                f"at {speed:.1f} m/s"
            )

    def _refuse(self, k: int, innovation: float, sigma: float, speed: float, path: float) -> None:
        """An innovation that cannot be: begin the way anew behind a slip; too many in a row are a reason."""
        self.slips += 1
        if k == 0:
            # the way by the odometer goes on from here, or from the next block: the wheels may slip on
            self.way = path * (1.0 + self.scale)
            self.P[WAY, :] = 0.0
            self.P[:, WAY] = 0.0
            self.P[WAY, WAY] = ((0.5 + abs(speed)) * BLOCK_S) ** 2
            self.slipped += 1
        if self.slips < SLIPS:
            return
        if self.slipped:
            self.reason = (
                f"the wheels slip: {self.slipped} times their way was off what the inertial sensors saw, "
                f"at {speed:.1f} m/s"
            )
        else:
            side = "sideways" if k == 1 else "upwards"
            self.reason = (
                f"the vehicle seems to move {side} at {abs(innovation):.2f} m/s ({sigma:.2f} are expected): "
                "an inertial sensor is wrong, or it is not mounted as configured"
            )

    def doubt(self) -> str | None:
        """What speaks against the result, or None: the way, the sensors, Earth's rate as it was felt."""
        north, felt = self.north(), None
        if abs(north.felt - self.level_rate) > DOUBT * north.unsure:
            off = math.degrees(north.felt - self.level_rate) * 3600.0
            felt = (
                f"Earth's rate about north is felt {off:+.3f} deg/h off what it is at this latitude: "
                "latitude, a gyro or calibration is wrong"
            )
        if self.reason is None:
            return felt
        if self.slipped > OFTEN * self.blocks:
            return (
                f"odometer and inertial sensors disagree in {self.slipped} of {self.blocks} seconds: "
                "latitude, mounting or calibration are wrong"
            )
        return self.reason if felt is None else f"{self.reason}; or {felt}"

    def _feed(self, error: Vector) -> None:
        x = self.x
        self.shift += error[POS]
        x[X_V : X_V + 3] += error[VEL]
        x[X_Q : X_Q + 4] = quat_multiply(quat_from_rotvec(error[TILT]), x[X_Q : X_Q + 4])
        self.bias += error[EPS.start : NAB.stop]
        self.scale += float(error[SCALE])
        self.mounting += error[[PITCH, YAWED]]
        self.way += float(error[WAY])
        self.rate += error[RATE]

    def north(self) -> North:
        """North by the rate that was felt; its length is one more measurement, an iterated one.

        Its row depends on where north is, so it is taken for an answer, never into the filter.
        """
        if self._north is None:
            self._north = self._find_north()
        return self._north

    def _find_north(self) -> North:
        r, P = self.rate + np.array([0.0, self.level_rate]), self.P
        felt = float(np.hypot(*r))
        to = r / felt
        for _ in range(TURNS):
            across = P[:, RATE] @ to
            S = float(to @ across[RATE]) + UNSURE**2
            error = across * ((self.level_rate - float(to @ r)) / S)
            to = r + error[RATE]
            to = to / np.hypot(*to)
        P = P - np.outer(across, across) / S
        by = np.array([to[1], -to[0]]) / self.level_rate
        sigma = math.sqrt(float(by @ P[RATE, RATE] @ by))
        return North(math.atan2(to[0], to[1]), sigma, by, felt, math.sqrt(S), error, P)
