"""``navbridge run``: the bridge on real buses."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "run",
        help="run the bridge on real buses",
        description="Run the bridge that a configuration describes until Ctrl-C, SIGTERM or --seconds, and "
        "print the digest of the solution at the end.",
    )
    parser.add_argument("config", metavar="CONFIG", help="a packaged configuration or a TOML file")
    parser.add_argument("--out", metavar="FILE.mcap", help="record a capture")
    parser.add_argument("--seconds", metavar="N", type=_positive, help="stop after N seconds")
    parser.add_argument(
        "--realtime-priority", metavar="1..99", type=_priority, help="run as SCHED_FIFO with this priority"
    )
    parser.add_argument("--cpu", metavar="N", type=int, help="stay on processor N")
    parser.add_argument("--lock-memory", action="store_true", help="keep all memory from being paged out")
    return parser


def run(args: argparse.Namespace) -> int:
    """Run, then say what happened; the digest is the last line."""
    from bridge.assemble import Bridge
    from bridge.clock import HostClock
    from bridge.config import Config
    from bridge.realtime import RealTime
    from bridge.report import Printer, outcome_lines

    real_time = RealTime(args.realtime_priority, args.cpu, args.lock_memory)
    with Bridge(Config.load(args.config), HostClock(), out=args.out) as bridge:
        for refusal in real_time.apply():  # now: the recorder's thread is not to have the priority
            print(f"navbridge: {refusal}", file=sys.stderr)
        outcome = bridge.live(sinks=[Printer(sys.stderr)]).run(args.seconds)
    unrecorded = bridge.recorder.unrecorded if bridge.recorder is not None else 0
    for line in outcome_lines(outcome, unrecorded):
        print(line)
    return 0


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a number above zero")
    return value


def _priority(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 99:
        raise argparse.ArgumentTypeError(f"{text} is not from 1 to 99")
    return value
