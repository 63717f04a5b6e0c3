"""Run on the bus: a slave in the bridge, and its IMU and its master in a process of their own."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import can

from dbc.codec import contract
from nav.types import Mode
from tests.socketcan.candump import Candump
from tests.socketcan.session import ANSWER_S, END_S, Operator, in_memory, navbridge, wait_for_bridge
from tests.socketcan.uml import CHANNEL

AFTERWARDS = 100
"""So many messages of the master are waited for once the slave navigates on its own: two seconds."""


def session(folder: Path) -> dict[str, object]:
    """Until the slave has been aligned and has navigated for some time; how the two processes ended."""
    with Candump(CHANNEL, folder / "bus.log"):
        bridge = navbridge(folder, "run", "run", "config.toml", "--out", "run.mcap")
        try:
            wait_for_bridge(bridge)
            # it is stopped, not awaited
            bench = navbridge(
                folder, "sim", "sim", "transfer", "--channel", CHANNEL, "--seconds", "600", "--seed", "1"
            )
            filters: list[can.typechecking.CanFilter] = [
                {"can_id": contract()[name].frame_id, "can_mask": 0x7FF}
                for name in ("SOL_TIME", "MASTER_TIME")
            ]
            with can.Bus(interface="socketcan", channel=CHANNEL, can_filters=filters) as bus:
                operator = Operator(bus)
                operator.wait("SOL_TIME", lambda said: said["MODE"] == Mode.NAVIGATE, 3.0 * ANSWER_S)
                for _ in range(AFTERWARDS):
                    operator.wait("MASTER_TIME", lambda _: True)
            bench.send_signal(signal.SIGINT)
            bench.wait(timeout=END_S)
            time.sleep(1.5)  # the last health report
        finally:
            bridge.send_signal(signal.SIGINT)
            bridge.wait(timeout=END_S)
    return {"sim_status": bench.returncode, "run_status": bridge.returncode}


if __name__ == "__main__":
    sys.exit(in_memory(Path(sys.argv[1]), session))
