"""What an operator can ask of the bridge, whichever way it arrives: console, CAN or MAVLink."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class CommandCode(IntEnum):
    """Values are those of CODE in the CAN frame COMMAND."""

    START_ALIGNMENT = 1
    STOP = 2  # back to STANDBY
    RESTART = 3  # stop, forget what was estimated, align again


class Command(NamedTuple):
    """One request; ``argument`` is the code's own (0 where it takes none)."""

    code: CommandCode
    argument: int = 0
