"""End-to-end protection of frames, over the library ``autosar-e2e``.

The profiles are those of AUTOSAR Foundation, "E2E Protocol Specification" (document 849,
PRS_E2EProtocol): Profile 1 with both bytes of the data id in every CRC (``E2E_P01_DATAID_BOTH``,
CRC-8 SAE J1850) for classic CAN, Profile 5 (CRC-16 CCITT-FALSE) for CAN FD. The polynomials and
their check values are in AUTOSAR Classic Platform, "Specification of CRC Routines" (document 016,
SWS_CRCLibrary).

The frame holds the whole header: Profile 1 has its CRC in byte 0 and the alive counter in the low
nibble of byte 1; Profile 5 has its CRC in bytes 0 and 1, low byte first, and the counter in byte 2.
"""

from __future__ import annotations

from typing import Final

from e2e.p01 import e2e_p01_check, e2e_p01_protect
from e2e.p05 import e2e_p05_check, e2e_p05_protect

P01_ALIVE_MODULUS: Final = 15
"""Profile 1 counts 0 to 14; 15 marks an invalid counter."""
P05_ALIVE_MODULUS: Final = 256
"""Profile 5 counts 0 to 255."""


def protect_p01(data: bytearray, data_id: int) -> None:
    """Write the Profile 1 CRC over ``data`` (2 or more bytes, alive counter in place) into byte 0."""
    e2e_p01_protect(data, data_id, increment_counter=False)


def check_p01(data: bytes, data_id: int) -> bool:
    """Whether byte 0 is the Profile 1 CRC of ``data`` (2 or more bytes) and ``data_id``.

    A frame with the invalid counter 15 fails too.
    """
    return e2e_p01_check(bytearray(data), data_id)  # the library wants a writable buffer


def protect_p05(data: bytearray, data_id: int) -> None:
    """Write the Profile 5 CRC over ``data`` (3 or more bytes, alive counter in place) into bytes 0, 1."""
    e2e_p05_protect(data, data_id, increment_counter=False)


def check_p05(data: bytes, data_id: int) -> bool:
    """Whether bytes 0 and 1 are the Profile 5 CRC of ``data`` (3 or more bytes) and ``data_id``."""
    return e2e_p05_check(data, data_id)
