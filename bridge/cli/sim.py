"""``navbridge sim``: the simulated bench alone, its devices on a real bus in real time, or in a capture."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import can

from bridge import arguments
from bridge.cli.bench_options import add_bench_options, epilog
from bridge.errors import ConfigError, SourceError
from bridge.live import signals
from bridge.sources.can_help import reason
from virtual_bus import scenario
from virtual_bus.bus import Bench, Sent
from virtual_bus.grades import GRADES
from virtual_bus.redundancy import AXES

_TURNTABLE = "turntable"
_NAP_S: Final = 0.1  # after which it is looked whether somebody stops it


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "sim",
        help="put the simulated sensors of a scenario on a CAN bus",
        description="Put the virtual devices of a scenario on a CAN bus and nothing else: what a vehicle's "
        "sensors would send. Run the bridge beside it: navbridge run DIR/config.toml (see --config-out). "
        "With the word turntable and a calibration plan it is a turntable that carries the plan out.",
        epilog=epilog(scenario.packaged()),
    )
    add_bench_options(parser, default=None, fastest="the bus takes it")
    parser.add_argument(
        "plan", metavar="PLAN", nargs="?", help="of a turntable: a packaged calibration plan, or a TOML file"
    )
    parser.add_argument(
        "--grade",
        choices=sorted(GRADES),
        help="of a turntable: how good the unit on it is (default: fog)",
    )
    parser.add_argument(
        "--axes",
        choices=sorted(AXES),
        help="of a turntable: directions of a redundant unit's sensors (default: three along its own axes)",
    )
    parser.add_argument(
        "--rate-hz", metavar="HZ", type=arguments.rate, help="of a turntable: samples a second (default: 200)"
    )
    parser.add_argument(
        "--site",
        metavar="LAT,HEIGHT[,G]",
        type=arguments.site,
        help="of a turntable: latitude in deg, height in m and gravity in m/s^2 (default: the plan's)",
    )
    parser.add_argument(
        "--soak",
        metavar="DEG_C",
        type=float,
        help="of a turntable: which of the plan's temperatures (default: its first)",
    )
    parser.add_argument(
        "--out",
        metavar="FILE.mcap",
        help="send nothing: record what a bridge would hear, in simulated time and as fast as it goes",
    )
    parser.add_argument(
        "--interface", default="socketcan", help="a python-can interface (default: socketcan)"
    )
    parser.add_argument("--channel", default="vcan0", help="its channel (default: vcan0)")
    parser.add_argument(
        "--config-out",
        metavar="DIR",
        type=Path,
        help="write the bridge configuration and the calibration file of this bench there first",
    )
    return parser


def run(args: argparse.Namespace) -> int:
    """Send until the scenario ends or somebody stops it, then say what was sent."""
    try:
        bench = Bench(_scenario(args), seed=args.seed, seconds=args.seconds)
    except scenario.ScenarioError as error:
        raise ConfigError(str(error)) from error
    if args.config_out is not None:
        _write_files(bench, args.config_out, args.interface, args.channel)
    bench.prepare()
    if args.out is not None:
        return _record(bench, args.out)
    sent = Sent({})
    with ExitStack() as stack:
        buses = {name: stack.enter_context(_open(bench, name, args)) for name in bench.channels}
        where = ", ".join(sorted({_channel(bench, name, args) for name in bench.channels}))
        print(f"{bench.scenario.title}: {bench.seconds:g} s on {args.interface} {where}", flush=True)
        begin_ns = time.monotonic_ns()
        told: list[str] = []
        try:
            with signals(told.append):  # between frames: what was sent is counted
                late_ns = _pace(bench, buses, args.speed, begin_ns, sent, told)
        except can.CanError as error:
            raise SourceError(
                f"{args.interface} {where}: cannot send: {reason(error, args.interface, where)}"
            ) from error
    seconds = (time.monotonic_ns() - begin_ns) * 1e-9
    total = sum(sent.frames.values())
    stopped = f"{told[0]}: " if told else ""
    line = f"{stopped}{total} frames sent in {seconds:.1f} s, send buffer full {sent.full} times"
    if math.isfinite(args.speed):
        line += f", worst lateness {late_ns * 1e-6:.1f} ms"
    print(line)
    return 0


def _scenario(args: argparse.Namespace) -> scenario.Scenario | str:
    """The scenario asked for: by name or path, or the turntable's that a plan makes."""
    if args.scenario != _TURNTABLE:
        for name, found in (
            ("PLAN", args.plan),
            ("--grade", args.grade),
            ("--rate-hz", args.rate_hz),
            ("--site", args.site),
            ("--soak", args.soak),
            ("--axes", args.axes),
        ):
            if found is not None:
                raise ConfigError(f"{name}: found one, but only the scenario {_TURNTABLE} has it")
        return str(args.scenario)
    from bridge import calibration_plan
    from bridge.studies.turntable import RATE_HZ, scenario_of

    if args.plan is None:
        expected = ", ".join(calibration_plan.packaged())
        raise ConfigError(f"PLAN: found nothing, expected a file or, packaged, one of {expected}")
    site = None if args.site is None else calibration_plan.Site(*args.site)
    plan, grade = calibration_plan.load(args.plan), args.grade or "fog"
    return scenario_of(plan, site, grade, args.rate_hz or RATE_HZ, args.soak, args.axes)


