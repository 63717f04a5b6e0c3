"""The one loop: drain the sources, record, feed the engine, publish.

It serves a live run and a demonstration alike; what differs is the clock and whether an embedded bench
puts frames on the bus. Everything that the engine sees is on its way to the disk before.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final, Protocol

import msgspec

from bridge.clock import Clock, WallClock
from bridge.digest import combine
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.latency import Latency
from bridge.outputs import Checkpoint, Health, Output, SensorsOut, SolutionOut, Transmit
from bridge.recording import Recorder
from bridge.recording_format import HEALTH, LATENCY
from bridge.sources.base import Source

_TICK_NS: Final = 100_000_000
_POLL_NS: Final = 1_000_000  # for sources that have no file descriptor to wait on
_BUDGET_NS: Final = 20_000_000  # of one source's drain, before the others get their turn
_LATENCY_NS: Final = 10_000_000_000
_SENSOR_LINES: Final = 20  # of what redundant units had to say


class Engine(Protocol):
    """A pure fold over frames."""

    def feed(self, frame: RawFrame) -> Sequence[Output]:
        """What follows from one more frame."""
        ...

    def digests(self) -> Mapping[str, str]:
        """Final digest of each navigator so far."""
        ...


class Sink(Protocol):
    """Turns outputs into frames to send, or shows them and sends nothing."""

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Frames that follow from the outputs of one step."""
        ...


