"""MAVLink over a serial line."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from collections import deque
from collections.abc import Sequence

from bridge.sources.carrier import READ_BYTES, RETRY_NS, Chunk


class Serial:
    """A serial line, raw; one that is pulled out is opened again when it is back."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        self._device = device
        self._baud = baud
        self._descriptor = -1
        self._retry_ns = 0
        self._news: deque[str] = deque(maxlen=16)

    def open(self) -> None:
        """Open and configure the line."""
        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise OSError(errno.EINVAL, f"a serial line cannot run at {self._baud} baud")
        descriptor = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _, _, control, _, _, _, special = termios.tcgetattr(descriptor)
            control = (control & ~(termios.CSIZE | termios.PARENB | termios.CSTOPB)) | termios.CS8
            control |= termios.CREAD | termios.CLOCAL
            # one byte at least: with none an empty line could not be told from one that was pulled out
            special[termios.VMIN], special[termios.VTIME] = 1, 0
            termios.tcsetattr(descriptor, termios.TCSANOW, [0, 0, control, 0, speed, speed, special])
        except termios.error as error:
            os.close(descriptor)
            raise OSError(errno.ENOTTY, f"{self._device} is not a serial line") from error
        self._descriptor = descriptor

    def descriptors(self) -> Sequence[int]:
        """The line."""
        return (self._descriptor,) if self._descriptor >= 0 else ()

    def receive(self, now_ns: int) -> list[Chunk]:
        """Bytes from the line."""
        if self._descriptor < 0:
            self._reopen(now_ns)
        if self._descriptor < 0:
            return []
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            self._lose(error.strerror or "error", now_ns)
            return []
        if not data:
            self._lose("hung up", now_ns)
            return []
        return [Chunk(0, self._device, data)]

    def send(self, data: bytes) -> bool:
        """Write what the line takes; the rest of a packet on a full line is lost."""
        if self._descriptor < 0:
            return False
        try:
            return os.write(self._descriptor, data) == len(data)
        except OSError:
            return False

    def heard(self, peer: str, now_ns: int) -> None:
        """Nothing: a line has two ends."""

    def news(self) -> list[str]:
        """The line lost and found."""
        told = list(self._news)
        self._news.clear()
        return told

    def close(self) -> None:
        """Close the line."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1

    def _lose(self, reason: str, now_ns: int) -> None:
        self.close()
        self._retry_ns = now_ns + RETRY_NS
        self._news.append(f"{self._device} lost: {reason}")

    def _reopen(self, now_ns: int) -> None:
        if now_ns < self._retry_ns:
            return
        self._retry_ns = now_ns + RETRY_NS
        with contextlib.suppress(OSError):
            self.open()
            self._news.append(f"{self._device} is there again")
