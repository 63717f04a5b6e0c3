"""Ways to carry MAVLink bytes, chosen by URL.

URLs are those of pymavlink: ``udpin:HOST:PORT`` (or ``udp:``), ``udpout:HOST:PORT``, ``tcp:HOST:PORT``,
``tcpin:HOST:PORT``, ``serial:DEVICE[:BAUD]`` or a path such as ``/dev/ttyUSB0``.
"""

from __future__ import annotations

from collections.abc import Callable

from bridge.errors import ConfigError
from bridge.sources.carrier import Transport
from bridge.sources.net import Address, Tcp, Udp
from bridge.sources.serial_line import Serial


def make_transport(url: str, baud: int) -> Transport:
    """The transport of a URL; raises ConfigError for one that is not understood."""
    kind, _, rest = url.partition(":")
    if url.startswith("/"):
        return Serial(url, baud)
    if kind == "serial" and rest:
        device, _, rate = rest.rpartition(":")
        return Serial(device, int(rate)) if device and rate.isdigit() else Serial(rest, baud)
    host, _, port = rest.rpartition(":")
    makers: dict[str, Callable[[Address], Transport]] = {
        "udp": lambda address: Udp(address, listen=True),
        "udpin": lambda address: Udp(address, listen=True),
        "udpout": lambda address: Udp(address, listen=False),
        "tcp": lambda address: Tcp(address, listen=False),
        "tcpin": lambda address: Tcp(address, listen=True),
    }
    if kind not in makers or not port.isdigit() or int(port) > 65535:
        raise ConfigError(
            f'url: found "{url}", expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT '
            "or serial:DEVICE[:BAUD]"
        )
    return makers[kind]((host.strip("[]") or "0.0.0.0", int(port)))
