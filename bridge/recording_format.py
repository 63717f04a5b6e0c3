"""What a capture looks like on disk: topic names and the packing of frames.

A capture is an MCAP file. Frames travel in batches: one message on ``/navbridge/frames`` holds up to
64 KiB or 50 ms of frames, each a little-endian header (sequence number uint64, monotonic
nanoseconds int64, source uint16, key uint32, length uint16) and its bytes.
"""

from __future__ import annotations

import struct
from typing import Final

from bridge.errors import CaptureError
from bridge.frame import RawFrame

PROFILE: Final = "navbridge"
FORMAT_VERSION: Final = "1"
FRAMES: Final = "/navbridge/frames"
DIGEST: Final = "/navbridge/digest"
HEALTH: Final = "/navbridge/health"
LATENCY: Final = "/navbridge/latency"
TRUTH: Final = "/truth"
META: Final = "navbridge"
RESULT: Final = "navbridge.result"
FRAME_ENCODING: Final = "navbridge-frames"

BATCH_BYTES: Final = 64 * 1024
BATCH_NS: Final = 50_000_000

HEADER: Final = struct.Struct("<QqHIH")
_HEADER_SIZE: Final = HEADER.size


def pack_frames(frames: list[RawFrame]) -> bytes:
    """Pack frames in order, as `unpack_frames` reads them."""
    pack = HEADER.pack
    return b"".join(
        [pack(seq, rx_ns, source, key, len(data)) + data for seq, rx_ns, source, key, data in frames]
    )


def unpack_frames(batch: bytes) -> list[RawFrame]:
    """Frames of one batch, in order.

    Raises CaptureError when a length points past the end of the batch.
    """
    frames: list[RawFrame] = []
    append, unpack, make = frames.append, HEADER.unpack_from, tuple.__new__
    at, end = 0, len(batch)
    try:
        while at < end:
            seq, rx_ns, source, key, length = unpack(batch, at)
            at += _HEADER_SIZE
            stop = at + length
            append(make(RawFrame, (seq, rx_ns, source, key, batch[at:stop])))
            at = stop
    except struct.error as error:
        raise CaptureError(f"a batch of frames ends in the middle of a header: {error}") from error
    if at != end:
        raise CaptureError("a batch of frames ends in the middle of a frame")
    return frames
