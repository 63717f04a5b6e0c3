"""``navbridge plot``: pictures of a capture."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bridge.errors import CaptureError, ConfigError


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "plot",
        help="draw the track, attitude, biases, innovations and errors of a capture",
        description="Play a capture through the engine and write pictures (PNG): track, attitude, velocity, "
        "biases with 3-sigma bands, innovations with their bounds, rates and gaps of each device, and the "
        "errors where the capture holds the truth.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    parser.add_argument(
        "--out", metavar="DIR", required=True, help="folder for the pictures, made where it is missing"
    )
    parser.add_argument("--config", metavar="CONFIG", help="another configuration than the capture's own")
    return parser


def run(args: argparse.Namespace) -> int:
    """Draw, and name the files."""
    from bridge.config import Config
    from bridge.plots import draw
    from bridge.plots.collect import collect
    from bridge.recording import Capture
    from bridge.report import explain_wait

    capture = Capture(args.capture)
    config = Config.for_capture(capture.attachments, args.config)
    folder = Path(args.out)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {folder}: is a file, expected a folder")
    folder.mkdir(parents=True, exist_ok=True)
    explain_wait(sys.stderr)
    runs = collect(capture, config)
    count = 0
    for data in runs:
        for path in draw(data, folder, f"{data.navigator}_" if len(runs) > 1 else ""):
            count += 1
            print(path)
    if capture.damage:
        print(f"cut off or damaged: {capture.damage}")
    if not count:
        raise CaptureError(f"{capture.path}: there is nothing in it to draw")
    return 0
