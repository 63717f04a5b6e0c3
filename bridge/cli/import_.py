"""``navbridge import``: make a capture of somebody else's recording."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.importers import IMPORTERS


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command with one sub-command for each importer."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "import",
        help="make a capture of somebody else's recording",
        description="Make a capture of somebody else's recording, with the raw frames that a bus would have "
        "carried. It holds its configuration and replays with: navbridge replay FILE.mcap",
    )
    kinds = parser.add_subparsers(dest="importer", metavar="KIND", required=True)
    for name, importer in IMPORTERS.items():
        kind = kinds.add_parser(name, help=importer.help, description=f"Import {importer.help}.")
        importer.add_arguments(kind)
        kind.add_argument("--out", metavar="FILE.mcap", required=True, help="capture to write")
    return parser


def run(args: argparse.Namespace) -> int:
    """Import and say what came of it."""
    done = IMPORTERS[args.importer].run(args)
    total = sum(done.frames.values())
    parts = ", ".join(f"{count} on {name}" for name, count in done.frames.items())
    print(f"{done.path}: {total} frames in {done.seconds:.1f} s ({parts})")
    return 0
