"""The loop: order, events, ticks, ends, and equality with its own replay."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import can
import pytest

from bridge.clock import Clock, HostClock, SimulatedClock, WallClock
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.live import Live
from bridge.options import CanSource
from bridge.recording import Capture, Recorder
from bridge.replay import replay
from bridge.sources.base import Notice, Received, SourceContext
from bridge.sources.can import CanBus
from tests.bridge.fakes import EchoSink, FakeEngine, ListSource, SteppableClock

MS = 1_000_000
SECOND = 1_000_000_000


def context(clock: Clock, number: int = 1) -> SourceContext:
    return SourceContext(number, f"can{number - 1}", clock, WallClock(clock))


def loop(
    clock: Clock, polls: Sequence[list[Received] | Notice], path: Path | None = None
) -> tuple[Live, FakeEngine, ListSource, Recorder | None]:
    engine = FakeEngine()
    source = ListSource(context(clock), polls)
    recorder = None
    if path is not None:
        recorder = Recorder(path, sources={0: "bridge", 1: "can0"}, utc_offset_ns=0, lossless=not clock.host)
    wall = source.context.wall
    live = Live(
        engine=engine, sources=[source], sinks=[EchoSink()], clock=clock, wall=wall, recorder=recorder
    )
    return live, engine, source, recorder


def test_a_run_begins_and_ends_with_events() -> None:
    clock = SimulatedClock(utc_ns=77, monotonic_ns=5)
    live, engine, source, _ = loop(clock, [[(6, 0x100, b"a"), (7, 0x101, b"b")], [(8, 0x100, b"c")]])
    outcome = live.run(1.0)
    first, *_, last = engine.frames
    assert (first.source, first.key, json.loads(first.data)) == (
        BRIDGE,
        Event.START,
        {"utc_ns": 77, "monotonic_ns": 5},
    )
    assert (last.key, json.loads(last.data)) == (Event.STOP, {"reason": "the time asked for is over"})
    assert [frame.seq for frame in engine.frames] == list(range(len(engine.frames)))
    assert [frame.data for frame in engine.frames if frame.source == 1] == [b"a", b"b", b"c"]
    assert outcome.frames == len(engine.frames)
    assert outcome.seconds == 1.0
    assert len(source.sent) >= 3, "a frame out for every solution"
    assert outcome.counters["can0"]["sent"] == len(source.sent)


def test_silence_makes_ticks_and_traffic_does_not() -> None:
    clock = SimulatedClock(utc_ns=0)
    live, engine, _, _ = loop(clock, [])
    live.run(1.0)
    ticks = [frame.rx_ns for frame in engine.frames if frame.key == Event.TICK and frame.source == BRIDGE]
    assert ticks == [n * 100 * MS for n in range(1, 10)]


def test_notices_come_before_the_frames_of_their_poll() -> None:
    clock = SimulatedClock(utc_ns=0)
    notice = Notice(3, Event.DROPPED, {"source": 1, "frames": 9})
    live, engine, _, _ = loop(clock, [notice, [(4, 1, b"x")]])
    live.run(0.5)
    assert (Event.DROPPED, b'{"source":1,"frames":9}') in engine.events()
    keys = [(frame.source, frame.key) for frame in engine.frames if frame.key != Event.TICK]
    assert keys.index((BRIDGE, Event.DROPPED)) < keys.index((1, 1))


def test_a_step_of_the_wall_clock_is_an_event_and_moves_nothing() -> None:
    clock = SteppableClock()
    live, engine, _, _ = loop(clock, [])
    timer = threading.Timer(0.05, lambda: setattr(clock, "step_ns", -3600 * SECOND))
    timer.start()
    live.run(0.15)
    timer.join()
    steps = [json.loads(data)["step_ns"] for event, data in engine.events() if event == Event.CLOCK_STEP]
    assert steps == [pytest.approx(-3600 * SECOND, abs=5 * MS)]
    stamps = [frame.rx_ns for frame in engine.frames]
    assert max(stamps) - min(stamps) < SECOND


def test_a_recorded_run_replays_to_the_same_bits(tmp_path: Path) -> None:
    clock = SimulatedClock(utc_ns=0)
    polls: list[list[Received] | Notice] = [
        [(0, 0x100 + i % 3, os.urandom(8)) for i in range(7)] for _ in range(60)
    ]
    live, engine, _, recorder = loop(clock, polls, tmp_path / "a.mcap")
    assert recorder is not None
    outcome = live.run(5.0)
    recorder.close()
    capture = Capture(tmp_path / "a.mcap")
    assert list(capture.frames()) == engine.frames
    report = replay(capture, FakeEngine())
    assert report.digest == outcome.digest == report.recorded
    assert report.agrees
    assert report.verified == report.checkpoints == 4
    assert report.deviation.compared == 4
    assert report.deviation.horizontal_m == report.deviation.attitude_deg == 0.0


def test_the_recorder_being_full_breaks_the_record_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.recording._QUEUE_BYTES", 200_000)
    held = threading.Event()
    real_write = os.write

    def write(descriptor: int, data: bytes) -> int:
        if held.is_set() and threading.current_thread().name == "recorder":
            raise OSError(28, "No space left on device")
        return real_write(descriptor, data)

    clock = HostClock()
    polls: list[list[Received] | Notice] = [
        [(clock.monotonic_ns(), 1, os.urandom(1000)) for _ in range(20)] for _ in range(100)
    ]
    live, engine, _, recorder = loop(clock, polls, tmp_path / "a.mcap")
    assert recorder is not None
    monkeypatch.setattr("bridge.recording_writer.os.write", write)
    held.set()
    threading.Timer(0.4, held.clear).start()
    live.run(1.0)
    recorder.close()
    marks = [json.loads(data)["frames"] for event, data in engine.events() if event == Event.UNRECORDED]
    assert sum(marks) == recorder.unrecorded > 0
    recorded = list(Capture(tmp_path / "a.mcap").frames())
    assert len(recorded) == len(engine.frames) - recorder.unrecorded
    assert {frame.seq for frame in recorded} < {frame.seq for frame in engine.frames}
    report = replay(Capture(tmp_path / "a.mcap"), FakeEngine())
    assert report.breaks_ns is not None
    assert report.agrees, "what lies behind a break cannot be held against the replay"


def test_latency_of_every_stage_is_counted() -> None:
    clock = HostClock()
    now = clock.monotonic_ns()
    live, _, _, _ = loop(clock, [[(now - 5 * MS, 1, b"x")]])
    latency = live.run(0.05).latency
    assert latency["received_to_sent"]["count"] == 1
    assert latency["received_to_read"]["p50_us"] >= 5000.0
    stages = ("received_to_read", "read_to_fed", "fed_to_sent")
    # each stage is rounded up by at most 3.2 per cent
    total = sum(latency[stage]["max_us"] for stage in stages)
    assert latency["received_to_sent"]["max_us"] == pytest.approx(total, rel=0.04)


class Bench:
    """Puts a frame on a virtual bus every 10 ms of the loop's clock."""

    def __init__(self, bus: can.BusABC, count: int) -> None:
        self._bus = bus
        self._left = count
        self._next = 0

    def send_due(self, now_ns: int) -> None:
        while self._left and self._next <= now_ns:
            self._bus.send(
                can.Message(arbitration_id=0x100, is_extended_id=False, data=self._left.to_bytes(2))
            )
            self._left -= 1
            self._next += 10 * MS

    def next_ns(self) -> int | None:
        return self._next if self._left else None


