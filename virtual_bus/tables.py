"""The tables of a scenario: start, vehicle, devices, sway, and what the bridge is told."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from virtual_bus.sway import FASTEST_HZ

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Rate = Annotated[float, Meta(ge=0.1, le=2000.0)]
DitherHz = Annotated[float, Meta(ge=160.0, le=1000.0)]
DegC = Annotated[float, Meta(ge=-60.0, le=140.0)]
Three = tuple[float, float, float]
Two = tuple[NotNegative, NotNegative]
Sigmas = tuple[NotNegative, NotNegative, NotNegative]


class Table(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Base of the tables of a scenario: no unknown key."""


class Start(Table):
    """``[start]``: where and when; GPS time of the first instant.

    ``heading_deg`` is true heading there (at a pole, along the meridian ``lon_deg``), which it has
    ``speed_m_s`` along already.
    """

    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    height_m: Annotated[float, Meta(ge=-1000.0, le=10_000.0)] = 0.0
    heading_deg: float = 0.0
    speed_m_s: NotNegative = 0.0
    gps_week: Annotated[int, Meta(ge=0, le=4095)] = 2300
    gps_tow_s: Annotated[int, Meta(ge=0, lt=604_800)] = 216_000
    leap_seconds: Annotated[int, Meta(ge=0, le=255)] = 18


class VehicleOptions(Table):
    """``[vehicle]``: places in vehicle axes (right, forward, up) from the middle of the rear axle.

    Its heading wanders ``crab_deg`` about its path (camber, side wind, steering).

    ``mounting_deg`` is pitch, roll, heading of the IMU in the vehicle as its maker wrote down; pitch and
    heading really differ from it by ``mounting_sigma_deg``, and roll too where there is a master.
    ``output_m`` is the point that the solution is for and truth is told at; by default the IMU. An aircraft
    ``banks`` into its curves.
    """

    imu_m: Three = (0.3, 1.2, 0.5)
    antenna_m: Three = (-0.2, 0.7, 1.6)
    output_m: Three | None = None
    mounting_deg: Three = (0.0, 0.0, 0.0)
    mounting_sigma_deg: NotNegative = 0.0
    roll_deg_per_g: float = 3.0
    pitch_deg_per_g: float = 0.0
    crab_deg: NotNegative = 0.0
    banks: bool = False


class DeviceTable(Table):
    """What the table of every device holds: its bus and how late its frames come.

    ``latency_ms`` is the shortest time from the instant measured to the first frame, ``jitter_ms`` what
    may be added (the mean of an exponential law for GNSS, the end of a uniform one for the others).
    ``clock_ppm`` by default is drawn; ``clock_offset_s`` is the device's clock at the start.
    """

    channel: str = "can0"
    latency_ms: NotNegative = 0.4
    jitter_ms: NotNegative = 0.1
    clock_ppm: Annotated[float, Meta(ge=-1000.0, le=1000.0)] | None = None
    clock_offset_s: NotNegative = 0.0


class ImuTable(DeviceTable):
    """``[imu]``. Its clock starts 100 s before its 32-bit microseconds wrap.

    ``dither_hz`` of laser gyros: each is latched at whole cycles of its own. ``inner_arms_mm`` is where
    each accelerometer sits, right, forward and up of the unit's origin. A redundant unit has more than three
    of each along ``axes``: "cone" six, "skew" five. From the first instant on it warms up
    from one ``temperature_deg_c`` to the other with the time constant ``warm_up_s``.
    """

    rate_hz: Rate = 200.0
    fd: bool = False
    temperature_deg_c: tuple[DegC, DegC] = (25.0, 37.0)
    warm_up_s: Positive = 600.0
    dither_hz: tuple[DitherHz, DitherHz, DitherHz] | None = None
    inner_arms_mm: tuple[Three, Three, Three] | None = None
    axes: Literal["cone", "skew"] | None = None
    clock_offset_s: NotNegative = 4194.967296


class OdometerTable(DeviceTable):
    """``[odometer]``. Tyre and road make the distance walk off by ``walk_m_per_sqrt_m``.

    ``ticks`` is what its counter shows at the start: shortly before it wraps.
    """

    rate_hz: Rate = 50.0
    m_per_tick: Positive = 0.02
    scale_error_ppm: NotNegative = 2000.0
    walk_m_per_sqrt_m: NotNegative = 0.0035
    ticks: Annotated[int, Meta(ge=0, lt=1 << 32)] = (1 << 32) - 20_000


class SpeedTable(DeviceTable):
    """``[speed]``: a Doppler log."""

    rate_hz: Rate = 10.0
    sigma_m_s: Positive = 0.05
    scale_error_ppm: NotNegative = 1000.0


class BaroTable(DeviceTable):
    """``[baro]``: sigmas of the datum, its drift, and the noise, in metres of height."""

    rate_hz: Rate = 25.0
    offset_m: NotNegative = 5.0
    drift_m: NotNegative = 0.5
    correlation_s: Positive = 1000.0
    noise_m: NotNegative = 0.3


