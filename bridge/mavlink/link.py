"""Packing: every packet that leaves on one link as one component shares one sequence counter."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as dialect

from bridge.outputs import Transmit


class Link:
    """Our component on one MAVLink source: packs messages as MAVLink 2, unsigned."""

    def __init__(self, source: int, system_id: int, component_id: int) -> None:
        self.source = source
        self.system_id = system_id
        self.component_id = component_id
        self._packer = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._parser = dialect.MAVLink(None)

    def send(self, message: Any) -> Transmit:
        """``message`` (an object of pymavlink's dialect) as the next packet of this component."""
        data = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        return Transmit(self.source, message.id, data)

    def decode(self, packet: bytes) -> Any:
        """The message in a whole packet.

        Raises ValueError when length or checksum is wrong.
        """
        try:
            return self._parser.decode(bytearray(packet))
        except (dialect.MAVError, IndexError) as error:
            raise ValueError(str(error)) from error
