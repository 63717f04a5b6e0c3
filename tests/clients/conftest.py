"""A running demo for real ground-station software to talk to."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SCENARIO = """
title = "A short rest, then round and round"
grade = "fog"
repeat_from = 2

[start]
lat_deg = 48.137
lon_deg = 11.575
height_m = 520.0
heading_deg = 65.0

[odometer]
[baro]
[gnss]

[[manoeuvre]]
kind = "static"
duration_s = 15.0

[[manoeuvre]]
kind = "accelerate"
duration_s = 8.0
speed_m_s = 10.0

[[manoeuvre]]
kind = "turn"
duration_s = 40.0
angle_deg = 360.0
"""


class Demo:
    """A demo in another process; its ground station has to listen on UDP ``port``."""

    def __init__(self, folder: Path) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.capture = folder / "live.mcap"
        scenario = folder / "round.toml"
        scenario.write_text(SCENARIO)
        options = {
            "--seconds": "3000",  # longer than any test: it is stopped, not awaited
            "--speed": "4",  # driving after four seconds, and a slow machine still keeps up
            "--out": str(self.capture),
            "--mavlink": f"udpout:127.0.0.1:{self.port}",
        }
        words = [word for pair in options.items() for word in pair]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bridge.cli", "demo", str(scenario), *words, "--no-view"],
            stdout=subprocess.PIPE,
            text=True,
        )

    def stop(self) -> str:
        """End the demo in order; returns what it printed."""
        self.process.send_signal(signal.SIGINT)
        printed, _ = self.process.communicate(timeout=240.0)
        assert self.process.returncode == 130
        return printed

    def kill(self) -> None:
        """End it at once, if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    running = Demo(tmp_path_factory.mktemp("demo"))
    yield running
    running.kill()
