"""``navbridge replay``: play a capture again and compare the digest."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from bridge import arguments
from bridge.errors import CaptureError, ReplayMismatch


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "replay",
        help="play a capture again and compare the digest",
        description="Play a capture through the engine as fast as it goes and compare the digest of the "
        "solution with the one recorded, or with --golden. A capture that was cut off is verified as far as "
        "its checkpoints reach. Exit status 1 when the digest differs. On other hardware or libraries than "
        "the recording's, a difference from the recorded digest is reported with the largest deviation and "
        "is not a failure; --golden always is exact.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument("--config", metavar="CONFIG", help="another configuration than the capture's own")
    parser.add_argument(
        "--golden", metavar="HEX", type=arguments.digest, help="digest that the replay must give"
    )
    parser.add_argument("--csv", metavar="FILE", help="write every solution as a table")
    return parser


def run(args: argparse.Namespace) -> int:
    """Replay, report, and raise ReplayMismatch where the digests differ."""
    from bridge.config import Config
    from bridge.engine import Engine
    from bridge.recording import Capture
    from bridge.replay import replay
    from bridge.report import explain_wait
    from bridge.solution_csv import CsvWriter

    capture = Capture(args.capture)
    config = Config.for_capture(capture.attachments, args.config)
    table = CsvWriter(args.csv, list(config.navigators)) if args.csv else None
    explain_wait(sys.stderr)
    try:
        report = replay(capture, Engine(config), table.consume if table is not None else None)
    finally:
        if table is not None:
            table.close()

    speed = f", {report.seconds / report.replay_seconds:.0f} times real time" if report.seconds > 0 else ""
    print(f"{capture.path}: {report.frames} frames, {report.seconds:.1f} s{speed}")
    if report.damage:
        print(f"{'cut off' if report.recorded is None else 'damaged'}: {report.damage}")
    if report.breaks_ns is not None or report.unrecorded:
        print(f"not recorded: {report.unrecorded or 'some'} frames; nothing can agree behind the first gap")
    if not args.config:
        found = f"{report.verified} of {report.checkpoints} agree" if report.checkpoints else "none in it"
        print(f"checkpoints: {found}")
    print(f"solution sha256: {report.digest}")
    if args.golden:
        if args.golden != report.digest:
            raise ReplayMismatch(f"the solution differs: expected {args.golden}, got {report.digest}")
        return 0
    if args.config:
        print(report.deviation)
        return 0
    if report.damage and report.lost_frames and report.failed is None:
        raise CaptureError(
            f"{capture.path}: damaged, {report.lost_frames} frames cannot be read and nothing behind the "
            "damage can be compared"
        )
    if report.agrees:
        return 0
    print(report.deviation)
    differs = f"; other than when recorded: {', '.join(report.machine)}" if report.machine else ""
    if report.failed is not None:
        link = report.failed
        where = (
            f"at the latest from {link.t_ns / 1e9:.1f} s on (navigator {link.navigator}, link {link.index})"
        )
    else:
        where = "after the last checkpoint"
    text = f"the solution differs from the recorded one {where}{differs}"
    if report.other_machine:
        print(text)
        return 0
    raise ReplayMismatch(text)
