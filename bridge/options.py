"""What the tables of a configuration may hold, apart from what each driver and each sink adds itself."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta, field

from bridge.strict import Table

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Three = tuple[float, float, float]
Sigmas = tuple[NotNegative, NotNegative, NotNegative]
SystemId = Annotated[int, Meta(ge=1, le=255)]


class SourceOptions(Table):
    """``[source.NAME]``: a bus or link. Sources are numbered from 1 in the order of the file."""

    type: str


class CanSource(SourceOptions):
    """A CAN bus through python-can; ``options`` go to its constructor unchanged."""

    interface: str
    channel: str | int
    fd: bool = False
    bitrate: Annotated[int, Meta(gt=0)] | None = None
    data_bitrate: Annotated[int, Meta(gt=0)] | None = None
    options: dict[str, str | int | float | bool] = field(default_factory=dict)


class MavlinkSource(SourceOptions):
    """A MAVLink link; ``system_id`` and ``component_id`` are those we send with.

    With ``signing_key_file`` (64 hexadecimal digits, the file beside the configuration) what is sent is
    signed, and only packets that are signed with the same key are let in, or with ``accept_unsigned`` those
    without any signature too. ``max_rate_hz`` bounds the packets let in, a second's worth at once.
    """

    url: str
    system_id: SystemId = 1
    component_id: SystemId = 1
    baud: Annotated[int, Meta(gt=0)] = 57600
    signing_key_file: str | None = None
    accept_unsigned: bool = False
    max_rate_hz: Annotated[float, Meta(ge=1.0)] = 5000.0


SOURCE_OPTIONS: dict[str, type[SourceOptions]] = {"can": CanSource, "mavlink": MavlinkSource}


class DeviceOptions(Table):
    """``[device.NAME]``: what every driver's options begin with.

    ``clock`` names a clock shared with other devices (one PPS); by default each has its own.
    ``latency_ms`` is the shortest time from the instant measured to the receive stamp of the frame that
    carries the device's time.
    ``files`` (of the class) lists the keys that name files: these are read and travel with a capture.
    """

    files: ClassVar[tuple[str, ...]] = ()

    driver: str
    source: str
    clock: str | None = None
    latency_ms: NotNegative = 0.0


class SinkOptions(Table):
    """``[sink.NAME]``: what every sink's options begin with."""

    files: ClassVar[tuple[str, ...]] = ()

    type: str
    navigator: str
    source: str


class ImuErrors(Table):
    """``[navigator.NAME.imu_errors]``: how good the IMU is, one sigma, after its calibration.

    A bias is all that is wrong at rest, with what the axes make of gravity, and stays for a whole run; an
    instability is what wanders within ``correlation_s``. Scale and ``axes`` errors (misalignment: what motion
    about or along one axis puts into each other one) are estimated; 0 for all leaves them out of the
    filter. A ``vibration`` is the part of the squared difference of neighbouring samples that is noise: 1 for
    a sensor that is sampled, on an engine that shakes it faster than half its rate, 0 for one that integrates
    between its samples.
    """

    gyro_bias_deg_per_h: Positive = 0.5
    gyro_instability_deg_per_h: NotNegative = 0.05
    gyro_random_walk_deg_per_sqrt_h: Positive = 0.01
    gyro_scale_ppm: NotNegative = 0.0
    accel_bias_ug: Positive = 500.0
    accel_instability_ug: NotNegative = 20.0
    accel_random_walk_ug_per_sqrt_hz: Positive = 20.0
    accel_scale_ppm: NotNegative = 0.0
    gyro_axes_ppm: NotNegative = 0.0
    accel_axes_ppm: NotNegative = 0.0
    gyro_vibration: NotNegative = 0.0
    accel_vibration: NotNegative = 0.0
    correlation_s: Positive = 3600.0


