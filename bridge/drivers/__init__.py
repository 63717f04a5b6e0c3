"""Drivers: frames of one device in, samples in SI units and engine time out.

A driver has ``keys``, the (source, key) pairs it subscribes to, ``counters``, and ``feed(frame)``, which
returns the samples that this frame completed. It never raises on a frame: what it turns away it counts. A
new driver is a file here and a line in `DRIVERS`.
"""

from __future__ import annotations

from bridge.drivers.baro_can import BaroCan, BaroCanOptions
from bridge.drivers.base import Entry
from bridge.drivers.gnss_can import GnssCan, GnssCanOptions
from bridge.drivers.imu_can import ImuCan, ImuCanOptions
from bridge.drivers.odometer_can import OdometerCan, OdometerCanOptions
from bridge.drivers.sensors_mavlink import SensorsMavlink, SensorsMavlinkOptions
from bridge.drivers.speed_can import SpeedCan, SpeedCanOptions

DRIVERS: dict[str, Entry] = {
    "imu_can": Entry(ImuCanOptions, ImuCan, "can"),
    "odometer_can": Entry(OdometerCanOptions, OdometerCan, "can"),
    "speed_can": Entry(SpeedCanOptions, SpeedCan, "can"),
    "gnss_can": Entry(GnssCanOptions, GnssCan, "can"),
    "baro_can": Entry(BaroCanOptions, BaroCan, "can"),
    "sensors_mavlink": Entry(SensorsMavlinkOptions, SensorsMavlink, "mavlink"),
}
