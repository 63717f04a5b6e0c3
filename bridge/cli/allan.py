"""``navbridge allan``: noise densities of a unit from a capture in which it rested."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from bridge import arguments


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "allan",
        help="measure a unit's noise in a capture at rest",
        description="Take a capture in which a unit rested, compute the Allan deviation of its gyros and "
        "accelerometers, and find quantisation, random walk, bias instability, rate random walk and ramp of "
        "each axis, with intervals. Prints them as a table and as lines for a configuration. Exit status 1 "
        "when the capture is too short or has gaps, or the unit was moved.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument("--device", metavar="NAME", help="which unit of it (default: the only one)")
    parser.add_argument(
        "--start", metavar="S", type=arguments.seconds, default=0.0, help="begin S seconds into the capture"
    )
    parser.add_argument("--seconds", metavar="S", type=arguments.seconds, help="end S seconds later")
    parser.add_argument("--out", metavar="FILE.toml", help="write the lines for the configuration")
    parser.add_argument("--picture", metavar="FILE.png", help="draw the curves with the fitted slopes")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def run(args: argparse.Namespace) -> int:
    """Find, print, write what was asked for."""
    from bridge import allan
    from bridge import allan_report as report
    from bridge.recording import Capture

    found = allan.find(Capture(args.capture), args.device, args.start, args.seconds)
    if args.json:
        print(json.dumps(report.document_of(found), indent=2), flush=True)
    else:
        print("\n".join(report.lines_of(found)), flush=True)
    if args.out is not None:
        Path(args.out).write_text("\n".join(report.config_lines(found)) + "\n", encoding="utf-8")
    if args.picture is not None:
        report.draw(found, Path(args.picture))
    return 0
