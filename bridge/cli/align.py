"""``navbridge align``: run alignments on a capture and compare what they find."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bridge import arguments
from bridge.cli.figures import writable
from bridge.commands import METHODS


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "align",
        help="run alignments on a capture and compare what they find",
        description="Run alignments on the samples of a capture, from its first one or from --start on, and "
        "print what each finds: heading, pitch and roll, how well it says it knows them, what its sensors "
        "cannot beat, how soon it came there, why it refused, and the error where the capture holds the "
        "truth. Without --method and --all it is the alignment that the capture's navigator is configured "
        "with. Exit status 1 when none of them handed over.",
    )
    parser.add_argument("capture", metavar="CAPTURE", help="capture file (.mcap)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--method", metavar="NAME", action="append", help=f"one of {', '.join(METHODS)}; may be repeated"
    )
    which.add_argument("--all", action="store_true", help="every alignment that there is")
    parser.add_argument("--config", metavar="CONFIG", help="another configuration than the capture's own")
    parser.add_argument("--navigator", metavar="NAME", help="whose devices and options (default: the first)")
    parser.add_argument(
        "--start", metavar="S", type=arguments.seconds, default=0.0, help="begin S seconds into the capture"
    )
    parser.add_argument("--seconds", metavar="S", type=arguments.seconds, help="end S seconds later")
    parser.add_argument(
        "--bound",
        metavar="DEG",
        type=arguments.angle,
        default=1.0,
        help="sigma of heading at which an alignment counts as converged (default: 1)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--out",
        metavar="PATH",
        help="draw how they converge: all of them in one FILE.png, or one file each in a folder",
    )
    return parser


def run(args: argparse.Namespace) -> int:
    """Run them and print the table; exit status 1 when none handed over."""
    from bridge.config import Config
    from bridge.recording import Capture
    from bridge.report import explain_wait
    from bridge.studies import alignment_report as report
    from bridge.studies.alignment_table import run_methods
    from nav.transfer import methods as every

    capture = Capture(args.capture)
    config = Config.for_capture(capture.attachments, args.config)
    if args.all:
        methods = list(every())
    elif args.method:
        methods = list(dict.fromkeys(args.method))
    else:
        name = args.navigator if args.navigator in config.navigators else next(iter(config.navigators))
        methods = [config.navigators[name].alignment]
    if args.out is not None and Path(args.out).suffix.lower() == ".png":
        writable(Path(args.out))
    explain_wait(sys.stderr)
    found = run_methods(
        capture, config, methods, navigator=args.navigator, start_s=args.start, seconds=args.seconds
    )
    if args.json:
        print(report.json_of(found, args.bound), flush=True)
    else:
        print("\n".join(report.lines_of(found, args.bound)), flush=True)
        if capture.damage:
            print(f"cut off or damaged: {capture.damage}")
    if args.out is not None:
        _draw(Path(args.out), Path(args.capture).name, found, args)
    return 0 if any(one.ended_s is not None for one in found) else 1


def _draw(out: Path, title: str, found: list[Any], args: argparse.Namespace) -> None:
    from bridge.studies.alignment_picture import draw, draw_each

    if out.suffix.lower() == ".png":
        drawn = [draw(found, out, title, args.bound)]
    else:
        drawn = draw_each(found, out, title, args.bound)
    if not args.json:
        print(*(f"drawn: {path}" for path in drawn), sep="\n", flush=True)
