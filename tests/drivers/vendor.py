"""A made-up vendor's DBC file with everything that such a file can have; drivers for it, and its frames."""

from __future__ import annotations

import math
from typing import Any

import cantools.database

from bridge.drivers.dbc_map import DbcMap, DbcMapOptions
from bridge.frame import CAN_EFF, RawFrame
from bridge.strict import convert, parse
from tests.drivers.made import context

VENDOR = """VERSION ""
NS_ :
BS_:
BU_: UNIT

BO_ 2147484689 Rates: 8 UNIT
 SG_ RateFwd : 7|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ RateLeft : 23|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ RateUp : 39|16@0- (0.01,0) [-327|327] "deg/s" UNIT
 SG_ Count : 51|4@0+ (1,0) [0|14] "" UNIT
 SG_ Ok : 52|1@0+ (1,0) [0|1] "" UNIT

BO_ 1042 Forces: 8 UNIT
 SG_ AccFwd : 0|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ AccLeft : 16|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ AccUp : 32|16@1- (0.001,0) [0|0] "g" UNIT
 SG_ Count : 48|4@1+ (1,0) [0|14] "" UNIT
 SG_ Ok : 52|1@1+ (1,0) [0|1] "" UNIT

BO_ 1043 Single: 8 UNIT
 SG_ W : 0|16@1- (0.01,0) [0|0] "deg/s" UNIT
 SG_ A : 16|16@1- (0.01,0) [0|0] "m/s^2" UNIT
 SG_ Stamp : 32|16@1+ (0.1,0) [0|0] "ms" UNIT
 SG_ Count : 48|8@1+ (1,0) [0|0] "" UNIT
 SG_ Ok : 56|1@1+ (1,0) [0|1] "" UNIT

BO_ 1060 Position: 8 UNIT
 SG_ Lat : 0|32@1- (1E-007,0) [-90|90] "°" UNIT
 SG_ Lon : 32|32@1- (1E-007,0) [-180|180] "°" UNIT

BO_ 1061 Motion: 8 UNIT
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" UNIT
 SG_ Height m0 : 8|24@1- (0.01,0) [0|0] "m" UNIT
 SG_ HAcc m0 : 32|16@1+ (1,0) [0|0] "mm" UNIT
 SG_ VAcc m0 : 48|16@1+ (1,0) [0|0] "mm" UNIT
 SG_ VelN m1 : 8|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ VelE m1 : 24|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ VelD m1 : 40|16@1- (1,0) [0|0] "cm/s" UNIT
 SG_ Fix m1 : 56|4@1+ (1,0) [0|15] "" UNIT
 SG_ VelOk m1 : 60|1@1+ (1,0) [0|1] "" UNIT

BO_ 1070 Wheel: 6 UNIT
 SG_ Ticks : 0|16@1+ (1,0) [0|0] "" UNIT
 SG_ Back : 16|1@1+ (1,0) [0|1] "" UNIT
 SG_ Stop : 17|1@1+ (1,0) [0|1] "" UNIT
 SG_ Trip : 24|16@1+ (0.1,0) [0|0] "m" UNIT

BO_ 1071 Speedo: 4 UNIT
 SG_ Kmh : 0|16@1+ (0.01,0) [0|300] "km/h" UNIT
 SG_ Back : 16|1@1+ (1,0) [0|1] "" UNIT

BO_ 1072 Floats: 8 UNIT
 SG_ Fast : 0|32@1- (1,0) [0|0] "m/s" UNIT
 SG_ Odd : 32|32@1- (1,0) [-10|10] "smoot" UNIT

SIG_VALTYPE_ 1072 Fast : 1;
SIG_VALTYPE_ 1072 Odd : 1;
"""
DB = cantools.database.load_string(VENDOR, "dbc")
MS = 1_000_000
DEG = math.pi / 180.0
G = 9.80665

TWO_FRAME_IMU = """
[imu]
rate_hz = 100
counter = "Count"
valid = { "Rates.Ok" = 1, "Forces.Ok" = 1 }
gyro = { x = "-RateLeft", y = "RateFwd", z = "RateUp" }
accel = { x = "-AccLeft", y = "AccFwd", z = "AccUp" }
"""
ONE_FRAME_IMU = """
[imu]
rate_hz = 100
valid = { "Single.Ok" = 1 }
gyro = { x = "W", y = "W", z = "-W" }
accel = { x = "A", y = "-A", z = "A" }
"""
GNSS = """
[gnss]
lat = "Lat"
lon = "Lon"
height = "Height"
sigma_horizontal = { signal = "HAcc", scale = 0.5 }
sigma_up = "VAcc"
vel_east = "VelE"
vel_north = "VelN"
vel_up = "-VelD"
sigma_speed = { value = 5, unit = "cm/s" }
sigma_vel_up = { value = 0.2, unit = "m/s" }
velocity_valid = { VelOk = 1 }
fix_type = { signal = "Fix", values = { 0 = "NO_FIX", 3 = "FIX_3D", 9 = "RTK_FIXED" } }
window_ms = 30
"""


def mapped(dbc: str, file: bytes, text: str, **more: Any) -> DbcMap:
    """A driver for the DBC ``file`` of that name, mapped by ``text``."""
    table = {"driver": "dbc_map", "source": "can0", "dbc": dbc, **more, **parse(text.encode(), "test.toml")}
    options = convert(table, DbcMapOptions, "test.toml", "device.dev")
    return DbcMap(options, context(files={dbc: file}))


def made(text: str, **more: Any) -> DbcMap:
    """A driver for the made-up vendor's file."""
    return mapped("vendor.dbc", VENDOR.encode("cp1252"), text, **more)


def frame(message: str, rx_ns: int, **values: float) -> RawFrame:
    m = DB.get_message_by_name(message)
    zero = {s.name: 0 for s in m.signals}
    key = m.frame_id | (CAN_EFF if m.is_extended_frame else 0)
    return RawFrame(0, rx_ns, 1, key, m.encode({**zero, **values}, strict=False))


def feed(driver: DbcMap, *frames: RawFrame) -> list[Any]:
    return [sample for f in frames for sample in driver.feed(f)]


def pair(count: int, rx_ns: int, ok: int = 1, **values: float) -> tuple[RawFrame, RawFrame]:
    rates = {k: v for k, v in values.items() if k.startswith("Rate")}
    forces = {k: v for k, v in values.items() if k.startswith("Acc")}
    return (
        frame("Rates", rx_ns, Count=count % 15, Ok=ok, **rates),
        frame("Forces", rx_ns + MS, Count=count % 15, Ok=1, **forces),
    )
