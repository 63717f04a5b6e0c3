"""GNSS receivers on CAN: six frames of an epoch, to a fix."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from dbc.codec import MessageCodec
from nav.types import FixType, GnssFix

WEEK_NS: Final = 604_800 * 10**9
_MESSAGES: Final = ("GNSS_TIME", "GNSS_LAT", "GNSS_LON", "GNSS_HEIGHT", "GNSS_VEL", "GNSS_ACC")
_ALL: Final = (1 << len(_MESSAGES)) - 1
_RAD: Final = math.pi / 180.0


class GnssCanOptions(DeviceOptions):
    """``[device.NAME]`` with ``driver = "gnss_can"``.

    A standard deviation below the
    ``min_sigma_`` values is not believed: receivers that do not know theirs send 0.
    """

    min_sigma_position_m: Positive = 0.005
    min_sigma_velocity_m_s: Positive = 0.005
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


class GnssCan:
    """Collects frames of one ALIVE until all six are there."""

    def __init__(self, options: GnssCanOptions, context: Context) -> None:
        self.counters = Counters()
        self._name = context.name
        self._port = context.port(None, options.latency_ms)
        self._min_p = options.min_sigma_position_m
        self._min_v = options.min_sigma_velocity_m_s
        self._codecs: dict[int, tuple[int, MessageCodec]] = {}
        for place, name in enumerate(_MESSAGES):
            codec = context.message(name)
            self._codecs[codec.frame_id + options.id_offset] = (place, codec)
        self.keys = [(context.source, key) for key in self._codecs]
        self._alive = -1  # of the epoch being collected; -1: none
        self._done_alive = -1
        self._have = 0
        self._parts: list[tuple[float, ...]] = [()] * len(_MESSAGES)
        self._data: list[bytes] = [b""] * len(_MESSAGES)
        self._rx_ns = 0

    def feed(self, frame: RawFrame) -> Sequence[GnssFix]:
        """The fix that ``frame`` completes."""
        _, rx_ns, _, key, data = frame
        counters = self.counters
        counters.frames += 1
        place, codec = self._codecs[key]
        if not intact(codec, data, counters):
            return ()
        alive = codec.alive(data)
        if alive == self._done_alive or (alive == self._alive and self._have >> place & 1):
            return repeated(data, self._data[place], counters)
        if alive != self._alive:
            if self._have:
                counters.reject(Reject.INCOMPLETE)
            if self._done_alive >= 0 or self._alive >= 0:
                last = self._alive if self._alive >= 0 else self._done_alive
                counters.missing += (alive - last) % codec.alive_modulus - 1
            self._alive = alive
            self._done_alive = -1
            self._have = 0
        if place == 0:
            self._rx_ns = rx_ns
        values = codec.decode(data)
        self._data[place] = data
        self._parts[place] = values
        self._have |= 1 << place
        if self._have != _ALL:
            return ()
        self._have = 0
        self._done_alive = alive
        self._alive = -1
        for part, (_, each) in zip(self._parts, self._codecs.values(), strict=True):
            if not each.in_range(part):
                return counters.reject(Reject.RANGE)
        return self._fix()

    def _fix(self) -> Sequence[GnssFix]:
        counters = self.counters
        (tow_us, week), (lat, sigma_n), (lon, sigma_e), height, velocity, accuracy = self._parts
        gps_ns = int(week) * WEEK_NS + int(tow_us) * 1000
        t_ns = self._port.stamp(gps_ns, self._rx_ns)
        elapsed = self._port.elapsed_ns
        fix_type = FixType(int(height[2]))
        if fix_type < FixType.FIX_3D:
            return counters.reject(Reject.INVALID)
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        v_g = sigma_v = None
        if accuracy[3]:
            v_g = np.array(velocity, dtype=np.float64)
            sigma_v = np.array([max(sigma, self._min_v) for sigma in accuracy[:3]])
        counters.samples += 1
        counters.last_ns = t_ns
        return (
            GnssFix(
                t_ns,
                lat * _RAD,
                lon * _RAD,
                float(height[0]),
                np.array([max(sigma, self._min_p) for sigma in (sigma_e, sigma_n, height[1])]),
                v_g,
                sigma_v,
                fix_type,
                self._name,
                gps_ns,
                int(height[3]),
            ),
        )
