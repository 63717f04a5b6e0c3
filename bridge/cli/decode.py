"""``navbridge decode``: decoded channels of a capture for people and viewers."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bridge.errors import CaptureError


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "decode",
        help="write the decoded channels of a capture for a viewer",
        description="Write a second MCAP file with what is in a capture as JSON with schemas: every CAN and "
        "MAVLink message by name and signal, every solution, innovations, mode changes, pose and location "
        "for a map. Viewers of MCAP files open it; it does not replay, keep the capture.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument("--out", metavar="VIEW.mcap", required=True, help="file to write")
    return parser


def run(args: argparse.Namespace) -> int:
    """Decode and say what was written."""
    from bridge.decoded_view import write_view
    from bridge.recording import Capture
    from bridge.report import explain_wait

    capture = Capture(args.capture)
    out = Path(args.out)
    if out.exists() and out.samefile(args.capture):
        raise CaptureError(f"{out}: is the capture itself; give another file with --out")
    explain_wait(sys.stderr)
    try:
        counts = write_view(capture, out)
    except OSError as error:
        raise CaptureError(f"{out}: cannot write the view: {error.strerror}") from error
    for topic, count in sorted(counts.items()):
        print(f"{count:>9}  {topic}")
    if capture.damage:
        print(f"cut off or damaged: {capture.damage}")
    print(f"{out}: {sum(counts.values())} messages on {len(counts)} channels")
    return 0
