"""What a mapping of somebody else's DBC file may say.

A quantity is the name of a signal, with a minus sign in front where the device counts the other way
and with its message (``Message.Signal``) where the name alone is ambiguous, or a table that adds a
unit, a factor, or gives a constant::

    lat = "Latitude"                                           # unit from the DBC file
    height = { signal = "Altitude", unit = "m" }               # unit stated
    sigma_up = { value = 3.0, unit = "m" }                     # the same for every fix
    sigma_horizontal = { signal = "Accuracy95", scale = 0.408 }

A condition is a table of signals and the values that fulfil it: ``{ ImuValid = 1, Mode = [2, 3] }``.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta, field

from bridge.options import DeviceOptions, NotNegative, Positive
from bridge.strict import Table


class Term(Table):
    """A signal or a constant, with its unit; ``scale`` multiplies what the device says."""

    signal: str | None = None
    value: float | None = None
    unit: str | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Raise ValueError unless there is one of signal and value, and a unit for a value."""
        if (self.signal is None) == (self.value is None):
            raise ValueError("found both or none of signal and value, expected one of them")
        if self.value is not None and self.unit is None:
            raise ValueError('found a value without unit, expected one, for example unit = "m"')


Quantity = str | Term
Condition = dict[str, int | list[int]]


class Axes(Table):
    """The body's right, forward and up axes; ``unit`` is for all three where they state none."""

    x: Quantity
    y: Quantity
    z: Quantity
    unit: str | None = None


class Channel(Table):
    """What every channel has.

    ``valid`` says when its values may be used. Frames belong to one epoch when their ``counter`` signals
    are equal, or without one when they arrive within ``window_ms``. ``time`` is the device's own time
    of the measurement, and all of one device count from one zero; without it arrival is the time.
    """

    valid: Condition = field(default_factory=dict)
    counter: str | None = None
    window_ms: Positive = 50.0
    time: Quantity | None = None


class ImuMap(Channel, kw_only=True):
    """``[device.NAME.imu]``: angular rates and specific forces, or their increments over a sample."""

    gyro: Axes
    accel: Axes
    rate_hz: Positive
    signals: Literal["rates", "increments"] = "rates"
    bridge_samples: Annotated[int, Meta(ge=0, le=100)] = 5


class FixTypes(Table):
    """A signal and the kind of fix each of its values stands for."""

    signal: str
    values: dict[str, str]


class GnssMap(Channel, kw_only=True):
    """``[device.NAME.gnss]``: a position, and a velocity as three components or as speed and course.

    ``fix_type`` is the name of a kind of fix, or a signal's values and their names. ``utc`` is the time
    of the fix in seconds since 1970. Standard deviations are one sigma of one axis.
    """

    lat: Quantity
    lon: Quantity
    height: Quantity
    sigma_up: Quantity
    sigma_horizontal: Quantity | None = None
    sigma_east: Quantity | None = None
    sigma_north: Quantity | None = None
    vel_east: Quantity | None = None
    vel_north: Quantity | None = None
    vel_up: Quantity | None = None
    speed: Quantity | None = None
    course: Quantity | None = None
    sigma_speed: Quantity | None = None
    sigma_course: Quantity | None = None
    sigma_vel_up: Quantity | None = None
    velocity_valid: Condition = field(default_factory=dict)
    fix_type: str | FixTypes = "FIX_3D"
    satellites: str | None = None
    utc: Quantity | None = None
    leap_seconds: Annotated[int, Meta(ge=0, le=255)] = 18


class SpeedMap(Channel, kw_only=True):
    """``[device.NAME.speed]``: forward speed; ``reverse`` says when an unsigned one is backward."""

    speed: Quantity
    sigma: Quantity
    reverse: Condition = field(default_factory=dict)


class OdometerMap(Channel, kw_only=True):
    """``[device.NAME.odometer]``: a distance that counts up and wraps at the end of its signal."""

    distance: Quantity | None = None
    ticks: str | None = None
    m_per_tick: Positive | None = None
    reverse: Condition = field(default_factory=dict)
    standstill: Condition = field(default_factory=dict)
    max_speed_m_s: Positive = 100.0


class DbcMapOptions(DeviceOptions, kw_only=True):
    """``[device.NAME]`` with ``driver = "dbc_map"``: a device that speaks somebody else's DBC."""

    files: ClassVar[tuple[str, ...]] = ("dbc",)

    dbc: str
    min_sigma_position_m: NotNegative = 0.005
    min_sigma_velocity_m_s: NotNegative = 0.005
    imu: ImuMap | None = None
    gnss: GnssMap | None = None
    speed: SpeedMap | None = None
    odometer: OdometerMap | None = None
