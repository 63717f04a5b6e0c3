"""Run on the bus: the bridge and the simulated bench as two processes, candump and an operator beside them.

Prints one JSON object with what each of them said; the logs and the capture stay in the folder.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can

from bridge.commands import METHODS, CommandCode
from dbc.codec import contract
from nav.types import Mode
from tests.socketcan.candump import Candump
from tests.socketcan.uml import CHANNEL

READY_S = 150.0
"""How long the bridge may take to start on a busy machine: interpreter, kernels from the cache, bus."""
END_S = 60.0
ANSWER_S = 60.0
WATCHED = ("COMMAND_ACK", "SOL_TIME", "SOL_ALIGN", "GNSS_TIME")


def navbridge(folder: Path, name: str, *arguments: str) -> subprocess.Popen[bytes]:
    """One command of ours, its output in ``name``.txt."""
    with (folder / f"{name}.txt").open("wb") as out:
        return subprocess.Popen(
            [str(Path(sys.executable).with_name("navbridge")), *arguments],
            stdout=out,
            stderr=subprocess.STDOUT,
            cwd=folder,
        )


def wait_for_bridge(bridge: subprocess.Popen[bytes]) -> None:
    """Until its first status frame is on the bus."""
    status = contract()["SOL_TIME"].frame_id
    end = time.monotonic() + READY_S
    with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
        while time.monotonic() < end:
            if bridge.poll() is not None:
                raise RuntimeError("the bridge ended before it was ready")
            message = bus.recv(timeout=0.5)
            if message is not None and message.arbitration_id == status:
                return
    raise TimeoutError("the bridge says nothing on the bus")


class Operator:
    """Gives commands on the bus and waits for what comes of each."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._alive = 0

    def command(self, code: int, argument: int = 0) -> None:
        """Send a COMMAND, and see that it is answered."""
        codec = contract()["COMMAND"]
        data = codec.encode(self._alive, code, argument)
        self._alive = (self._alive + 1) % 15
        self._bus.send(can.Message(arbitration_id=codec.frame_id, data=data, is_extended_id=False))
        self.wait("COMMAND_ACK", lambda ack: ack["CODE"] == code)

    def wait(
        self, name: str, wanted: Callable[[dict[str, Any]], bool], patience_s: float = ANSWER_S
    ) -> dict[str, Any]:
        """Signals of the first such frame on the bus."""
        codec, end = contract()[name], time.monotonic() + patience_s
        while time.monotonic() < end:
            message = self._bus.recv(timeout=0.5)
            if message is not None and message.arbitration_id == codec.frame_id:
                signals = dict(zip(codec.signals, codec.decode(bytes(message.data)), strict=True))
                if wanted(signals):
                    return signals
        raise TimeoutError(f"no such {name} on the bus")

    def aligning(self, method: str) -> None:
        """Until this alignment says that it has come some way."""
        number = METHODS[method]
        self.wait("SOL_ALIGN", lambda said: said["METHOD"] == number and said["PROGRESS"] > 0)


def commands(operator: Operator) -> None:
    """An alignment begun while it navigates, another picked, one refused, begun anew, and given up."""
    operator.command(CommandCode.START_ALIGNMENT, METHODS["gnss"])
    operator.aligning("gnss")
    operator.command(CommandCode.START_ALIGNMENT, METHODS["odometer"])
    operator.wait("SOL_ALIGN", lambda said: said["METHOD"] == METHODS["odometer"])
    operator.command(CommandCode.START_ALIGNMENT, METHODS["stored"])
    operator.command(CommandCode.RESTART, METHODS["gnss"])
    operator.aligning("gnss")
    operator.command(CommandCode.STOP)
    operator.wait("SOL_TIME", lambda said: said["MODE"] == Mode.STANDBY)


def main(where: str, scenario: str, seconds: str) -> int:
    """Bridge first, then the bench for ``seconds``; both end in order."""
    return in_memory(Path(where), lambda folder: session(folder, scenario, seconds))


def in_memory(folder: Path, play: Callable[[Path], dict[str, object]]) -> int:
    """Play a session in a copy of ``folder``, and print what it reports; all files are in the folder then.

    They are written to memory first: in user-mode Linux a slow disk stops the whole guest.
    """
    memory = Path("/dev/shm")
    os.environ["PYTHONUNBUFFERED"] = "1"
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as fast:
        for path in folder.glob("*.toml"):
            shutil.copy(path, fast)
        try:
            report = play(Path(fast))
        finally:
            for path in Path(fast).iterdir():
                shutil.copy(path, folder)
    print(json.dumps(report))
    return 0


def session(folder: Path, scenario: str, seconds: str) -> dict[str, object]:
    """The session itself; how the two ended, and when what happened."""
    times = {"start": time.monotonic()}
    with Candump(CHANNEL, folder / "bus.log"):
        bridge = navbridge(folder, "run", "run", "config.toml", "--out", "run.mcap")
        try:
            wait_for_bridge(bridge)
            times["ready"] = time.monotonic()
            longest = str(float(seconds) + 10.0 * ANSWER_S)  # it is stopped, not awaited
            bench = navbridge(
                folder, "sim", "sim", scenario, "--channel", CHANNEL, "--seconds", longest, "--seed", "1"
            )
            # not all of the bus: it would be behind the bridge in reading it
            filters: list[can.typechecking.CanFilter] = [
                {"can_id": contract()[name].frame_id, "can_mask": 0x7FF} for name in WATCHED
            ]
            with can.Bus(interface="socketcan", channel=CHANNEL, can_filters=filters) as bus:
                operator = Operator(bus)
                end_us = operator.wait("GNSS_TIME", lambda _: True, READY_S)["TOW"] + 1e6 * float(seconds)
                operator.wait("GNSS_TIME", lambda fix: fix["TOW"] >= end_us, float(seconds) + READY_S)
                commands(operator)
            bench.send_signal(signal.SIGINT)
            bench.wait(timeout=END_S)
            times["sent"] = time.monotonic()
            time.sleep(1.5)  # the last health report
        finally:
            bridge.send_signal(signal.SIGINT)
            bridge.wait(timeout=END_S)
        times["end"] = time.monotonic()
    return {
        "sim_status": bench.returncode,
        "run_status": bridge.returncode,
        "seconds": {name: value - times["start"] for name, value in times.items()},
    }


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
