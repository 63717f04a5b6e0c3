"""Reading and writing a SocketCAN socket directly.

python-can opens and configures the socket; its ``recv`` makes a float of the kernel's stamp and has no
room for the kernel's count of frames that did not fit in the buffer. Both are wanted here.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from typing import Final

from bridge.frame import CAN_EFF, CAN_ERR

_FRAME: Final = struct.Struct("=IBBxx")
_STAMP: Final = struct.Struct("@qq")
_DROPS: Final = struct.Struct("=I")
_FD_SIZE: Final = 72
_CLASSIC_SIZE: Final = 16
_ANCILLARY: Final = socket.CMSG_SPACE(_STAMP.size) + socket.CMSG_SPACE(_DROPS.size)
_SO_RCVBUFFORCE: Final = 33
_SO_RXQ_OVFL: Final = 40
_SO_TIMESTAMPNS: Final = 35
_MSG_CONFIRM: Final = getattr(socket, "MSG_CONFIRM", 0x800)  # set on frames that this socket sent
_BITRATE_SWITCH: Final = 0x01
_FD_FORMAT: Final = 0x04
_FD_LENGTHS: Final = (8, 12, 16, 20, 24, 32, 48, 64)
_BUFFER_BYTES: Final = 8 * 1024 * 1024  # the default holds some 280 frames

Stamped = tuple[int, int, bytes]


def enlarge(sock: socket.socket) -> int:
    """Give the socket a large receive buffer and have losses counted; bytes that the kernel granted."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except OSError:  # needs CAP_NET_ADMIN; without it the system's limit holds
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def receive(sock: socket.socket) -> tuple[int, int | None, bytes, int] | None:
    """One frame: (utc_ns, drops or None, data, key); None for one of our own.

    ``drops`` is the kernel's running count modulo 2**32. Raises BlockingIOError when nothing is there,
    OSError when the interface went away.
    """
    raw, ancillary, flags, _ = sock.recvmsg(_FD_SIZE, _ANCILLARY, socket.MSG_DONTWAIT)
    if flags & _MSG_CONFIRM or len(raw) < _FRAME.size:
        return None
    key, length, _ = _FRAME.unpack_from(raw)
    utc_ns, drops = 0, None
    for _, kind, value in ancillary:
        if kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = _STAMP.unpack_from(value)
            utc_ns = seconds * 1_000_000_000 + nanoseconds
        elif kind == _SO_RXQ_OVFL:
            (drops,) = _DROPS.unpack_from(value)
    if not key & (CAN_EFF | CAN_ERR):
        key &= 0x7FF | 0x4000_0000
    return utc_ns, drops, raw[8 : 8 + length], key


def pack(key: int, data: bytes) -> bytes:
    """A frame as SocketCAN takes it; more than 8 bytes make it CAN FD with bit-rate switch.

    Raises ValueError for data that no frame can hold.
    """
    if len(data) <= 8:
        return _FRAME.pack(key, len(data), 0) + data.ljust(_CLASSIC_SIZE - _FRAME.size, b"\0")
    if len(data) not in _FD_LENGTHS:
        raise ValueError(f"a CAN FD frame has 8, 12, 16, 20, 24, 32, 48 or 64 bytes, not {len(data)}")
    header = _FRAME.pack(key, len(data), _BITRATE_SWITCH | _FD_FORMAT)
    return header + data.ljust(_FD_SIZE - _FRAME.size, b"\0")
