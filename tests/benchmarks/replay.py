"""Replay speed against real time: a demo of two minutes with a 200 Hz unit and every device, played again.

``python -m tests.benchmarks.replay`` prints the table.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import time
from pathlib import Path

from bridge.cli import main as navbridge
from bridge.config import Config
from bridge.engine import Engine
from bridge.recording import Capture
from bridge.replay import Report, replay
from tests.benchmarks.measure import print_table


def measure(folder: Path, seconds: float = 120.0, rounds: int = 3) -> list[tuple[Report, float]]:
    """Reports of ``rounds`` replays of one demo, and the processor time (s) that each took."""
    path = folder / "demo.mcap"
    words = [
        "demo",
        "--seconds",
        f"{seconds:g}",
        "--speed",
        "max",
        "--out",
        str(path),
        "--mavlink",
        "none",
        "--no-view",
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        assert navbridge(words) == 0
    reports = []
    for _ in range(rounds):
        capture = Capture(path)
        engine = Engine(Config.from_attachments(capture.attachments))
        began = time.process_time()
        reports.append((replay(capture, engine), time.process_time() - began))
    return reports


def main() -> int:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        reports = measure(Path(folder))
    rows = [
        (
            f"{report.seconds:.0f} s, {report.frames} frames",
            f"{report.seconds / report.replay_seconds:.0f}",
            f"{report.seconds / busy:.0f}",
            f"{busy / report.frames * 1e6:.1f}",
        )
        for report, busy in reports
    ]
    header = ("replay", "times real time", "by processor time", "us a frame")
    print_table("replay against real time", header, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
