"""MAVLink sources: framing under noise, both versions, and peers that come and go."""

import os
import pty
import random
import socket
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.clock import HostClock, WallClock
from bridge.errors import ConfigError, SourceError
from bridge.frame import Event
from bridge.options import MavlinkSource
from bridge.outputs import Transmit
from bridge.sources.base import Received, SourceContext
from bridge.sources.carrier import BURST
from bridge.sources.mavlink import MavlinkLink
from bridge.sources.mavlink_framing import Framer
from bridge.sources.transports import make_transport

FOREVER = 1 << 62


def packets(count: int, system: int = 42, version: int = 2, sign: bool = False) -> list[bytes]:
    link = dialect.MAVLink(None, srcSystem=system, srcComponent=7)
    if sign:
        link.signing.secret_key = bytes(32)
        link.signing.sign_outgoing = True
    made = []
    for i in range(count):
        message = dialect.MAVLink_attitude_message(i, 0.1 * i, -0.2, 0.3, 1e-3, 2e-3, 3e-3)
        made.append(bytes(message.pack(link, force_mavlink1=version == 1)))
        link.seq = (link.seq + 1) % 256
    return made


def other_packet(message_id: int) -> bytes:
    """A well-formed packet of a message that no dialect has."""
    head = bytes([0xFD, 4, 0, 0, 0, 9, 9]) + message_id.to_bytes(3, "little")
    return head + bytes(4) + b"\x12\x34"


def link(url: str, **options: object) -> MavlinkLink:
    clock = HostClock()
    source = MavlinkLink(
        MavlinkSource(type="mavlink", url=url, **options),  # type: ignore[arg-type]
        SourceContext(2, "gcs", clock, WallClock(clock)),
    )
    source.open()
    return source


def collect(source: MavlinkLink, count: int) -> list[Received]:
    got: list[Received] = []
    deadline = time.monotonic() + 3.0
    while len(got) < count and time.monotonic() < deadline:
        got += source.poll(FOREVER)
        source.context.clock.wait_until(time.monotonic_ns() + 5_000_000, source.descriptors())
    return got


def texts(source: MavlinkLink) -> list[str]:
    return [str(item.body["text"]) for item in source.notices() if item.event is Event.PEER]


def wait_for_news(source: MavlinkLink) -> list[str]:
    deadline = time.monotonic() + 3.0
    while time.monotonic() < deadline:
        source.poll(FOREVER)
        if news := texts(source):
            return news
        time.sleep(0.002)
    return []


def test_packets_left_in_the_queue_keep_their_stamps() -> None:
    source = link("udpin:127.0.0.1:0")
    time.sleep(0.1)  # the kernel begins to stamp a moment after it is asked to
    try:
        clock = source.context.clock
        (number,) = source.descriptors()
        with socket.socket(fileno=os.dup(number)) as bound, socket.socket(type=socket.SOCK_DGRAM) as peer:
            for packet in packets(2 * BURST):
                peer.sendto(packet, bound.getsockname())
        sent_ns = clock.monotonic_ns()
        got: list[Received] = []
        for polls in range(1, 4):
            time.sleep(0.005)
            got += source.poll(0)  # no time at all: one burst
            assert len(got) == min(polls, 2) * BURST
        # the wall clock, in which they are stamped, is known to well under a millisecond
        assert max(rx_ns for rx_ns, _, _ in got) < sent_ns + 1_000_000
    finally:
        source.close()


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("sign", [False, True])
def test_packets_come_out_whole(version: int, sign: bool) -> None:
    sent = packets(5, version=version, sign=sign)
    got = Framer().feed(b"".join(sent))
    assert [item.data for item in got] == sent
    assert {(item.message, item.system, item.component) for item in got} == {(30, 42, 7)}


@settings(deadline=None)
@given(st.data())
def test_any_noise_and_any_pieces_never_lose_a_packet_for_good(data: st.DataObject) -> None:
    noise = st.binary(max_size=40) | st.lists(st.sampled_from([0xFD, 0xFE, 0, 255]), max_size=40).map(bytes)
    stream, total = b"", 0
    sent = [*packets(4), *packets(3, version=1)]
    for packet in sent:
        junk = data.draw(noise)
        total += len(junk)
        stream += junk + packet
    # a false beginning waits for its claimed length, 280 bytes at most
    stream += bytes(300)
    framer, got, at = Framer(), [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 200))
        got += framer.feed(stream[at : at + size])
        at += size
    assert [item.data for item in got] == sent
    assert framer.noise == total + 300


def test_one_wrong_bit_costs_one_packet() -> None:
    sent = packets(3)
    broken = bytearray(b"".join(sent))
    broken[len(sent[0]) + 15] ^= 0x10
    framer = Framer()
    got = framer.feed(bytes(broken)) + framer.feed(bytes(300))
    assert [item.data for item in got] == [sent[0], sent[2]]
    assert framer.noise > 0


def test_unknown_messages_are_stepped_over() -> None:
    sent = packets(2)
    framer = Framer(datagrams=True)
    got = framer.feed(sent[0] + other_packet(0xABCDEF) + sent[1])
    assert [item.data for item in got] == sent
    assert (framer.unknown, framer.noise) == (1, 0)


def test_a_cut_datagram_does_not_eat_the_next() -> None:
    first, second = packets(2)
    framer = Framer(datagrams=True)
    assert framer.feed(first[:-5]) + framer.flush() == []
    assert [item.data for item in framer.feed(second) + framer.flush()] == [second]
    assert framer.noise == len(first) - 5


