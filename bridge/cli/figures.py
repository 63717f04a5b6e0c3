"""``navbridge figures``: published figures beside what the program's own kernels give."""

from __future__ import annotations

import argparse
import errno
import json
import os
from pathlib import Path
from typing import Any

from bridge import arguments
from bridge.errors import ConfigError


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "figures",
        help="reproduce published figures with the program's own kernels",
        description="Compute a published figure with the kernels that the bridge runs, and print it beside "
        "the published numbers, with the reason where one differs. Without a name, list the figures. Exit "
        "status 1 when a number is outside its tolerance.",
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="which figure (default: list them)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--runs", metavar="N", type=arguments.whole(2), help="of a figure of random runs (default: its own)"
    )
    parser.add_argument(
        "--jobs", metavar="N", type=arguments.whole(1), help="processes for these (default: all CPUs)"
    )
    parser.add_argument("--out", metavar="FILE.png", help="draw the figure")
    return parser


def run(args: argparse.Namespace) -> int:
    """List the figures, or print one; exit status 1 when it is outside its tolerance."""
    from bridge.studies.figures import FIGURES, load
    from bridge.studies.workers import on_terminal

    if args.name is None:
        if args.out is not None:
            raise ConfigError(f"--out draws one figure; expected a name, one of {', '.join(FIGURES)}")
        print(json.dumps({k: f._asdict() for k, f in FIGURES.items()}, indent=2) if args.json else _list())
        return 0
    if args.name not in FIGURES:
        raise ConfigError(f'no figure "{args.name}"; expected one of {", ".join(FIGURES)}')
    runs = FIGURES[args.name].runs
    if not runs and (args.runs or args.jobs):
        raise ConfigError(f"--runs, --jobs: {args.name} has no random runs")
    path = None if args.out is None else Path(args.out)
    if path is not None:
        # some figures take a minute: say what cannot be written before, not after
        writable(path)
    figure = load(args.name)
    options: dict[str, Any] = {}
    if runs:
        jobs = args.jobs or os.cpu_count() or 1
        options = {"runs": args.runs or runs, "jobs": jobs, "progress": on_terminal()}
    result = figure.compute(**options)
    text = (
        json.dumps(result.document(), indent=2)
        if args.json
        else "\n".join(_titled(args.name, result.lines()))
    )
    print(text, flush=True)
    if path is not None:
        figure.draw(result, path)
    return 0 if result.passed else 1


def _list() -> str:
    from bridge.studies.figures import FIGURES

    width = max(map(len, FIGURES))
    lines = [f"{name:<{width}}  {figure.summary} ({figure.source})" for name, figure in FIGURES.items()]
    return "\n".join([*lines, "", "navbridge figures NAME computes one; --out FILE.png draws it"])


def _titled(name: str, lines: list[str]) -> list[str]:
    from bridge.studies.figures import FIGURES

    return [f"{lines[0]} ({FIGURES[name].source})", *lines[1:]]


def writable(path: Path) -> None:
    """Raise OSError where a picture cannot be put, before it is computed."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path.parent))
