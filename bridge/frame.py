"""The one thing that crosses the recorder: a raw frame, numbered and stamped."""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

BRIDGE: Final = 0
"""Source number of the bridge itself: its frames are events, its keys are `Event` values."""

CAN_EFF: Final = 0x8000_0000
"""Key flag of an extended (29-bit) CAN identifier, as in SocketCAN's can_id."""
CAN_RTR: Final = 0x4000_0000
"""Key flag of a remote frame."""
CAN_ERR: Final = 0x2000_0000
"""Key flag of an error frame."""


class RawFrame(NamedTuple):
    """One frame as the border received it.

    ``seq`` orders frames, counted from 0 over all sources. ``rx_ns`` is monotonic host time.
    ``source`` is a place in the capture's table of sources (0: the bridge). ``key`` is the CAN
    identifier with its flags, the MAVLink message number, or an `Event`. ``data`` is the CAN
    payload, the whole MAVLink packet, or the event's body.
    """

    seq: int
    rx_ns: int
    source: int
    key: int
    data: bytes


class Event(IntEnum):
    """Keys of source 0. The body of every event but TICK is a JSON object, named fields below."""

    TICK = 0  # nothing arrived for a while; empty body
    START = 1  # utc_ns, monotonic_ns of one instant
    STOP = 2  # reason
    DROPPED = 3  # source, frames: the kernel or the driver lost this many
    BUS_STATE = 4  # source, state, text
    PEER = 5  # source, text: a MAVLink peer appeared or went
    REFUSED = 6  # source, reason, packets (or bytes, of what was none): turned away since the last of these
    COMMAND = 7  # command, method (an alignment, optional): what an operator asked for at the console
    CLOCK_STEP = 8  # step_ns: the wall clock jumped against the monotonic one
    UNRECORDED = 9  # frames: lost to the recorder just before this frame
