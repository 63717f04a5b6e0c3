"""What a navigator is told about its sensors, its vehicle and its patience; SI units throughout."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from nav.align.types import AlignConfig
from nav.filter import states as st
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.coning import MOST_SAMPLES
from nav.strapdown.control import U_KH
from nav.strapdown.height import height_gains
from nav.types import Vector


def _zero() -> Vector:
    return np.zeros(3)


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """Errors of the inertial sensors that are left after compensation, one sigma.

    ``angle_random_walk`` rad/sqrt(s), ``velocity_random_walk`` m/s/sqrt(s). ``gyro_bias`` rad/s and
    ``accel_bias`` m/s^2: constant part where an alignment does not say better. ``gyro_instability``
    and ``accel_instability``: steady sigma of the part that wanders with the correlation times
    ``gyro_bias_time`` and ``accel_bias_time``, s. ``gyro_scale``, ``accel_scale`` (1): errors of scale, and
    ``gyro_axes``, ``accel_axes`` (1): what input along one axis puts into each other one, misalignment; zero
    for all leaves them out of the filter. ``accel_bias`` is all that is wrong at rest, with what axes and
    scale make of gravity. ``gyro_vibration``, ``accel_vibration`` (1): part
    of the squared difference of the two increments of an update that is taken for noise, axis by axis. 1
    for sensors that are sampled, so that vibration faster than half the rate comes back at any frequency;
    0 for those that integrate.
    """

    angle_random_walk: float
    velocity_random_walk: float
    gyro_bias: float
    accel_bias: float
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    gyro_bias_time: float = 600.0
    accel_bias_time: float = 600.0
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    gyro_vibration: float = 0.0
    accel_vibration: float = 0.0
    gyro_axes: float = 0.0
    accel_axes: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NavigatorConfig:
    """Configuration of one navigator.

    Lever arms (3,) m go from the IMU to the point, in b. ``C_vb`` (3, 3) takes b to v; None has it found.
    ``sigma_mounting`` (rad) is how far a given C_vb is to be trusted in pitch and heading.

    ``gnss_timeout``, ``odometer_timeout``, ``barometer_timeout`` (s): after that long without an accepted
    measurement the navigator is DEGRADED; None: the aid is not counted on. ``odometer`` says that odometer
    samples will come. Other times in s, sigmas in SI units:

    - ``gnss_position_floor``, ``gnss_velocity_floor``: least sigmas of a fix
    - ``gnss_correlated`` m, horizontal per axis and vertical: the part of the receiver's position error that
      varies slowly, with ``gnss_correlation`` s; it is contained in the sigmas of a fix. Zero: all white
    - ``gnss_velocity_age``: the velocity of a fix holds this long before its position (filtered or
      differenced velocities lag)
    - ``odometer_interval``: ticks are gathered this long; ``odometer_sigma`` m/s of an interval's mean,
      ``odometer_walk`` m/sqrt(m) of the distance, ``odometer_quantum`` m per tick; ``odometer_scale`` initial
      sigma
    - ``non_holonomic``: sigma m/s of the velocity across, None switches the constraint off;
      ``sideways_walk`` m/sqrt(m): of the path to the side, from a heading that wanders about it;
      ``slip`` s: growth per lateral acceleration; ``non_holonomic_interval``
    - ``zero_velocity`` sigma m/s, None: off; ``zero_rate`` rad/s sigma added to the white noise, None: off
    - ``rest_gyro`` rad/s, ``rest_accel`` m/s^2: standard deviations (of the vector, over updates) below which
      an IMU stands still, None: from what the alignment saw at rest, axis by axis; ``rest_speed`` m/s: and
      the speed;
      ``rest_interval``: over how long
    - ``baro_bias`` m initial sigma, ``baro_wander`` m/sqrt(s)
    - ``gap_limit``: a longer silence of the IMU ends navigation; ``gap_rate`` rad/s and ``gap_accel`` m/s^2
      may pass unseen in a shorter one
    - ``lockout``: measurements refused for this long that agree are believed (`nav.filter.recovery`)
    - ``heading_limit`` rad: sigma below which the heading is called valid
    - ``replay_updates``: most stored updates that one call works off
    - ``azimuth``: law of `nav.strapdown.azimuth`; ``azimuth_rate`` rad/s of a rotating one.
      ``samples_per_update``: 1 to 6, order of the coning and sculling algorithms
    - ``height_channel``: order (2 or 3) and time constant s of the feedback of the barometer's height by
    fixed
      gains instead of updates of the filter; None: the filter uses the barometer
    - ``align``: what the alignment needs beyond this; None: its own defaults

    Raises ValueError for an azimuth law, a rate or a number of samples that there is not, and for one
    sample an update with vibration.
    """

    imu: ImuErrors
    alignment: str = "static"
    C_vb: Vector | None = field(default_factory=lambda: np.eye(3))
    sigma_mounting: float = 0.0
    gnss_lever_arm: Vector = field(default_factory=_zero)
    odometer_lever_arm: Vector = field(default_factory=_zero)
    output_point: Vector = field(default_factory=_zero)
    odometer: bool = False
    gnss_timeout: float | None = None
    odometer_timeout: float | None = None
    barometer_timeout: float | None = None
    gnss_position_floor: float = 0.005
    gnss_velocity_floor: float = 0.005
    gnss_correlated: tuple[float, float] = (0.0, 0.0)
    gnss_correlation: float = 120.0
    gnss_velocity_age: float = 0.0
    odometer_interval: float = 0.2
    odometer_sigma: float = 0.03
    odometer_walk: float = 0.0
    odometer_quantum: float = 0.0
    odometer_scale: float = 0.01
    odometer_scale_walk: float = 1e-5
    non_holonomic: float | None = None
    sideways_walk: float = 0.0
    non_holonomic_interval: float = 0.2
    slip: float = 0.01
    mounting_walk: float = 1e-6
    zero_velocity: float | None = 0.01
    zero_rate: float | None = None
    rest_gyro: float | None = None
    rest_accel: float | None = None
    rest_speed: float = 0.5
    rest_interval: float = 0.5
    baro_bias: float = 30.0
    baro_wander: float = 0.05
    gap_limit: float = 3.0
    gap_rate: float = 0.5
    gap_accel: float = 3.0
    lockout: float = 3.0
    heading_limit: float = math.radians(10.0)
    replay_updates: int = 64
    azimuth: str = "wander"
    azimuth_rate: float = 0.0
    samples_per_update: int = 2
    height_channel: tuple[int, float] | None = None
    align: AlignConfig | None = None

    def __post_init__(self) -> None:
        azimuth_control(self.azimuth, self.azimuth_rate)
        if self.height_channel is not None:
            height_gains(*self.height_channel)
        if not 1 <= self.samples_per_update <= MOST_SAMPLES:
            raise ValueError(f"{self.samples_per_update} samples an update, expected 1 to {MOST_SAMPLES}")
        if self.samples_per_update == 1 and max(self.imu.gyro_vibration, self.imu.accel_vibration) > 0.0:
            raise ValueError("vibration shows between the samples of an update, and one sample has no other")

    @property
    def states(self) -> int:
        """Number of error states of the filter."""
        if self.height_channel is not None and self.height_channel[0] > 2:
            return st.ALL
        if max(self.gnss_correlated) > 0.0:
            return st.RECEIVER
        imu = self.imu
        return st.FULL if imu.gyro_scale or imu.accel_scale or imu.gyro_axes or imu.accel_axes else st.BASIC


def sensors_align(imu: ImuErrors) -> AlignConfig:
    """What an alignment must know about the sensors, and its own defaults for all else."""
    return AlignConfig(
        gyro_bias=math.hypot(imu.gyro_bias, imu.gyro_instability),
        accel_bias=math.hypot(imu.accel_bias, imu.accel_instability),
        angle_random_walk=imu.angle_random_walk,
        velocity_random_walk=imu.velocity_random_walk,
        gyro_scale=imu.gyro_scale,
        gyro_axes=imu.gyro_axes,
        accel_scale=imu.accel_scale,
        accel_axes=imu.accel_axes,
        gyro_walk=math.sqrt(wander(imu.gyro_instability, imu.gyro_bias_time)),
        accel_walk=math.sqrt(wander(imu.accel_instability, imu.accel_bias_time)),
    )


def wander(sigma: float, seconds: float) -> float:
    """Variance per second of the random walk that a Markov process of steady ``sigma`` is in the short run.

    A bias is a constant and a part that wanders; one state for both must not decay.
    """
    return 2.0 * sigma**2 / seconds


def align_config(config: NavigatorConfig) -> AlignConfig:
    """The alignment's configuration."""
    if config.align is not None:
        return config.align
    return replace(
        sensors_align(config.imu),
        gnss_lever_arm=config.gnss_lever_arm,
        gnss_velocity_age=config.gnss_velocity_age,
        C_vb=config.C_vb,
        odometer_lever_arm=config.odometer_lever_arm,
        odometer_quantum=config.odometer_quantum,
        odometer_scale=config.odometer_scale,
        odometer_walk=config.odometer_walk,
        sigma_mounting=config.sigma_mounting,
    )


