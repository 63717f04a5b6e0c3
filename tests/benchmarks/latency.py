"""Frame received to solution sent, against a bare python-can program that answers with equal frames.

``python -m tests.benchmarks.latency`` prints the table. Both sides use python-can's virtual bus in this
process and take turns: the bench sends what is due, most often one frame; the bridge's whole loop turns once:
it receives, records and navigates, and where that frame completed a solution it sends it, twelve frames as a
rule. The time is that until the last of them is on the bus, by its stamp. Then a bare loop receives as many
frames from a bus of its own and sends as many frames of the same content, which it has to make of identifiers
and bytes as any program must. Time is simulated, so nothing waits; the bridge records to disk.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np

from bridge.assemble import Bridge
from bridge.config import Config
from tests.benchmarks.measure import print_table
from virtual_bus.bus import Bench, Sent

CHANNEL, ECHO = "latency-bridge", "latency-echo"
SOLUTION_ID = 0x200


class TimedBench:
    """The loop's bench: puts a burst on the bus, then starts the stop-watch."""

    def __init__(self, bench: Bench, bus: can.BusABC) -> None:
        self._bench = bench
        self._buses = dict.fromkeys(bench.channels, bus)
        self._bus = bus
        self._sent = Sent({})
        self._total = 0
        self.count = 0
        """Frames of the burst."""
        self._start_ns: int | None = None
        self.began_s = 0.0

    def send_due(self, now_ns: int) -> None:
        """Send what is due at ``now_ns``."""
        if self._start_ns is None:
            self._start_ns = now_ns
        self._bench.send_due(self._buses, min(now_ns - self._start_ns, self._bench.end_ns), self._sent)
        total = sum(self._sent.frames.values())
        self.count, self._total = total - self._total, total
        self.began_s = time.time()

    def next_ns(self) -> int | None:
        """When the next burst is due."""
        due = self._bench.next_ns
        return None if due is None or due > self._bench.end_ns else due + (self._start_ns or 0)


class TimedClock:
    """Simulated time; when the loop has done its turn and waits, the stop-watch is read and the echo runs."""

    host = False

    def __init__(self, devices: can.BusABC, smallest: int) -> None:
        self._smallest = smallest
        self._now_ns = 1_000_000_000
        self._devices = devices
        self.bench: TimedBench | None = None
        self.bridge_us: list[float] = []
        self.echo_us: list[float] = []
        self._bench_end = can.Bus(interface="virtual", channel=ECHO)
        self._echo_end = can.Bus(interface="virtual", channel=ECHO)

    def monotonic_ns(self) -> int:
        """The simulated instant."""
        return self._now_ns

    def utc_ns(self) -> int:
        """The simulated instant."""
        return self._now_ns

    def wait_until(self, ns: int, descriptors: Sequence[int] = ()) -> None:
        """The end of a turn: read the stop-watch, let the bare loop do the same, go on."""
        assert self.bench is not None
        answer = _received(self._devices)
        if len(answer) >= self._smallest and any(message.arbitration_id == SOLUTION_ID for message in answer):
            self.bridge_us.append((answer[-1].timestamp - self.bench.began_s) * 1e6)
            self.echo_us.append(self._echo(self.bench.count, answer))
        self._now_ns = max(self._now_ns, ns)

    def close(self) -> None:
        """Release the buses of the echo."""
        self._bench_end.shutdown()
        self._echo_end.shutdown()

    def _echo(self, count: int, answer: list[can.Message]) -> float:
        """``count`` frames in, ``answer`` out, in a loop that does nothing else; us."""
        for _ in range(count):
            self._bench_end.send(answer[0])
        frames = [(message.arbitration_id, bytes(message.data)) for message in answer]
        began_s = time.time()
        while self._echo_end.recv(0) is not None:
            pass
        for key, data in frames:
            self._echo_end.send(can.Message(arbitration_id=key, data=data, is_extended_id=False))
        return (_received(self._bench_end)[-1].timestamp - began_s) * 1e6


def _received(bus: can.BusABC) -> list[can.Message]:
    """Whatever has arrived; the virtual bus stamps a frame with the system's time when it is sent."""
    messages = []
    while (message := bus.recv(0)) is not None:
        messages.append(message)
    return messages


def measure(
    folder: Path, seconds: float = 120.0, smallest: int = 12
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Microseconds from burst to answer, bridge and echo, for answers of ``smallest`` frames or more."""
    bench = Bench("drive", seed=1, seconds=seconds)
    bench.prepare()
    files = bench.files("virtual", CHANNEL)
    config = Config.from_files(files)
    devices = can.Bus(interface="virtual", channel=CHANNEL)
    clock = TimedClock(devices, smallest)
    try:
        clock.bench = TimedBench(bench, devices)
        with Bridge(config, clock, out=folder / "latency.mcap") as bridge:
            bridge.live(bench=clock.bench).run()
    finally:
        clock.close()
        devices.shutdown()
    return np.array(clock.bridge_us), np.array(clock.echo_us)


def main() -> int:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        bridge, echo = measure(Path(folder))
    rows = []
    for name, percent in (("median", 50.0), ("99 %", 99.0), ("99.9 %", 99.9)):
        ours, bare = np.percentile(bridge, percent), np.percentile(echo, percent)
        rows.append((name, f"{ours:.0f}", f"{bare:.0f}", f"{ours / bare:.2f}"))
    title = f"frame received to solution sent, us, over {len(bridge)} solutions"
    print_table(title, ("", "bridge", "bare echo", "ratio"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
