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
    """A MAVLink link through pymavlink; ``system_id`` and ``component_id`` are those we send with."""

    url: str
    system_id: SystemId = 1
    component_id: SystemId = 1
    baud: Annotated[int, Meta(gt=0)] = 57600


SOURCE_OPTIONS: dict[str, type[SourceOptions]] = {"can": CanSource, "mavlink": MavlinkSource}


class DeviceOptions(Table):
    """``[device.NAME]``: what every driver's options begin with.

    ``clock`` names a clock shared with other devices (one PPS); by default each has its own.
    ``latency_ms`` is the shortest time from the instant measured to the frame's receive stamp.
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
    """``[navigator.NAME.imu_errors]``: how good the IMU is, one sigma, after its calibration."""

    gyro_bias_deg_per_h: Positive = 0.5
    gyro_instability_deg_per_h: Positive = 0.05
    gyro_random_walk_deg_per_sqrt_h: Positive = 0.01
    accel_bias_ug: Positive = 500.0
    accel_instability_ug: Positive = 20.0
    accel_random_walk_ug_per_sqrt_hz: Positive = 20.0
    correlation_s: Positive = 3600.0


class NavigatorOptions(Table):
    """``[navigator.NAME]``: who is heard, how it starts, and where things are.

    Lever arms are in IMU axes (right, forward, up) from the IMU; ``output_point_m`` likewise.
    ``mounting_deg`` is pitch, roll, heading of the IMU in the vehicle, or "find".
    """

    devices: Annotated[list[str], Meta(min_length=1)]
    alignment: str = "static"
    autostart: bool = True
    mounting_deg: Three | Literal["find"] = (0.0, 0.0, 0.0)
    gnss_lever_arm_m: Three = (0.0, 0.0, 0.0)
    odometer_lever_arm_m: Three = (0.0, 0.0, 0.0)
    output_point_m: Three = (0.0, 0.0, 0.0)
    non_holonomic: bool = True
    imu_errors: ImuErrors = field(default_factory=ImuErrors)
