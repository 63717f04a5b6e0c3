"""What every MAVLink driver does with a packet before it believes what is in it."""

from __future__ import annotations

import struct
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.counters import Counters
from bridge.frame import RawFrame
from bridge.outputs import Reject


class Packets:
    """Decodes the packets of one sender; ``system_id`` and ``component_id`` 0: of any."""

    def __init__(self, system_id: int, component_id: int, counters: Counters) -> None:
        self._parser = dialect.MAVLink(None)
        self._system, self._component = system_id, component_id
        self._counters = counters

    def message(self, frame: RawFrame) -> Any:
        """The message in a packet; None: turned away, and counted."""
        counters = self._counters
        counters.frames += 1
        try:
            message = self._parser.decode(bytearray(frame.data))
        except (dialect.MAVError, IndexError, TypeError, ValueError, struct.error):
            # pymavlink's one exception does not say which it was
            counters.reject(Reject.CRC if len(frame.data) >= 8 else Reject.LENGTH)
            return None
        if (self._system and message.get_srcSystem() != self._system) or (
            self._component and message.get_srcComponent() != self._component
        ):
            counters.reject(Reject.UNKNOWN)
            return None
        return message
