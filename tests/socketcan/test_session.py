"""The bench and the bridge as two processes on a real bus: aligned, navigating, and not one frame lost.

In the end an operator on the bus begins alignments, picks other ones and gives them up.

The bus is judged from outside: by candump's log, decoded with cantools, and by the simulator's own count.
Nothing here is measured by the clock on the wall, because the machine may have other things to do: frames
that come late are recorded, answered and navigated with all the same.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections import Counter
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from bridge.commands import METHODS, CommandCode, Reason, Result
from bridge.config import Config
from bridge.engine import Engine
from bridge.frame import BRIDGE, Event
from bridge.outputs import Output, Transmit
from bridge.recording import Capture
from bridge.replay import Report, replay
from bridge.sinks import SINKS, SinkContext
from nav.types import Mode, SolutionFlag
from tests.socketcan.candump import read_log
from tests.socketcan.session import END_S, READY_S
from tests.socketcan.uml import CHANNEL, Machine
from virtual_bus.bus import Bench

ROOT = Path(__file__).parents[2]
SCENARIO = str(Path(__file__).with_name("town.toml"))
SECONDS = 60.0
REST_S = 32.0
"""Half a minute at rest, in which the bridge aligns, then away."""

DATABASE = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"))
assert isinstance(DATABASE, Database)
NAMES = {message.frame_id: message.name for message in DATABASE.messages}

METRES = 111_320.0
"""To a degree of latitude, well enough for metres."""

Frames = list[tuple[float, str, dict[str, Any]]]


@pytest.fixture(scope="module")
def session(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one session: bus.log, run.mcap, run.txt, sim.txt."""
    folder = tmp_path_factory.mktemp("session")
    bench = Bench(SCENARIO, seed=1)
    for name, text in bench.files("socketcan", CHANNEL).items():
        (folder / name).write_text(text)
    Engine(Config.load(folder / "config.toml"))  # compiles what is not in the cache, much faster out here
    outcome = machine.run(
        [sys.executable, "-m", "tests.socketcan.session", str(folder), SCENARIO, f"{SECONDS:g}"],
        work=folder,
        timeout_s=SECONDS + READY_S + READY_S + END_S,
        env={"PYTHONPATH": str(ROOT)},
    )
    said = "\n".join(
        f"{name}: {(folder / name).read_text()[-2000:]}"
        for name in ("run.txt", "sim.txt")
        if (folder / name).exists()
    )
    assert outcome.status == 0, f"{outcome.output}\n{said}\n{outcome.console[-2000:]}"
    report = json.loads(outcome.output)
    assert (report["sim_status"], report["run_status"]) == (0, 0), said
    return folder


@pytest.fixture(scope="module")
def bus(session: Path) -> Frames:
    """Every frame that candump saw, decoded: time since the first one of the bench, name, signals."""
    assert isinstance(DATABASE, Database)
    raw = read_log(session / "bus.log")
    first = next(time for time, key, _ in raw if not NAMES[key].startswith("SOL_"))
    return [
        (time - first, NAMES[key], dict(DATABASE.decode_message(key, data, decode_choices=False)))  # type: ignore[arg-type]
        for time, key, data in raw
    ]


def sent_by_bench(session: Path) -> int:
    found = re.search(r"(\d+) frames sent", (session / "sim.txt").read_text())
    assert found
    return int(found[1])


@pytest.fixture(scope="module")
def replayed(session: Path) -> tuple[Report, list[tuple[int, bytes]]]:
    """The capture played again, here, and the frames that a sink would have sent."""
    capture = Capture(session / "run.mcap")
    config = Config.from_attachments(capture.attachments)
    engine = Engine(config)
    sinks = [
        SINKS[options.type].factory(options, SinkContext(name, config.source_number(options.source)))
        for name, options in config.sinks.items()
    ]
    sent: list[tuple[int, bytes]] = []

    def watch(outputs: Sequence[Output]) -> None:
        said = [output for output in outputs if isinstance(output, Transmit)]
        for sink in sinks:
            said += sink.consume(outputs)
        sent.extend((transmit.key, transmit.data) for transmit in said)

    return replay(capture, engine, watch), sent


