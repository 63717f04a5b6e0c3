"""``navbridge check``: read a configuration and everything it names, open nothing."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.calibration_sensors import RedundantFile, read_unit
from bridge.config import Config, packaged_configs


def add_parser(subparsers: Any) -> None:
    """Add the sub-command's options."""
    parser = subparsers.add_parser(
        "check",
        help="check a configuration without opening a bus",
        description="Read a configuration and every file it names, and build what would run, without opening "
        "a bus. Exit status 2 and one line that says what is wrong where it cannot run.",
    )
    parser.add_argument(
        "config",
        metavar="CONFIG",
        help=f"path of a configuration, or the name of a packaged one ({', '.join(packaged_configs())})",
    )
    parser.add_argument(
        "--resolved", action="store_true", help="print the configuration with every default spelled out"
    )


def run(args: argparse.Namespace) -> int:
    """Check and say what the configuration has."""
    # the engine brings compiled kernels with it, which --help need not wait for
    from bridge.assemble import make_sinks, make_sources
    from bridge.clock import HostClock, WallClock
    from bridge.drivers.imu_can import ImuCanOptions
    from bridge.engine import Engine
    from bridge.navigators import provided

    config = Config.load(args.config)
    clock = HostClock()
    engine = Engine(config, warm=False)
    make_sinks(config, engine)
    make_sources(config, engine, clock, WallClock(clock))
    if args.resolved:
        print(config.resolved_toml(), end="")
        return 0
    print(f"{args.config}: in order")
    for name, source in config.sources.items():
        print(f"  source {name}: {source.type}")
    for name, device in config.devices.items():
        print(f"  device {name}: {device.driver} on {device.source}")
        if isinstance(device, ImuCanOptions):
            print(f"    {_calibration(config.files[device.calibration], device.calibration)}")
    for name, navigator in config.navigators.items():
        kinds = ", ".join(sorted(provided(name, config)))
        print(f"  navigator {name}: {kinds}; {navigator.alignment} alignment")
    for name, sink in config.sinks.items():
        print(f"  sink {name}: {sink.type} of {sink.navigator} on {sink.source}")
    return 0


def _calibration(data: bytes, name: str) -> str:
    """What a calibration file says of itself, in a line."""
    file = read_unit(data, name)
    unit = "any unit" if file.serial is None else f"serial number {file.serial}"
    if isinstance(file, RedundantFile):
        unit += f", {len(file.gyros.axes)} gyros and {len(file.accels.axes)} accelerometers"
    made = file.certificate
    if made is None:
        return f"{name}: for {unit}, no certificate"
    return f"{name}: for {unit}, {made.date[:10]} at {made.temperature_deg_c:.1f} degC, {made.plan}"
