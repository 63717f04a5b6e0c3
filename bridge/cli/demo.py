"""``navbridge demo``: a simulated vehicle is aligned and navigated over an embedded virtual bus."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import can
from msgspec.structs import replace

from bridge.assemble import Bridge
from bridge.cli.bench_options import add_bench_options, epilog
from bridge.clock import SimulatedClock
from bridge.config import Config
from bridge.errors import ConfigError
from bridge.evaluate import SolutionTable, TruthTable, coverage, errors, summary, table, truth_document
from bridge.live import Outcome
from bridge.outputs import Output, Progress, SolutionOut, Transmit
from bridge.recording import Recorder, require_place
from bridge.report import explain_wait, outcome_lines
from bridge.studies.transfer_end import TransferSink
from bridge.view import ViewProcess, ViewSink
from nav import rotation
from nav.transfer import MATCHINGS, PREFIX
from virtual_bus import scenario
from virtual_bus.bus import Bench, Sent
from virtual_bus.flights import FLIGHTS, scenario_of

NAVIGATOR: Final = "main"
CHANNEL: Final = "bench"
_INTERRUPTED: Final = 130
_TRUTH_NS: Final = 100_000_000
_GPS_EPOCH_UNIX_S: Final = 315_964_800
_WEEK_S: Final = 604_800
_NS: Final = 1_000_000_000


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Declare the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "demo",
        help="simulate, align and navigate a vehicle, all in one",
        description="Run a simulated bench and the bridge in one process on a virtual CAN bus: the vehicle "
        "is aligned and navigated, a ground station on udp 127.0.0.1:14550 shows it, everything is captured, "
        "and at the end the solution is compared with the truth, and with the master where there is one.",
        epilog=epilog(scenario.packaged()),
    )
    add_bench_options(parser, default="drive", fastest="the machine can")
    parser.add_argument(
        "--out",
        metavar="FILE.mcap",
        default="demo.mcap",
        help="the capture, overwritten (default: demo.mcap)",
    )
    parser.add_argument(
        "--mavlink",
        metavar="URL",
        default="udpout:127.0.0.1:14550",
        help='where the ground station is, or "none" (default: udpout:127.0.0.1:14550)',
    )
    parser.add_argument(
        "--manoeuvre",
        metavar="NAME",
        type=_dashed,
        choices=sorted(FLIGHTS),
        help="of a scenario with a master, what is flown, sailed or driven: " + ", ".join(FLIGHTS),
    )
    parser.add_argument(
        "--matching",
        metavar="NAME",
        type=_dashed,
        choices=[_dashed(name) for name in MATCHINGS],
        help="of a scenario with a master, what is compared with it: " + ", ".join(map(_dashed, MATCHINGS)),
    )
    parser.add_argument("--no-view", action="store_true", help="no live view")
    return parser


def _dashed(name: str) -> str:
    return name.replace("_", "-")


class EmbeddedBench:
    """A bench on python-can's virtual bus, for the live loop; it starts at the loop's first turn."""

    def __init__(self, bench: Bench, buses: dict[str, can.BusABC]) -> None:
        self.sent = Sent({})
        self._bench = bench
        self._buses = buses
        self._start_ns: int | None = None

    def send_due(self, now_ns: int) -> None:
        """Put on the bus whatever is due by now."""
        if self._start_ns is None:
            self._start_ns = now_ns
        self._bench.send_due(self._buses, min(now_ns - self._start_ns, self._bench.end_ns), self.sent)
        for bus in self._buses.values():
            # the devices do not listen, and what nobody reads would pile up
            while bus.recv(0) is not None:
                pass

    def next_ns(self) -> int | None:
        """When the next frame is due; None when there are no more."""
        next_ns = self._bench.next_ns
        if next_ns is None or next_ns > self._bench.end_ns:
            return None
        return next_ns + self.start_ns

    @property
    def start_ns(self) -> int:
        """When the scenario began, on the loop's clock."""
        return self._start_ns or 0

    def truth(self, t_ns: int) -> dict[str, Any]:
        """An object of the truth channel for an instant of the loop's clock."""
        truth = self._bench.truth(t_ns - self.start_ns)
        # rates from IMU to vehicle axes by way of east-north-up
        w_iv_g = rotation.quat_rotate(truth.q_gb, truth.w_ib_b)
        w_iv_v = rotation.quat_rotate(rotation.quat_conjugate(truth.q_gv), w_iv_g)
        document = truth_document(truth.lat, truth.lon, truth.height, truth.v_g, truth.q_gv, w_iv_v)
        return {"t_ns": t_ns, **document}

    def truth_row(self, t_ns: int) -> TruthTable:
        """The same as a table of one row."""
        return TruthTable.from_documents([self.truth(t_ns)])


