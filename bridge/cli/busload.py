"""``navbridge busload``: how much of a CAN bus the messages of a configuration, or the default set, take."""

from __future__ import annotations

import argparse
import json
from typing import Any

from rich.console import Console
from rich.table import Table

from bridge import arguments
from bridge.errors import ConfigError
from dbc.busload import BusLoad, as_document, default_table


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "busload",
        help="how much of a CAN bus the messages take",
        description="Compute the load of a CAN bus, without stuff bits and with as many as can be: of every "
        "bus of a configuration with the messages of its devices and sinks, or without one of a bus with one "
        "of every cyclic message, for one or more IMU rates. Exit status 1 when a worst case does not fit.",
    )
    parser.add_argument("config", metavar="CONFIG", nargs="?", help="a packaged configuration or a TOML file")
    parser.add_argument(
        "--imu-rate",
        metavar="HZ",
        type=arguments.rate,
        action="append",
        help="samples a second; may be repeated (default: 200 and 1000; with CONFIG its own)",
    )
    parser.add_argument(
        "--solution-rate",
        metavar="HZ",
        type=arguments.rate,
        help="published solutions a second (default: 50; with CONFIG its own)",
    )
    parser.add_argument(
        "--bitrate",
        metavar="BIT_S",
        type=arguments.whole(1),
        default=1_000_000,
        help="bit rate (default: 1000000), where CONFIG does not say it",
    )
    parser.add_argument(
        "--fd", action="store_true", help="IMUs send their CAN FD frame instead of three classic ones"
    )
    parser.add_argument(
        "--data-bitrate",
        metavar="BIT_S",
        type=arguments.whole(1),
        help="bit rate of the CAN FD data phase (default: --bitrate)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def run(args: argparse.Namespace) -> int:
    """Print the tables; exit status 1 when a worst case does not fit the bus."""
    others: list[tuple[str, ...]]
    if args.config is None:
        rates, solution = args.imu_rate or (200.0, 1000.0), args.solution_rate or 50.0
        loads = default_table(rates, solution, args.bitrate, args.data_bitrate, fd=args.fd)
        others = [() for _ in loads]
    else:
        for option, value in (("imu-rate", args.imu_rate), ("solution-rate", args.solution_rate)):
            if value is not None:
                raise ConfigError(f"--{option}: found one with {args.config}, which has its own")
        from bridge.bus_messages import buses
        from bridge.config import Config

        found = buses(Config.load(args.config), args.bitrate, args.data_bitrate, fd=args.fd)
        loads, others = [bus.load for bus in found], [bus.others for bus in found]
    if args.json:
        print(json.dumps([as_document(load) for load in loads], indent=2))
    else:
        console = Console()
        for load, left in zip(loads, others, strict=True):
            console.print(_table(load))
            if left:
                console.print(f"not counted, as their messages are not the bridge's own: {', '.join(left)}")
            console.print(_verdict(load))
    return 0 if all(load.load_worst <= 1.0 for load in loads) else 1


def _table(load: BusLoad) -> Table:
    rate = f"{load.bitrate / 1e6:g} Mbit/s"
    if load.data_bitrate != load.bitrate:
        rate += f", data {load.data_bitrate / 1e6:g} Mbit/s"
    table = Table(title=f"{load.title}, {rate}", title_justify="left")
    table.add_column("id")
    table.add_column("message")
    for name in ("bytes", "Hz", "bits", "bits worst", "load", "load worst"):
        table.add_column(name, justify="right")
    for row in load.rows:
        table.add_row(
            f"{row.frame_id:03X}",
            row.name,
            str(row.length),
            f"{row.rate_hz:g}",
            str(row.bits_plain),
            str(row.bits_worst),
            f"{row.load_plain:.2%}",
            f"{row.load_worst:.2%}",
        )
    table.add_section()
    total = sum(row.rate_hz for row in load.rows)
    table.add_row("", "all", "", f"{total:g}", "", "", f"{load.load_plain:.1%}", f"{load.load_worst:.1%}")
    return table


def _verdict(load: BusLoad) -> str:
    if load.load_worst <= 1.0:
        return f"fits: {1.0 - load.load_worst:.0%} of the bus is left in the worst case\n"
    if load.load_plain <= 1.0:
        return "does not fit in the worst case of stuffing: lower a rate, or use CAN FD\n"
    return "does not fit: lower a rate, or use CAN FD\n"
