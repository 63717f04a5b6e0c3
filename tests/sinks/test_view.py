"""The live view: pictures through the pipe, plain lines where there is no terminal, never in the way."""

from __future__ import annotations

import math
import re
import sys
import time
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bridge.evaluate import TruthTable
from bridge.outputs import DeviceHealth, Health, ModeChange, Output, Progress, Reject, Severity, Text
from bridge.view import ViewProcess, ViewSink
from bridge.view_screen import Picture, plain_line, render
from nav.types import Mode, S
from tests.sinks.made import out, solution, unknown


class Shown(ViewProcess):
    """Keeps the pictures instead of drawing them."""

    def __init__(self) -> None:
        super().__init__(start=False)
        self.pictures: list[Picture] = []

    def update(self, picture: Picture) -> bool:
        self.pictures.append(picture)
        return True


def two_metres_east(t_ns: int) -> TruthTable:
    s = solution(t_ns)
    east = 2.0 / (6.3892e6 * math.cos(s.lat))  # R_N at 48 degrees, and the height
    one = np.ones(1)
    return TruthTable(
        np.array([t_ns]),
        one * s.lat,
        one * (s.lon - east),
        one * s.height,
        s.v_g[None],
        s.state[None, S.Q],
        one[None],
    )


def everything() -> list[Output]:
    imu = DeviceHealth(frames=600, samples=200, missing=2, rejects={Reject.CRC: 3}, rate_hz=200.0, age_ms=4.0)
    return [
        ModeChange(4_000_000_000, "main", Mode.STANDBY, Mode.ALIGN, "started"),
        Progress(4_100_000_000, "main", "coarse levelling", 0.25),
        Health(4_500_000_000, {"imu": imu}, 1, 0, 0),
        Text(4_600_000_000, Severity.WARNING, "imu: 2 samples missing"),
    ]


def drawn(picture: Picture, width: int = 120) -> str:
    console = Console(file=StringIO(), width=width, color_system=None)
    console.print(render(picture, picture["messages"], width))
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_screen_shows_progress_devices_and_messages() -> None:
    shown = Shown()
    ViewSink(shown, "main", title="drive", duration_s=120.0).consume(everything())
    screen = drawn(shown.pictures[-1])
    for words in (
        "ALIGN",
        "of 120",
        "coarse levelling",
        "imu",
        "200.0",
        "crc 3",
        "unknown 1",
        "2 samples missing",
    ):
        assert words in screen
    assert "coarse levelling 25 %" in plain_line(shown.pictures[-1])


def test_screen_shows_the_solution_and_its_error() -> None:
    shown = Shown()
    ViewSink(shown, "main", truth=two_metres_east).consume([out(solution())])
    picture = shown.pictures[-1]
    assert picture["error"]["horizontal"] == pytest.approx(2.0, abs=0.01)
    screen = drawn(picture)
    assert "48.1400000" in screen
    assert "heading 200.000" in screen
    assert re.search(r"error 2\.00 m 0\.000 deg", plain_line(picture))


@pytest.mark.parametrize("width", [60, 80, 99, 100])
def test_no_number_is_cut_short_in_a_narrow_terminal(width: int) -> None:
    shown = Shown()
    sink = ViewSink(shown, "main", truth=two_metres_east, clock=lambda: 0.0)
    sink.consume([*everything(), out(solution(heading_deg=359.123, lon_deg=-123.1234567))])
    sink.show()
    screen = drawn(shown.pictures[-1], width)
    assert "…" not in screen
    assert max(map(len, screen.splitlines())) == width
    for words in (
        "48.1400000°",
        "-123.1234567°",
        "heading 359.123°",
        "1 sigma",
        "error",
        "missing",
        "bridged",
    ):
        assert words in screen


def test_unknown_values_are_dashes() -> None:
    shown = Shown()
    ViewSink(shown, "main").consume([out(unknown())])
    assert "heading -" in drawn(shown.pictures[-1])
    assert "nan" not in plain_line(shown.pictures[-1])


def test_a_flood_of_messages_is_cut() -> None:
    shown = Shown()
    texts: list[Output] = [Text(0, Severity.NOTICE, f"again {count}") for count in range(100)]
    ViewSink(shown, "main").consume(texts)
    messages = shown.pictures[-1]["messages"]
    assert len(messages) == 21
    assert messages[-1] == (False, "and 80 more messages")


def test_pictures_are_at_most_five_a_second() -> None:
    now = 0.0
    shown = Shown()
    sink = ViewSink(shown, "main", clock=lambda: now)
    for tick in range(1000):
        now = tick * 0.01
        sink.consume([out(solution(tick * 10_000_000))])
    assert 45 <= len(shown.pictures) <= 51


def test_child_prints_plain_lines(capfd: pytest.CaptureFixture[str]) -> None:
    view = ViewProcess()
    sink = ViewSink(view, "main")
    sink.consume(everything())
    sink.consume([out(solution())])
    sink.show()
    view.close()
    printed = capfd.readouterr().out
    assert "imu: 2 samples missing" in printed
    assert "ALIGN" in printed


@pytest.mark.parametrize("script", ["exit 1", "exec sleep 60"])
def test_a_dead_or_stuck_child_does_not_hold_the_loop_up(
    script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = tmp_path / "child"
    child.write_text(f"#!/bin/sh\n{script}\n")
    child.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(child))
    monkeypatch.setattr("bridge.view._CLOSE_S", 0.2)
    view = ViewProcess()
    sink = ViewSink(view, "main")
    start = time.monotonic()
    for _ in range(500):  # more than a pipe holds
        sink.consume(everything())
        sink.show()
    view.close()
    # the pictures take some milliseconds and closing two waits of 0.2 s; waiting for the child takes 60 s
    assert time.monotonic() - start < 10.0
