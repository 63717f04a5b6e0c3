"""Contexts and frames for driver tests."""

from __future__ import annotations

import math

from bridge.drivers.base import Context
from bridge.drivers.device_clock import DeviceClock
from bridge.frame import RawFrame
from dbc.codec import Contract, contract

CALIBRATION = b"""
[device]
serial = 77
[gyro]
scale_arcsec_per_pulse = [1.0, 1.0, 1.0]
[accel]
scale_m_s_per_pulse = [1e-4, 1e-4, 1e-4]
"""
ARCSEC = math.radians(1.0 / 3600.0)


def context(
    name: str = "dev",
    files: dict[str, bytes] | None = None,
    clock: DeviceClock | None = None,
    messages: Contract | None = None,
) -> Context:
    files = files or {"cal.toml": CALIBRATION}
    return Context(name, 1, "test.toml", files, clock or DeviceClock(), messages or contract())


def can(message: str, alive: int, *values: float, rx_ns: int = 0, offset: int = 0) -> RawFrame:
    codec = contract()[message]
    return RawFrame(0, rx_ns, 1, codec.frame_id + offset, codec.encode(alive, *values))


def with_data(frame: RawFrame, data: bytes) -> RawFrame:
    return frame._replace(data=data)


def flipped(frame: RawFrame) -> RawFrame:
    """The frame with one bit of its last byte wrong."""
    return frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))


def rejects(driver: object) -> dict[str, int]:
    health = driver.counters.health(0)  # type: ignore[attr-defined]
    return {reason.name: count for reason, count in health.rejects.items()}
