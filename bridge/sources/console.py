"""The operator's terminal: a line typed into it is a command, recorded like everything from outside."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final, TextIO

from bridge.clock import Clock, WallClock
from bridge.commands import METHODS, CommandCode
from bridge.frame import BRIDGE, Event
from bridge.outputs import Transmit
from bridge.sources.base import Notice, Received, SourceContext

WORDS: Final = {
    "start": CommandCode.START_ALIGNMENT,
    "stop": CommandCode.STOP,
    "restart": CommandCode.RESTART,
}
_READ_BYTES: Final = 4096


class Console:
    """A source without frames: its notices are COMMAND events. ``start`` and ``restart`` take an alignment.

    Only a terminal is read, and only while we are its foreground: what comes out of a file or a pipe was
    meant for somebody else, and a read in the background would stop the process. Words that are no command
    are answered on ``answers``.
    """

    def __init__(self, context: SourceContext, descriptor: int, answers: TextIO) -> None:
        self.context = context
        self._descriptor = descriptor
        self._answers = answers
        self._line = bytearray()
        self._notices: list[Notice] = []
        self._counts = {"commands": 0}
        self._ended = False
        self._never: tuple[int, ...] = ()  # both ends of a pipe that nobody writes to

    def open(self) -> None:
        """Begin to listen."""
        self._never = os.pipe()

    def descriptors(self) -> Sequence[int]:
        """The terminal; while it is not ours something that never has input, so that nobody polls for it."""
        return (self._descriptor,) if self._ours() else self._never[:1]

    def poll(self, deadline_ns: int) -> list[Received]:
        """Read what was typed; it is in `notices`."""
        if not self._ours() or not select.select((self._descriptor,), (), (), 0.0)[0]:
            return []
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except OSError:
            data = b""
        if not data:  # hung up, or the end of input was typed
            self._ended = True
        self._line += data
        while b"\n" in self._line:
            line, _, rest = self._line.partition(b"\n")
            self._line = bytearray(rest)
            self._take(line.decode(errors="replace").strip().lower())
        del self._line[_READ_BYTES:]
        return []

    def notices(self) -> list[Notice]:
        """Commands since the last call."""
        told, self._notices = self._notices, []
        return told

    def send(self, transmit: Transmit) -> bool:
        """Nothing goes out here."""
        return False

    def counters(self) -> dict[str, int]:
        """How many commands were given."""
        return dict(self._counts)

    def filters(self) -> str:
        """The words that are understood."""
        return ", ".join(WORDS)

    def close(self) -> None:
        """Stop listening; the terminal stays open."""
        for descriptor in self._never:
            os.close(descriptor)
        self._never = ()

    def _ours(self) -> bool:
        if self._ended or not self._never:
            return False
        try:
            return os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:  # the terminal is gone, or not that of our session
            return False

    def _take(self, line: str) -> None:
        word, _, method = line.partition(" ")
        method = method.strip()
        if word not in WORDS:
            if word:
                self._answer(f'"{word}" is no command; expected one of {self.filters()}')
            return
        body: dict[str, int | str] = {"command": WORDS[word].name.lower()}
        if method:
            if method not in METHODS or word == "stop":
                expected = f"nothing or one of {', '.join(METHODS)}" if word != "stop" else "nothing"
                self._answer(f'"{method}" after {word}; expected {expected}')
                return
            body["method"] = method
        self._counts["commands"] += 1
        self._notices.append(Notice(self.context.clock.monotonic_ns(), Event.COMMAND, body))

    def _answer(self, text: str) -> None:
        print(text, file=self._answers, flush=True)


@contextmanager
def at_terminal(clock: Clock, wall: WallClock, answers: TextIO) -> Iterator[list[Console]]:
    """The terminal that we were started in as an open console; none where there is none."""
    try:
        descriptor = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # none, closed, or replaced by something else
        yield []
        return
    if not os.isatty(descriptor):
        yield []
        return
    console = Console(SourceContext(BRIDGE, "console", clock, wall), descriptor, answers)
    console.open()
    try:
        yield [console]
    finally:
        console.close()
