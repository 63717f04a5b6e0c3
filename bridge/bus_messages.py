"""Which messages a configuration has on its CAN buses, and how much of them these take."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from bridge.config import Config
from bridge.drivers.base import Driver
from bridge.drivers.imu_can import ImuCanOptions
from bridge.engine import build_drivers
from bridge.options import CanSource, DeviceOptions
from bridge.sinks.can_solution import CanSolutionOptions
from bridge.sinks.epoch import EPOCH
from dbc.busload import IMU_CLASSIC, IMU_FD, BusLoad, Stream, bus_load, stream
from nav.transfer import PREFIX

_BESIDE = ("SOL_REJECTS", "SOL_HEALTH", "SOL_ALIGN")
_TRANSFER = ("SOL_TRANSFER", "SOL_TRANSFER_OBS")


class Bus(NamedTuple):
    """The load of one bus, and the devices and sinks on it that have messages of their own."""

    load: BusLoad
    others: tuple[str, ...]


def buses(config: Config, bitrate: int, data_bitrate: int | None, *, fd: bool) -> list[Bus]:
    """The load of every CAN bus of ``config``; ``fd``: units that may send CAN FD frames do.

    A bus has the bit rates that its source says, else these. Samples of units and solutions come at the rates
    configured, all else at the contract's. What is sent during an alignment is counted.

    Raises:
        ConfigError: a file that a device needs is wrong.
    """
    drivers = build_drivers(config)
    made = []
    for name, source in config.sources.items():
        if not isinstance(source, CanSource):
            continue
        found = {
            device: list(_heard(config, options, drivers[device], fd))
            for device, options in config.devices.items()
            if options.source == name
        }
        found |= {
            sink: list(_solutions(config, options)) if isinstance(options, CanSolutionOptions) else []
            for sink, options in config.sinks.items()
            if options.source == name
        }
        streams = [one for every in found.values() for one in every]
        others = [who for who, every in found.items() if not every]
        rates = source.bitrate or bitrate, source.data_bitrate or data_bitrate
        made.append(Bus(bus_load(name, sorted(streams, key=lambda one: one.frame_id), *rates), tuple(others)))
    return made


def _heard(config: Config, options: DeviceOptions, driver: Driver, fd: bool) -> Iterator[Stream]:
    """What a device of the contract sends; nothing of one that has another DBC."""
    offset = getattr(options, "id_offset", None)
    if offset is None:
        return
    rate = options.rate_hz if isinstance(options, ImuCanOptions) else 0.0
    codecs = {codec.frame_id + offset: codec for codec in config.contract.values()}
    sent = {key: codecs[key] for _, key in driver.keys}
    both = {codec.name for codec in sent.values()}
    left_out = IMU_CLASSIC if fd and both.issuperset(IMU_FD) else IMU_FD
    for key, codec in sent.items():
        if codec.name not in left_out:
            yield stream(codec, key, rate, 0.0)


def _solutions(config: Config, options: CanSolutionOptions) -> Iterator[Stream]:
    """What a sink sends of its navigator, and of every unit of more than three sensors."""
    navigator = config.navigators[options.navigator]
    transfer = _TRANSFER if navigator.alignment.startswith(PREFIX) else ()
    redundant = [one for one in config.devices.values() if getattr(one, "redundant", None) is not None]
    names = (*EPOCH, *_BESIDE, *transfer, *("SOL_IMU_HEALTH" for _ in redundant))
    for name in names:
        codec = config.contract[name]
        yield stream(codec, codec.frame_id + options.id_offset, 0.0, options.rate_hz)
