"""``navbridge run``: the bridge on real buses."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from bridge import arguments


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "run",
        help="run the bridge on real buses",
        description="Run the bridge that a configuration describes until Ctrl-C, SIGTERM or --seconds, and "
        "print the digest of the solution at the end. Typed into its terminal, the words start, stop and "
        "restart are commands to every navigator; start and restart may name an alignment (start motion).",
    )
    parser.add_argument("config", metavar="CONFIG", help="a packaged configuration or a TOML file")
    parser.add_argument("--out", metavar="FILE.mcap", help="record a capture")
    parser.add_argument("--seconds", metavar="N", type=arguments.seconds, help="stop after N seconds")
    parser.add_argument(
        "--realtime-priority",
        metavar="1..99",
        type=arguments.whole(1, 99),
        help="run as SCHED_FIFO with this priority",
    )
    parser.add_argument("--cpu", metavar="N", type=arguments.whole(0), help="stay on processor N")
    parser.add_argument("--lock-memory", action="store_true", help="keep all memory from being paged out")
    return parser


def run(args: argparse.Namespace) -> int:
    """Run, then say what happened; the digest is the last line."""
    from bridge.assemble import Bridge
    from bridge.clock import HostClock
    from bridge.config import Config
    from bridge.errors import ConfigError
    from bridge.realtime import RealTime
    from bridge.recording import require_place
    from bridge.report import Printer, Strangers, explain_wait, outcome_lines
    from bridge.sources.console import at_terminal

    real_time = RealTime(args.realtime_priority, args.cpu, args.lock_memory)
    config = Config.load(args.config)
    if args.out is not None:
        require_place(args.out)
    explain_wait(sys.stderr)
    with Bridge(config, HostClock(), out=args.out) as bridge:
        for refusal in real_time.apply():  # now: the recorder's thread is not to have the priority
            print(f"navbridge: {refusal}", file=sys.stderr)
        with at_terminal(bridge.clock, bridge.wall, sys.stderr) as console:
            strangers = Strangers()
            live = bridge.live(sources=console, sinks=[Printer(sys.stderr), strangers])
            strangers.stop = live.stop
            outcome = live.run(args.seconds)
    unrecorded = bridge.recorder.unrecorded if bridge.recorder is not None else 0
    for line in outcome_lines(outcome, unrecorded):
        print(line)
    if strangers.device is not None:
        raise ConfigError(f"{args.config}: device.{strangers.device}.calibration: {outcome.reason}")
    return 0
