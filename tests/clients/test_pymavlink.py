"""pymavlink, the library under MAVProxy, talking to a running demo; what it did must replay equal."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as dialect

from bridge.commands import METHODS, CommandCode, Reason
from tests.clients.conftest import Demo

PATIENCE_S = 240.0  # a demo that compiles its kernels first, on a machine that does much else


@pytest.fixture
def station(demo: Demo) -> Iterator[Any]:
    connection = mavutil.mavlink_connection(
        f"udpin:127.0.0.1:{demo.port}", source_system=255, dialect="common"
    )
    yield connection
    connection.close()


def receive(station: Any, kind: str, wanted: Callable[[Any], bool] = lambda message: True) -> Any:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        message = station.recv_match(type=kind, blocking=True, timeout=1.0)
        if message is not None and wanted(message):
            return message
    raise AssertionError(f"no {kind} within {PATIENCE_S} s")


def command(station: Any, code: int, *params: float) -> int:
    return int(acknowledged(station, code, *params).result)


def acknowledged(station: Any, code: int, *params: float) -> Any:
    padded = (*params, *(0.0,) * 7)[:7]
    station.mav.command_long_send(1, 1, code, 0, *padded)
    return receive(station, "COMMAND_ACK", lambda ack: ack.command == code)


def aligned_by(station: Any, method: str) -> None:
    """Ask for an alignment, and wait till it says of itself how far it is and what it could reach."""
    start = dialect.MAV_CMD_USER_1, float(CommandCode.START_ALIGNMENT), float(METHODS[method])
    assert command(station, *start) == dialect.MAV_RESULT_ACCEPTED
    receive(station, "STATUSTEXT", lambda text: text.text.startswith(f"alignment {method}"))
    receive(
        station, "NAMED_VALUE_FLOAT", lambda value: value.name == "AlignPct" and 0.0 < value.value < 100.0
    )
    receive(
        station, "NAMED_VALUE_FLOAT", lambda value: value.name == "AlignLimH" and 0.0 < value.value < 10.0
    )


def test_a_live_run_that_was_commanded_replays_equal(demo: Demo, station: Any) -> None:
    heartbeat = receive(station, "HEARTBEAT")
    assert heartbeat.get_srcSystem() == 1
    assert heartbeat.type == dialect.MAV_TYPE_GROUND_ROVER
    active = receive(station, "HEARTBEAT", lambda m: m.system_status == dialect.MAV_STATE_ACTIVE)
    assert active.base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

    set_interval = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
    assert command(station, set_interval, dialect.MAVLINK_MSG_ID_ATTITUDE, 1e6) == dialect.MAV_RESULT_ACCEPTED
    station.mav.mission_request_list_send(1, 1)
    assert receive(station, "MISSION_COUNT").count == 0
    station.mav.timesync_send(0, 4711)
    assert receive(station, "TIMESYNC", lambda m: m.ts1 == 4711).tc1 > 0

    # the operator stops navigation: the mode changes, and so does what follows in the capture
    assert command(station, dialect.MAV_CMD_USER_1, 2.0) == dialect.MAV_RESULT_ACCEPTED
    receive(station, "HEARTBEAT", lambda m: m.system_status == dialect.MAV_STATE_STANDBY)

    # begins an alignment as it drives, picks another one, asks for one that cannot be, and gives it up
    aligned_by(station, "gnss")
    aligned_by(station, "odometer")
    refused = acknowledged(station, dialect.MAV_CMD_USER_1, 1.0, float(METHODS["stored"]))
    assert (refused.result, refused.result_param2) == (dialect.MAV_RESULT_DENIED, Reason.NO_HEADING)
    assert command(station, dialect.MAV_CMD_USER_1, 2.0) == dialect.MAV_RESULT_ACCEPTED
    receive(station, "HEARTBEAT", lambda m: m.system_status == dialect.MAV_STATE_STANDBY)

    digest = demo.stop().splitlines()[-1].removeprefix("solution sha256: ")
    replay = [sys.executable, "-m", "bridge.cli", "replay", str(demo.capture), "--golden", digest]
    done = subprocess.run(replay, capture_output=True, text=True, timeout=240.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == f"solution sha256: {digest}"
