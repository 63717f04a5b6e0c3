"""A CAN bus through python-can, with any of its interfaces."""

from __future__ import annotations

import contextlib
import errno
import json
import socket
from collections import Counter, deque
from collections.abc import Sequence
from typing import Any, Final

import can

from bridge.errors import ConfigError, SourceError
from bridge.frame import CAN_EFF, CAN_ERR, CAN_RTR, Event
from bridge.options import CanSource
from bridge.outputs import Transmit
from bridge.sources import can_socket
from bridge.sources.base import Notice, Received, SourceContext
from bridge.sources.can_errors import describe
from bridge.sources.can_help import reason
from bridge.strict import one_of

_BURST: Final = 2000  # frames in one poll
_DOUBT_NS: Final = 1_000_000  # of the wall clock against the monotonic one
_RETRY_NS: Final = 500_000_000
_QUIET_NS: Final = 1_000_000_000
_REPORT_NS: Final = 1_000_000_000
_FAULTS: Final = 10  # errors in a row after which a bus is opened anew
_FILTERS: Final = 256  # with more wanted all are let through: the kernel holds 512
_ECHOES: Final = 256  # of our own frames that may be on their way back
_ECHOING: Final = frozenset({"udp_multicast"})  # interfaces that hand us our own frames


class CanBus:
    """One bus.

    SocketCAN is read directly, for the kernel's nanosecond stamps and its count of lost frames; any
    other interface through python-can. An interface that goes away is opened anew until it is back.

    Raises ConfigError, which names the key, when python-can has no such interface.
    """

    def __init__(self, options: CanSource, context: SourceContext) -> None:
        if options.interface not in can.VALID_INTERFACES:
            expected = one_of(options.interface, can.VALID_INTERFACES)
            raise ConfigError(f'interface: found "{options.interface}", expected {expected}')
        self.context = context
        self._options = options
        self._echoing = options.interface in _ECHOING
        self._bus: can.BusABC | None = None
        self._socket: socket.socket | None = None
        self._index = 0
        self._descriptors: tuple[int, ...] = ()
        self._notices: list[Notice] = []
        self._counts: Counter[str] = Counter()
        self._state = "unknown"
        self._drops = 0
        self._emptied_ns = 0  # when nothing was left in the queue: what comes later is not older
        self._heard_ns = 0
        self._retry_ns = 0
        self._faults = 0
        self._errors_told_ns = 0
        self._errors = 0
        self._echoes: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)

    def open(self) -> None:
        """Open the bus; raises SourceError with the reason."""
        try:
            self._open()
        except Exception as error:  # every interface of python-can has errors of its own
            bus = f'{self._options.interface} "{self._options.channel}"'
            raise SourceError(
                f"source {self.context.name}: cannot open {bus}: {self._reason(error)}"
            ) from error
        self._heard_ns = self._emptied_ns = self.context.clock.monotonic_ns()

    def descriptors(self) -> Sequence[int]:
        """The bus's file descriptor, where its interface has one."""
        return self._descriptors

    def poll(self, deadline_ns: int) -> list[Received]:
        """Frames that have arrived; see `bridge.sources.base.Source`."""
        now_ns = self.context.clock.monotonic_ns()
        if self._bus is None:
            self._reopen(now_ns)
        if self._bus is None:
            return []
        earliest_ns = self._emptied_ns - _DOUBT_NS
        was_down = self._state == "down"
        if self._socket is not None:
            frames, emptied = self._poll_socket(self._socket, earliest_ns, deadline_ns)
        else:
            frames, emptied = self._poll_bus(self._bus, earliest_ns, deadline_ns)
        if emptied:
            self._emptied_ns = now_ns
        if frames:
            self._heard_ns = now_ns
            self._counts["frames"] += len(frames)
            if was_down:
                self._state = "up"
                self._tell(Event.BUS_STATE, state="up", text="the interface is up again")
        elif self._socket is not None and now_ns - self._heard_ns > _QUIET_NS:
            self._heard_ns = now_ns
            self._check_interface()
        return frames

    def notices(self) -> list[Notice]:
        """Losses, states of the bus and of its interface since the last call."""
        told, self._notices = self._notices, []
        return told

    def send(self, transmit: Transmit) -> bool:
        """Send one frame; False when the bus is not there or its queue is full."""
        key, data = transmit.key, transmit.data
        try:
            if self._socket is not None:
                self._socket.send(can_socket.pack(key, data), socket.MSG_DONTWAIT)
            elif self._bus is not None:
                if self._echoing:
                    self._echoes.append((key, data))
                self._bus.send(_message(key, data), timeout=0)
            else:
                self._counts["unsent"] += 1
                return False
        except (OSError, ValueError, can.CanError):
            self._counts["unsent"] += 1
            return False
        self._counts["sent"] += 1
        return True

    def counters(self) -> dict[str, int]:
        """Totals: frames, sent, unsent, dropped, errors, malformed."""
        return dict(self._counts)

    def filters(self) -> str:
        """Identifiers let through, as JSON, or "all"."""
        accept = self._filtered()
        return "all" if accept is None else json.dumps(sorted(accept))

    def close(self) -> None:
        """Close the bus."""
        if self._bus is not None:
            with contextlib.suppress(Exception):
                self._bus.shutdown()
        self._bus = self._socket = None
        self._descriptors = ()

    # opening

    def _open(self) -> None:
        options = self._options
        arguments: dict[str, Any] = dict(options.options)
        if options.bitrate is not None:
            arguments["bitrate"] = options.bitrate
        if options.data_bitrate is not None:
            arguments["data_bitrate"] = options.data_bitrate
        if options.fd:
            arguments["fd"] = True
        bus = can.Bus(interface=options.interface, channel=options.channel, **arguments)
        try:
            if options.interface == "socketcan":
                accept = self._filtered()
                if accept is not None:
                    bus.set_filters([_filter(key) for key in sorted(accept)])
                self._socket = bus.socket  # type: ignore[attr-defined]
                self._index = socket.if_nametoindex(str(options.channel))
                self._counts["buffer_bytes"] = can_socket.enlarge(bus.socket)  # type: ignore[attr-defined]
                self._drops = 0
        except BaseException:
            self._socket = None
            bus.shutdown()
            raise
        self._bus = bus
        self._faults = 0
        with contextlib.suppress(NotImplementedError):
            self._descriptors = (bus.fileno(),)

    def _filtered(self) -> frozenset[int] | None:
        accept = self.context.accept
        return accept if accept is not None and len(accept) <= _FILTERS else None

    def _reopen(self, now_ns: int) -> None:
        if now_ns < self._retry_ns:
            return
        self._retry_ns = now_ns + _RETRY_NS
        try:
            self._open()
        except Exception:
            return
        self._heard_ns = self._emptied_ns = now_ns
        self._tell(Event.BUS_STATE, state="back", text="the interface is there again")

    def _lose(self, reason: str) -> None:
        self.close()
        self._retry_ns = self.context.clock.monotonic_ns() + _RETRY_NS
        self._state = "gone"
        self._tell(Event.BUS_STATE, state="gone", text=reason)

    def _check_interface(self) -> None:
        """A socket of an interface that was deleted and made again stays silent for ever."""
        try:
            index = socket.if_nametoindex(str(self._options.channel))
        except OSError:
            self._lose("the interface is gone")
            return
        if index != self._index:
            self._lose("the interface was made anew")

    # receiving

    def _poll_socket(
        self, sock: socket.socket, earliest_ns: int, deadline_ns: int
    ) -> tuple[list[Received], bool]:
        """Frames, and whether none was left behind."""
        frames: list[Received] = []
        clock, to_monotonic = self.context.clock, self.context.wall.to_monotonic
        for _ in range(_BURST):
            try:
                got = can_socket.receive(sock)
            except BlockingIOError:
                return frames, True
            except OSError as error:
                self._fault(error)
                break
            now_ns = clock.monotonic_ns()
            if got is not None:
                utc_ns, drops, data, key = got
                if drops is not None and drops != self._drops:
                    self._dropped((drops - self._drops) & 0xFFFF_FFFF)
                    self._drops = drops
                if key & CAN_ERR:
                    self._error(key & 0x1FFF_FFFF, data, now_ns)
                else:
                    frames.append((to_monotonic(utc_ns, earliest_ns, now_ns), key, data))
            if now_ns >= deadline_ns:
                break
        return frames, False

    def _poll_bus(self, bus: can.BusABC, earliest_ns: int, deadline_ns: int) -> tuple[list[Received], bool]:
        """Frames, and whether none was left behind."""
        frames: list[Received] = []
        clock, to_monotonic = self.context.clock, self.context.wall.to_monotonic
        # not left to python-can: its recv takes a frame that was filtered out for an empty queue
        accept = self._filtered()
        for _ in range(_BURST):
            try:
                message = bus.recv(timeout=0)
            except Exception as error:  # see open
                self._fault(error)
                break
            if message is None:
                return frames, True
            self._faults = 0
            now_ns = clock.monotonic_ns()
            key = _key(message)
            data = bytes(message.data)
            if key & CAN_ERR:
                self._error(key & 0x1FFF_FFFF, data, now_ns)
            elif message.is_rx and (accept is None or key in accept) and not self._is_echo(key, data):
                frames.append((to_monotonic(round(message.timestamp * 1e9), earliest_ns, now_ns), key, data))
            if now_ns >= deadline_ns:
                break
        return frames, False

    def _fault(self, error: Exception) -> None:
        number = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
        if number == errno.ENETDOWN:
            if self._state != "down":
                self._state = "down"
                self._tell(Event.BUS_STATE, state="down", text="the interface is down")
            return
        self._faults += 1
        self._counts["malformed"] += 1
        if self._socket is not None or self._faults >= _FAULTS:
            self._lose(self._reason(error))

    def _dropped(self, frames: int) -> None:
        self._counts["dropped"] += frames
        self._tell(Event.DROPPED, frames=frames)

    def _error(self, error_class: int, data: bytes, now_ns: int) -> None:
        """Tell every change of state at once, other errors at most once a second."""
        self._counts["errors"] += 1
        self._errors += 1
        state, text = describe(error_class, data)
        changed = state is not None and state != self._state
        if state is not None:
            self._state = state
        if changed or now_ns - self._errors_told_ns >= _REPORT_NS:
            self._errors_told_ns = now_ns
            self._tell(Event.BUS_STATE, state=self._state, text=text, errors=self._errors)
            self._errors = 0

    def _tell(self, event: Event, **body: int | str) -> None:
        now_ns = self.context.clock.monotonic_ns()
        self._notices.append(Notice(now_ns, event, {"source": self.context.number, **body}))

    def _reason(self, error: Exception) -> str:
        return reason(error, self._options.interface, self._options.channel)

    def _is_echo(self, key: int, data: bytes) -> bool:
        if (key, data) not in self._echoes:
            return False
        self._echoes.remove((key, data))
        return True


def _key(message: can.Message) -> int:
    key = message.arbitration_id
    if message.is_extended_id:
        key |= CAN_EFF
    if message.is_remote_frame:
        key |= CAN_RTR
    if message.is_error_frame:
        key |= CAN_ERR
    return key


def _message(key: int, data: bytes) -> can.Message:
    if key < 0x800 and len(data) <= 8:  # nearly all: every further keyword costs time
        return can.Message(arbitration_id=key, is_extended_id=False, data=data)
    return can.Message(
        arbitration_id=key & 0x1FFF_FFFF,
        is_extended_id=bool(key & CAN_EFF),
        is_remote_frame=bool(key & CAN_RTR),
        is_fd=len(data) > 8,
        bitrate_switch=len(data) > 8,
        data=data,
    )


def _filter(key: int) -> Any:
    extended = bool(key & CAN_EFF)
    return {
        "can_id": key & 0x1FFF_FFFF,
        "can_mask": 0x1FFF_FFFF if extended else 0x7FF,
        "extended": extended,
    }
