"""The bench on python-can buses, and ``navbridge sim``."""

from __future__ import annotations

import argparse
import errno
import signal
import subprocess
import sys
import time

import can
import pytest

from bridge.cli import sim
from bridge.config import Config
from bridge.errors import ConfigError, SourceError
from virtual_bus.bus import Bench, Sent, send


def arguments(*words):
    parser = argparse.ArgumentParser()
    sim.add_parser(parser.add_subparsers())
    return parser.parse_args(["sim", *words])


def collect(bus):
    out = []
    while (message := bus.recv(0.0)) is not None:
        out.append(message)
    return out


def test_every_frame_reaches_a_bus():
    expected = [(f.frame_id, f.data) for f in Bench("drive", seconds=2.0).due(2_000_000_000)]
    with (
        can.Bus(interface="virtual", channel="bench-1") as bus,
        can.Bus(interface="virtual", channel="bench-1") as listener,
    ):
        bench = Bench("drive", seconds=2.0)
        sent = Sent({})
        for now in range(0, 2_000_000_001, 100_000_000):
            bench.send_due({"can0": bus}, now, sent)
        got = [(m.arbitration_id, bytes(m.data)) for m in collect(listener)]
    assert got == expected
    assert sent.frames == {"can0": len(expected)}


class Full:
    """A bus without room for the first frames."""

    def __init__(self, times, error):
        self.times, self.error, self.got = times, error, []

    def send(self, message):
        if self.times:
            self.times -= 1
            raise self.error
        self.got.append(message)


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
    ],
)
def test_a_full_buffer_is_waited_for_and_counted(error):
    frame = next(iter(Bench("drive", seconds=1.0).due(1_000_000_000)))
    bus, sent = Full(3, error), Sent({})
    send(bus, frame, sent)
    assert (len(bus.got), sent.full) == (1, 3)
    assert sent.frames == {"can0": 1}


def test_another_error_is_not_swallowed():
    frame = next(iter(Bench("drive", seconds=1.0).due(1_000_000_000)))
    with pytest.raises(can.CanOperationError):
        send(Full(1, can.CanOperationError("network is down", errno.ENETDOWN)), frame, Sent({}))


def test_sim_at_full_speed(capsys, tmp_path):
    with can.Bus(interface="virtual", channel="sim-1") as listener:
        status = sim.run(
            arguments(
                "drive",
                "--interface",
                "virtual",
                "--channel",
                "sim-1",
                "--seconds",
                "3",
                "--speed",
                "max",
                "--config-out",
                str(tmp_path),
            )
        )
        got = len(collect(listener))
    out = capsys.readouterr().out
    assert status == 0
    assert f"{got} frames sent" in out
    assert got > 2000
    assert Config.load(tmp_path / "config.toml").sources["can0"].channel == "sim-1"


def test_sim_keeps_time(capsys):
    begin = time.monotonic()
    sim.run(
        arguments("drive", "--interface", "virtual", "--channel", "sim-2", "--seconds", "4", "--speed", "4")
    )
    # the last frame is due at 4 s of scenario, 1 s of ours
    assert time.monotonic() - begin > 0.97
    assert "worst lateness" in capsys.readouterr().out


def test_sim_stops_cleanly_when_told_to():
    code = (
        "import sys; from tests.virtual_bus.test_sim_command import arguments; from bridge.cli import sim; "
        "sys.exit(sim.run(arguments('drive', '--interface', 'virtual', '--channel', 'x')))"
    )
    processes = {
        number: subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    for number, process in processes.items():
        assert process.stdout is not None
        process.stdout.readline()  # it says what it sends when the bus is open
        time.sleep(0.3)
        process.send_signal(number)
        out, err = process.communicate(timeout=30)
        assert (process.returncode, err) == (0, "")
        assert f"stopped by {number.name}: " in out


def test_sim_says_what_is_wrong(tmp_path):
    with pytest.raises(ConfigError, match="no such scenario"):
        sim.run(arguments("nowhere"))
    with pytest.raises(SourceError, match="nocan0: cannot be opened"):
        sim.run(arguments("drive", "--channel", "nocan0", "--seconds", "1"))
    with pytest.raises(SourceError, match="cannot be opened"):
        sim.run(arguments("drive", "--interface", "telepathy", "--seconds", "1"))
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        sim.run(arguments("drive", "--config-out", str(tmp_path / "file")))
    for words in (["--speed", "0"], ["--seed", "-1"], ["--seconds", "nan"]):
        with pytest.raises(SystemExit):
            arguments("drive", *words)
