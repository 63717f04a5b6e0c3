"""Barometers on CAN: static pressure to pressure altitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

from msgspec import Meta

from bridge.drivers.base import Context
from bridge.drivers.can_frames import Intake
from bridge.frame import RawFrame
from bridge.options import DeviceOptions, Positive
from bridge.outputs import Reject
from nav.types import BaroSample

# ICAO Standard Atmosphere (Doc 7488), the two lowest layers
P0_PA: Final = 101325.0
_T0_K: Final = 288.15
_LAPSE_K_PER_M: Final = 0.0065
_R_J_PER_KG_K: Final = 287.05287
_G: Final = 9.80665
_TROPOPAUSE_M: Final = 11000.0
_T11_K: Final = _T0_K - _LAPSE_K_PER_M * _TROPOPAUSE_M
_EXPONENT: Final = _LAPSE_K_PER_M * _R_J_PER_KG_K / _G
_P11_PA: Final = P0_PA * (_T11_K / _T0_K) ** (1.0 / _EXPONENT)

LOWEST_PA: Final = 5475.0  # 20 km, the top of the layers below
HIGHEST_PA: Final = 130_000.0  # 2 km below sea level


def pressure_altitude(pressure_pa: float) -> float:
    """Geopotential altitude (m) at which the ICAO Standard Atmosphere has this pressure (Pa), to 20 km."""
    if pressure_pa >= _P11_PA:
        return _T0_K / _LAPSE_K_PER_M * (1.0 - math.pow(pressure_pa / P0_PA, _EXPONENT))
    return _TROPOPAUSE_M - _R_J_PER_KG_K * _T11_K / _G * math.log(pressure_pa / _P11_PA)


class BaroCanOptions(DeviceOptions):
    """``[device.NAME]`` with ``driver = "baro_can"``."""

    sigma_m: Positive = 1.0
    id_offset: Annotated[int, Meta(ge=0, le=0x5FF)] = 0


class BaroCan:
    """One frame, one sample."""

    def __init__(self, options: BaroCanOptions, context: Context) -> None:
        self._intake = Intake("BARO", options.id_offset, options.latency_ms, context)
        self.keys, self.counters = self._intake.keys, self._intake.counters
        self._name = context.name
        self._sigma = options.sigma_m

    def feed(self, frame: RawFrame) -> Sequence[BaroSample]:
        """The pressure altitude in ``frame``."""
        intake = self._intake
        taken = intake.take(frame)
        if taken is None:
            return ()
        t_ns, (valid, pressure, _, _) = taken
        if not valid:
            return self.counters.reject(Reject.INVALID)
        if not LOWEST_PA <= pressure <= HIGHEST_PA:
            return self.counters.reject(Reject.RANGE)
        if intake.stale:
            return self.counters.reject(Reject.STALE)
        intake.given(t_ns)
        return (BaroSample(t_ns, pressure_altitude(pressure), self._sigma, self._name),)
