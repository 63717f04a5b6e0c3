"""``navbridge campaign``: many simulated runs, and whether errors are as large as they are said to be."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bridge import arguments
from bridge.commands import METHODS
from nav.imu.geometry import GEOMETRIES

if TYPE_CHECKING:
    from bridge.studies.workers import Progress

_RUNS: Final = 100
_UNITS: Final = 20
_SITE: Final = (34.25, 400.0)


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "campaign",
        help="simulate many runs and compare errors with sigmas",
        description="Simulate a scenario with many seeds and compare the errors with what the navigator "
        "claims. The seeds are N, N+1, ... from --seed-base, and every one counts. Exit status 1 when "
        "they do not agree.",
    )
    kinds = parser.add_subparsers(dest="campaign", metavar="CAMPAIGN", required=True)
    moving = kinds.add_parser(
        "consistency",
        help="position, velocity and attitude at fixed epochs against their covariances",
        description="Mean normalised error squared (NEES) of position, velocity and attitude over all runs "
        "at twelve epochs, against the two-sided 95 % band of so many runs, and mean error against zero. At "
        "least 90 % must lie inside.",
    )
    _common(moving)
    moving.add_argument(
        "--scenario", default="drive", help="a packaged scenario or a TOML file (default: drive)"
    )
    moving.add_argument(
        "--seconds", metavar="N", type=arguments.seconds, help="cut or extend the scenario to N seconds"
    )
    moving.add_argument("--out", metavar="FILE.png", help="draw errors, sigmas and NEES over time")
    still = kinds.add_parser(
        "static",
        help="attitude after an alignment at rest against its theoretical limit",
        description="Spread of the attitude when a static alignment hands over, against the theoretical "
        "limit of its sensors in that time, and against what the alignment claims.",
    )
    _common(still)
    still.add_argument(
        "--scenario", default="static_rlg", help="a packaged scenario or a TOML file (default: static_rlg)"
    )
    every = kinds.add_parser(
        "alignment",
        help="attitude while each alignment runs, and at its end, against its covariance",
        description="Mean normalised error squared (NEES) of the attitude that an alignment says at twelve "
        "epochs and hands over at its end, over all runs, against the two-sided 95 % band of so many runs, "
        "and mean error against zero. Each method runs on the base that it is for. At least 90 % must lie "
        "inside, and no run may be refused.",
    )
    _common(every)
    every.add_argument(
        "--method",
        action="append",
        choices=list(METHODS),
        metavar="NAME",
        help=f"one of {', '.join(METHODS)}; may be given again (default: all)",
    )
    units = kinds.add_parser(
        "calibration",
        help="coefficients of units on a turntable against their sigmas",
        description="Draw units and turntables, carry a calibration plan out on them and solve for all "
        "coefficients: 93 to 97.5 % of all errors must be within two of their own sigmas (of fewer than 100 "
        "runs, what chance leaves of that), and the largest under 4.5.",
    )
    _common(units)
    units.add_argument(
        "--plan",
        help="a packaged plan or a TOML file (default: positions_12, for other axes than three positions_18)",
    )
    units.add_argument(
        "--geometry",
        choices=list(GEOMETRIES),
        default="orthogonal",
        help="of gyros and of accelerometers: three along x, y, z, these and two askew, or six on a cone",
    )
    units.add_argument(
        "--grade",
        action="append",
        metavar="NAME",
        help="fog, mems, rlg, tactical (default: all) or, with a plan of second-order terms, dtg; may be "
        "given again",
    )
    units.add_argument(
        "--encoder",
        action="store_true",
        help="on a table that comes to rest 0.1 deg off and tells where, by its encoders",
    )
    units.add_argument(
        "--site",
        metavar="LAT,HEIGHT[,G]",
        type=arguments.site,
        default=_SITE,
        help=f"where the table is: deg, m, m/s^2 (default: {_SITE[0]:g},{_SITE[1]:g})",
    )
    failing = kinds.add_parser(
        "faults",
        help="sensors of redundant units that fail: missed, wrongly excluded, delays, false alarms",
        description="Let every sensor of units of 12 sensors on cones and of 10 on orthogonal and skew axes "
        "fail in five ways and four sizes, in N units each; count false alarms of healthy units, and let any "
        "two sensors of the cone die.",
    )
    _common(failing, _UNITS)
    return parser


def _common(parser: argparse.ArgumentParser, runs: int = _RUNS) -> None:
    parser.add_argument("--runs", metavar="N", type=arguments.whole(1), default=runs, help=f"default: {runs}")
    parser.add_argument(
        "--seed-base", metavar="N", type=arguments.whole(0), default=0, help="first seed (default: 0)"
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=arguments.whole(1),
        default=os.cpu_count() or 1,
        help="processes (default: all CPUs)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Fly all runs and print the table; exit status 1 when it does not agree."""
    from bridge.studies import consistency as of
    from bridge.studies.campaign import run_consistency, run_static
    from bridge.studies.workers import on_terminal

    progress = on_terminal()
    if args.campaign == "alignment":
        from bridge.studies import alignment_campaign as study

        methods = args.method or list(METHODS)
        every = study.run_alignments(
            methods, args.runs, seed_base=args.seed_base, jobs=args.jobs, progress=progress
        )
        _print(args, study.lines(every), study.document(every))
        return 0 if all(one.passed for one in every) else 1
    if args.campaign == "calibration":
        return _calibration(args, progress)
    if args.campaign == "faults":
        from bridge.studies import fault_campaign

        faults = fault_campaign.run_faults(
            args.runs, seed_base=args.seed_base, jobs=args.jobs, progress=progress
        )
        _print(args, fault_campaign.lines(faults), fault_campaign.document(faults))
        return 1 if faults.complaints() else 0
    if args.campaign == "static":
        still = run_static(
            args.scenario, args.runs, seed_base=args.seed_base, jobs=args.jobs, progress=progress
        )
        _print(args, of.alignment_lines(still), of.alignment_document(still))
        return 0 if still.passed else 1
    found = run_consistency(
        args.scenario,
        args.runs,
        seconds=args.seconds,
        seed_base=args.seed_base,
        jobs=args.jobs,
        progress=progress,
    )
    _print(args, of.consistency_lines(found), of.consistency_document(found))
    if args.out is not None:
        from bridge.studies.consistency_picture import draw

        draw(found, Path(args.out), f"{args.scenario}, seeds {args.seed_base} and on")
    return 0 if found.passed else 1


def _calibration(args: argparse.Namespace, progress: Progress | None) -> int:
    from bridge.calibration_plan import Site, load
    from bridge.errors import ConfigError
    from bridge.studies import calibration_campaign as study

    grades = args.grade or study.USUAL
    for grade in grades:
        if grade not in study.NAMES:
            expected = ", ".join(study.NAMES)
            raise ConfigError(f'--grade: found "{grade}", expected one of {expected}')
    usual = "positions_12" if args.geometry == "orthogonal" else "positions_18"
    plan, site = load(args.plan or usual), Site(*args.site)
    if args.encoder:
        plan = study.encoded(plan)
    every = [
        study.run_calibrations(
            plan,
            site,
            grade,
            args.runs,
            geometry=args.geometry,
            seed_base=args.seed_base,
            jobs=args.jobs,
            progress=progress,
        )
        for grade in grades
    ]
    _print(args, study.lines(every), study.document(every))
    return 0 if all(one.passed for one in every) else 1


def _print(args: argparse.Namespace, lines: list[str], document: dict[str, Any]) -> None:
    print(json.dumps(document, indent=2) if args.json else "\n".join(lines), flush=True)
