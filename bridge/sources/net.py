"""MAVLink over UDP and TCP."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections import deque
from collections.abc import Sequence
from typing import Final

from bridge.sources.carrier import BURST, READ_BYTES, RETRY_NS, Chunk

_STAMP: Final = struct.Struct("@qq")
_ANCILLARY: Final = socket.CMSG_SPACE(_STAMP.size)
_SO_TIMESTAMPNS: Final = 35
_BUFFER_BYTES: Final = 1 << 20
_LISTENERS: Final = 8  # addresses that a listening link answers
_FORGET_NS: Final = 10_000_000_000
_BACKLOG_BYTES: Final = 65536

Address = tuple[str, int]


class Udp:
    """Datagrams: bound and answering those who sent something good of late, or towards one address.

    The socket is never connected: an unreachable peer is then not an error of ours.
    """

    datagrams = True

    def __init__(self, address: Address, listen: bool) -> None:
        self._address = address
        self._listen = listen
        self._socket: socket.socket | None = None
        self._peers: dict[Address, int] = {}

    def open(self) -> None:
        """Open the socket and look the address up."""
        family, _, _, _, place = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            if self._listen:
                sock.bind(place)
        except OSError:
            sock.close()
            raise
        self._address = (str(place[0]), int(place[1]))
        self._socket = sock

    def descriptors(self) -> Sequence[int]:
        """The socket."""
        return (self._socket.fileno(),) if self._socket is not None else ()

    def receive(self, now_ns: int) -> list[Chunk]:
        """Datagrams with the kernel's stamps."""
        chunks: list[Chunk] = []
        if self._socket is None:
            return chunks
        for _ in range(BURST):
            try:
                data, ancillary, _, source = self._socket.recvmsg(READ_BYTES, _ANCILLARY)
            except OSError:  # empty, or an error a peer caused
                break
            utc_ns = 0
            for _, kind, value in ancillary:
                if kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _STAMP.unpack_from(value)
                    utc_ns = seconds * 1_000_000_000 + nanoseconds
            address = (str(source[0]), int(source[1]))
            chunks.append(Chunk(utc_ns, f"{address[0]}:{address[1]}", data))
        return chunks

    def send(self, data: bytes) -> bool:
        """One datagram to every listener."""
        if self._socket is None:
            return False
        sent = False
        for address in list(self._peers) if self._listen else (self._address,):
            with contextlib.suppress(OSError):
                self._socket.sendto(data, address)
                sent = True
        return sent

    def heard(self, peer: str, now_ns: int) -> None:
        """A listening link sends to ``peer`` from now on."""
        if self._listen:
            host, _, port = peer.rpartition(":")
            self._remember((host, int(port)), now_ns)

    def news(self) -> list[str]:
        """Nothing: datagrams know no connection."""
        return []

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _remember(self, address: Address, now_ns: int) -> None:
        peers = self._peers
        if address not in peers:
            for old in [peer for peer, heard in peers.items() if now_ns - heard > _FORGET_NS]:
                del peers[old]
            if len(peers) >= _LISTENERS:
                del peers[min(peers, key=lambda peer: peers[peer])]
        peers[address] = now_ns


class Tcp:
    """One connection, made by us or accepted; a lost one is made or accepted again."""

    datagrams = False

    def __init__(self, address: Address, listen: bool) -> None:
        self._address = address
        self._listen = listen
        self._listener: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._connected = False
        self._retry_ns = -(1 << 62)
        self._backlog = bytearray()
        self._news: deque[str] = deque(maxlen=16)

    def open(self) -> None:
        """Bind a listening socket; a connection of our own is made while running."""
        if self._listen:
            self._listener = socket.create_server(self._address)
            self._listener.setblocking(False)
        else:
            socket.getaddrinfo(*self._address, type=socket.SOCK_STREAM)

    def descriptors(self) -> Sequence[int]:
        """The connection where there is one, otherwise the listening socket."""
        if self._socket is not None:
            return (self._socket.fileno(),) if self._connected else ()
        return (self._listener.fileno(),) if self._listener is not None else ()

    def receive(self, now_ns: int) -> list[Chunk]:
        """Bytes from the connection."""
        if self._socket is None:
            self._connect(now_ns)
        if self._socket is None or not (self._connected or self._finish()):
            return []
        self._push()
        return self._read()

    def send(self, data: bytes) -> bool:
        """Queue for the connection; packets that a full one cannot take are refused whole."""
        if not self._connected or len(self._backlog) + len(data) > _BACKLOG_BYTES:
            return False
        self._backlog += data
        self._push()
        return True

    def heard(self, peer: str, now_ns: int) -> None:
        """Nothing: a connection is with one peer."""

    def news(self) -> list[str]:
        """Connections made and lost."""
        told = list(self._news)
        self._news.clear()
        return told

    def close(self) -> None:
        """Close connection and listener."""
        for sock in (self._socket, self._listener):
            if sock is not None:
                sock.close()
        self._socket = self._listener = None
        self._connected = False

    def _name(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    def _connect(self, now_ns: int) -> None:
        if self._listener is not None:
            with contextlib.suppress(OSError):
                self._socket, address = self._listener.accept()
                self._socket.setblocking(False)
                self._begin(f"{address[0]}:{address[1]} connected")
            return
        if now_ns < self._retry_ns:
            return
        self._retry_ns = now_ns + RETRY_NS
        try:
            family, _, _, _, place = socket.getaddrinfo(*self._address, type=socket.SOCK_STREAM)[0]
            sock = socket.socket(family, socket.SOCK_STREAM)
        except OSError:
            return
        sock.setblocking(False)
        if sock.connect_ex(place) in (0, errno.EINPROGRESS):
            self._socket = sock
        else:
            sock.close()

    def _finish(self) -> bool:
        """Whether the connection under way is made by now."""
        assert self._socket is not None
        if self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._drop()
            return False
        try:
            self._socket.getpeername()
        except OSError:
            return False
        self._begin(f"{self._name()} connected")
        return True

    def _begin(self, news: str) -> None:
        assert self._socket is not None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connected = True
        self._backlog.clear()
        self._news.append(news)

    def _read(self) -> list[Chunk]:
        chunks: list[Chunk] = []
        while self._socket is not None and len(chunks) < BURST:
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                self._lose(error.strerror or "error")
                break
            if not data:
                self._lose("closed by the other side")
                break
            chunks.append(Chunk(0, self._name(), data))
        return chunks

    def _push(self) -> None:
        while self._backlog and self._socket is not None:
            try:
                count = self._socket.send(self._backlog)
            except BlockingIOError:
                return
            except OSError as error:
                self._lose(error.strerror or "error")
                return
            del self._backlog[:count]

    def _lose(self, reason: str) -> None:
        self._news.append(f"{self._name()} lost: {reason}")
        self._drop()

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._connected = False