def parameters(config: NavigatorConfig) -> Vector:
    """The parameter vector (P_SIZE,) of the kernels."""
    p = np.zeros(st.P_SIZE)
    p[st.P_LG : st.P_LG + 3] = config.gnss_lever_arm
    p[st.P_LO : st.P_LO + 3] = config.odometer_lever_arm
    p[st.P_LP : st.P_LP + 3] = config.output_point
    p[st.P_SLIP] = config.slip
    p[st.P_GAP_W] = config.gap_rate
    p[st.P_GAP_A] = config.gap_accel
    p[st.P_U :] = azimuth_control(config.azimuth, config.azimuth_rate)
    if config.height_channel is not None:
        p[st.P_U + U_KH : st.P_U + U_KH + 3] = height_gains(*config.height_channel)
    imu = config.imu
    p[st.P_ARW] = imu.angle_random_walk
    p[st.P_VIB_G] = imu.gyro_vibration
    p[st.P_VIB_A] = imu.accel_vibration
    q = p[st.P_Q : st.P_Q + st.ALL]
    q[st.VELOCITY] = imu.velocity_random_walk**2
    q[st.PHI] = imu.angle_random_walk**2
    q[st.GYRO_BIAS] = wander(imu.gyro_instability, imu.gyro_bias_time)
    q[st.ACCEL_BIAS] = wander(imu.accel_instability, imu.accel_bias_time)
    q[st.ODO_SCALE] = config.odometer_scale_walk**2
    q[st.MOUNTING] = config.mounting_walk**2 if config.C_vb is None or config.sigma_mounting > 0.0 else 0.0
    q[st.BARO_BIAS] = config.baro_wander**2
    horizontal, vertical = config.gnss_correlated
    p[st.P_GNSS] = 1.0 / config.gnss_correlation
    q[st.GNSS] = 2.0 * np.square([horizontal, horizontal, vertical]) / config.gnss_correlation
    return p
