"""Finding whole MAVLink packets in a stream of bytes, noise or not.

A candidate that fails its length, flags or checksum costs one byte and not its whole length: a byte of
noise that looks like the beginning of a packet must not swallow the good ones behind it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

_V1: Final = 0xFE
_V2: Final = 0xFD
V2: Final = b"\xfd"
"""First byte of a MAVLink 2 packet."""
SIGNED: Final = 0x01
"""Flag of a packet with a signature, in its third byte."""
SIGNATURE: Final = 13
"""Bytes behind the checksum: link, stamp and signature."""
_EXTRA: Final[dict[int, int]] = {number: kind.crc_extra for number, kind in dialect.mavlink_map.items()}


class Packet(NamedTuple):
    """A packet with a good checksum; ``data`` is all of it, signature included."""

    message: int
    system: int
    component: int
    data: bytes


class Framer:
    """Splits bytes into packets.

    ``noise`` counts bytes that belong to no packet. The checksum of a message that the dialect does not
    have cannot be told from noise: in datagrams, where packets are whole, it is stepped over and counted
    in ``unknown``; in a stream its bytes count as noise.
    """

    def __init__(self, datagrams: bool = False) -> None:
        self._datagrams = datagrams
        self.noise = 0
        self.unknown = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Packets completed by ``data``; an incomplete one is kept for the next call."""
        buffer = self._buffer
        buffer += data
        packets: list[Packet] = []
        at, end = 0, len(buffer)
        while at < end:
            start = buffer[at]
            if start != _V1 and start != _V2:
                at += 1
                self.noise += 1
                continue
            length = _length(buffer, at)
            if length is None:
                break
            if length and at + length > end:
                break
            packet = _check(buffer, at, length) if length else None
            if packet is not None:
                packets.append(packet)
                at += length
            elif length and self._datagrams and self._skip_unknown(buffer, at, length):
                at += length
            else:
                at += 1
                self.noise += 1
        del buffer[:at]
        return packets

    def flush(self) -> list[Packet]:
        """The end of a datagram: nothing more of it comes; an incomplete packet in it was noise."""
        packets: list[Packet] = []
        while self._buffer:
            rest = bytes(self._buffer[1:])
            self._buffer.clear()
            self.noise += 1
            packets += self.feed(rest)
        return packets

    def _skip_unknown(self, buffer: bytearray, at: int, length: int) -> bool:
        """A packet of an unknown message is stepped over whole if another one, or nothing, follows it."""
        after = at + length
        if _message(buffer, at) in _EXTRA:
            return False
        if after < len(buffer) and buffer[after] not in (_V1, _V2):
            return False
        self.unknown += 1
        return True


def seal(packet: bytes) -> bytes:
    """A packet with the checksum that its other bytes ask for; its message is one of the dialect's."""
    body = packet[:-2]
    extra = _EXTRA[_message(bytearray(packet), 0)]
    return body + int(dialect.x25crc(body[1:] + bytes((extra,))).crc).to_bytes(2, "little")


def _message(buffer: bytearray, at: int) -> int:
    if buffer[at] == _V1:
        return buffer[at + 5]
    return int.from_bytes(buffer[at + 7 : at + 10], "little")


def _length(buffer: bytearray, at: int) -> int | None:
    """Length of the packet that begins here, None where more bytes are needed, 0 where none begins."""
    if len(buffer) - at < 3:
        return None
    if buffer[at] == _V1:
        return buffer[at + 1] + 8
    if buffer[at + 2] & ~SIGNED:
        return 0  # flags that say the packet cannot be understood
    return buffer[at + 1] + 12 + (SIGNATURE if buffer[at + 2] & SIGNED else 0)


def _check(buffer: bytearray, at: int, length: int) -> Packet | None:
    message = _message(buffer, at)
    extra = _EXTRA.get(message)
    if extra is None:
        return None
    data = bytes(buffer[at : at + length])
    checked = length - (SIGNATURE if data[0] == _V2 and data[2] & SIGNED else 0)
    crc = dialect.x25crc(data[1 : checked - 2] + bytes((extra,))).crc
    if data[checked - 2] | data[checked - 1] << 8 != crc:
        return None
    if data[0] == _V1:
        return Packet(message, data[3], data[4], data)
    return Packet(message, data[5], data[6], data)