def from_bridge(name: str) -> bool:
    """Whether the bridge sends such frames."""
    return name.startswith("SOL_") or name == "COMMAND_ACK"


def test_alignments_are_commanded_on_the_bus(bus: Frames) -> None:
    """Each command is answered, and what is told of an alignment from then on is of the one asked for."""
    answers = of(bus, "COMMAND_ACK")
    assert [(ack["CODE"], ack["RESULT"], ack["REASON"]) for _, ack in answers] == [
        (CommandCode.START_ALIGNMENT, Result.ACCEPTED, Reason.NONE),
        (CommandCode.START_ALIGNMENT, Result.ACCEPTED, Reason.NONE),
        (CommandCode.START_ALIGNMENT, Result.DENIED, Reason.NO_HEADING),
        (CommandCode.RESTART, Result.ACCEPTED, Reason.NONE),
        (CommandCode.STOP, Result.ACCEPTED, Reason.NONE),
    ]
    begun, another, refused, anew, given_up = (time for time, _ in answers)
    spans = ((begun, another), (another, refused), (refused, anew), (anew, given_up), (given_up, math.inf))
    methods = [
        {signals["METHOD"] for time, signals in of(bus, "SOL_ALIGN") if a < time < b} for a, b in spans
    ]
    gnss, odometer = {METHODS["gnss"]}, {METHODS["odometer"]}
    assert methods[:2] == [gnss, odometer]
    assert methods[2] <= odometer  # a restart may follow at once
    assert methods[3:] == [gnss, set()]
    assert Mode(of(bus, "SOL_TIME")[-1][1]["MODE"]) is Mode.STANDBY


def of(bus: Frames, name: str) -> list[tuple[float, dict[str, Any]]]:
    return [(time, signals) for time, found, signals in bus if found == name]


def test_no_frame_is_lost(session: Path, bus: Frames) -> None:
    sent = sent_by_bench(session)
    # the default load in Hz: IMU 200 in three frames, its status 10, odometer 50, barometer 25, GNSS 5 in six
    assert sent > 0.99 * SECONDS * (3 * 200 + 50 + 25 + 6 * 5 + 10)
    logged = Counter(name for _, name, _ in bus if not from_bridge(name))
    assert sum(logged.values()) == sent + logged["COMMAND"]
    capture = Capture(session / "run.mcap")
    recorded: Counter[str] = Counter()
    events: Counter[int] = Counter()
    for frame in capture.frames():
        if frame.source == BRIDGE:
            events[frame.key] += 1
        else:
            recorded[NAMES[frame.key]] += 1
    assert capture.damage is None
    assert recorded == logged
    assert not events[Event.DROPPED]
    assert not events[Event.UNRECORDED]
    result = capture.result()
    assert result is not None
    assert result["unrecorded"] == "0"
    # and the bridge says so itself, on the bus
    time, health = of(bus, "SOL_HEALTH")[-1]
    assert time > SECONDS - 1.0
    assert {name: health[name] for name in ("DROPPED", "UNRECORDED", "UNKNOWN", "MISSING")} == {
        "DROPPED": 0,
        "UNRECORDED": 0,
        "UNKNOWN": 0,
        "MISSING": 0,
    }


def test_it_aligns_and_navigates(bus: Frames) -> None:
    driven = [(time, signals) for time, signals in of(bus, "SOL_TIME") if signals["TIME_BASE"] == 1]
    first_us = next(signals["TOW"] for _, signals in of(bus, "GNSS_TIME"))
    began, signals = next(item for item in driven if Mode(item[1]["MODE"]) is Mode.NAVIGATE)
    # by the satellites' time; it is ready before the vehicle moves, and not long before
    assert REST_S - 10.0 < (signals["TIME"] - first_us) * 1e-6 < REST_S
    commanded = of(bus, "COMMAND")[0][0]
    assert commanded > SECONDS - 1.0
    after = Counter(Mode(signals["MODE"]) for time, signals in driven if began < time < commanded)
    assert set(after) <= {Mode.NAVIGATE, Mode.CATCH_UP}
    assert after[Mode.NAVIGATE] > 0.9 * sum(after.values())
    *_, flags = (SolutionFlag(each["FLAGS"]) for time, each in of(bus, "SOL_HEADING") if time < commanded)
    wanted = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING
    assert wanted & flags == wanted