class TruthSink:
    """Keeps the truth of one solution in every tenth of a second, and records it.

    While it aligns there is not always a solution: what an alignment reports is a time to record it as well.
    """

    def __init__(self, bench: EmbeddedBench, recorder: Recorder | None) -> None:
        self._bench = bench
        self._recorder = recorder
        self._slot = self._recorded = -1
        self._solutions: list[SolutionOut] = []
        self._documents: list[dict[str, Any]] = []

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Take the truth at the very instant of a solution, so that nothing is interpolated."""
        for output in outputs:
            if isinstance(output, SolutionOut) and output.navigator == NAVIGATOR:
                t_ns = output.solution.t_ns
                if t_ns // _TRUTH_NS > self._slot:
                    self._slot = t_ns // _TRUTH_NS
                    self._solutions.append(output)
                    self._documents.append(self._record(t_ns))
            elif isinstance(output, Progress) and output.t_ns // _TRUTH_NS > self._recorded:
                self._record(output.t_ns)
        return []

    def _record(self, t_ns: int) -> dict[str, Any]:
        document = self._bench.truth(t_ns)
        if self._recorder is not None and t_ns // _TRUTH_NS > self._recorded:
            self._recorded = t_ns // _TRUTH_NS
            self._recorder.truth(t_ns, document)
        return document

    def lines(self, seconds: float) -> list[str]:
        """Errors of the whole run of so many seconds, for people."""
        solutions = SolutionTable.from_outputs(self._solutions)
        begin_ns = self._bench.start_ns
        of = coverage(solutions, begin_ns, begin_ns + round(seconds * _NS))
        return table(summary(errors(solutions, TruthTable.from_documents(self._documents))), of)


def run(args: argparse.Namespace) -> int:
    """Simulate and navigate; the last lines are the errors against truth and the digest."""
    try:
        bench = Bench(_scenario(args), seed=args.seed, seconds=args.seconds)
    except scenario.ScenarioError as error:
        raise ConfigError(str(error)) from error
    require_place(args.out)
    explain_wait(sys.stderr)
    bench.prepare()
    mavlink_url = None if args.mavlink == "none" else args.mavlink
    files = bench.files("virtual", CHANNEL, mavlink_url)
    config = Config.from_files(files)
    outcome, unrecorded, errors_found = _drive(args, bench, config)
    *lines, digest = outcome_lines(outcome, unrecorded)
    print(*lines, f"capture: {args.out}", *errors_found, digest, sep="\n", flush=True)
    return _INTERRUPTED if outcome.reason.startswith("stopped by") else 0


def _scenario(args: argparse.Namespace) -> scenario.Scenario:
    """The scenario that is asked for, with another manoeuvre or matching where one is named."""
    what = scenario.load(args.scenario)
    for option in ("manoeuvre", "matching"):
        if getattr(args, option) is not None and what.master is None:
            raise ConfigError(
                f"--{option}: found {args.scenario}, expected a scenario with a master (transfer)"
            )
    if args.manoeuvre is not None:
        what = scenario_of(args.manoeuvre, what)
    if args.matching is not None:
        alignment = PREFIX + args.matching.replace("-", "_")
        what = replace(what, navigator=replace(what.navigator, alignment=alignment))
    return what


def _drive(args: argparse.Namespace, bench: Bench, config: Config) -> tuple[Outcome, int, list[str]]:
    """The run itself, everything closed again at its end."""
    clock = clock_of(args.speed, bench)
    metadata = {"scenario": str(args.scenario), "seed": str(args.seed), "speed": str(args.speed)}
    with (
        Bridge(config, clock, out=args.out, lossless=math.isinf(args.speed), metadata=metadata) as bridge,
        embedded_buses(bench) as buses,
    ):
        embedded = EmbeddedBench(bench, buses)
        truth = TruthSink(embedded, bridge.recorder)
        view = ViewProcess(start=not args.no_view)
        title = f"{bench.scenario.title}, seed {args.seed}"
        shown = ViewSink(view, NAVIGATOR, title=title, duration_s=bench.seconds, truth=embedded.truth_row)
        transfer = TransferSink(bench, NAVIGATOR, lambda: embedded.start_ns)
        try:
            outcome = bridge.live(bench=embedded, sinks=[truth, shown, transfer]).run()
        finally:
            view.close()
    unrecorded = bridge.recorder.unrecorded if bridge.recorder is not None else 0
    return outcome, unrecorded, [*truth.lines(outcome.seconds), *transfer.lines()]


def clock_of(speed: float, bench: Bench) -> SimulatedClock:
    """A clock that begins at the scenario's own time."""
    start = bench.scenario.start
    gps_s = start.gps_week * _WEEK_S + start.gps_tow_s
    utc_ns = (_GPS_EPOCH_UNIX_S + gps_s - start.leap_seconds) * _NS
    return SimulatedClock(utc_ns, _NS, speed)


@contextmanager
def embedded_buses(bench: Bench) -> Iterator[dict[str, can.BusABC]]:
    """The devices' ends of the virtual buses, by the scenario's channels."""
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(can.Bus(interface="virtual", channel=place))
            for name, place in bench.wiring("virtual", CHANNEL).buses.items()
        }
