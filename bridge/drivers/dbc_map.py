"""Devices that speak somebody else's DBC: the mapping in the configuration says which signal is what.

::

    [device.unit]
    driver = "dbc_map"
    source = "can0"
    dbc = "vendor.dbc"

    [device.unit.imu]
    rate_hz = 100
    valid = { ImuValid = 1 }
    gyro = { x = "AngularRateY", y = "-AngularRateX", z = "AngularRateZ" }
    accel = { x = "AccelerationY", y = "-AccelerationX", z = "AccelerationZ", unit = "g" }

A device may have any of the channels imu, gnss, speed and odometer (`bridge.drivers.dbc_map_options`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from cantools.database.errors import Error as CantoolsError

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.dbc_map_channels import BaseChannel, ImuChannel, OdometerChannel, SpeedChannel
from bridge.drivers.dbc_map_gnss import GnssChannel
from bridge.drivers.dbc_map_options import DbcMapOptions
from bridge.drivers.dbc_map_signals import Book, key_of
from bridge.frame import RawFrame
from bridge.outputs import Reject
from nav.types import Sample

__all__ = ["DbcMap", "DbcMapOptions"]


class DbcMap:
    """Decodes the frames that its channels map and hands the values to them.

    Raises ConfigError when the DBC file is none, or the mapping names a signal or a unit that is not there.
    """

    def __init__(self, options: DbcMapOptions, context: Context) -> None:
        book = Book(context.files[options.dbc], options.dbc, context.file, f"device.{context.name}")
        self.counters = Counters()
        channels: list[BaseChannel] = []
        if options.imu is not None:
            channels.append(ImuChannel(book, options, options.imu, context, self.counters))
        if options.gnss is not None:
            channels.append(GnssChannel(book, options, options.gnss, context, self.counters))
        if options.speed is not None:
            channels.append(SpeedChannel(book, options, options.speed, context, self.counters))
        if options.odometer is not None:
            channels.append(OdometerChannel(book, options, options.odometer, context, self.counters))
        if not channels:
            raise context.wrong("dbc", options.dbc, "at least one of the tables imu, gnss, speed, odometer")
        self._channels = {
            key: [channel for channel in channels if key in channel.keys]
            for key in sorted({key for channel in channels for key in channel.keys})
        }
        self._messages = {key_of(m): m for m in book.messages.values()}
        self.keys = [(context.source, key) for key in self._channels]

    def feed(self, frame: RawFrame) -> Sequence[Sample]:
        """The samples that ``frame`` completes."""
        _, rx_ns, _, key, data = frame
        counters = self.counters
        counters.frames += 1
        message = self._messages[key]
        if len(data) < message.length:
            return counters.reject(Reject.LENGTH)
        try:
            # longer is good: a device may pad its frames; no choices, so that all values are numbers
            values = cast(dict[str, float], message.decode_simple(data, decode_choices=False))
        except (CantoolsError, ValueError):
            return counters.reject(Reject.RANGE)  # a multiplexer value that the file does not know
        channels = self._channels[key]
        if len(channels) == 1:
            return channels[0].take(key, rx_ns, values)
        return [sample for channel in channels for sample in channel.take(key, rx_ns, values)]
