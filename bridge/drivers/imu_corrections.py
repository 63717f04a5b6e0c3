"""What some inertial units need besides the compensation of pulses: each is there or is None.

Latch times of dithered laser gyros come on CAN, and counts are corrected by them before they are compensated;
the size effect of accelerometers that sit apart is taken off afterwards. Where scales and biases go with
temperature, they are those at the one that the unit told last.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bridge.drivers.base import Context
from bridge.drivers.can_frames import intact, repeated
from bridge.drivers.counters import Counters
from bridge.outputs import Reject
from dbc.codec import MessageCodec
from nav.imu.pulses import Calibration
from nav.imu.size_effect import SizeEffect
from nav.imu.whole_cycle import METHODS, WholeCycle
from nav.types import Vector

_US: Final = 1e-6
_SAMPLE_MASK: Final = 0xF


def latches(method: str | None, id_offset: int, context: Context, counters: Counters) -> Latches | None:
    """The correction of counts by a method of `nav.imu.whole_cycle.METHODS`; None without one.

    Raises:
        ConfigError: there is no such method, or no IMU_LATCH in the contract in force.
    """
    if method is None:
        return None
    if method not in METHODS:
        raise context.unknown("whole_cycle", method, tuple(METHODS))
    codec = context.message("IMU_LATCH")
    return Latches(codec, codec.frame_id + id_offset, method, counters)


def size_effect(calibration: Calibration) -> SizeEffect | None:
    """What takes off the size effect of a unit; None where all its accelerometers sit in the origin."""
    if not calibration.accel_arms.any():
        return None
    effect = SizeEffect(calibration)
    # compiled here, before a bus is opened
    effect.take_off(np.zeros(3), np.zeros(3), 1.0)
    effect.restart()
    return effect


def warmth(calibration: Calibration, table: Vector) -> Warmth | None:
    """What keeps ``table``, its coefficients, at the unit's temperature; None where that does not matter."""
    return None if calibration.thermal is None else Warmth(calibration, table)


class Warmth:
    """Scales and biases in a `Calibration.table`: at the reference till the unit tells its temperature."""

    def __init__(self, calibration: Calibration, table: Vector) -> None:
        self._calibration = calibration
        self._table = table
        self._last = np.nan

    def told(self, temperature: float) -> None:
        """From here on the unit has ``temperature`` degC."""
        if temperature != self._last:
            self._last = temperature
            values = self._calibration.scales_and_biases(temperature)
            self._table[: len(values)] = values


class Latches:
    """Takes the ages of latches that come before each sample, and moves its counts to its end.

    ``codec`` and ``key`` are those of IMU_LATCH; ``method`` is one of `nav.imu.whole_cycle.METHODS`.
    """

    def __init__(self, codec: MessageCodec, key: int, method: str, counters: Counters) -> None:
        self.key = key
        self._codec = codec
        self._counters = counters
        self._oldest = next(signal.maximum for signal in codec.info if signal.name == "AGE_X")
        self._alive = -1
        self._data = b""
        self._sample = -1
        self._ages = np.empty(3)
        self._unknown = np.full(3, -1.0)
        self._cycles = WholeCycle(METHODS[method])
        # compiled here, before a bus is opened
        self._cycles.correct(self._unknown, 1.0, np.zeros(3))
        self._cycles.restart()

    def feed(self, data: bytes) -> tuple[()]:
        """Keep the ages of ``data`` for the sample that follows."""
        codec = self._codec
        if not intact(codec, data, self._counters):
            return ()
        alive = codec.alive(data)
        if alive == self._alive:
            return repeated(data, self._data, self._counters)
        self._alive, self._data = alive, data
        sample, *ages = codec.decode(data)
        self._sample = int(sample)
        for i, age in enumerate(ages):
            # a gyro whose dither stands still has no age
            self._ages[i] = age * _US if age < self._oldest else -1.0
        return ()

    def restart(self) -> None:
        """Forget: samples before the next one are missing."""
        self._cycles.restart()

    def correct(self, sample: int, tau: float, counts: Vector) -> None:
        """Turn ``counts`` (6,) of the sample with this running number, ``tau`` s long, into those at its end.

        Without the ages that belong to it, which is counted, the rate before is taken to go on.
        """
        ages = self._ages
        if self._sample != sample & _SAMPLE_MASK:
            self._counters.reject(Reject.INCOMPLETE)
            ages = self._unknown
        elif ages.min() < 0.0:
            self._counters.reject(Reject.RANGE)
        self._sample = -1
        self._cycles.correct(ages, tau, counts)
