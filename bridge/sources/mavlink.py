"""A MAVLink link: whole packets with a good checksum become frames; what else arrives is counted."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from typing import Final

from bridge.errors import SourceError
from bridge.frame import Event
from bridge.options import MavlinkSource
from bridge.outputs import Transmit
from bridge.sources.base import Notice, Received, SourceContext
from bridge.sources.carrier import BURST, Chunk
from bridge.sources.mavlink_framing import Framer, Packet
from bridge.sources.transports import make_transport

_SILENT_NS: Final = 10_000_000_000
_PEERS: Final = 64
_FRAMERS: Final = 8
_CHECK_NS: Final = 1_000_000_000


class MavlinkLink:
    """One link, MAVLink 1 and 2. The key of a frame is the message number, its data the whole packet.

    Packets that carry our own system and component are dropped: a router sent them back.

    Raises ConfigError, which names the key, for a URL that is not understood.
    """

    def __init__(self, options: MavlinkSource, context: SourceContext) -> None:
        self.context = context
        self._options = options
        self._us = (options.system_id, options.component_id)
        self._transport = make_transport(options.url, options.baud)
        self._framers: dict[str, Framer] = {}
        self._retired: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()
        self._peers: dict[tuple[int, int], tuple[int, str]] = {}
        self._notices: list[Notice] = []
        self._emptied_ns = 0  # when nothing was left to read: what comes later is not older
        self._check_ns = 0

    def open(self) -> None:
        """Open the link; raises SourceError with the reason."""
        try:
            self._transport.open()
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SourceError(
                f"source {self.context.name}: cannot open {self._options.url}: {reason}"
            ) from error
        self._emptied_ns = self.context.clock.monotonic_ns()

    def descriptors(self) -> Sequence[int]:
        """File descriptors of the link."""
        return self._transport.descriptors()

    def poll(self, deadline_ns: int) -> list[Received]:
        """Packets that have arrived; see `bridge.sources.base.Source`."""
        now_ns = self.context.clock.monotonic_ns()
        frames: list[Received] = []
        accept = self.context.accept
        chunks = self._transport.receive(now_ns)
        for chunk in chunks:
            rx_ns = self.context.wall.to_monotonic(chunk.utc_ns, self._emptied_ns - 1_000_000, now_ns)
            for packet in self._split(chunk):
                sender = (packet.system, packet.component)
                if sender == self._us:
                    self._counts["own"] += 1
                    continue
                self._meet(sender, chunk.peer, now_ns)
                if accept is None or packet.message in accept:
                    frames.append((rx_ns, packet.message, packet.data))
                else:
                    self._counts["ignored"] += 1
        for news in self._transport.news():
            self._tell(now_ns, news)
        if now_ns >= self._check_ns:
            self._check_ns = now_ns + _CHECK_NS
            self._miss(now_ns)
        self._counts["frames"] += len(frames)
        if len(chunks) < BURST:
            self._emptied_ns = now_ns
        return frames

    def notices(self) -> list[Notice]:
        """Peers and connections that came and went."""
        told, self._notices = self._notices, []
        return told

    def send(self, transmit: Transmit) -> bool:
        """Send one packet; False when nobody is there to take it."""
        sent = False
        with contextlib.suppress(OSError):
            sent = self._transport.send(transmit.data)
        self._counts["sent" if sent else "unsent"] += 1
        return sent

    def counters(self) -> dict[str, int]:
        """Totals: frames, sent, unsent, own, ignored, noise (bytes), unknown."""
        noise = sum(framer.noise for framer in self._framers.values()) + self._retired["noise"]
        unknown = sum(framer.unknown for framer in self._framers.values()) + self._retired["unknown"]
        return {**self._counts, "noise": noise, "unknown": unknown}

    def filters(self) -> str:
        """Message numbers let through, or "all"."""
        accept = self.context.accept
        return "all" if accept is None else str(sorted(accept))

    def close(self) -> None:
        """Close the link."""
        self._transport.close()

    def _split(self, chunk: Chunk) -> list[Packet]:
        # bytes of two senders must not be joined, and neither must two datagrams
        name = "" if self._transport.datagrams else chunk.peer
        framer = self._framers.get(name)
        if framer is None:
            if len(self._framers) >= _FRAMERS:
                old = self._framers.pop(next(iter(self._framers)))
                self._retired.update(noise=old.noise, unknown=old.unknown)
            framer = self._framers[name] = Framer(self._transport.datagrams)
        packets = framer.feed(chunk.data)
        return packets + framer.flush() if self._transport.datagrams else packets

    def _meet(self, sender: tuple[int, int], place: str, now_ns: int) -> None:
        if sender not in self._peers:
            if len(self._peers) >= _PEERS:
                return
            self._tell(now_ns, f"system {sender[0]} component {sender[1]} at {place} appeared")
        self._peers[sender] = (now_ns, place)

    def _miss(self, now_ns: int) -> None:
        for sender, (heard_ns, place) in list(self._peers.items()):
            if now_ns - heard_ns > _SILENT_NS:
                del self._peers[sender]
                self._tell(now_ns, f"system {sender[0]} component {sender[1]} at {place} went silent")

    def _tell(self, now_ns: int, text: str) -> None:
        self._notices.append(Notice(now_ns, Event.PEER, {"source": self.context.number, "text": text}))
