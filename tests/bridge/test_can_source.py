"""CAN sources on python-can's virtual and multicast interfaces, and on an imitated SocketCAN socket."""

import errno
import itertools
import json
import os
import socket
import struct
import time
from collections.abc import Iterator

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.clock import Clock, HostClock, SimulatedClock, WallClock
from bridge.errors import ConfigError, SourceError
from bridge.frame import CAN_EFF, CAN_ERR, Event
from bridge.options import CanSource
from bridge.outputs import Transmit
from bridge.sources import SOURCES, can_socket
from bridge.sources.base import SourceContext
from bridge.sources.can import CanBus
from bridge.sources.can_errors import describe
from bridge.sources.can_help import reason

FOREVER = 1 << 62
_channels = itertools.count()


@pytest.fixture
def channel() -> str:
    return f"test-{next(_channels)}"


def make(
    channel: str, interface: str = "virtual", accept: frozenset[int] | None = None, clock: Clock | None = None
) -> CanBus:
    clock = clock or HostClock()
    context = SourceContext(1, "can0", clock, WallClock(clock), accept)
    source = SOURCES["can"](CanSource(type="can", interface=interface, channel=channel), context)
    assert isinstance(source, CanBus)
    source.open()
    return source


@pytest.fixture
def pair(channel: str) -> Iterator[tuple[CanBus, can.BusABC]]:
    source = make(channel)
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield source, bus
    source.close()


def test_frames_arrive_with_their_flags_in_order(pair: tuple[CanBus, can.BusABC]) -> None:
    source, bus = pair
    before = source.context.clock.monotonic_ns()
    bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"abc"))
    bus.send(can.Message(arbitration_id=0x123, is_extended_id=True, data=b""))
    bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False, data=bytes(12), is_fd=True))
    got = source.poll(FOREVER)
    assert [(key, data) for _, key, data in got] == [
        (0x123, b"abc"),
        (0x123 | CAN_EFF, b""),
        (0x7FF, bytes(12)),
    ]
    for rx_ns, _, _ in got:
        assert before - 5_000_000 <= rx_ns <= source.context.clock.monotonic_ns()
    assert source.poll(FOREVER) == []
    assert source.counters()["frames"] == 3


def test_frames_left_in_the_queue_keep_their_stamps(pair: tuple[CanBus, can.BusABC]) -> None:
    source, bus = pair
    for number in range(5):
        bus.send(can.Message(arbitration_id=number, is_extended_id=False))
    sent_ns = source.context.clock.monotonic_ns()
    got = []
    for _ in range(5):
        time.sleep(0.005)
        got += source.poll(0)  # the time for this poll is over: one frame
    assert [key for _, key, _ in got] == list(range(5))
    # the wall clock, in which they are stamped, is known to well under a millisecond
    assert max(rx_ns for rx_ns, _, _ in got) < sent_ns + 1_000_000


def test_what_is_sent_reaches_the_others_and_not_us(pair: tuple[CanBus, can.BusABC]) -> None:
    source, bus = pair
    assert source.send(Transmit(1, 0x200, b"12345678"))
    assert source.send(Transmit(1, 0x201 | CAN_EFF, bytes(32)))
    first, second = bus.recv(0), bus.recv(0)
    assert first is not None
    assert second is not None
    assert (first.arbitration_id, bytes(first.data), first.is_fd) == (0x200, b"12345678", False)
    assert (second.arbitration_id, second.is_extended_id, second.is_fd) == (0x201, True, True)
    assert source.poll(FOREVER) == []


def test_multicast_echoes_are_not_input() -> None:
    source = make("239.74.163.77", "udp_multicast")
    try:
        with can.Bus(interface="udp_multicast", channel="239.74.163.77") as bus:
            assert source.descriptors()
            assert source.send(Transmit(1, 0x200, b"x"))
            assert bus.recv(1.0) is not None
            bus.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=b"y"))
            clock = source.context.clock
            got = []
            for _ in range(20):
                clock.wait_until(clock.monotonic_ns() + 50_000_000, source.descriptors())
                got += source.poll(FOREVER)
                if got:
                    break
            assert [(key, data) for _, key, data in got] == [(0x100, b"y")]
    finally:
        source.close()


