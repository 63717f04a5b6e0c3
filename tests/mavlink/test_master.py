"""A slave that ``navbridge run`` aligns from a master in another process, over a real MAVLink link."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from bridge.config import Config
from bridge.engine import Engine
from bridge.outputs import Health, ModeChange, Output, Reject, SolutionOut, Transfer
from bridge.recording import Capture
from bridge.replay import Report, replay
from nav import rotation as rot
from nav.types import Mode, S
from tests.mavlink.speaking import BOOT_NS, MASTER, SECONDS, SLAVE, flown, scenario
from virtual_bus.bus import Bench

SEED = 6
END_S = 150.0
IMU_LATE_NS = 2_500_000  # sent at the end of the interval in whose middle it holds
HEARD = {"angles": "ATTITUDE_QUATERNION", "odometry": "ODOMETRY"}
"""A navigator each, both of the same flight: the message that its master's attitude is taken from."""

LINK = """
[source.link]
type = "mavlink"
url = "udpin:127.0.0.1:{port}"

[device.imu]
driver = "sensors_mavlink"
source = "link"
system_id = {slave}
messages = ["HIGHRES_IMU"]
rate_hz = 200.0
latency_ms = 2.5

[sink.telemetry]
type = "mavlink"
source = "link"
navigator = "angles"
"""
DEVICE = """
[device.{name}]
driver = "master_mavlink"
source = "link"
system_id = {master}
message = "{message}"
latency_ms = 4.0
"""


def configuration(port: int) -> str:
    """The bench's own navigator, twice, on other devices."""
    text = Bench(scenario(), seed=SEED, seconds=SECONDS).files("virtual", "unused")["config.toml"]
    navigator = text[text.index("[navigator.main]") : text.index("[sink.solution]")]
    # what the seed's unit is has been taken out of its samples; the rock is over after 2.5 s
    navigator = navigator.replace("duration_s = 5.0", "duration_s = 3.0")
    parts = [LINK.format(port=port, slave=SLAVE)]
    for name, message in HEARD.items():
        parts.append(DEVICE.format(name=name, master=MASTER, message=message))
        parts.append(
            navigator.replace("navigator.main", f"navigator.{name}").replace('"master"', f'"{name}"')
        )
    return "\n".join(parts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one run: config.toml, run.mcap, run.txt."""
    where = tmp_path_factory.mktemp("master")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    (where / "config.toml").write_text(configuration(port))
    Engine(Config.load(where / "config.toml"))  # compiles what is not in the cache
    speaker = subprocess.Popen([sys.executable, "-m", "tests.mavlink.speaking", str(port), str(SEED)])
    with (where / "run.txt").open("wb") as out:
        bridge = subprocess.Popen(
            [sys.executable, "-m", "bridge.cli", "run", "config.toml", "--out", "run.mcap"],
            cwd=where,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    try:
        assert speaker.wait(END_S) == 0
        bridge.send_signal(signal.SIGINT)
        assert bridge.wait(END_S) == 0, (where / "run.txt").read_text()
    finally:
        for process in (speaker, bridge):
            if process.poll() is None:
                process.kill()
                process.wait()
    return where


@pytest.fixture(scope="module")
def replayed(folder: Path) -> tuple[Report, list[Output], int]:
    """What a replay says, what comes of it, and when the flight began, ns on the engine's clock."""
    capture = Capture(folder / "run.mcap")
    engine = Engine(Config.from_attachments(capture.attachments))
    outputs: list[Output] = []
    report = replay(capture, engine, outputs.extend)
    # the least delayed of the slave's samples
    late = [
        frame.rx_ns - 1000 * dialect.MAVLink(None).parse_buffer(bytearray(frame.data))[0].time_usec
        for frame in capture.frames()
        if frame.source == 1 and frame.key == dialect.MAVLINK_MSG_ID_HIGHRES_IMU
    ]
    return report, outputs, min(late) - IMU_LATE_NS + BOOT_NS


Replayed = tuple[Report, list[Output], int]


@pytest.mark.parametrize("name", HEARD)
def test_it_is_aligned_within_what_it_says(replayed: Replayed, name: str) -> None:
    _, outputs, start_ns = replayed
    mine: list[Any] = [one for one in outputs if getattr(one, "navigator", None) == name]
    changes = [one.new for one in mine if isinstance(one, ModeChange)]
    assert changes == [Mode.TRANSFER, Mode.NAVIGATE]
    known = [one for one in mine if isinstance(one, Transfer)][-1]
    assert max(known.sigma) <= 1e-3
    solution = [one.solution for one in mine if isinstance(one, SolutionOut)][-1]
    assert solution.mode is Mode.NAVIGATE
    flight = flown(SEED)
    t_ns = solution.t_ns - start_ns
    assert 1e9 * (SECONDS - 0.5) < t_ns < 1e9 * SECONDS
    truth = flight.trajectory.state(t_ns)
    phi = rot.rotvec_from_quat(rot.quat_multiply(truth.q_gb, rot.quat_conjugate(solution.state[S.Q])))
    own = flight.master.errors(np.array([t_ns]))[0][0]
    # chi-square of three at 99.9 %
    assert np.sum(((phi - own) / np.array(known.sigma)) ** 2) < 16.3
    assert np.sum((phi / solution.state[S.SIGMA_PHI]) ** 2) < 16.3


def test_nothing_that_was_sent_is_lost_or_refused(replayed: Replayed) -> None:
    health = [one for one in replayed[1] if isinstance(one, Health)][-1]
    assert health.refused == {}
    assert (health.dropped_frames, health.unrecorded_frames) == (0, 0)
    for name in ("imu", *HEARD):
        device = health.devices[name]
        assert (device.missing, device.bridged) == (0, 0), name
        # the last second may not have been told of any more
        assert device.samples > (SECONDS - 1.5) * (200 if name == "imu" else 50), name
        assert set(device.rejects) <= {Reject.UNKNOWN}, name


def test_the_run_replays_to_its_own_digest(replayed: Replayed, folder: Path) -> None:
    report = replayed[0]
    printed = (folder / "run.txt").read_text().rstrip().splitlines()[-1]
    assert printed == f"solution sha256: {report.digest}"
    # two navigators
    assert report.verified == report.checkpoints > 2 * (SECONDS - 2)
