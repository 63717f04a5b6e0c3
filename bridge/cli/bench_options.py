"""What the commands that simulate a bench are asked: which scenario, how long, how fast, which errors."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

from bridge import arguments


def epilog(packaged: Mapping[str, str]) -> str:
    """The packaged scenarios by name with their titles, for the end of a help text."""
    return "packaged scenarios: " + "; ".join(f"{name} ({title})" for name, title in packaged.items())


def add_bench_options(parser: argparse.ArgumentParser, *, default: str | None, fastest: str) -> None:
    """Declare SCENARIO, --seconds, --speed and --seed.

    Without a ``default`` the scenario has to be named; ``fastest`` says what bounds the speed "max".
    """
    text = "name of a packaged scenario, or a TOML file"
    if default is None:
        parser.add_argument("scenario", metavar="SCENARIO", help=text)
    else:
        parser.add_argument(
            "scenario", metavar="SCENARIO", nargs="?", default=default, help=f"{text} (default: {default})"
        )
    parser.add_argument(
        "--seconds", metavar="N", type=arguments.seconds, help="cut or extend the scenario to N seconds"
    )
    parser.add_argument(
        "--speed",
        metavar="max|X",
        type=arguments.speed,
        default=1.0,
        help=f"X times real time, or as fast as {fastest} (default: 1)",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=arguments.whole(0),
        default=1,
        help="draws every sensor's errors (default: 1)",
    )
