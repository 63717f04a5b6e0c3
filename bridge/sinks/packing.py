"""The frames of a solution in one kernel: values to protected payloads.

Message by message its twin is `dbc.codec.MessageCodec.encode`: a value that this refuses leaves out
the frame. Standard deviations and limits are never refused: one that is unknown or too large is sent as the
largest that there is, one that is smaller than a step as a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.crc8 import CRC8
from dbc.codec import MessageCodec
from dbc.e2e import P01_ALIVE_MODULUS
from nav.jit import in_place
from nav.types import Vector

FRAME_BYTES: Final = 8
_MESSAGE, _START, _MASK, _LOWEST, _HIGHEST, _SATURATES = range(6)  # columns of the places
_FACTOR, _OFFSET, _MAXIMUM = range(3)  # columns of the scales


class Packer:
    """Encodes the same messages again and again.

    Raises ValueError for a message that is longer than a classic frame or not under Profile 1.
    """

    def __init__(self, codecs: Sequence[MessageCodec]) -> None:
        places, scales, heads = [], [], []
        for number, codec in enumerate(codecs):
            if codec.length > FRAME_BYTES or codec.alive_modulus != P01_ALIVE_MODULUS:
                raise ValueError(f"{codec.name}: expected a classic frame under Profile 1")
            heads.append((codec.data_id & 0xFF, codec.data_id >> 8, codec.length))
            for s in codec.info:
                lowest, highest = (round((end - s.offset) / s.factor) for end in (s.minimum, s.maximum))
                saturates = s.name.startswith(("SIGMA_", "LIMIT_"))
                places.append((number, s.start, (1 << s.bits) - 1, lowest, highest, saturates))
                scales.append((s.factor, s.offset, s.maximum))
        self._places = np.array(places, dtype=np.int64)
        self._scales = np.array(scales, dtype=np.float64)
        self._heads = np.array(heads, dtype=np.int64)
        self._wire = np.zeros(len(codecs) * FRAME_BYTES, dtype=np.uint8)
        self._ends = [FRAME_BYTES * number + codec.length for number, codec in enumerate(codecs)]
        self._words = np.zeros(len(codecs), dtype=np.int64)
        self.encode(0, np.zeros(len(places)))  # compiled here, before a bus is opened

    def encode(self, alive: int, values: Vector) -> list[bytes | None]:
        """A payload for each message, None where a value of it is not a number or out of range.

        ``values`` are those of all messages, one after the other, in the order of their signals.
        """
        bad = pack(values, self._scales, self._places, self._heads, alive, self._words, self._wire)
        wire = self._wire.tobytes()
        return [
            None if bad >> number & 1 else wire[FRAME_BYTES * number : end]
            for number, end in enumerate(self._ends)
        ]


@in_place
def pack(
    values: Vector,
    scales: Vector,
    places: NDArray[np.int64],
    heads: NDArray[np.int64],
    alive: int,
    words: NDArray[np.int64],
    wire: NDArray[np.uint8],
) -> int:
    """Write the payloads to ``wire``, 8 bytes each; returns a bit for each with a value it cannot hold.

    ``words`` (messages,) is scratch.
    """
    for message in range(heads.shape[0]):
        words[message] = alive << 8
    bad = 0
    for i in range(values.shape[0]):
        message = places[i, _MESSAGE]
        value = values[i]
        if places[i, _SATURATES]:
            # asked this way round, so that what is not a number ends up as the largest as well
            if not 0.0 <= value <= scales[i, _MAXIMUM]:
                value = scales[i, _MAXIMUM]
            elif 0.0 < value < scales[i, _FACTOR]:
                value = scales[i, _FACTOR]
        raw = np.rint((value - scales[i, _OFFSET]) / scales[i, _FACTOR])
        if places[i, _LOWEST] <= raw <= places[i, _HIGHEST]:  # not so where it is not a number
            words[message] |= (np.int64(raw) & places[i, _MASK]) << places[i, _START]
        else:
            bad |= 1 << message
    for message in range(heads.shape[0]):
        first, length = FRAME_BYTES * message, heads[message, 2]
        crc = CRC8[CRC8[heads[message, 0]] ^ heads[message, 1]]
        for i in range(1, length):
            byte = words[message] >> 8 * i & 0xFF
            wire[first + i] = byte
            crc = CRC8[crc ^ byte]
        wire[first] = crc
    return bad
