"""Why a bus cannot be opened, and what to do about it."""

from __future__ import annotations

import errno
from typing import Final

_SOCKETCAN: Final = {
    errno.EAFNOSUPPORT: "this kernel has no SocketCAN; load it (modprobe can, modprobe vcan; in a container "
    'on its host), or use interface "udp_multicast", which needs none',
    errno.ENODEV: "there is no such interface; ip link lists them, and a virtual one is made by: "
    "ip link add dev {channel} type vcan && ip link set {channel} up",
    errno.ENETDOWN: "the interface is down: ip link set {channel} up",
}


def reason(error: Exception, interface: str, channel: object) -> str:
    """One line about ``error``, with what to do where that is known."""
    number = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    if interface == "socketcan" and number in _SOCKETCAN:
        return _SOCKETCAN[number].format(channel=channel)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split()) or type(error).__name__