def _record(bench: Bench, out: str) -> int:
    """Run a bridge on an embedded bus in simulated time, and keep what it hears in a capture."""
    from bridge.assemble import Bridge
    from bridge.cli.demo import CHANNEL, EmbeddedBench, clock_of, embedded_buses
    from bridge.config import Config
    from bridge.recording import require_place

    require_place(out)
    config = Config.from_files(bench.files("virtual", CHANNEL))
    metadata = {"scenario": bench.scenario.title, "seed": str(bench.seed), "speed": "inf"}
    with (
        Bridge(config, clock_of(math.inf, bench), out=out, lossless=True, metadata=metadata) as bridge,
        embedded_buses(bench) as buses,
    ):
        outcome = bridge.live(bench=EmbeddedBench(bench, buses)).run()
    print(f"{bench.scenario.title}: {outcome.frames} frames in {outcome.seconds:.1f} s: {out}")
    return 0


def _pace(
    bench: Bench, buses: dict[str, can.BusABC], speed: float, begin_ns: int, sent: Sent, told: Sequence[str]
) -> int:
    """Send every frame at its own time after ``begin_ns`` until there is a word in ``told``.

    Returns the worst lateness in ns.
    """
    worst = 0
    while not told and (due_ns := bench.next_ns) is not None and due_ns <= bench.end_ns:
        if not math.isfinite(speed):
            bench.send_due(buses, due_ns, sent)
            continue
        # each deadline is counted from the beginning, so lateness never adds up
        deadline_ns = begin_ns + round(due_ns / speed)
        now_ns = time.monotonic_ns()
        if now_ns < deadline_ns:
            time.sleep(min(_NAP_S, (deadline_ns - now_ns) * 1e-9))
            continue
        worst = max(worst, now_ns - deadline_ns)
        bench.send_due(buses, min(round((now_ns - begin_ns) * speed), bench.end_ns), sent)
    return worst


def _open(bench: Bench, name: str, args: argparse.Namespace) -> can.BusABC:
    channel = _channel(bench, name, args)
    options: dict[str, Any] = {"fd": True} if bench.scenario.imu.fd else {}
    try:
        return can.Bus(interface=args.interface, channel=channel, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        raise SourceError(
            f"{args.interface} {channel}: cannot be opened: {reason(error, args.interface, channel)}"
        ) from error


def _channel(bench: Bench, name: str, args: argparse.Namespace) -> str:
    """The real channel of one of the scenario's: the one asked for, unless there are several."""
    return bench.wiring(args.interface, args.channel).buses[name]


def _write_files(bench: Bench, folder: Path, interface: str, channel: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in bench.files(interface, channel).items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--config-out {folder}: cannot be written: {error.strerror}") from error
