"""MAVSDK, as a user's program would use it, connected over UDP to a running demo."""

from __future__ import annotations

import asyncio
import math
import socket
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from importlib.resources import files
from typing import Any, TypeVar

import pytest

from bridge.geoid import undulation
from tests.clients.conftest import Demo

T = TypeVar("T")

PATIENCE_S = 240.0  # a demo that compiles its kernels first, on a machine that does much else


async def first(stream: AsyncIterator[T], wanted: Any = lambda item: True) -> T:
    """The first item of a telemetry stream that is ``wanted``."""

    async def search() -> T:
        async for item in stream:
            if wanted(item):
                return item
        raise AssertionError("the stream ended")

    return await asyncio.wait_for(search(), PATIENCE_S)


def free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def server(demo: Demo) -> Iterator[int]:
    """MAVSDK's own server process, connected to the demo; yields the port for its clients."""
    port = free_tcp_port()
    program = str(files("mavsdk.bin") / "mavsdk_server")
    process = subprocess.Popen(
        [program, "-p", str(port), f"udpin://127.0.0.1:{demo.port}"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield port
    finally:
        process.kill()
        process.wait()


async def fly(demo: Demo) -> None:
    from mavsdk import System
    from mavsdk.telemetry import FixType

    with server(demo) as port:
        system = System(mavsdk_server_address="localhost", port=port)
        await asyncio.wait_for(system.connect(), PATIENCE_S)
        await first(system.core.connection_state(), lambda state: state.is_connected)

        attitude = await first(system.telemetry.attitude_euler())
        assert abs(attitude.roll_deg) < 10.0
        assert abs(attitude.pitch_deg) < 10.0

        position = await first(system.telemetry.position())
        # everything happens within a hundred metres of the start
        assert math.isclose(position.latitude_deg, 48.137, abs_tol=0.003)
        assert math.isclose(position.longitude_deg, 11.575, abs_tol=0.005)
        geoid = undulation(math.radians(48.137), math.radians(11.575))
        assert math.isclose(position.absolute_altitude_m, 520.0 - geoid, abs_tol=10.0)
        assert abs(position.relative_altitude_m) < 10.0

        gps = await first(system.telemetry.gps_info())
        assert gps.num_satellites == 14
        assert gps.fix_type == FixType.FIX_3D

        driving = await first(
            system.telemetry.odometry(), lambda odometry: odometry.velocity_body.x_m_s > 8.0
        )
        assert abs(driving.velocity_body.y_m_s) < 1.0  # a car does not slide
        home = await first(system.telemetry.home())
        assert math.isclose(home.latitude_deg, 48.137, abs_tol=0.0005)

        version = await asyncio.wait_for(system.info.get_version(), PATIENCE_S)
        assert (version.flight_sw_major, version.flight_sw_minor) == (0, 1)
        parameters = await asyncio.wait_for(system.param.get_all_params(), PATIENCE_S)
        values = {parameter.name: parameter.value for parameter in parameters.float_params}
        assert values["DEV_IMU_RATE_HZ"] == 200.0


# the package announces its renaming, and its libraries their own plans
@pytest.mark.filterwarnings("ignore")
def test_mavsdk_reads_heartbeat_attitude_and_position(demo: Demo) -> None:
    asyncio.run(fly(demo))
