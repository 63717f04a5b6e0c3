"""The mapping of a folder of tables to devices: which column is what, in which unit.

A mapping is TOML. ``config`` names the bridge configuration that the capture is replayed with (a
path relative to the mapping, or a packaged name). Each table ``[imu.NAME]``, ``[gnss.NAME]``,
``[odometer.NAME]`` or ``[baro.NAME]`` stands for the device NAME of that configuration. Times are those of
one clock, GPS time where there are fixes, in the week ``gps_week``::

    config = "bench.toml"

    [imu.imu]
    file = "imu.csv"
    time = { column = "t", unit = "s" }
    gyro = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
    accel = { columns = ["ax", "-az", "ay"], unit = "g" }

A minus before a column's name turns its sign.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from bridge.options import NotNegative
from bridge.strict import Table


class Column(Table):
    """One column and its unit."""

    column: str
    unit: str


class Columns(Table):
    """Three columns of one unit."""

    columns: tuple[str, str, str]
    unit: str


class Choice(Table):
    """A column of codes and what each stands for."""

    column: str
    values: dict[str, str]


class Source(Table, kw_only=True):
    """What every table has: its file, its time, and how late its frames arrive.

    ``delay_ms`` is the time from the instant measured to the frame's arrival.
    """

    file: str
    time: Column
    delay_ms: NotNegative = 0.0


class Imu(Source, kw_only=True):
    """Angular rate and specific force, each held over the interval that ends at its time."""

    gyro: Columns
    accel: Columns
    temperature_deg_c: float = 25.0


class Gnss(Source, kw_only=True):
    """Fixes; ``time`` is GPS time."""

    lat: Column
    lon: Column
    height: Column
    sigma: Columns  # east, north, up
    velocity: Columns | None = None  # east, north, up
    sigma_velocity: Columns | None = None  # east, north, up
    sigma_velocity_m_s: tuple[NotNegative, NotNegative, NotNegative] | None = None
    fix_type: Choice | str = "FIX_3D"
    satellites: Annotated[int, Meta(ge=0, le=63)] = 0
    leap_seconds: Annotated[int, Meta(ge=0, le=255)] = 18


class Odometer(Source, kw_only=True):
    """Forward speed, made into the ticks of the configuration's ``m_per_tick``."""

    speed: Column


class Baro(Source, kw_only=True):
    """Static pressure."""

    pressure: Column
    temperature_deg_c: float = 15.0


class Mapping(Table):
    """A mapping file. All times count from the beginning of the GPS week ``gps_week``."""

    config: str
    gps_week: Annotated[int, Meta(ge=0)] = 0
    imu: dict[str, Imu] = field(default_factory=dict)
    gnss: dict[str, Gnss] = field(default_factory=dict)
    odometer: dict[str, Odometer] = field(default_factory=dict)
    baro: dict[str, Baro] = field(default_factory=dict)
