"""The ``navbridge`` command: a sub-command is a module with ``add_parser`` and ``run``, named in `COMMANDS`.

A module is imported when its command is asked for and not before, so that ``--help`` answers at once.

Exit statuses: 0 done, 1 failed (a digest differs, a bus or a capture is unusable), 2 the command line or a
configuration is wrong, 70 a fault of navbridge itself, 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import re
import sys
import traceback
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from bridge.errors import NavbridgeError


class Command(NamedTuple):
    """Where a sub-command lives and what it does, in a line."""

    module: str
    help: str


COMMANDS: Final[dict[str, Command]] = {
    "demo": Command("bridge.cli.demo", "simulate, align and navigate a vehicle, all in one"),
    "run": Command("bridge.cli.run", "run the bridge on real buses"),
    "sim": Command("bridge.cli.sim", "put a simulated vehicle's devices on a bus"),
    "replay": Command("bridge.cli.replay", "play a capture again and compare the digest"),
    "import": Command("bridge.cli.import_", "make a capture of somebody else's recording"),
    "align": Command("bridge.cli.align", "run alignments on a capture and compare what they find"),
    "calibrate": Command("bridge.cli.calibrate", "make a calibration file of turntable captures"),
    "arms": Command("bridge.cli.arms", "find where the accelerometers of a unit sit"),
    "allan": Command("bridge.cli.allan", "measure a unit's noise in a capture at rest"),
    "plot": Command("bridge.cli.plot", "draw what is in a capture"),
    "check": Command("bridge.cli.check", "check a configuration without opening a bus"),
    "inspect": Command("bridge.cli.inspect", "say what is in a capture and what looks wrong"),
    "decode": Command("bridge.cli.decode", "add decoded channels to a capture"),
    "campaign": Command("bridge.cli.campaign", "simulate many runs and compare errors with sigmas"),
    "figures": Command("bridge.cli.figures", "reproduce published figures with the program's own kernels"),
    "busload": Command("bridge.cli.busload", "compute the load of the default messages on a bus"),
}

_FAULT: Final = 70
_INTERRUPTED: Final = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; ``argv`` without the program's name. Returns the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    verbose = "--verbose" in arguments
    arguments = [item for item in arguments if item != "--verbose"]
    try:
        status = _dispatch(arguments)
        sys.stdout.flush()
        return status
    except NavbridgeError as error:
        return _complain(str(error), error.exit_status, verbose)
    except KeyboardInterrupt:
        return _complain("interrupted", _INTERRUPTED, verbose)
    except BrokenPipeError:
        # whoever read our output has gone; nothing more may be written, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(f"{place}{error.strerror or error}", 1, verbose)
    except Exception as error:
        hint = "" if verbose else " (a fault of navbridge; --verbose shows where)"
        return _complain(f"{type(error).__name__}: {error}{hint}", _FAULT, verbose)


def _dispatch(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="navbridge",
        description="Inertial navigation bridge for test benches: CAN and MAVLink in, an aligned navigation "
        "solution out, bit-identical replay.",
        epilog="navbridge COMMAND --help explains one command. --verbose adds a traceback to an error.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND")
    wanted = next((item for item in arguments if not item.startswith("-")), None)
    module, of_command = None, parser
    if wanted in COMMANDS:
        module = importlib.import_module(COMMANDS[wanted].module)
        of_command = module.add_parser(subparsers)
    elif wanted is not None:
        parser.error(f'no command "{wanted}"; expected one of {", ".join(COMMANDS)}{_near(wanted, COMMANDS)}')
    else:
        for name, command in COMMANDS.items():
            subparsers.add_parser(name, help=command.help)
    args, strange = parser.parse_known_args(arguments)
    if strange:
        # by the command's own parser, which shows its usage; argparse would show the program's
        known = re.findall(r"--[a-z-]+", of_command.format_help())
        of_command.error(f"unrecognized arguments: {' '.join(strange)}{_near(strange[0], known)}")
    if args.version:
        from importlib.metadata import version

        print(f"navbridge {version('navbridge')}")
        return 0
    if module is None:
        parser.print_help()
        return 2
    return int(module.run(args))


def _near(found: str, names: Iterable[str]) -> str:
    near = difflib.get_close_matches(found, list(names), n=1, cutoff=0.6)
    return f'; did you mean "{near[0]}"?' if near else ""


def _complain(text: str, status: int, verbose: bool) -> int:
    if verbose:
        traceback.print_exc()
    print("navbridge: " + " ".join(text.split()), file=sys.stderr)
    return status