def test_random_bytes_are_noise_and_nothing_else() -> None:
    framer = Framer()
    junk = random.Random(3).randbytes(100_000)
    # a random candidate passes a 16-bit checksum once in 65536, and is a known message once in 2**16:
    # MAVLink 1 with its 8-bit message number may slip through about once here
    assert len(framer.feed(junk)) <= 3
    assert framer.noise > 90_000


def test_udp_in_answers_whoever_spoke() -> None:
    source = link("udpin:127.0.0.1:0")
    port = _port(source)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.settimeout(2.0)
        assert not source.send(Transmit(2, 30, b"nobody"))
        sent = packets(3)
        for packet in sent:
            peer.sendto(b"\xff" + packet, ("127.0.0.1", port))
        before = time.monotonic_ns()
        got = collect(source, 3)
        assert [data for _, _, data in got] == sent
        assert {key for _, key, _ in got} == {30}
        # kernel stamps: some time ago, not in the future
        assert all(before - 1_000_000_000 < rx_ns <= time.monotonic_ns() for rx_ns, _, _ in got)
        (text,) = texts(source)
        assert text.startswith("system 42 component 7 at 127.0.0.1:")
        assert source.counters()["refused (no packet)"] == 3
        assert source.send(Transmit(2, 30, sent[0]))
        assert peer.recv(1000) == sent[0]
    source.close()


def test_a_peer_that_is_not_there_stops_nothing() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    source = link(f"udpout:127.0.0.1:{port}")
    for _ in range(20):
        source.send(Transmit(2, 30, packets(1)[0]))
        assert source.poll(FOREVER) == []
    source.close()


def test_udp_out_hears_the_answer() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(2.0)
        source = link(f"udpout:127.0.0.1:{peer.getsockname()[1]}")
        assert source.send(Transmit(2, 30, b"hello"))
        data, address = peer.recvfrom(100)
        assert data == b"hello"
        (packet,) = packets(1)
        peer.sendto(packet, address)
        assert [data for _, _, data in collect(source, 1)] == [packet]
        source.close()


def test_our_own_packets_sent_back_are_dropped() -> None:
    source = link("udpin:127.0.0.1:0", system_id=42, component_id=7)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.sendto(packets(1)[0] + packets(1, system=9)[0], ("127.0.0.1", _port(source)))
        assert [data[5] for _, _, data in collect(source, 1)] == [9]
    assert source.counters()["refused (our own, sent back)"] == 1
    source.close()


def test_a_silent_peer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.sources.mavlink._SILENT_NS", 20_000_000)
    monkeypatch.setattr("bridge.sources.mavlink._CHECK_NS", 0)
    source = link("udpin:127.0.0.1:0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.sendto(packets(1)[0], ("127.0.0.1", _port(source)))
        collect(source, 1)
    time.sleep(0.03)
    source.poll(FOREVER)
    appeared, silent = texts(source)
    assert appeared.endswith("appeared")
    assert silent.endswith("went silent")
    source.close()


def test_tcp_client_connects_loses_and_connects_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.sources.net.RETRY_NS", 0)
    sent = packets(2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(2.0)
        source = link(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        for packet in sent:
            source.poll(FOREVER)
            connection, _ = server.accept()
            connection.settimeout(2.0)
            with connection:
                connection.sendall(packet[:9])
                source.poll(FOREVER)
                connection.sendall(packet[9:])
                assert [data for _, _, data in collect(source, 1)] == [packet]
                assert source.send(Transmit(2, 30, packet))
                assert connection.recv(1000) == packet
            news = texts(source)
            assert any("connected" in item for item in news)
            assert any("lost" in item for item in wait_for_news(source))
        source.close()


def test_tcp_server_takes_one_client_after_another() -> None:
    source = link("tcpin:127.0.0.1:0")
    for packet in packets(2):
        with socket.create_connection(("127.0.0.1", _port(source)), timeout=2.0) as client:
            client.sendall(packet)
            assert [data for _, _, data in collect(source, 1)] == [packet]
        texts(source)
        assert any("lost" in item for item in wait_for_news(source))
    source.close()


def test_a_serial_line_that_is_pulled_out() -> None:
    master, slave = pty.openpty()
    source = link(f"serial:{os.ttyname(slave)}:115200")
    os.close(slave)
    sent = packets(2)
    os.write(master, b"\x00garbage" + b"".join(sent))
    assert [data for _, _, data in collect(source, 2)] == sent
    assert source.send(Transmit(2, 30, sent[0]))
    assert os.read(master, 1000) == sent[0]
    os.close(master)
    assert source.poll(FOREVER) == []
    assert any("lost" in item for item in texts(source))
    assert not source.send(Transmit(2, 30, sent[0]))
    assert source.poll(FOREVER) == []
    source.close()


@pytest.mark.parametrize(
    "url", ["", "udpin", "udpin:127.0.0.1", "udpin:127.0.0.1:x", "ftp:a:1", "tcp:h:70000", "serial:"]
)
def test_urls_that_are_not_understood(url: str) -> None:
    with pytest.raises(ConfigError, match=r"url: found .* expected udpin:HOST:PORT"):
        make_transport(url, 57600)


def test_links_that_cannot_be_opened_say_why() -> None:
    with pytest.raises(SourceError, match=r"source gcs: cannot open serial:/dev/nothing: "):
        link("serial:/dev/nothing")
    with pytest.raises(SourceError, match="not a serial line"):
        link("/dev/null")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(SourceError, match="Address already in use"):
            link(f"udpin:127.0.0.1:{taken.getsockname()[1]}")


def _port(source: MavlinkLink) -> int:
    transport = source._transport
    sock = getattr(transport, "_listener", None) or transport._socket  # type: ignore[attr-defined]
    return int(sock.getsockname()[1])