def test_only_subscribed_frames_are_let_in(channel: str) -> None:
    source = make(channel, accept=frozenset({0x100, 0x5000 | CAN_EFF}))
    with can.Bus(interface="virtual", channel=channel) as bus:
        for number, extended in ((0x100, False), (0x101, False), (0x100, True), (0x5000, True)):
            bus.send(can.Message(arbitration_id=number, is_extended_id=extended, data=b""))
        assert [key for _, key, _ in source.poll(FOREVER)] == [0x100, 0x5000 | CAN_EFF]
    assert json.loads(source.filters()) == [0x100, 0x5000 | CAN_EFF]
    source.close()


def test_simulated_time_stamps_frames(channel: str) -> None:
    source = make(channel, clock=SimulatedClock(utc_ns=0, monotonic_ns=42))
    with can.Bus(interface="virtual", channel=channel) as bus:
        bus.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert source.poll(FOREVER) == [(42, 1, b"")]
    source.close()


def test_error_frames_become_states_and_not_frames(pair: tuple[CanBus, can.BusABC]) -> None:
    source, bus = pair

    def error(error_class: int, data: bytes) -> can.Message:
        return can.Message(
            arbitration_id=error_class, is_error_frame=True, is_extended_id=False, data=data.ljust(8, b"\0")
        )

    for _ in range(3):
        bus.send(error(0x004, b"\0\x30"))  # error passive, three times
    bus.send(error(0x040, b""))
    bus.send(error(0x100, b""))
    assert source.poll(FOREVER) == []
    notices = source.notices()
    assert [(item.event, item.body["state"]) for item in notices] == [
        (Event.BUS_STATE, "error_passive"),
        (Event.BUS_STATE, "bus_off"),
        (Event.BUS_STATE, "error_active"),
    ]
    assert all(item.body["source"] == 1 for item in notices)
    assert source.counters()["errors"] == 5
    assert source.notices() == []


def test_error_classes_in_words() -> None:
    assert describe(0x004, b"\0\x01") == (None, "controller, receive overflow")
    assert describe(0x004, b"\0\x08") == ("error_warning", "controller")
    assert describe(0, b"") == (None, "unspecified")


def test_a_bus_that_is_not_there_is_one_line() -> None:
    with pytest.raises(SourceError, match=r'source can0: cannot open socketcan "nosuchbus0": ') as caught:
        make("nosuchbus0", "socketcan")
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match='interface: found "nosuchinterface", expected one of'):
        make("x", "nosuchinterface")


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (errno.EAFNOSUPPORT, "modprobe vcan"),
        (errno.ENODEV, "ip link add dev vcan7 type vcan"),
        (errno.ENETDOWN, "ip link set vcan7 up"),
        (errno.EPERM, "Operation not permitted"),
    ],
)
def test_a_socketcan_that_cannot_be_opened_says_what_to_do(number: int, expected: str) -> None:
    assert expected in reason(OSError(number, os.strerror(number)), "socketcan", "vcan7")
    assert reason(can.CanInitializationError("no\nlibrary"), "pcan", "x") == "no library"


def test_a_bus_that_fails_is_opened_again(pair: tuple[CanBus, can.BusABC]) -> None:
    source, bus = pair
    assert source._bus is not None
    source._bus.shutdown()  # every receive now raises
    for _ in range(20):
        assert source.poll(FOREVER) == []
    assert [item.body["state"] for item in source.notices()] == ["gone"]
    assert not source.send(Transmit(1, 1, b""))
    source._retry_ns = 0
    assert source.poll(FOREVER) == []
    assert [item.body["state"] for item in source.notices()] == ["back"]
    bus.send(can.Message(arbitration_id=7, is_extended_id=False))
    assert [key for _, key, _ in source.poll(FOREVER)] == [7]


class FakeSocket:
    """What the kernel hands out, prepared."""

    def __init__(self, items: list[tuple[int, bytes, int, int] | OSError]) -> None:
        self.items = items
        self.sent: list[bytes] = []

    def recvmsg(self, *_: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, tuple[str]]:
        if not self.items:
            raise BlockingIOError
        item = self.items.pop(0)
        if isinstance(item, OSError):
            raise item
        key, data, drops, flags = item
        ancillary = [(socket.SOL_SOCKET, 35, struct.pack("@qq", 1_700_000_000, 123_456_789))]
        if drops:
            ancillary.append((socket.SOL_SOCKET, 40, struct.pack("=I", drops)))
        return can_socket.pack(key, data), ancillary, flags, ("vcan0",)

    def send(self, data: bytes, _: int) -> int:
        if self.items and isinstance(self.items[0], OSError):
            raise self.items[0]
        self.sent.append(data)
        return len(data)


