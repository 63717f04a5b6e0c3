"""The last pass of the moving gyrocompass: weights by covariance in place of fixed gains.

The loops take a change of the accelerometers' errors in n for Earth's rate: in a turn the constant error of
an accelerometer turns with the vehicle, and eq. (2-17) says what that costs, 0.16 deg for 50 ug turned by
90 deg in 5 min. So the loops only lead up to a last pass over the stored data, in which the same
velocity is corrected by a Kalman filter that has the sensors' errors among its states: what turns with
the vehicle is an error of a sensor, what does not is tilt and heading.

The odometer counts the way, so the way is what is compared: a tick more or less is then an error of one
instant, where as a velocity it would be one of every second.

Heading is none of the states (see `nav.align.moving_block`). n has some azimuth and keeps it, and what is not
known of Earth's rate is two constants of n, in which everything is linear: a filter that turns n by what it
finds holds its earlier rows against another north than they were made for, and so learns of heading what
nobody measured (three times too sure of it after a minute). North is where the level part of Earth's rate
points in the end, and how long that is, is known from the latitude (`Weights.north`). It takes the place of
eq. (2-45) in a first pass, which sees the rate only in the velocity at the end, beside every error of level
that turns on the way made.

Gyros are off by what they turn, too: 40 ppm of a quarter of a turn tilt the level by 3.5e-3 deg, more than
accelerometers leave where the road winds. So errors of scale and axes are states as well.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from nav.align.compass_loop import SAMPLES
from nav.align.disturbance import spread
from nav.align.match_filter import own_errors
from nav.align.moving_block import (
    EPS,
    NAB,
    OWN,
    PITCH,
    POS,
    RATE,
    S_SIZE,
    SCALE,
    SIZE,
    TILT,
    VEL,
    WAY,
    YAWED,
    Block,
    block,
    seconds,
    track,
)
from nav.align.rolled import road
from nav.align.types import AlignConfig
from nav.rotation import quat_from_rotvec, quat_multiply
from nav.strapdown.kernels import X_Q, X_V
from nav.types import Vector

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
        self.v_n = x[X_V : X_V + 3].copy()  # where the open block began
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
        *self.entries, own = own_errors(config)
        self.own = np.zeros(len(own))  # of scale and axes
        self.P = np.diag(np.concatenate([sigma**2, own]))

    def go(self, rows: Vector, dt: Vector) -> None:
        """Navigate through samples (k, 6) over ``dt`` (k,) s, within a block."""
        arm = self.config.odometer_lever_arm
        track(self.x, rows, dt, self.bias, self.rate, self.C_vb, arm, SAMPLES, self.sums)

    @property
    def seconds(self) -> float:
        """Length of the open block."""
        return seconds(self.sums)

    def close(self, path: float | None) -> None:
        """End the block; ``path`` m by the odometer there, None: not known."""
        if self.seconds == 0.0:
            return
        v_n = self.x[X_V : X_V + 3]
        now = block(self.sums, self.C_vb, v_n, v_n - self.v_n, *self.entries)
        self.sums = np.zeros(S_SIZE)
        self._north = None
        transition = np.eye(len(self.P)) + now.F + 0.5 * now.F @ now.F
        config, rolled = self.config, float(now.rolled[1])
        q = np.zeros(len(self.P))
        q[VEL], q[TILT] = config.velocity_random_walk**2, config.angle_random_walk**2
        q[EPS], q[NAB] = config.gyro_walk**2, config.accel_walk**2
        across, along = road(config.slip, config.odometer_walk, rolled / now.tau, now.level)
        q[WAY] = along**2
        Q = np.diag(q * (0.5 * now.tau))
        self.P = transition @ (self.P + Q) @ transition.T + Q
        self.way += rolled
        # errors of scale and axes are not taken off the samples: what they did in the block is
        error = transition[:, OWN] @ self.own
        if path is not None:
            self.blocks += 1
            self.length = spread(self.blocks, BLOCK_S, WIDE_S)
            self._update(now, error, path - self.start, across / math.sqrt(now.tau))
        self._feed(error)

    def _update(self, now: Block, error: Vector, path: float, across: float) -> None:
        """Change the ``error`` (n,) by what the odometer and the wheels, ``across`` m/s, say."""
        speed = float(now.rolled[1]) / now.tau
        H = np.zeros((3, len(error)))
        H[0, WAY], H[0, SCALE] = 1.0, -path
        H[1, VEL], H[1, TILT], H[1, YAWED] = now.J[0], now.M[0], speed
        H[2, VEL], H[2, TILT], H[2, PITCH] = now.J[2], now.M[2], -speed
        H[1:] -= 0.5 * H[1:] @ now.F
        z = np.array(
            [
                path * (1.0 + self.scale) - self.way,
                -now.rolled[0] / now.tau - speed * self.mounting[1],
                -now.rolled[2] / now.tau + speed * self.mounting[0],
            ]
        )
        noise = np.array([self.quantum, across, across]) ** 2
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
                    error[WAY] = 0.0
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
        self.own = error[OWN]
        self.v_n = x[X_V : X_V + 3].copy()

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
