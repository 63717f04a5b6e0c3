"""Run on the bus: send and receive with python-can while candump listens; prints what it saw."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import can

from tests.socketcan.candump import Candump
from tests.socketcan.uml import CHANNEL

FRAMES = 500


def main(folder: str) -> int:
    """Send `FRAMES` classic and FD frames, receive them on a second socket, log them with candump."""
    log = Path(folder) / "smoke.log"
    with (
        Candump(CHANNEL, log),
        can.Bus(interface="socketcan", channel=CHANNEL, fd=True) as sender,
        can.Bus(interface="socketcan", channel=CHANNEL, fd=True) as receiver,
    ):
        before_ns = time.time_ns()
        received = []
        for number in range(FRAMES):
            fd = number % 5 == 4
            data = number.to_bytes(4, "little") * (8 if fd else 2)
            sender.send(
                can.Message(arbitration_id=0x100 + number % 7, data=data, is_extended_id=False, is_fd=fd)
            )
            message = receiver.recv(timeout=1.0)
            if message is not None:
                received.append((message.arbitration_id, bytes(message.data).hex(), message.timestamp))
        after_ns = time.time_ns()
    links = subprocess.run(
        ["ip", "-json", "-statistics", "link", "show", CHANNEL], capture_output=True, check=True, text=True
    )
    print(
        json.dumps(
            {
                "received": received,
                "before_s": before_ns / 1e9,
                "after_s": after_ns / 1e9,
                "link": json.loads(links.stdout)[0],
            }
        )
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
