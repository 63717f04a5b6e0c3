"""GNSS receivers on CAN: six frames of an epoch, to a fix."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_epochs import Epochs, Parts
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from nav.types import FixType, GnssFix

WEEK_NS: Final = 604_800 * 10**9
_MESSAGES: Final = ("GNSS_TIME", "GNSS_LAT", "GNSS_LON", "GNSS_HEIGHT", "GNSS_VEL", "GNSS_ACC")
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
    """Makes a fix of the six frames of one ALIVE."""

    def __init__(self, options: GnssCanOptions, context: Context) -> None:
        self._epochs = Epochs(_MESSAGES, options.id_offset, context)
        self.counters, self.keys = self._epochs.counters, self._epochs.keys
        self._name = context.name
        self._port = context.port(None, options.latency_ms)
        self._min_p = options.min_sigma_position_m
        self._min_v = options.min_sigma_velocity_m_s

    def feed(self, frame: RawFrame) -> Sequence[GnssFix]:
        """The fix that ``frame`` completes."""
        parts = self._epochs.take(frame)
        return () if parts is None else self._fix(parts)

    def _fix(self, parts: Parts) -> Sequence[GnssFix]:
        counters = self.counters
        (tow_us, week), (lat, sigma_n), (lon, sigma_e), height, velocity, accuracy = parts
        gps_ns = int(week) * WEEK_NS + int(tow_us) * 1000
        t_ns = self._port.stamp(gps_ns, self._epochs.rx_ns)
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
