"""``navbridge arms``: find where the accelerometers of a unit sit."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from bridge.errors import ConfigError


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    from bridge.arms import ORIGINS

    parser: argparse.ArgumentParser = subparsers.add_parser(
        "arms",
        help="find where the accelerometers of a unit sit",
        description="Take a capture in which a unit was turned to and fro, about at least two axes, round a "
        "point that stayed where it was, and find how far off each accelerometer sits, with sigmas. The "
        "arms can be written into the calibration file, by which the bridge takes off what they add. Exit "
        "status 1 when the turns do not show every arm.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument("--device", metavar="NAME", help="which unit of it (default: the only one)")
    parser.add_argument(
        "--calibration", metavar="FILE.toml", help="another calibration than the capture's own"
    )
    parser.add_argument(
        "--origin",
        choices=ORIGINS,
        default="axes",
        help="count from the point nearest to all sensitive axes, or from that of the turn (default: axes)",
    )
    parser.add_argument("--out", metavar="FILE.toml", help="write the calibration with these arms")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def run(args: argparse.Namespace) -> int:
    """Find, print, write."""
    from bridge import arms
    from bridge.recording import Capture

    calibration = None
    if args.calibration is not None:
        path = Path(args.calibration)
        if not path.is_file():
            raise ConfigError(f"{path}: no such file")
        calibration = (path.name, path.read_bytes())
    found = arms.find(Capture(args.capture), args.device, args.origin, calibration)
    if args.json:
        print(json.dumps(arms.document_of(found), indent=2))
    else:
        print("\n".join(arms.lines_of(found)))
    if args.out is not None:
        Path(args.out).write_text(arms.file_of(found), encoding="utf-8")
    return 0
