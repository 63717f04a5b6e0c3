"""A master navigator on CAN: the frames of an epoch, to what a slave is aligned from."""

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
from nav.rotation import quat_from_euler
from nav.types import MasterState

_MESSAGES: Final = (
    "MASTER_TIME",
    "MASTER_LAT",
    "MASTER_LON",
    "MASTER_HEIGHT",
    "MASTER_VEL_H",
    "MASTER_VEL_U",
    "MASTER_LEVEL",
    "MASTER_HEADING",
    "MASTER_RATE",
    "MASTER_FORCE",
)
_ALWAYS, _ATTITUDE, _RATES = 0b0000111111, 0b0011000000, 0b1100000000
_TIME_MODULUS_NS: Final = (1 << 48) * 1000
_RAD: Final = math.pi / 180.0


class MasterCanOptions(DeviceOptions):
    """``[device.NAME]`` with ``driver = "master_can"``.

    A master that is not sure of itself says so by its standard deviations; those below the ``min_sigma_``
    values are not believed.
    """

    min_sigma_position_m: Positive = 0.1
    min_sigma_velocity_m_s: Positive = 0.01
    min_sigma_attitude_deg: Positive = 0.001
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


def _belong(values: tuple[float, ...]) -> int:
    """Which messages an epoch has, by its MASTER_TIME."""
    _, attitude, rates, _ = values
    return _ALWAYS | (_ATTITUDE if attitude else 0) | (_RATES if rates else 0)


class MasterCan:
    """Makes a `MasterState` of the frames of one ALIVE."""

    def __init__(self, options: MasterCanOptions, context: Context) -> None:
        self._epochs = Epochs(_MESSAGES, options.id_offset, context, _belong)
        self.counters, self.keys = self._epochs.counters, self._epochs.keys
        self._name = context.name
        self._options = options
        self._port = context.port(_TIME_MODULUS_NS, options.latency_ms)

    def feed(self, frame: RawFrame) -> Sequence[MasterState]:
        """What ``frame`` completes."""
        parts = self._epochs.take(frame)
        return () if parts is None else self._state(parts)

    def _state(self, parts: Parts) -> Sequence[MasterState]:
        counters, options = self.counters, self._options
        (valid, _, _, time_us), *place, level_v, vertical, level, azimuth, rate, force = parts
        (lat, sigma_n), (lon, sigma_e), (height, sigma_u) = place
        t_ns = self._port.stamp(int(time_us) * 1000, self._epochs.rx_ns)
        elapsed = self._port.elapsed_ns
        if elapsed is not None and elapsed <= 0:
            return counters.reject(Reject.STALE)
        up, sigma_vh, sigma_vu = vertical
        q_ga = sigma_phi = None
        if azimuth:
            heading, tilt, turn = (x * _RAD for x in azimuth)
            roll, pitch = (x * _RAD for x in level)
            q_ga = quat_from_euler(heading, pitch, roll)
            sigma_phi = np.maximum(np.array([tilt, tilt, turn]), options.min_sigma_attitude_deg * _RAD)
        counters.samples += 1
        counters.last_ns = t_ns
        return (
            MasterState(
                t_ns=t_ns,
                lat=lat * _RAD,
                lon=lon * _RAD,
                height=float(height),
                v_g=np.array([*level_v, up]),
                q_ga=q_ga,
                w_ia_a=np.array(rate) * _RAD if rate else None,
                f_a=np.array(force) if force else None,
                sigma_position=np.maximum([sigma_e, sigma_n, sigma_u], options.min_sigma_position_m),
                sigma_velocity=np.maximum([sigma_vh, sigma_vh, sigma_vu], options.min_sigma_velocity_m_s),
                sigma_phi=sigma_phi,
                valid=bool(valid),
                device=self._name,
            ),
        )