class AlignOptions(Table):
    """``[navigator.NAME.align]``: how long alignment may take and what it may assume.

    ``coarse_s`` and ``fine_s`` are the static alignment's. ``position_deg_m`` (latitude, longitude in deg,
    height in m above the ellipsoid) stands in where no GNSS gives one. ``sway_m_s`` is the rms velocity
    of the standing vehicle; ``rest_s`` the standstill that an alignment in motion takes for levelling,
    ``heading_deg`` the sigma at which it ends, ``window_s`` the motion it looks at.

    Alignments that go over their data again keep at most ``store_s`` of it, and work off at most
    ``replay_samples`` of what they kept with every sample that comes. What is known from outside, for the
    stored alignment: ``known_heading_deg`` of the vehicle, or ``known_attitude_deg`` (its pitch, roll and
    heading); the latter's sigmas are of the level and of the heading.

    ``slip_m_s`` is how fast the vehicle moves sideways on a straight road, ``slope_deg`` how much the ground
    is inclined where it stands at first, both one sigma.
    """

    coarse_s: Positive = 60.0
    fine_s: Positive = 240.0
    position_deg_m: Three | None = None
    position_sigma_m: Positive = 10.0
    sway_m_s: Positive = 0.003
    rest_s: Positive = 5.0
    heading_deg: Positive = 2.0
    window_s: Positive = 40.0
    store_s: Positive = 900.0
    replay_samples: Annotated[int, Meta(ge=2, le=1000)] = 64
    known_heading_deg: float | None = None
    known_heading_sigma_deg: Positive = 1.0
    known_attitude_deg: Three | None = None
    known_attitude_sigma_deg: tuple[Positive, Positive] = (0.1, 1.0)
    slip_m_s: Positive = 0.02
    slope_deg: Positive = 2.0


class HeightChannel(Table):
    """``[navigator.NAME.height_channel]``: the barometer's height is fed back by fixed gains.

    ``order`` 2 or 3; the time constant is that of its poles. What the barometer differs by from the height at
    the start of navigation is taken to be its bias. Without this table the filter uses the barometer.
    """

    order: Annotated[int, Meta(ge=2, le=3)] = 2
    time_constant_s: Annotated[float, Meta(gt=0.0, le=500.0)] = 30.0


class TransferOptions(Table):
    """``[navigator.NAME.transfer]``: of the master that a transfer alignment (``transfer_...``) follows.

    Of a master that is a navigator of this process ``rate_hz`` solutions a second are taken; its point is its
    output point and its axes are its vehicle's. ``lever_arm_m`` goes from the master's point to the IMU, in
    the master's axes (right, forward, up); ``mounting_deg`` is pitch, roll and heading of the IMU on the
    master's axes, one sigma about each of these ``mounting_sigma_deg``. The ``noise`` is that of one message,
    independent of the next. Its vertical velocity, held by a barometer, wanders by
    ``vertical_walk_m_s_per_sqrt_s`` besides. Its dating is late by a constant of ``latency_sigma_ms``: by
    default 1 where the master has the same ``clock`` as the IMU, and else 40, as straight on nothing would
    show a tenth of a second. A message older than ``latest_ms`` is of no use.

    ``flexure_mrad``, about right, forward and up, which is forgotten within ``flexure_s``, is estimated where
    it is given; otherwise it belongs into the noise of the attitude.

    It takes ``duration_s`` at least, until the attitude relative to the master is known to ``sigma_mrad``
    about east, north and up, and refuses after ``patience_s``, or when the master agrees with nothing for
    ``lockout_s``.
    """

    rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 50.0
    lever_arm_m: Three = (0.0, 0.0, 0.0)
    lever_arm_sigma_m: NotNegative = 0.02
    mounting_deg: Three = (0.0, 0.0, 0.0)
    mounting_sigma_deg: Positive = 0.5
    velocity_noise_m_s: Positive = 0.02
    attitude_noise_mrad: Positive = 0.3
    position_noise_m: Positive = 2.0
    rate_noise_deg_per_s: Positive = 0.06
    vertical_walk_m_s_per_sqrt_s: NotNegative = 0.01
    latency_sigma_ms: NotNegative | None = None
    latest_ms: Positive = 500.0
    flexure_mrad: Sigmas | None = None
    flexure_s: tuple[Positive, Positive, Positive] = (0.5, 0.5, 0.5)
    duration_s: Positive = 5.0
    sigma_mrad: tuple[Positive, Positive, Positive] = (2.0, 2.0, 2.0)
    patience_s: Positive = 3600.0
    lockout_s: Positive = 2.0


