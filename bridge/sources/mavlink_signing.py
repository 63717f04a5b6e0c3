"""MAVLink 2 signatures of one link: what comes in is checked, what goes out is signed.

The MAVLink developer guide, "Message Signing": a signature is the first six bytes of a SHA-256 over the
key, the packet and a time stamp of 10 us since 2015, which may not go back within a stream. Nothing is
learned from a packet before its signature is known to be right: a forged one with a late stamp would
otherwise lock the true sender out.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable
from typing import Final

from bridge.sources.mavlink_framing import SIGNATURE, SIGNED, V2, seal

KEY_BYTES: Final = 32
_EPOCH_NS: Final = 1_420_070_400 * 1_000_000_000  # 2015-01-01 as Unix time
_UNIT_NS: Final = 10_000
_LATE: Final = 60 * 100_000  # how far a stream that is new may be behind, in units
_LARGEST: Final = (1 << 48) - 1

UNSIGNED: Final = "not signed"
WRONG: Final = "wrong signature"
OLD: Final = "signed before, or too long ago"


class Signing:
    """Signatures with one key (32 bytes); ``utc_ns`` tells the time, ``link`` is the number of our link."""

    def __init__(self, key: bytes, link: int, utc_ns: Callable[[], int]) -> None:
        self._key = key
        self._link = link & 0xFF
        self._utc_ns = utc_ns
        self._latest = 0  # of all stamps sent or found to be right
        self._streams: dict[tuple[int, int, int], int] = {}

    def fault(self, packet: bytes, system: int, component: int) -> str | None:
        """Why a whole packet of this sender is not to be trusted; None when it is."""
        if not is_signed(packet):
            return UNSIGNED
        if not hmac.compare_digest(self._hash(packet[:-6]), packet[-6:]):
            return WRONG
        stream = (packet[-SIGNATURE], system, component)
        stamp = int.from_bytes(packet[-12:-6], "little")
        last = self._streams.get(stream)
        if stamp < self._now() - _LATE if last is None else stamp <= last:
            return OLD
        self._streams[stream] = stamp
        self._latest = max(self._latest, stamp)
        return None

    def sign(self, packet: bytes) -> bytes:
        """A packet of ours with a signature; MAVLink 1 has no room for one and stays as it is."""
        if packet[:1] != V2 or is_signed(packet):
            return packet
        self._latest = min(max(self._latest + 1, self._now()), _LARGEST)
        whole = seal(packet[:2] + bytes((packet[2] | SIGNED,)) + packet[3:])
        whole += bytes((self._link,)) + self._latest.to_bytes(6, "little")
        return whole + self._hash(whole)

    def _hash(self, text: bytes) -> bytes:
        return hashlib.sha256(self._key + text).digest()[:6]

    def _now(self) -> int:
        return max(self._latest, (self._utc_ns() - _EPOCH_NS) // _UNIT_NS)


def is_signed(packet: bytes) -> bool:
    """Whether a whole packet has a signature, right or not."""
    return packet[:1] == V2 and bool(packet[2] & SIGNED)