def socket_source(channel: str, items: list[tuple[int, bytes, int, int] | OSError]) -> CanBus:
    source = make(channel)
    source._socket = FakeSocket(items)  # type: ignore[assignment]
    return source


def test_the_kernels_losses_are_counted_once(channel: str) -> None:
    source = socket_source(
        channel, [(1, b"a", 0, 0), (1, b"b", 7, 0), (1, b"c", 7, 0), (1, b"d", 9, 0), (2, b"own", 9, 0x800)]
    )
    assert [data for _, _, data in source.poll(FOREVER)] == [b"a", b"b", b"c", b"d"]
    assert [(item.event, item.body["frames"]) for item in source.notices()] == [
        (Event.DROPPED, 7),
        (Event.DROPPED, 2),
    ]
    assert source.counters()["dropped"] == 9
    source._socket = None
    source.close()


def test_the_kernels_count_wraps(channel: str) -> None:
    source = socket_source(channel, [(1, b"", 0xFFFF_FFFF, 0), (1, b"", 4, 0)])
    source._drops = 0xFFFF_FFFE
    source.poll(FOREVER)
    assert [item.body["frames"] for item in source.notices()] == [1, 5]
    source._socket = None
    source.close()


def test_an_interface_going_down_and_up(channel: str) -> None:
    down = OSError(errno.ENETDOWN, "Network is down")
    source = socket_source(channel, [(1, b"", 0, 0), down])
    assert len(source.poll(FOREVER)) == 1
    assert [item.body["state"] for item in source.notices()] == ["down"]
    assert source._socket is not None
    source._socket.items = [(1, b"", 0, 0)]  # type: ignore[attr-defined]
    assert len(source.poll(FOREVER)) == 1
    assert [item.body["state"] for item in source.notices()] == ["up"]
    source._socket = None
    source.close()


def test_an_interface_that_vanishes_is_looked_for(channel: str) -> None:
    source = socket_source(channel, [OSError(errno.ENODEV, "No such device")])
    assert source.poll(FOREVER) == []
    assert [item.body["state"] for item in source.notices()] == ["gone"]
    source._retry_ns = 0
    source.poll(FOREVER)
    assert [item.body["state"] for item in source.notices()] == ["back"]
    source.close()


@pytest.mark.parametrize("index", [None, 5])
def test_an_interface_made_anew_is_found_out(
    channel: str, index: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lookup(name: str) -> int:
        if index is None:
            raise OSError(errno.ENODEV, "No such device")
        return index

    monkeypatch.setattr("bridge.sources.can.socket.if_nametoindex", lookup)
    source = socket_source(channel, [])
    source._index = 4
    source._heard_ns = 0  # silent for long: the old socket would stay so for ever
    source.poll(FOREVER)
    assert [item.body["state"] for item in source.notices()] == ["gone"]
    source.close()


def test_a_full_transmit_queue_is_counted(channel: str) -> None:
    source = socket_source(channel, [OSError(errno.ENOBUFS, "No buffer space available")])
    assert not source.send(Transmit(1, 1, b""))
    assert not source.send(Transmit(1, 1, bytes(9)))  # no CAN FD frame has nine bytes
    assert source.counters()["unsent"] == 2
    source._socket = None
    source.close()


@settings(deadline=None)
@given(
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda number: number | CAN_EFF),
    st.binary(max_size=8) | st.sampled_from([12, 16, 20, 24, 32, 48, 64]).map(bytes),
)
def test_socket_frames_round_trip(key: int, data: bytes) -> None:
    class One:
        def recvmsg(self, *_: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
            return can_socket.pack(key, data), [(1, 35, struct.pack("@qq", 2, 3))], 0, None

    assert can_socket.receive(One()) == (2_000_000_003, None, data, key)  # type: ignore[arg-type]


def test_packed_frames_are_those_of_the_kernel() -> None:
    # struct can_frame and struct canfd_frame of linux/can.h
    assert can_socket.pack(0x123, b"ab") == struct.pack("=IB3x8s", 0x123, 2, b"ab")
    assert can_socket.pack(0x123, bytes(12)) == struct.pack("=IBB2x64s", 0x123, 12, 0x05, b"")
    assert CAN_ERR == socket.CAN_ERR_FLAG
