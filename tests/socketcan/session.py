"""Run on the bus: the bridge and the simulated bench as two processes, candump beside them.

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
from pathlib import Path

import can

from dbc.codec import contract
from tests.socketcan.candump import Candump
from tests.socketcan.uml import CHANNEL

READY_S = 150.0
"""How long the bridge may take to start on a busy machine: interpreter, kernels from the cache, bus."""
END_S = 60.0


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


def main(where: str, scenario: str, seconds: str) -> int:
    """Bridge first, then the bench for ``seconds``; both end in order.

    All files are written to memory first: in user-mode Linux a slow disk stops the whole guest.
    """
    folder = Path(where)
    memory = Path("/dev/shm")
    os.environ["PYTHONUNBUFFERED"] = "1"
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as fast:
        for path in folder.glob("*.toml"):
            shutil.copy(path, fast)
        try:
            report = session(Path(fast), scenario, seconds)
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
            bench = navbridge(
                folder, "sim", "sim", scenario, "--channel", CHANNEL, "--seconds", seconds, "--seed", "1"
            )
            bench.wait(timeout=float(seconds) + READY_S)
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
