"""What a CAN error frame says about the state of the bus (Linux, linux/can/error.h)."""

from __future__ import annotations

from typing import Final

_CLASSES: Final = (
    (0x001, "transmit timeout"),
    (0x002, "lost arbitration"),
    (0x004, "controller"),
    (0x008, "protocol violation"),
    (0x010, "transceiver"),
    (0x020, "no acknowledgement"),
    (0x040, "bus off"),
    (0x080, "bus error"),
    (0x100, "restarted"),
)
_RX_OVERFLOW: Final = 0x01
_CONTROLLER: Final = (
    (0x30, "error_passive"),
    (0x0C, "error_warning"),
    (0x40, "error_active"),
)


def describe(error_class: int, data: bytes) -> tuple[str | None, str]:
    """New state of the controller, or None where the frame says nothing of it; and the error in words.

    ``error_class`` is the identifier of the error frame without its flags.
    """
    words = ", ".join(text for bit, text in _CLASSES if error_class & bit) or "unspecified"
    if error_class & 0x040:
        return "bus_off", words
    if error_class & 0x100:
        return "error_active", words
    if error_class & 0x004 and len(data) > 1:
        if data[1] & _RX_OVERFLOW:
            words += ", receive overflow"
        for bits, state in _CONTROLLER:
            if data[1] & bits:
                return state, words
    return None, words
