"""candump as a context: running and listening inside, its log complete after."""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path
from types import TracebackType

import can

from tests.socketcan.uml import CHANNEL

_PROBE = 0x7FF
"""An identifier nobody uses: its echo in the log proves that candump listens."""


class Candump:
    """Log ``channel`` to ``path`` in candump's format, with a receive buffer of several seconds."""

    def __init__(self, channel: str, path: Path) -> None:
        self._path = path
        self._log = path.open("wb")
        self._process = subprocess.Popen(
            ["stdbuf", "-o0", "candump", "-L", "-d", "-r", "8000000", channel],
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    def __enter__(self) -> Candump:
        self._knock()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # what was sent before this moment is ahead of the probe in candump's queue
        self._knock()
        self._process.send_signal(signal.SIGINT)
        self._process.wait(timeout=10)
        self._log.close()

    def _knock(self) -> None:
        size = self._path.stat().st_size
        with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
            for _ in range(100):
                bus.send(can.Message(arbitration_id=_PROBE, data=b"", is_extended_id=False))
                time.sleep(0.05)
                tail = self._path.read_bytes()[size:]
                if f"{_PROBE:03X}#".encode() in tail:
                    return
        raise TimeoutError(f"candump does not log {self._path}")


def read_log(path: Path) -> list[tuple[float, int, bytes]]:
    """(time, identifier, payload) of every frame but the probes; a line candump adds of its own fails."""
    frames = []
    for line in path.read_text().splitlines():
        stamp, _channel, frame = line.split()
        identifier, _, body = frame.partition("#")
        if body.startswith("#"):  # CAN FD: one hexadecimal digit of flags
            body = body[2:]
        if int(identifier, 16) != _PROBE:
            frames.append((float(stamp.strip("()")), int(identifier, 16), bytes.fromhex(body)))
    return frames
