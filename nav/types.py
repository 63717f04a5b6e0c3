"""What goes into and comes out of a navigator: samples, fixes and the solution.

Every sample is stamped ``t_ns``, nanoseconds of the engine's monotonic time, at the instant the
measurement holds (for increments: the end of their interval), and names the device it came from.
"""

from __future__ import annotations

import math
from enum import IntEnum, IntFlag
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class Mode(IntEnum):
    """What a navigator is doing; the values are the wire values of the solution's mode signal."""

    STANDBY = 0
    ALIGN = 1
    CATCH_UP = 2
    NAVIGATE = 3
    TRANSFER = 4
    DEGRADED = 5
    FAULT = 6


class ImuFlag(IntFlag):
    """Conditions of one inertial sample."""

    OK = 0
    BRIDGED = 1  # made up from its neighbours across a short gap
    SATURATED = 2  # a counter was at the end of its range
    DEVICE_FAULT = 4  # the device itself says so
    GAP = 8  # samples before this one are missing and were not bridged
    EXCLUDED = 16  # made without a sensor of a redundant unit that is not trusted


class FixType(IntEnum):
    """Kind of GNSS fix, numbered as MAVLink's GPS_FIX_TYPE."""

    NO_GPS = 0
    NO_FIX = 1
    FIX_2D = 2
    FIX_3D = 3
    DGPS = 4
    RTK_FLOAT = 5
    RTK_FIXED = 6


class SolutionFlag(IntFlag):
    """Conditions of one solution."""

    NONE = 0
    POSITION = 1  # position is valid
    VELOCITY = 2  # velocity is valid
    LEVEL = 4  # roll and pitch are valid
    HEADING = 8  # heading is valid
    MOUNTING = 16  # the IMU-to-vehicle rotation is known: attitude is the vehicle's
    GNSS = 32  # aided by GNSS within the last seconds
    ODOMETER = 64  # aided by odometer or speed within the last seconds
    STANDSTILL = 128  # a zero-velocity update holds
    IMU_GAP = 256  # inertial samples were missing within the last seconds
    DEAD_RECKONING = 512  # no position aid within the last seconds


class ImuSample(NamedTuple):
    """Compensated inertial increments over one interval, axes b (right, forward, up).

    ``dtheta`` (3,) rad is the integral of w_ib_b, ``dv`` (3,) m/s of f_b, over ``dt`` seconds
    of the device's own clock ending at ``t_ns``.
    """

    t_ns: int
    dt: float
    dtheta: Vector
    dv: Vector
    device: str
    flags: int = 0


class ImuChange(NamedTuple):
    """From ``t_ns`` on a redundant unit is made of other sensors, or others are suspected.

    Bits are sensors, the first the lowest: those that are not used (``out``) and those one of which has
    failed, as far as is known (``suspect``). ``owed`` (2, 3) rad and m/s in b is what samples before lack,
    those of about the last ``over`` s; ``bias`` (2, 3) rad/s and m/s^2 one sigma of what the biases changed
    by along each axis of b. ``walk`` (2, 3, 3) rad^2/s and m^2/s^3 is the density of the noise in b of
    what the unit says from now on.
    """

    t_ns: int
    device: str
    gyros_out: int
    gyros_suspect: int
    accels_out: int
    accels_suspect: int
    owed: Vector
    over: float
    bias: Vector
    walk: Vector


class OdoSample(NamedTuple):
    """Distance (m, forward positive) rolled by the wheel over ``dt`` seconds ending at ``t_ns``."""

    t_ns: int
    dt: float
    distance: float
    standstill: bool
    device: str


class SpeedSample(NamedTuple):
    """Forward speed (m/s) of the vehicle and its standard deviation."""

    t_ns: int
    speed: float
    sigma: float
    device: str


class BaroSample(NamedTuple):
    """Pressure altitude (m, standard atmosphere) and its standard deviation."""

    t_ns: int
    height: float
    sigma: float
    device: str


class GnssFix(NamedTuple):
    """Antenna position (rad, rad, m above the ellipsoid) and velocity (3,) m/s east, north, up.

    ``sigma_position`` and ``sigma_velocity`` (3,) are standard deviations east, north, up (m, m/s);
    ``v_g`` and ``sigma_velocity`` are None where the receiver gives no velocity. ``gps_ns`` is the
    same instant as ``t_ns`` in nanoseconds of GPS time (since 6 January 1980) where the device tells.
    """

    t_ns: int
    lat: float
    lon: float
    height: float
    sigma_position: Vector
    v_g: Vector | None
    sigma_velocity: Vector | None
    fix_type: FixType
    device: str
    gps_ns: int | None = None
    satellites: int | None = None