class EncoderTable(DeviceTable):
    """Encoders of a turntable's outer, middle and inner axis, which turn about ``axes`` when all are zero.

    A reading is wrong by up to ``sigma_arcsec`` (rms over a turn): the circle that is read is off its centre.
    """

    axes: str = "zxy"
    sigma_arcsec: NotNegative = 2.0
    rate_hz: Rate = 50.0


class GnssTable(DeviceTable):
    """``[gnss]``: sigmas are [horizontal per axis, vertical]."""

    rate_hz: Rate = 5.0
    latency_ms: NotNegative = 60.0
    jitter_ms: NotNegative = 4.0
    white_m: Two = (0.5, 0.8)
    correlated_m: Two = (0.0, 0.0)
    correlation_s: Positive = 120.0
    velocity_m_s: Two = (0.03, 0.05)
    fix_type: Annotated[int, Meta(ge=2, le=6)] = 3
    satellites: Annotated[int, Meta(ge=4, le=60)] = 14


class MasterTable(DeviceTable):
    """``[master]``: a navigator of the class of 0.8 nmi/h at ``at_m`` of the vehicle, its axes the vehicle's.

    The first seven are sigmas of its lasting errors at the start, those with ``noise`` of single messages.
    On a ``platform`` it has no rates and forces to tell. What it says is ``age_ms`` older than it tells.
    """

    rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 50.0
    latency_ms: NotNegative = 4.0
    jitter_ms: NotNegative = 1.0
    at_m: Three = (0.0, 0.0, 0.0)
    platform: bool = False
    age_ms: NotNegative = 0.0
    tilt_mrad: NotNegative = 0.1
    heading_mrad: NotNegative = 1.0
    velocity_m_s: NotNegative = 0.5
    position_m: NotNegative = 1000.0
    height_m: NotNegative = 5.0
    gyro_deg_per_h: NotNegative = 0.008
    accel_ug: NotNegative = 30.0
    position_noise_m: NotNegative = 0.5
    velocity_noise_m_s: NotNegative = 0.02
    attitude_noise_mrad: NotNegative = 0.1
    rate_noise_deg_per_s: NotNegative = 0.03
    force_noise_m_s2: NotNegative = 0.05


class FlexureTable(Table):
    """``[flexure]``: the IMU turns on its mounting, about right, forward and up of itself.

    ``sigma_mrad`` of a second-order Markov process, which forgets within ``correlation_s``, and
    ``vibration_mrad`` of a resonance at ``vibration_hz``. It turns about a point that is ``arm_m`` before it,
    in vehicle axes: by default the master.
    """

    sigma_mrad: Sigmas = (0.3, 0.3, 0.3)
    correlation_s: tuple[Positive, Positive, Positive] = (0.5, 0.5, 0.5)
    vibration_mrad: Sigmas = (0.02, 0.02, 0.02)
    vibration_hz: Annotated[float, Meta(ge=1.0, le=30.0)] = 12.0
    arm_m: Three | None = None


class SwayTable(Table):
    """``[sway]``: it sways about the place of its rear axle, rms angles, between two frequencies.

    From the first instant on, or from rest: then it begins after ``begins_s``.
    """

    heading_deg: NotNegative = 0.0
    pitch_deg: NotNegative = 0.0
    roll_deg: NotNegative = 0.0
    slowest_hz: Positive = 0.1
    fastest_hz: Annotated[float, Meta(gt=0.0, le=FASTEST_HZ)] = 0.5
    begins_s: NotNegative | None = None

    def speed_m_s(self, lever_m: Three) -> float:
        """Velocity of a point so far off that place, root mean square of an axis."""
        x, y, z = (part * part for part in lever_m)
        low, high = self.slowest_hz, self.fastest_hz
        rate = 2.0 * math.pi * math.sqrt((low * low + low * high + high * high) / 3.0)
        swept = self.heading_deg**2 * (x + y) + self.pitch_deg**2 * (y + z) + self.roll_deg**2 * (x + z)
        return rate * math.radians(math.sqrt(swept / 3.0))


class NavigatorTable(Table):
    """``[navigator]``: what the bridge is told about this vehicle, and the frame it shows in polar waters.

    ``alignment`` is one that the bridge knows by that name; without ``autostart`` it waits for a command.
    It may take ``alignment_s``, by default nearly as long as the vehicle rests at the start. Counts of gyros
    that dither are corrected by its method ``whole_cycle``, or taken as they are.
    """

    alignment: str = "static"
    alignment_s: Annotated[float, Meta(ge=2.0)] | None = None
    autostart: bool = True
    find_mounting: bool = False
    non_holonomic: bool = True
    whole_cycle: str | None = None
    polar: Literal["geographic", "grid", "transverse"] = "geographic"
