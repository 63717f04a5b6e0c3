"""``navbridge busload``: how much of a CAN bus the default set of messages takes."""

from __future__ import annotations

import argparse
import json
from typing import Any

from rich.console import Console
from rich.table import Table

from bridge import arguments
from dbc.busload import BusLoad, as_document, default_table


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "busload",
        help="how much of a CAN bus the default messages take",
        description="Compute the load of the default messages on a CAN bus, without stuff bits and with "
        "as many as can be, for one or more IMU rates.",
    )
    parser.add_argument(
        "--imu-rate",
        metavar="HZ",
        type=arguments.rate,
        action="append",
        help="samples a second; may be repeated (default: 200 and 1000)",
    )
    parser.add_argument(
        "--solution-rate",
        metavar="HZ",
        type=arguments.rate,
        default=50.0,
        help="published solutions a second (default: 50)",
    )
    parser.add_argument(
        "--bitrate",
        metavar="BIT_S",
        type=arguments.whole(1),
        default=1_000_000,
        help="bit rate (default: 1000000)",
    )
    parser.add_argument(
        "--fd", action="store_true", help="the IMU sends its CAN FD frame instead of three classic ones"
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
    loads = default_table(
        args.imu_rate or (200.0, 1000.0), args.solution_rate, args.bitrate, args.data_bitrate, fd=args.fd
    )
    if args.json:
        print(json.dumps([as_document(load) for load in loads], indent=2))
    else:
        console = Console()
        for load in loads:
            console.print(_table(load))
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
