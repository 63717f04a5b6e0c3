"""Drivers: frames of one device in, samples in SI units and engine time out.

A driver has ``keys``, the (source, key) pairs it subscribes to, ``counters``, and ``feed(frame)``, which
returns the samples that this frame completed. It never raises on a frame: what it turns away it counts. A
new driver is a file here and a line in `DRIVERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.drivers.baro_can import BaroCan, BaroCanOptions
from bridge.drivers.base import Entry
from bridge.drivers.dbc_map import DbcMap
from bridge.drivers.dbc_map_options import DbcMapOptions
from bridge.drivers.gnss_can import GnssCan, GnssCanOptions
from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.drivers.master_can import MasterCan, MasterCanOptions
from bridge.drivers.master_mavlink import MasterMavlink, MasterMavlinkOptions
from bridge.drivers.odometer_can import OdometerCan, OdometerCanOptions
from bridge.drivers.sensors_mavlink import SensorsMavlink, SensorsMavlinkOptions
from bridge.drivers.speed_can import SpeedCan, SpeedCanOptions
from bridge.drivers.table_can import TableCan, TableCanOptions


def _always(kind: str) -> Callable[[Any], frozenset[str]]:
    return lambda options: frozenset((kind,))


def _mapped(options: DbcMapOptions) -> frozenset[str]:
    channels = ("imu", "gnss", "speed", "odometer")
    return frozenset(name for name in channels if getattr(options, name) is not None)


DRIVERS: dict[str, Entry] = {
    "imu_can": Entry(ImuCanOptions, ImuCan, "can", _always("imu")),
    "odometer_can": Entry(OdometerCanOptions, OdometerCan, "can", _always("odometer")),
    "speed_can": Entry(SpeedCanOptions, SpeedCan, "can", _always("speed")),
    "gnss_can": Entry(GnssCanOptions, GnssCan, "can", _always("gnss")),
    "baro_can": Entry(BaroCanOptions, BaroCan, "can", _always("baro")),
    "master_can": Entry(MasterCanOptions, MasterCan, "can", _always("master")),
    "master_mavlink": Entry(MasterMavlinkOptions, MasterMavlink, "mavlink", _always("master")),
    "table_can": Entry(TableCanOptions, TableCan, "can", _always("table")),
    "sensors_mavlink": Entry(
        SensorsMavlinkOptions, SensorsMavlink, "mavlink", SensorsMavlinkOptions.provides
    ),
    "dbc_map": Entry(DbcMapOptions, DbcMap, "can", _mapped),
}
