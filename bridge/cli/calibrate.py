"""``navbridge calibrate``: from turntable captures to a calibration file with sigmas."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from bridge import arguments
from bridge.errors import ConfigError


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    from bridge.calibration_plan import packaged

    parser: argparse.ArgumentParser = subparsers.add_parser(
        "calibrate",
        help="make a calibration file of turntable captures",
        description="Find the positions and rotations of a plan in captures of a unit on a turntable, solve "
        "for every coefficient of its gyros and accelerometers with the table's own errors, and write the "
        "calibration file: coefficients, sigmas, and a certificate of when and how they were measured. "
        "Without a capture, say what the plan will show of the unit of --config. Exit status 1 when plan and "
        "captures do not agree or the plan does not show every coefficient.",
        epilog="packaged plans: " + "; ".join(f"{name} ({title})" for name, title in packaged().items()),
    )
    parser.add_argument("plan", metavar="PLAN", help="a packaged plan or a TOML file")
    parser.add_argument(
        "captures", metavar="CAPTURE", nargs="*", help="captures (.mcap) that hold the plan's steps in order"
    )
    parser.add_argument("--out", metavar="FILE.toml", help="write the calibration file")
    parser.add_argument(
        "--site",
        metavar="LAT,HEIGHT[,G]",
        type=arguments.site,
        help="where the table is: latitude in deg, height in m and gravity in m/s^2 (default: the plan's)",
    )
    parser.add_argument("--device", metavar="NAME", help="which unit of the captures (default: the only one)")
    parser.add_argument("--picture", metavar="FILE.png", help="draw the residuals")
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        help="without a capture: the configuration whose unit is to be looked at",
    )
    parser.add_argument("--json", action="store_true", help="print the certificate and the table as JSON")
    return parser


def run(args: argparse.Namespace) -> int:
    """Calibrate, print the report, write what was asked for."""
    from bridge import calibrating
    from bridge.calibration_capture import record
    from bridge.calibration_plan import Site, load
    from bridge.recording import Capture

    plan = load(args.plan)
    site = None if args.site is None else Site(*args.site)
    if not args.captures:
        return _promise(args, plan, site)
    if args.config is not None:
        raise ConfigError("--config: found one with captures, which have their own")
    recorded = [record(Capture(path), args.device) for path in args.captures]
    result = calibrating.calibrate(plan, site, recorded)
    if args.json:
        print(json.dumps(calibrating.document_of(result), indent=2), flush=True)
    else:
        print("\n".join(calibrating.lines_of(result)), flush=True)
    if args.out is not None:
        Path(args.out).write_text(calibrating.file_of(result), encoding="utf-8")
    if args.picture is not None:
        from bridge.calibration_picture import draw

        draw(result, Path(args.picture))
    return 0


def _promise(args: argparse.Namespace, plan: Any, site: Any) -> int:
    """What the plan will show of the unit of a configuration."""
    from bridge import calibrating
    from bridge.calibration_capture import noise_of, nominal_of, unit_of
    from bridge.calibration_sensors import read_unit
    from bridge.config import Config

    for option in ("out", "picture"):
        if getattr(args, option) is not None:
            raise ConfigError(f"--{option}: nothing to write without a capture")
    if args.config is None:
        raise ConfigError("CAPTURE: found nothing, expected captures, or --config to look at the plan alone")
    config = Config.load(args.config)
    name, options = unit_of(config, args.device)
    nominal = nominal_of(read_unit(config.files[options.calibration], options.calibration))
    model = calibrating.model_of(plan, plan.at(site)[1], nominal)
    noise = calibrating.with_table(noise_of(config, name), plan, plan.encoded)
    seen = calibrating.look(plan, model, noise)
    print("\n".join(calibrating.promise_lines(model, seen)), flush=True)
    return 0