class TableSample(NamedTuple):
    """Angles (3,) rad of a turntable's outer, middle and inner axis."""

    t_ns: int
    angles: Vector
    device: str


class MasterState(NamedTuple):
    """What a master navigator says of its own point, for a slave to be aligned from.

    ``lat``, ``lon`` rad, ``height`` m above the ellipsoid, ``v_g`` (3,) m/s east, north, up. ``q_ga`` (4,)
    takes the master's body axes a (right, forward, up) to east-north-up; None where it tells no attitude.
    ``w_ia_a`` (3,) rad/s and ``f_a`` (3,) m/s^2 in a are None for a master on a platform, which has no rates
    to tell. ``sigma_position`` (3,) m, ``sigma_velocity`` (3,) m/s and ``sigma_phi`` (3,) rad, east, north,
    up, are what it holds of its own lasting errors; the noise of its messages is configured with who takes
    them. ``valid``: the master itself says that it is to be used.
    """

    t_ns: int
    lat: float
    lon: float
    height: float
    v_g: Vector
    q_ga: Vector | None
    w_ia_a: Vector | None
    f_a: Vector | None
    sigma_position: Vector
    sigma_velocity: Vector
    sigma_phi: Vector | None
    valid: bool
    device: str


Sample = ImuSample | ImuChange | OdoSample | SpeedSample | BaroSample | TableSample | GnssFix | MasterState


class S:
    """Places in ``Solution.state``, the canonical float64 row that digests, tables and plots use."""

    LAT: Final = 0  # rad, geodetic
    LON: Final = 1  # rad
    HEIGHT: Final = 2  # m above the ellipsoid
    V: Final = slice(3, 6)  # m/s east, north, up
    Q: Final = slice(6, 10)  # quaternion w, x, y, z of C_gv: vehicle axes to east-north-up
    W: Final = slice(10, 13)  # rad/s, w_ib in vehicle axes, biases removed
    F: Final = slice(13, 16)  # m/s^2, specific force in vehicle axes, biases removed
    SIGMA_P: Final = slice(16, 19)  # m east, north, up
    SIGMA_V: Final = slice(19, 22)  # m/s east, north, up
    SIGMA_PHI: Final = slice(22, 25)  # rad, misalignment about east, north, up
    GYRO_BIAS: Final = slice(25, 28)  # rad/s, axes b
    ACCEL_BIAS: Final = slice(28, 31)  # m/s^2, axes b
    ODO_SCALE: Final = 31  # 1
    MOUNTING: Final = slice(32, 34)  # rad, residual pitch and heading of b in v
    BARO_BIAS: Final = 34  # m
    SIGMA_GYRO_BIAS: Final = slice(35, 38)
    SIGMA_ACCEL_BIAS: Final = slice(38, 41)
    SIGMA_ODO_SCALE: Final = 41
    SIGMA_MOUNTING: Final = slice(42, 44)
    SIGMA_BARO_BIAS: Final = 44
    SIZE: Final = 45


class Solution(NamedTuple):
    """A navigation solution at ``t_ns`` for the configured output point, in vehicle axes.

    ``state`` has the layout of `S`; what is not known yet is NaN there, and ``flags`` says which
    parts may be used.
    """

    t_ns: int
    mode: Mode
    flags: int
    state: Vector

    @property
    def lat(self) -> float:
        """Geodetic latitude, rad."""
        return float(self.state[S.LAT])

    @property
    def lon(self) -> float:
        """Longitude, rad."""
        return float(self.state[S.LON])

    @property
    def height(self) -> float:
        """Height above the ellipsoid, m."""
        return float(self.state[S.HEIGHT])

    @property
    def v_g(self) -> Vector:
        """Velocity east, north, up (3,), m/s."""
        return self.state[S.V]

    @property
    def heading(self) -> float:
        """Heading of the vehicle's forward axis clockwise from true north, rad in [0, 2 pi)."""
        w, x, y, z = self.state[S.Q].tolist()
        # second column of C_gv is the forward axis
        angle = math.atan2(2.0 * (x * y - w * z), w * w - x * x + y * y - z * z) % (2.0 * math.pi)
        return 0.0 if angle == 2.0 * math.pi else angle  # the remainder of -1e-20 rounds to the whole turn

    @property
    def pitch(self) -> float:
        """Pitch, nose up positive, rad."""
        w, x, y, z = self.state[S.Q].tolist()
        sine = 2.0 * (y * z + w * x)
        if abs(sine) > 1.0:  # by rounding; not asked of NaN, which stays
            sine = math.copysign(1.0, sine)
        return math.asin(sine)

    @property
    def roll(self) -> float:
        """Roll, right side down positive, rad."""
        w, x, y, z = self.state[S.Q].tolist()
        return math.atan2(-2.0 * (x * z - w * y), w * w - x * x - y * y + z * z)