def test_the_solution_keeps_its_rate(session: Path, bus: Frames) -> None:
    """One in every 20 ms in which there was an inertial sample, by the bridge's own clock."""
    solutions = [time for time, _ in of(bus, "SOL_LAT")]
    rest, end = (sum(time < at for time, _ in of(bus, "IMU_TIME")) for at in (solutions[0], solutions[-1]))
    samples = [
        frame.rx_ns
        for frame in Capture(session / "run.mcap").frames()
        if frame.source != BRIDGE and NAMES[frame.key] == "IMU_TIME"
    ]
    slots = {rx_ns // 20_000_000 for rx_ns in samples[rest:end]}
    # a solution comes with every second sample, so that a slot with one alone may have none
    assert 0.9 * len(slots) < len(solutions) <= len(slots) + 1


def test_the_bus_carries_what_the_capture_leads_to(
    session: Path, replayed: tuple[Report, list[tuple[int, bytes]]]
) -> None:
    """Every frame of the solution, and no other, bit for bit."""
    sent = [(key, data) for _, key, data in read_log(session / "bus.log") if from_bridge(NAMES[key])]
    assert sent == replayed[1]
    assert len(sent) > 12 * 10 * (SECONDS - REST_S)


def test_the_solution_is_where_the_vehicle_is(bus: Frames) -> None:
    """Against the receiver's fixes at the same GPS time, so that it does not matter how busy the host is."""
    solutions = epochs(bus, "SOL_TIME", "TIME", "SOL_SIGMA_VEL")
    fixes = epochs(bus, "GNSS_TIME", "TOW", "GNSS_ACC")
    times = np.array(sorted(solutions))
    compared = []
    for tow, fix in fixes.items():
        at = int(np.searchsorted(times, tow))
        speed = math.hypot(fix["VEL_E"], fix["VEL_N"])
        if 0 < at < len(times) and times[at] - times[at - 1] < 0.2e6 and speed > 8.0:
            ours = solutions[times[at]]
            late = (times[at] - tow) * 1e-6
            north = (ours["LAT"] - fix["LAT"]) * METRES - fix["VEL_N"] * late
            east = (ours["LON"] - fix["LON"]) * METRES * math.cos(math.radians(fix["LAT"])) - fix[
                "VEL_E"
            ] * late
            course = math.degrees(math.atan2(fix["VEL_E"], fix["VEL_N"]))
            turned = (ours["HEADING"] - course + 180.0) % 360.0 - 180.0
            compared.append((math.hypot(north, east), abs(turned)))
    assert len(compared) > 10
    away, turned_by = np.median(np.array(compared), axis=0)
    # the receiver's noise is 0.5 m an axis and its velocity 60 ms old; its antenna is 0.7 m beside our point
    assert away < 2.5
    # the course is that of the antenna, 60 ms ago: 20 deg/s in the curves
    assert turned_by < 3.0


def epochs(bus: Frames, first: str, clock: str, last: str) -> dict[float, dict[str, float]]:
    """Signals of all messages of one device's epoch, by the time that its first message carries.

    Of epochs that came as far as their ``last`` message: the record may end within one.
    """
    device = first.split("_")[0]
    found: dict[float, dict[str, float]] = {}
    time, current = math.nan, dict[str, float]()
    for _, name, signals in bus:
        if name == first:
            time, current = float(signals[clock]), {}
        if name.startswith(device):
            current.update({key: float(value) for key, value in signals.items()})
        # a receiver's time is GPS time, the bridge's as soon as it says so
        if name == last and math.isfinite(time) and current.get("TIME_BASE", 1.0) == 1.0:
            found[time] = current
    return found


def test_the_live_run_replays_to_its_own_digest(
    session: Path, replayed: tuple[Report, list[tuple[int, bytes]]]
) -> None:
    printed = (session / "run.txt").read_text().rstrip().splitlines()[-1]
    report, _ = replayed
    assert printed == f"solution sha256: {report.digest}"
    assert report.checkpoints > SECONDS - REST_S
    assert report.verified == report.checkpoints