class NavigatorOptions(Table):
    """``[navigator.NAME]``: who is heard, how it starts, and where things are.

    Without ``autostart`` a command starts it. ``mounting_deg`` is pitch, roll and heading of the IMU in the
    vehicle, or "find"; ``mounting_sigma_deg`` says how far given angles are to be trusted. Lever arms go
    from the IMU to the point, in IMU axes (right, forward, up); ``output_point_m`` likewise.

    ``gnss_correlated_m`` (horizontal per axis, vertical) is how much of a fix's error stays the same over
    ``gnss_correlation_s``; with 0 every fix is taken to be wrong in its own way.

    The ``floor`` keys are the least sigmas that a fix is believed to have. The velocity of a fix is that of
    ``gnss_velocity_age_ms`` before it: half the interval that a receiver averages or differences over.

    Distances of an odometer walk off by ``odometer_walk_m_per_sqrt_m`` (tyres, road) beside its ticks and
    ``odometer_sigma_m_s``, which every fifth of a second is wrong by anew. A vehicle whose heading wanders
    about its path (camber, wind, steering) walks to the side by ``sideways_walk_m_per_sqrt_m``.

    A ``zero_velocity_sigma_m_s`` of 0 switches zero-velocity updates off, a ``zero_rate_sigma_deg_per_s``
    of 0 those of the gyro biases at rest. Without an odometer an IMU rests that shakes less than
    ``rest_gyro_deg_per_s`` and ``rest_accel_m_s2`` (standard deviations of the vectors): by default what an
    alignment in motion saw, axis by axis, while the vehicle stood, or else 0.6 deg/s and 0.15 m/s^2.

    ``azimuth`` is the law by which the navigation frame turns about the vertical: what is put out is the same
    with all of them, but north stops near a pole; rotating turns by ``azimuth_rate_deg_per_h`` more. A
    solution comes with every ``samples_per_update`` inertial samples, which coning and sculling are computed
    from.

    ``master_navigator`` is another navigator that this one may be aligned from (``transfer_...``).

    A navigator is DEGRADED when an aid is missing for longer than its ``timeout_s``: 0 means that it is not
    counted on; by default an aid that a device of the navigator provides is.
    """

    devices: Annotated[list[str], Meta(min_length=1)]
    alignment: str = "static"
    master_navigator: str | None = None
    autostart: bool = True
    mounting_deg: Three | Literal["find"] = (0.0, 0.0, 0.0)
    mounting_sigma_deg: NotNegative = 0.5
    gnss_lever_arm_m: Three = (0.0, 0.0, 0.0)
    odometer_lever_arm_m: Three = (0.0, 0.0, 0.0)
    output_point_m: Three = (0.0, 0.0, 0.0)
    gnss_correlated_m: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    gnss_correlation_s: Positive = 120.0
    gnss_position_floor_m: Positive = 0.005
    gnss_velocity_floor_m_s: Positive = 0.005
    gnss_velocity_age_ms: NotNegative = 0.0
    gnss_timeout_s: NotNegative = 5.0
    odometer_timeout_s: NotNegative = 5.0
    barometer_timeout_s: NotNegative = 10.0
    odometer_sigma_m_s: Positive = 0.03
    odometer_walk_m_per_sqrt_m: NotNegative = 0.003
    odometer_scale_ppm: Positive = 10_000.0
    barometer_bias_m: Positive = 30.0
    barometer_wander_m_per_sqrt_s: NotNegative = 0.05
    non_holonomic: bool = True
    non_holonomic_sigma_m_s: Positive = 0.1
    sideways_walk_m_per_sqrt_m: NotNegative = 0.0
    zero_velocity_sigma_m_s: NotNegative = 0.01
    zero_rate_sigma_deg_per_s: NotNegative = 0.0
    rest_gyro_deg_per_s: Positive | None = None
    rest_accel_m_s2: Positive | None = None
    gap_limit_s: Positive = 3.0
    azimuth: str = "wander"
    azimuth_rate_deg_per_h: float = 0.0
    samples_per_update: Annotated[int, Meta(ge=1, le=6)] = 2
    imu_errors: ImuErrors = field(default_factory=ImuErrors)
    align: AlignOptions = field(default_factory=AlignOptions)
    transfer: TransferOptions = field(default_factory=TransferOptions)
    height_channel: HeightChannel | None = None
