"""A small engine, sources and clocks to drive the loop with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bridge.clock import HostClock
from bridge.digest import DigestChain
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.outputs import Output, SolutionOut, Transmit
from bridge.sources.base import Notice, Received, SourceContext
from nav.types import Mode, S, Solution, SolutionFlag

VALID = SolutionFlag.POSITION | SolutionFlag.LEVEL | SolutionFlag.HEADING


class FakeEngine:
    """Folds bytes into numbers: a solution for every frame of a source, from all frames so far."""

    def __init__(self, bias: float = 0.0) -> None:
        self.frames: list[RawFrame] = []
        self._sum = bias
        self._now_ns = 0
        self._chain = DigestChain("main")

    def feed(self, frame: RawFrame) -> list[Output]:
        self.frames.append(frame)
        self._now_ns = max(self._now_ns, frame.rx_ns)
        if frame.source == BRIDGE and frame.key != Event.TICK:
            return []
        self._sum = 0.9 * self._sum + 1e-7 * (sum(frame.data) + 1)
        state = np.full(S.SIZE, self._sum)
        state[S.Q] = [1.0, 0.0, 0.0, 0.0]
        state[S.BARO_BIAS] = np.nan
        solution = Solution(self._now_ns, Mode.NAVIGATE, VALID, state)
        outputs: list[Output] = [SolutionOut("main", solution, frame.rx_ns)]
        if (link := self._chain.add(solution)) is not None:
            outputs.append(link)
        return outputs

    def digests(self) -> dict[str, str]:
        return {"main": self._chain.final()}

    def events(self) -> list[tuple[Event, bytes]]:
        return [
            (Event(frame.key), frame.data)
            for frame in self.frames
            if frame.source == BRIDGE and frame.key != Event.TICK
        ]


class EchoSink:
    """Sends one frame for every solution."""

    def __init__(self, source: int = 1) -> None:
        self._source = source

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        return [Transmit(self._source, 0x200, b"\1") for out in outputs if isinstance(out, SolutionOut)]


class ListSource:
    """Hands out prepared polls; each is a list of frames or a notice."""

    def __init__(self, context: SourceContext, polls: Sequence[list[Received] | Notice]) -> None:
        self.context = context
        self.sent: list[Transmit] = []
        self._polls = list(polls)
        self._notices: list[Notice] = []

    def open(self) -> None: ...

    def descriptors(self) -> Sequence[int]:
        return ()

    def poll(self, deadline_ns: int) -> list[Received]:
        if not self._polls:
            return []
        item = self._polls.pop(0)
        if isinstance(item, Notice):
            self._notices.append(item)
            return []
        return item

    def notices(self) -> list[Notice]:
        told, self._notices = self._notices, []
        return told

    def send(self, transmit: Transmit) -> bool:
        self.sent.append(transmit)
        return True

    def counters(self) -> dict[str, int]:
        return {"sent": len(self.sent)}

    def filters(self) -> str:
        return "all"

    def close(self) -> None: ...


class SteppableClock(HostClock):
    """The host's clock with a wall clock that a test may step."""

    def __init__(self) -> None:
        self.step_ns = 0

    def utc_ns(self) -> int:
        return super().utc_ns() + self.step_ns
