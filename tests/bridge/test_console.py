"""Commands typed into the terminal: what is understood, what is recorded, and when nothing is read."""

import io
import json
import os
import pty
import select
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.clock import HostClock, WallClock
from bridge.frame import BRIDGE, Event
from bridge.outputs import Transmit
from bridge.recording import Capture
from bridge.sources.base import SourceContext
from bridge.sources.console import Console, at_terminal
from virtual_bus.bus import Bench

FOREVER = 1 << 62


class Terminal:
    """A console on a terminal of its own; ``keys`` is the end where somebody types."""

    def __init__(self) -> None:
        clock = HostClock()
        self.keys, self.line = pty.openpty()
        self.answers = io.StringIO()
        context = SourceContext(BRIDGE, "console", clock, WallClock(clock))
        self.console = Console(context, self.line, self.answers)
        self.console.open()

    def type(self, text: bytes) -> list[object]:
        os.write(self.keys, text)
        deadline = time.monotonic() + 2.0
        told = []
        while time.monotonic() < deadline and len(told) < max(1, text.count(b"\n")):
            self.console.poll(FOREVER)
            told += self.console.notices()
            if self.answers.getvalue():
                break
            time.sleep(0.005)
        assert all(notice.event is Event.COMMAND for notice in told)
        return [notice.body["command"] for notice in told]

    def close(self) -> None:
        self.console.close()
        for descriptor in (self.keys, self.line):
            os.close(descriptor)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    # it is not the terminal of this session: say that it is
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
    made = Terminal()
    yield made
    made.close()


def test_words_become_commands(terminal: Terminal) -> None:
    assert terminal.type(b"start\n") == ["start_alignment"]
    assert terminal.type(b"  Stop \n") == ["stop"]
    assert terminal.type(b"restart\nstart\n") == ["restart", "start_alignment"]
    assert terminal.console.counters() == {"commands": 4}
    assert terminal.console.notices() == []


def test_an_alignment_may_be_named(terminal: Terminal) -> None:
    os.write(terminal.keys, b"start  gyrocompass\n")
    terminal.console.poll(FOREVER)
    (notice,) = terminal.console.notices()
    assert notice.body == {"command": "start_alignment", "method": "gyrocompass"}


@pytest.mark.parametrize(
    ("typed", "says"), [(b"start north\n", "one of static, motion"), (b"stop static\n", "expected nothing\n")]
)
def test_an_alignment_that_is_none_is_answered(terminal: Terminal, typed: bytes, says: str) -> None:
    assert terminal.type(typed) == []
    assert says in terminal.answers.getvalue()


def test_other_words_are_answered_and_are_no_commands(terminal: Terminal) -> None:
    assert terminal.type(b"alighn\n\n") == []
    assert terminal.answers.getvalue() == '"alighn" is no command; expected one of start, stop, restart\n'


def test_half_a_line_waits_and_nothing_blocks(terminal: Terminal) -> None:
    os.write(terminal.keys, b"sto")
    time.sleep(0.01)
    assert terminal.console.poll(FOREVER) == []
    assert terminal.type(b"p\n") == ["stop"]
    assert not terminal.console.send(Transmit(0, 1, b"x"))
    assert list(terminal.console.descriptors()) == [terminal.line]


def test_the_end_of_input_ends_the_listening_and_not_the_run(terminal: Terminal) -> None:
    os.write(terminal.keys, b"\x04")
    time.sleep(0.01)
    terminal.console.poll(FOREVER)
    (quiet,) = terminal.console.descriptors()
    assert quiet != terminal.line
    assert select.select([quiet], [], [], 0.0)[0] == []
    assert terminal.console.poll(FOREVER) == []


def test_in_the_background_the_terminal_is_left_alone(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp() + 1)
    os.write(terminal.keys, b"stop\n")
    time.sleep(0.01)
    assert terminal.console.poll(FOREVER) == []
    assert terminal.console.notices() == []
    assert list(terminal.console.descriptors()) != [terminal.line]
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
    assert terminal.type(b"") == ["stop"]


@pytest.mark.parametrize("kind", ["none", "file"])
def test_only_a_terminal_is_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = HostClock()
    (tmp_path / "words").write_text("stop\n")
    with (tmp_path / "words").open() as stream:
        monkeypatch.setattr(sys, "stdin", None if kind == "none" else stream)
        with at_terminal(clock, WallClock(clock), io.StringIO()) as consoles:
            assert consoles == []


def test_a_command_is_in_the_capture_and_replays(tmp_path: Path) -> None:
    """The whole way, with the program in the foreground of a terminal of its own."""
    for name, text in Bench("drive", seconds=1.0).files("virtual", "console").items():
        (tmp_path / name).write_text(text)
    out = tmp_path / "a.mcap"
    keys, line = pty.openpty()
    root = Path(__file__).parents[2]
    # a session of its own, whose terminal is the one that is opened first
    begin = (
        "import os, sys; os.setsid(); os.close(os.open(os.ttyname(0), os.O_RDWR)); "
        "os.execv(sys.executable, [sys.executable, '-m', 'bridge', *sys.argv[1:]])"
    )
    command = [sys.executable, "-c", begin, "run", str(tmp_path / "config.toml"), "--out", str(out)]
    process = subprocess.Popen(command, stdin=line, stdout=line, stderr=subprocess.PIPE, cwd=root)
    os.close(line)
    try:
        assert process.stderr is not None
        said = b""
        while b"STANDBY to ALIGN" not in said:
            said = process.stderr.readline()
            assert said, "it ended early"
        os.write(keys, b"stop\n")
        while b"ALIGN to STANDBY" not in said:
            said = process.stderr.readline()
            assert said
        os.write(keys, termios.tcgetattr(keys)[6][termios.VINTR])  # Ctrl-C
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()
        os.close(keys)
    commands = [f.data for f in Capture(out).frames() if (f.source, f.key) == (BRIDGE, Event.COMMAND)]
    assert [json.loads(data) for data in commands] == [{"command": "stop"}]
    assert main(["replay", str(out)]) == 0
