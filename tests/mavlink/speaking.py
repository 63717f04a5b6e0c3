"""A slave and its master that speak MAVLink, in a process of their own.

``python -m tests.mavlink.speaking PORT SEED`` waits for the bridge on a UDP port of this host, sends the
flight of `flown` in real time, and ends.
"""

from __future__ import annotations

import select
import socket
import sys
import time
from typing import Any, Final

import numpy as np
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as dialect

from bridge.geoid import undulation
from nav import rotation as rot
from virtual_bus import ellipsoid
from virtual_bus.flights import Flown, fly
from virtual_bus.manoeuvres import Cruise, WingRock
from virtual_bus.master import MasterBlock
from virtual_bus.scenario import Scenario, load

SLAVE: Final = 2
MASTER: Final = 9
SECONDS: Final = 5.0
BOOT_NS: Final = 7_000_000_000
"""What the clock of both shows when the flight begins."""
_PATIENCE_S: Final = 120.0
_CALL_S: Final = 0.1


def scenario() -> Scenario:
    """The packaged flight, in which the wings are rocked at once."""
    rock = [Cruise(duration_s=0.5), WingRock(duration_s=2.0, angle_deg=30.0), Cruise(duration_s=60.0)]
    return replace(load("transfer"), manoeuvre=rock)


def flown(seed: int) -> Flown:
    """That flight of a seed."""
    return fly(scenario(), seed, SECONDS)


def turned(v: Any) -> list[float]:
    """East-north-up to north-east-down, and right-forward-up to front-right-down."""
    x, y, z = (float(part) for part in v)
    return [y, x, -z]


def attitude_and_place(said: MasterBlock, k: int, ms: int) -> tuple[Any, Any]:
    """ATTITUDE_QUATERNION and GLOBAL_POSITION_INT of message ``k``, ``ms`` after the start of its clock."""
    w, *v = rot.quat_from_dcm(said.C_ga[k]).tolist()
    lat, lon, height = float(said.lat[k]), float(said.lon[k]), float(said.height[k])
    where = [round(np.degrees(angle) * 1e7) for angle in (lat, lon)]
    velocity = [round(100.0 * x) for x in turned(said.v_g[k])]
    return (
        dialect.MAVLink_attitude_quaternion_message(ms, w, *turned(v), *turned(said.w_ia_a[k])),
        dialect.MAVLink_global_position_int_message(
            ms, *where, round(1e3 * (height - undulation(lat, lon))), 0, *velocity, 0
        ),
    )


class Local:
    """ODOMETRY in the frame of the first place, which GPS_GLOBAL_ORIGIN tells."""

    def __init__(self, said: MasterBlock) -> None:
        self._said = said
        self._C_eg = ellipsoid.axes_eg(said.lat, said.lon)
        self._r_e = ellipsoid.to_ecef(said.lat, said.lon, said.height)

    def origin(self) -> Any:
        """The message that tells it."""
        lat, lon, height = (float(x[0]) for x in (self._said.lat, self._said.lon, self._said.height))
        where = [round(np.degrees(angle) * 1e7) for angle in (lat, lon)]
        return dialect.MAVLink_gps_global_origin_message(*where, round(1e3 * (height - undulation(lat, lon))))

    def odometry(self, k: int, us: int) -> Any:
        """Message ``k``, velocity along the axes of the body, accuracy unknown."""
        said, C_lg = self._said, self._C_eg[0].T @ self._C_eg[k]
        w, *v = rot.quat_from_dcm(C_lg @ said.C_ga[k]).tolist()
        here = turned(self._C_eg[0].T @ (self._r_e[k] - self._r_e[0]))
        speed, rate = turned(said.C_ga[k].T @ said.v_g[k]), turned(said.w_ia_a[k])
        unknown = [float("nan")] * 21
        local, body = dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_FRD
        return dialect.MAVLink_odometry_message(
            us, local, body, *here, [w, *turned(v)], *speed, *rate, unknown, unknown, 0, 0, 0
        )


def packets(flight: Flown) -> list[tuple[int, bytes]]:
    """When each is sent, on the flight's clock, and the packet."""
    packers = {system: dialect.MAVLink(None, srcSystem=system, srcComponent=1) for system in (SLAVE, MASTER)}
    sent: list[tuple[int, bytes]] = []

    def send(t_ns: int, system: int, message: Any) -> None:
        packer = packers[system]
        sent.append((t_ns, bytes(message.pack(packer))))
        packer.seq = (packer.seq + 1) % 256

    t_ns = flight.t_ns
    for k, (start, end) in enumerate(zip(t_ns[:-1].tolist(), t_ns[1:].tolist(), strict=True)):
        # mean rate and force of an interval hold in its middle
        us, dt = (BOOT_NS + (start + end) // 2) // 1000, 1e-9 * (end - start)
        force, rate = turned(flight.dv[k] / dt), turned(flight.dtheta[k] / dt)
        nothing = [0.0] * 7  # magnetic field, pressures, temperature
        send(end, SLAVE, dialect.MAVLink_highres_imu_message(us, *force, *rate, *nothing, 0b111111))
    local = Local(flight.said)
    send(0, MASTER, local.origin())
    for k, t in enumerate(flight.master_ns.tolist()):
        ns = BOOT_NS + t
        for message in (*attitude_and_place(flight.said, k, ns // 1_000_000), local.odometry(k, ns // 1000)):
            # behind the samples of its time
            send(t + 4_000_000, MASTER, message)
    return sorted(sent, key=lambda one: one[0])


def main(port: int, seed: int) -> int:
    """Fly."""
    to = ("127.0.0.1", port)
    made = packets(flown(seed))
    packer = dialect.MAVLink(None, srcSystem=MASTER, srcComponent=1)
    call = bytes(dialect.MAVLink_heartbeat_message(1, 8, 0, 0, 4, 3).pack(packer))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        end = time.monotonic() + _PATIENCE_S
        while not select.select([sock], [], [], _CALL_S)[0]:
            if time.monotonic() > end:
                print("no bridge", file=sys.stderr)
                return 1
            sock.sendto(call, to)
        start_ns = time.monotonic_ns()
        for t_ns, packet in made:
            wait_ns = start_ns + t_ns - time.monotonic_ns()
            if wait_ns > 0:
                time.sleep(wait_ns * 1e-9)
            sock.sendto(packet, to)
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