def test_an_embedded_bench_drives_simulated_time_and_is_repeatable() -> None:
    digests = []
    for _ in range(2):
        clock = SimulatedClock(utc_ns=10**18)
        where = context(clock)
        source = CanBus(CanSource(type="can", interface="virtual", channel="bench-test"), where)
        source.open()
        engine = FakeEngine()
        with can.Bus(interface="virtual", channel="bench-test") as bus:
            live = Live(
                engine=engine,
                sources=[source],
                sinks=[EchoSink()],
                clock=clock,
                wall=where.wall,
                bench=Bench(bus, 200),
            )
            outcome = live.run()
        source.close()
        got = [frame for frame in engine.frames if frame.source == 1]
        assert [frame.rx_ns for frame in got] == [i * 10 * MS for i in range(200)]
        assert outcome.reason == "the scenario is over"
        digests.append(outcome.digest)
    assert digests[0] == digests[1]


def test_another_thread_may_stop_the_loop() -> None:
    live, engine, _, _ = loop(HostClock(), [])
    outcomes = []
    thread = threading.Thread(target=lambda: outcomes.append(live.run()))
    thread.start()
    time.sleep(0.02)
    live.stop("enough")
    thread.join(2.0)
    assert outcomes[0].reason == "enough"
    assert engine.events()[-1] == (Event.STOP, b'{"reason":"enough"}')


CHILD = """
import os, sys
from bridge.clock import HostClock, WallClock
from bridge.live import Live
from bridge.recording import Recorder
from bridge.sources.base import SourceContext
from tests.bridge.fakes import EchoSink, FakeEngine, ListSource

class Busy(ListSource):
    count = 0
    def poll(self, deadline_ns):
        self.count += 1
        if self.count == 400:
            print("far enough", flush=True)
        return [(self.context.clock.monotonic_ns(), 1, os.urandom(100)) for _ in range(10)]

clock = HostClock()
where = SourceContext(1, "can0", clock, WallClock(clock))
recorder = Recorder(sys.argv[1], sources={0: "bridge", 1: "can0"}, utc_offset_ns=0)
try:
    outcome = Live(engine=FakeEngine(), sources=[Busy(where, [])], sinks=[EchoSink()], clock=clock,
                   wall=where.wall, recorder=recorder).run()
finally:
    recorder.close()
print(outcome.reason)
print(outcome.digest)
"""


def start_child(path: Path) -> subprocess.Popen[bytes]:
    root = Path(__file__).parents[2]
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, cwd=root)
    assert child.stdout is not None
    assert child.stdout.readline() == b"far enough\n"
    time.sleep(1.2)
    return child


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_in_order(tmp_path: Path, number: signal.Signals) -> None:
    child = start_child(tmp_path / "a.mcap")
    child.send_signal(number)
    out, _ = child.communicate(timeout=10)
    reason, digest = out.decode().split("\n")[:2]
    assert child.returncode == 0
    assert reason == f"stopped by {number.name}"
    capture = Capture(tmp_path / "a.mcap")
    report = replay(capture, FakeEngine())
    assert report.damage is None
    assert report.digest == report.recorded == digest


def test_a_killed_run_verifies_as_far_as_it_was_written(tmp_path: Path) -> None:
    child = start_child(tmp_path / "a.mcap")
    child.kill()
    child.communicate(timeout=10)
    report = replay(Capture(tmp_path / "a.mcap"), FakeEngine())
    assert report.damage is not None
    assert report.recorded is None
    assert report.verified == report.checkpoints >= 1
    assert report.agrees
    assert report.frames > 2000


def test_frames_of_the_bridge_carry_no_future(tmp_path: Path) -> None:
    live, engine, _, _ = loop(HostClock(), [[(1, 1, b"")]])
    live.run(0.05)
    assert all(isinstance(frame, RawFrame) for frame in engine.frames)
    assert max(frame.rx_ns for frame in engine.frames) <= time.monotonic_ns()