class Bench(Protocol):
    """A simulated bench in the same process, driven by the loop's clock."""

    def send_due(self, now_ns: int) -> None:
        """Put on the bus whatever is due by now."""
        ...

    def next_ns(self) -> int | None:
        """When the next frame is due; None when there are no more."""
        ...


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended."""

    reason: str
    frames: int
    seconds: float
    digest: str
    digests: dict[str, str]
    counters: dict[str, dict[str, int]]
    latency: dict[str, dict[str, float]]
    sensors: tuple[str, ...] = ()
    """What there was to say of redundant units, each with its time since the start."""


class Live:
    """Runs sources, recorder, engine and sinks until told to stop.

    ``sources`` are opened already. A recorder is closed by the caller, after `run`.
    """

    def __init__(
        self,
        *,
        engine: Engine,
        sources: Sequence[Source],
        sinks: Sequence[Sink],
        clock: Clock,
        wall: WallClock,
        recorder: Recorder | None = None,
        bench: Bench | None = None,
    ) -> None:
        self._engine = engine
        self._sources = sources
        self._by_number = {source.context.number: source for source in sources}
        self._sinks = sinks
        self._clock = clock
        self._wall = wall
        self._recorder = recorder
        self._bench = bench
        self._latency = Latency()
        self._latency_ns = 0
        self._start_ns = 0
        self._sensors: list[str] = []
        self._seq = 0
        self._last_ns = 0
        self._stop: str | None = None

    def stop(self, reason: str) -> None:
        """Let the loop end at its next turn; may be called from anywhere."""
        self._stop = self._stop or reason

    def run(self, seconds: float | None = None) -> Outcome:
        """Run for ``seconds`` of the clock, until the bench has nothing more, a signal or `stop`."""
        clock = self._clock
        with signals(self.stop):
            start_ns = self._start_ns = self._last_ns = self._latency_ns = clock.monotonic_ns()
            end_ns = None if seconds is None else start_ns + round(seconds * 1e9)
            self._event(start_ns, Event.START, {"utc_ns": clock.utc_ns(), "monotonic_ns": start_ns})
            while self._stop is None:
                self._turn(end_ns)
            now_ns = clock.monotonic_ns()
            self._event(now_ns, Event.STOP, {"reason": self._stop})
            return self._finish((now_ns - start_ns) / 1e9)

    def _turn(self, end_ns: int | None) -> None:
        clock, bench = self._clock, self._bench
        now_ns = clock.monotonic_ns()
        if end_ns is not None and now_ns >= end_ns:
            self.stop("the time asked for is over")
            return
        if bench is not None:
            bench.send_due(now_ns)
        if step_ns := self._wall.update():
            self._event(now_ns, Event.CLOCK_STEP, {"step_ns": step_ns})
        for source in self._sources:
            received = source.poll(clock.monotonic_ns() + _BUDGET_NS)
            for notice in source.notices():
                self._event(notice.rx_ns, notice.event, notice.body)
            number = source.context.number
            for rx_ns, key, data in received:
                self._frame(rx_ns, number, key, data)
        now_ns = clock.monotonic_ns()
        if now_ns - self._last_ns >= _TICK_NS:
            self._frame(now_ns, BRIDGE, Event.TICK, b"")
        next_ns = bench.next_ns() if bench is not None else None
        if bench is not None and next_ns is None:
            self.stop("the scenario is over")
            return
        if self._recorder is not None and now_ns - self._latency_ns >= _LATENCY_NS:
            self._latency_ns = now_ns
            self._recorder.document(LATENCY, now_ns, self._latency.summary())
        self._wait(now_ns, end_ns, next_ns)

    def _wait(self, now_ns: int, end_ns: int | None, next_ns: int | None) -> None:
        until_ns = self._last_ns + _TICK_NS
        if end_ns is not None:
            until_ns = min(until_ns, end_ns)
        descriptors: list[int] = []
        for source in self._sources:
            numbers = source.descriptors()
            descriptors += numbers
            if not numbers and self._bench is None:
                until_ns = min(until_ns, now_ns + _POLL_NS)
        if next_ns is not None:
            until_ns = min(until_ns, next_ns)
        self._clock.wait_until(until_ns, descriptors)

    def _event(self, rx_ns: int, event: Event, body: dict[str, Any]) -> None:
        self._frame(rx_ns, BRIDGE, event, msgspec.json.encode(body))

    def _frame(self, rx_ns: int, source: int, key: int, data: bytes) -> None:
        """One frame all the way: numbered, recorded, fed, its outputs published."""
        read_ns = time.monotonic_ns()
        recorder = self._recorder
        if recorder is not None and (lost := recorder.resume()):
            self._step(RawFrame(self._seq, rx_ns, BRIDGE, Event.UNRECORDED, b'{"frames":%d}' % lost), read_ns)
        self._step(RawFrame(self._seq, rx_ns, source, key, data), read_ns)
        self._last_ns = max(self._last_ns, self._clock.monotonic_ns())

    def _step(self, frame: RawFrame, read_ns: int) -> None:
        self._seq += 1
        if self._recorder is not None:
            self._recorder.record(frame)
        outputs = self._engine.feed(frame)
        if not outputs:
            return
        fed_ns = time.monotonic_ns()
        sent = 0
        for output in outputs:
            if isinstance(output, Transmit):
                sent += self._send(output)
            elif isinstance(output, SensorsOut) and len(self._sensors) < _SENSOR_LINES:
                after_s = (output.health.t_ns - self._start_ns) * 1e-9
                words = ", ".join(output.health.words()) or "all sensors in use"
                self._sensors.append(f"{output.device}: {words} after {after_s:.2f} s")
        for sink in self._sinks:
            for transmit in sink.consume(outputs):
                sent += self._send(transmit)
        if sent and self._clock.host and frame.source != BRIDGE:
            self._latency.add(frame.rx_ns, read_ns, fed_ns, time.monotonic_ns())
        if self._recorder is not None:
            self._document(self._recorder, outputs)

    def _send(self, transmit: Transmit) -> bool:
        source = self._by_number.get(transmit.source)
        return source is not None and source.send(transmit)

    @staticmethod
    def _document(recorder: Recorder, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, SolutionOut):
                recorder.solution(output)
            elif isinstance(output, Checkpoint):
                recorder.checkpoint(output)
            elif isinstance(output, Health):
                recorder.document(HEALTH, output.t_ns, health_document(output))

    def _finish(self, seconds: float) -> Outcome:
        digests = dict(self._engine.digests())
        outcome = Outcome(
            reason=self._stop or "",
            frames=self._seq,
            seconds=seconds,
            digest=combine(digests),
            digests=digests,
            counters={source.context.name: source.counters() for source in self._sources},
            latency=self._latency.summary(),
            sensors=tuple(self._sensors),
        )
        if self._recorder is not None:
            self._recorder.finish(
                {
                    "solution_sha256": outcome.digest,
                    "digests": msgspec.json.encode(digests).decode(),
                    "counters": msgspec.json.encode(outcome.counters).decode(),
                    "latency": msgspec.json.encode(outcome.latency).decode(),
                    "frames": str(outcome.frames),
                }
            )
        return outcome


def health_document(health: Health) -> dict[str, Any]:
    """A health report as plain JSON, the reasons of rejects by name."""
    return {
        "t_ns": health.t_ns,
        "unknown_frames": health.unknown_frames,
        "dropped_frames": health.dropped_frames,
        "unrecorded_frames": health.unrecorded_frames,
        "refused": health.refused,
        "devices": {
            name: {
                **{
                    key: getattr(device, key)
                    for key in ("frames", "samples", "missing", "bridged", "duplicates", "rate_hz", "age_ms")
                },
                "rejects": {reason.name.lower(): count for reason, count in device.rejects.items()},
                **({} if device.sensors is None else {"sensors": device.sensors._asdict()}),
            }
            for name, device in health.devices.items()
        },
    }


@contextmanager
def signals(stop: Callable[[str], object]) -> Iterator[None]:
    """Ctrl-C and SIGTERM call ``stop`` with the reason; a second one ends the program at once."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop(f"stopped by {signal.Signals(number).name}")
        for each, old in before.items():
            signal.signal(each, old)

    before: dict[int, Any] = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, handle)
    except ValueError:  # not the main thread: whoever started it may call stop()
        pass
    try:
        yield
    finally:
        for each, old in before.items():
            signal.signal(each, old)
