"""A MAVLink link: whole packets with a good checksum become frames; what else arrives is refused and counted.

A refusal is told in the stream: a `REFUSED` event within a tenth of a second for the first of a reason, then
at most one a second for all that came since.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from typing import Final

from bridge.errors import ConfigError, SourceError
from bridge.frame import Event
from bridge.options import MavlinkSource
from bridge.outputs import Transmit
from bridge.sources.base import Notice, Received, SourceContext
from bridge.sources.carrier import BURST, Chunk
from bridge.sources.mavlink_framing import Framer, Packet
from bridge.sources.mavlink_signing import Signing, is_signed
from bridge.sources.transports import make_transport

_SILENT_NS: Final = 10_000_000_000
_PEERS: Final = 64
_FRAMERS: Final = 8
_CHECK_NS: Final = 1_000_000_000
_TELL_NS: Final = 1_000_000_000
_LOOK_NS: Final = 100_000_000
_SETUP_SIGNING: Final = 256

NOISE: Final = "no packet"
"""Reason of a refusal that counts bytes; the others count packets."""
UNKNOWN: Final = "unknown message"
OWN: Final = "our own, sent back"
KEY: Final = "carries a key"
UNWANTED: Final = "nobody asked for it"
TOO_MANY: Final = "too many"


class MavlinkLink:
    """One link, MAVLink 1 and 2. The key of a frame is the message number, its data the whole packet.

    Refused are packets of our own system and component (a router sent them back), those that would put a
    key into a capture, those whose signature is missing or wrong where the link has a key, and those
    beyond ``max_rate_hz``. Nothing is answered to a peer that sent only such.

    Raises ConfigError, which names the key, for a URL that is not understood or a key that is not there.
    """

    def __init__(self, options: MavlinkSource, context: SourceContext) -> None:
        self.context = context
        self._options = options
        self._us = (options.system_id, options.component_id)
        self._transport = make_transport(options.url, options.baud)
        self._signing = _signing(options, context)
        self._allowed = options.max_rate_hz  # packets that may come at once: a second's worth
        self._allowed_ns = 0
        self._framers: dict[str, Framer] = {}
        self._retired: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._told: Counter[str] = Counter()  # of these
        self._told_ns: dict[str, int] = {}
        self._look_ns = 0
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
        clock, to_monotonic = self.context.clock, self.context.wall.to_monotonic
        frames: list[Received] = []
        while True:
            now_ns = clock.monotonic_ns()
            chunks = self._transport.receive(now_ns)
            for chunk in chunks:
                rx_ns = to_monotonic(chunk.utc_ns, self._emptied_ns - 1_000_000, now_ns)
                for packet in self._split(chunk):
                    reason = self._fault(packet, chunk.peer, now_ns)
                    if reason is None:
                        frames.append((rx_ns, packet.message, packet.data))
                    else:
                        self._refused[reason] += 1
            if len(chunks) < BURST:
                self._emptied_ns = now_ns
                break
            if now_ns >= deadline_ns:
                break
        for news in self._transport.news():
            self._tell(now_ns, news)
        self._tell_refusals(now_ns)
        if now_ns >= self._check_ns:
            self._check_ns = now_ns + _CHECK_NS
            self._miss(now_ns)
        self._counts["frames"] += len(frames)
        return frames

    def notices(self) -> list[Notice]:
        """Peers and connections that came and went, and what was refused."""
        told, self._notices = self._notices, []
        return told

    def send(self, transmit: Transmit) -> bool:
        """Send one packet; False when nobody is there to take it."""
        sent = False
        data = transmit.data if self._signing is None else self._signing.sign(transmit.data)
        with contextlib.suppress(OSError):
            sent = self._transport.send(data)
        self._counts["sent" if sent else "unsent"] += 1
        return sent

    def counters(self) -> dict[str, int]:
        """Totals: frames, sent, unsent, and each reason of a refusal that was met."""
        refused = {f"refused ({reason})": count for reason, count in self._refusals().items() if count}
        return {**self._counts, **refused}

    def filters(self) -> str:
        """Message numbers let through, or "all"."""
        accept = self.context.accept
        return "all" if accept is None else str(sorted(accept))

    def close(self) -> None:
        """Close the link."""
        self._transport.close()

    def _fault(self, packet: Packet, place: str, now_ns: int) -> str | None:
        """Why a packet is refused; None when it is let in."""
        sender = (packet.system, packet.component)
        if sender == self._us:
            return OWN
        if packet.message == _SETUP_SIGNING:
            return KEY  # before anything else: its bytes are never to be recorded
        if self._signing is not None and (is_signed(packet.data) or not self._options.accept_unsigned):
            fault = self._signing.fault(packet.data, *sender)
            if fault is not None:
                return fault
        self._meet(sender, place, now_ns)
        self._transport.heard(place, now_ns)
        accept = self.context.accept
        if accept is not None and packet.message not in accept:
            return UNWANTED
        rate = self._options.max_rate_hz
        self._allowed = min(rate, self._allowed + (now_ns - self._allowed_ns) * 1e-9 * rate)
        self._allowed_ns = now_ns
        if self._allowed < 1.0:
            return TOO_MANY
        self._allowed -= 1.0
        return None

    def _refusals(self) -> Counter[str]:
        counts = self._refused.copy()
        counts[NOISE] += sum(framer.noise for framer in self._framers.values()) + self._retired[NOISE]
        counts[UNKNOWN] += sum(framer.unknown for framer in self._framers.values()) + self._retired[UNKNOWN]
        return counts

    def _tell_refusals(self, now_ns: int) -> None:
        if now_ns < self._look_ns:
            return
        self._look_ns = now_ns + _LOOK_NS
        for reason, count in self._refusals().items():
            new = count - self._told[reason]
            if new and now_ns >= self._told_ns.get(reason, now_ns):
                self._told[reason] = count
                self._told_ns[reason] = now_ns + _TELL_NS
                what = "bytes" if reason == NOISE else "packets"
                body: dict[str, int | str] = {"source": self.context.number, "reason": reason, what: new}
                self._notices.append(Notice(now_ns, Event.REFUSED, body))

    def _split(self, chunk: Chunk) -> list[Packet]:
        # bytes of two senders must not be joined, and neither must two datagrams
        name = "" if self._transport.datagrams else chunk.peer
        framer = self._framers.get(name)
        if framer is None:
            if len(self._framers) >= _FRAMERS:
                old = self._framers.pop(next(iter(self._framers)))
                self._retired.update({NOISE: old.noise, UNKNOWN: old.unknown})
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


def _signing(options: MavlinkSource, context: SourceContext) -> Signing | None:
    if options.signing_key_file is None:
        if options.accept_unsigned:
            raise ConfigError("accept_unsigned: found true, expected it only beside signing_key_file")
        return None
    if context.key is None:
        raise ConfigError(
            f'signing_key_file: found "{options.signing_key_file}" without the key in it; a configuration '
            "out of a capture has none"
        )
    return Signing(context.key, context.number, context.clock.utc_ns)
