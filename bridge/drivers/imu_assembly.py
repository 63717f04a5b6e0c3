"""The usual inertial sample in one kernel: its three payloads checked, decoded and compensated.

The frame-by-frame path of `bridge.drivers.imu_can` is the readable twin, and takes every sample that is
not usual: the kernel says so and leaves counting what is wrong to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.crc8 import CRC8
from dbc.codec import MessageCodec
from dbc.e2e import P01_ALIVE_MODULUS
from nav.imu.pulses import compensate
from nav.jit import in_place
from nav.types import Vector

FRAME_BYTES: Final = 8
IRREGULAR: Final = -1
"""In the place of the alive counter: the sample is for the frame-by-frame path."""

_SIGNALS: Final = (
    ("SAT_X", "SAT_Y", "SAT_Z", "GYRO_X", "GYRO_Y", "GYRO_Z"),
    ("SAT_X", "SAT_Y", "SAT_Z", "ACCEL_X", "ACCEL_Y", "ACCEL_Z"),
    ("STATUS", "SAMPLE", "TIME"),
)
_START, _MASK, _SIGN = range(3)  # columns of a layout
_TIME_MASK: Final = 2**32 - 1


def layout(codecs: Sequence[MessageCodec]) -> NDArray[np.int64] | None:
    """What `assemble` must know of the messages with gyros, accelerometers and time.

    Rows 0 to 14 are the signals (start bit, mask, bit of the sign or 0), rows 15 to 17 the messages (both
    bytes of the data id). None where these messages are not what the kernel is made for: eight bytes under
    Profile 1, integer signals without factor or offset.
    """
    rows = []
    for codec, names in zip(codecs, _SIGNALS, strict=True):
        if codec.length != FRAME_BYTES or codec.alive_modulus != P01_ALIVE_MODULUS:
            return None
        for signal in (codec.info[codec.signals.index(name)] for name in names):
            if (signal.factor, signal.offset) != (1, 0) or signal.bits > 32:
                return None
            rows.append((signal.start, (1 << signal.bits) - 1, signal.signed << signal.bits - 1))
    rows += [(codec.data_id & 0xFF, codec.data_id >> 8, 0) for codec in codecs]
    return np.array(rows, dtype=np.int64)


@in_place
def _word(wire: NDArray[np.uint8], first: int) -> int:
    word = 0
    for i in range(FRAME_BYTES):
        word |= wire[first + i] << 8 * i
    return word


@in_place
def _signal(places: NDArray[np.int64], row: int, word: int) -> int:
    raw = word >> places[row, _START] & places[row, _MASK]
    sign = places[row, _SIGN]
    return int((raw ^ sign) - sign)


@in_place
def assemble(
    wire: NDArray[np.uint8],
    places: NDArray[np.int64],
    table: Vector,
    before_us: int,
    counts: Vector,
    dtheta: Vector,
    dv: Vector,
) -> tuple[int, int, int, int, int, float]:
    """Alive counter, whether saturated, STATUS, SAMPLE and TIME (us) of one sample, and its interval (s).

    ``wire`` (24,) is the three payloads; ``places`` from `layout`, ``table`` from `Calibration.table`.
    ``before_us`` is the TIME of the sample before: over the interval since then the pulses, which go to
    ``counts`` (6,), are compensated to ``dtheta`` (3,) rad and ``dv`` (3,) m/s.

    The alive counter is `IRREGULAR`, and nothing is written, where a CRC is wrong or the three are not equal.
    """
    for message in range(3):
        first = FRAME_BYTES * message
        crc = CRC8[CRC8[places[15 + message, 0]] ^ places[15 + message, 1]]
        for i in range(1, FRAME_BYTES):
            crc = CRC8[crc ^ wire[first + i]]
        if crc != wire[first]:
            return IRREGULAR, 0, 0, 0, 0, 0.0
    gyro, accel, time = _word(wire, 0), _word(wire, FRAME_BYTES), _word(wire, 2 * FRAME_BYTES)
    alive = gyro >> 8 & 0xF
    if alive >= P01_ALIVE_MODULUS or accel >> 8 & 0xF != alive or time >> 8 & 0xF != alive:
        return IRREGULAR, 0, 0, 0, 0, 0.0
    saturated = 0
    for k in range(3):
        saturated |= _signal(places, k, gyro) | _signal(places, 6 + k, accel)
        counts[k] = _signal(places, 3 + k, gyro)
        counts[3 + k] = _signal(places, 9 + k, accel)
    status, sample, time_us = _signal(places, 12, time), _signal(places, 13, time), _signal(places, 14, time)
    tau = float((time_us - before_us & _TIME_MASK) * 1000) * 1e-9
    compensate(table, counts, tau, dtheta, dv)
    return alive, saturated, status, sample, time_us, tau
