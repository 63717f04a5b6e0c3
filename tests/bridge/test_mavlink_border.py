"""What a MAVLink link refuses, and that it says so; signatures, and keys that stay outside of a capture."""

import hashlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.assemble import Bridge
from bridge.cli import main
from bridge.clock import HostClock, WallClock
from bridge.config import Config
from bridge.errors import ConfigError
from bridge.frame import BRIDGE, Event
from bridge.mavlink.link import Link
from bridge.options import MavlinkSource
from bridge.outputs import Transmit
from bridge.recording import Capture
from bridge.sources.base import Received, SourceContext
from bridge.sources.mavlink import MavlinkLink
from bridge.sources.mavlink_signing import OLD, UNSIGNED, WRONG, Signing

KEY = hashlib.sha256(b"a passphrase").digest()
FOREVER = 1 << 62
EPOCH_S = 1_420_070_400  # 2015-01-01
NOW_S = EPOCH_S + 300_000_000
NOW = 300_000_000 * 100_000  # as a stamp of a signature
MINUTE = 60 * 100_000


class Peer:
    """Somebody else's end of a link: pymavlink, which packs and signs by itself."""

    def __init__(
        self, key: bytes | None = None, system: int = 42, stamp: int = NOW, link_id: int = 3
    ) -> None:
        self.packer = dialect.MAVLink(None, srcSystem=system, srcComponent=7)
        if key is not None:
            self.packer.signing.secret_key = key
            self.packer.signing.sign_outgoing = True
            self.packer.signing.timestamp = stamp
            self.packer.signing.link_id = link_id

    def packet(self, message: Any = None, version: int = 2) -> bytes:
        message = message or dialect.MAVLink_attitude_message(1, 0.1, -0.2, 0.3, 1e-3, 2e-3, 3e-3)
        packed = bytes(message.pack(self.packer, force_mavlink1=version == 1))
        self.packer.seq = (self.packer.seq + 1) % 256
        return packed


def signing(now: Callable[[], int] = lambda: NOW_S * 10**9) -> Signing:
    return Signing(KEY, 2, now)


def ours() -> bytes:
    """A packet as our end packs it, not signed."""
    return Link(2, 1, 1).send(dialect.MAVLink_attitude_message(1, 0.1, -0.2, 0.3, 1e-3, 2e-3, 3e-3)).data


# ---- signatures -----------------------------------------------------------------------------------


def test_what_pymavlink_signs_is_right_and_nothing_else_is() -> None:
    check = signing()
    good = Peer(KEY).packet()
    assert check.fault(good, 42, 7) is None
    assert check.fault(Peer(bytes(32)).packet(), 42, 7) == WRONG
    assert check.fault(Peer().packet(), 42, 7) == UNSIGNED
    assert check.fault(Peer().packet(version=1), 42, 7) == UNSIGNED
    for place in range(len(good)):
        changed = bytearray(Peer(KEY, stamp=NOW + 10).packet())
        changed[place] ^= 0x10
        assert check.fault(bytes(changed), 42, 7) in (WRONG, UNSIGNED)


def test_pymavlink_believes_what_we_sign() -> None:
    sign = signing()
    their = dialect.MAVLink(None)
    their.signing.secret_key = KEY
    for _ in range(3):
        message = their.decode(bytearray(sign.sign(ours())))
        assert (message.get_type(), message.get_signed()) == ("ATTITUDE", True)
    # a stamp that did not grow would be refused: it grows even while the clock stands
    assert their.signing.stream_timestamps == {(2, 1, 1): NOW + 2}


def test_mavlink_1_has_no_room_for_a_signature() -> None:
    old = Peer().packet(version=1)
    assert signing().sign(old) == old


def test_a_packet_counts_once() -> None:
    check, peer = signing(), Peer(KEY)
    first, second = peer.packet(), peer.packet()
    assert check.fault(second, 42, 7) is None
    assert check.fault(second, 42, 7) == OLD
    assert check.fault(first, 42, 7) == OLD
    assert check.fault(peer.packet(), 42, 7) is None


def test_a_new_stream_may_be_a_minute_behind_and_no_more() -> None:
    check = signing()
    assert check.fault(Peer(KEY, system=1, stamp=NOW - MINUTE).packet(), 1, 7) is None
    assert check.fault(Peer(KEY, system=2, stamp=NOW - MINUTE - 1).packet(), 2, 7) == OLD


def test_a_forged_packet_locks_nobody_out() -> None:
    """Late stamps with a wrong signature move nothing, for streams that are known and that are not."""
    check, peer = signing(), Peer(KEY)
    late = NOW + 1000 * MINUTE
    forged = Peer(bytes(32), stamp=late).packet()
    their = dialect.MAVLink(None)
    their.signing.secret_key = KEY
    for _ in range(2):
        assert check.fault(forged, 42, 7) == WRONG
        assert check.fault(Peer(bytes(32), system=9, stamp=late).packet(), 9, 7) == WRONG
        assert check.fault(peer.packet(), 42, 7) is None
    assert check.fault(Peer(KEY, system=9).packet(), 9, 7) is None
    # our own stamps have not moved either: a receiver whose time is ours believes them
    stamp = int.from_bytes(check.sign(ours())[-12:-6], "little")
    assert NOW <= stamp < NOW + MINUTE
    # this is what the library would have done
    with pytest.raises(dialect.MAVError):
        their.decode(bytearray(forged))
    with pytest.raises(dialect.MAVError):
        their.decode(bytearray(peer.packet()))


def test_a_peer_ahead_of_us_takes_our_stamps_along() -> None:
    """Its clock is an hour fast; what we send after hearing it is not too old for it."""
    sign = signing()
    assert sign.fault(Peer(KEY, stamp=NOW + 60 * MINUTE).packet(), 42, 7) is None
    assert int.from_bytes(sign.sign(ours())[-12:-6], "little") > NOW + 60 * MINUTE


def test_a_clock_before_2015_stops_nothing() -> None:
    sign = signing(lambda: 0)
    assert sign.sign(ours())[-12:-6] == (1).to_bytes(6, "little")
    assert sign.fault(Peer(KEY).packet(), 42, 7) is None


# ---- the link -------------------------------------------------------------------------------------


class Bench:
    """A listening link and sockets that send to it."""

    def __init__(
        self, key: bytes | None = None, accept: frozenset[int] | None = None, **options: Any
    ) -> None:
        clock = HostClock()
        name = None if key is None else "a.key"
        self.source = MavlinkLink(
            MavlinkSource(type="mavlink", url="udpin:127.0.0.1:0", signing_key_file=name, **options),
            SourceContext(2, "gcs", clock, WallClock(clock), accept, key),
        )
        self.source.open()
        with socket.socket(fileno=socket.dup(self.source.descriptors()[0])) as bound:
            self.port = bound.getsockname()[1]
        self.peer = socket.socket(type=socket.SOCK_DGRAM)
        self.peer.settimeout(2.0)

    def send(self, *datagrams: bytes) -> list[bytes]:
        """Send them from one address; returns what came through."""
        for data in datagrams:
            self.peer.sendto(data, ("127.0.0.1", self.port))
        time.sleep(0.01)
        got: list[Received] = []
        for _ in range(3):
            got += self.source.poll(FOREVER)
        return [data for _, _, data in got]

    def refused(self) -> dict[str, int]:
        """Sums of what the REFUSED events of a second say."""
        sums: dict[str, int] = {}
        self.source._look_ns = 0
        self.source._told_ns.clear()
        self.source.poll(FOREVER)
        for notice in self.source.notices():
            if notice.event is Event.REFUSED:
                assert notice.body["source"] == 2
                unit = "bytes" if notice.body["reason"] == "no packet" else "packets"
                assert notice.body.keys() == {"source", "reason", unit}
                reason = str(notice.body["reason"])
                sums[reason] = sums.get(reason, 0) + int(notice.body[unit])
        return sums

    def close(self) -> None:
        self.source.close()
        self.peer.close()


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(*args: Any, **options: Any) -> Bench:
        made.append(Bench(*args, **options))
        return made[-1]

    yield make
    for item in made:
        item.close()


def stamp_now() -> int:
    return (time.time_ns() - EPOCH_S * 10**9) // 10_000


def test_only_signed_packets_come_through(bench: Callable[..., Bench]) -> None:
    link = bench(KEY)
    good = Peer(KEY, stamp=stamp_now()).packet()
    assert link.send(Peer().packet(), Peer(bytes(32), stamp=stamp_now()).packet(), good, good) == [good]
    assert link.refused() == {UNSIGNED: 1, WRONG: 1, OLD: 1}
    assert link.refused() == {}
    assert link.source.counters()[f"refused ({WRONG})"] == 1


def test_unsigned_packets_may_be_let_in_but_forged_ones_never(bench: Callable[..., Bench]) -> None:
    link = bench(KEY, accept_unsigned=True)
    plain, good = Peer(system=5).packet(), Peer(KEY, stamp=stamp_now()).packet()
    assert link.send(plain, Peer(bytes(32), stamp=stamp_now()).packet(), good) == [plain, good]
    assert link.refused() == {WRONG: 1}


def test_who_is_not_trusted_is_not_answered(bench: Callable[..., Bench]) -> None:
    link = bench(KEY)
    assert link.send(Peer().packet()) == []
    assert not link.source.send(Transmit(2, 30, ours()))
    assert link.send(Peer(KEY, stamp=stamp_now()).packet())
    assert link.source.send(Transmit(2, 30, ours()))
    their = dialect.MAVLink(None)
    their.signing.secret_key = KEY
    assert their.decode(bytearray(link.peer.recv(1000))).get_signed()


def test_without_a_key_signed_packets_are_packets(bench: Callable[..., Bench]) -> None:
    link = bench()
    signed = Peer(KEY).packet()
    assert link.send(signed) == [signed]
    assert Link(2, 1, 1).decode(signed).get_type() == "ATTITUDE"
    assert link.source.send(Transmit(2, 30, ours()))
    assert link.peer.recv(1000) == ours()


def test_noise_strangers_echoes_and_keys_are_refused(bench: Callable[..., Bench]) -> None:
    link = bench(accept=frozenset({30}), system_id=9, component_id=7)
    good = Peer().packet()
    stranger = bytes([0xFD, 4, 0, 0, 0, 9, 9]) + (0xABCDEF).to_bytes(3, "little") + bytes(4) + b"\x12\x34"
    setup = Peer().packet(dialect.MAVLink_setup_signing_message(9, 7, KEY, 1))
    unwanted = Peer().packet(dialect.MAVLink_system_time_message(1, 2))
    echo = Peer(system=9).packet()
    assert link.send(b"garbage", stranger, setup, unwanted, echo, good) == [good]
    assert link.refused() == {
        "no packet": 7,
        "unknown message": 1,
        "carries a key": 1,
        "nobody asked for it": 1,
        "our own, sent back": 1,
    }


def test_a_flood_is_cut_to_the_rate(bench: Callable[..., Bench]) -> None:
    link = bench(max_rate_hz=10.0)
    peer = Peer()
    got = link.send(*(peer.packet() for _ in range(50)))
    # a second's worth at once, and what the time that the test took allows
    assert 10 <= len(got) <= 20
    assert link.refused() == {"too many": 50 - len(got)}
    time.sleep(0.25)
    assert len(link.send(*(peer.packet() for _ in range(5)))) >= 2


def test_refusals_are_told_at_once_and_then_once_a_second(bench: Callable[..., Bench]) -> None:
    link = bench()
    told = []
    deadline = time.monotonic() + 0.5
    while time.monotonic() < deadline:
        link.send(b"\0")
        told += [n.body["bytes"] for n in link.source.notices() if n.event is Event.REFUSED]
    assert told == [1]


def test_the_largest_datagram_of_false_beginnings_does_not_hold_the_loop_up(
    bench: Callable[..., Bench],
) -> None:
    """Every byte begins a packet that is whole, of a known message, and wrong."""
    link = bench()
    good = Peer().packet()
    assert link.send(b"\xfe" * 60_000, good) == [good]
    # what does not fit into a read is cut off by the kernel, so that no read takes long
    assert link.refused()["no packet"] <= 4096


def test_options_that_make_no_sense_together() -> None:
    clock = HostClock()
    context = SourceContext(2, "gcs", clock, WallClock(clock))
    with pytest.raises(ConfigError, match=r"^accept_unsigned: found true, expected"):
        MavlinkLink(MavlinkSource(type="mavlink", url="udpin:h:1", accept_unsigned=True), context)
    with pytest.raises(ConfigError, match=r'^signing_key_file: found "k" without the key'):
        MavlinkLink(MavlinkSource(type="mavlink", url="udpin:h:1", signing_key_file="k"), context)
    assert "key" not in repr(SourceContext(2, "gcs", clock, WallClock(clock), key=KEY))


# ---- configuration and capture --------------------------------------------------------------------


def write_config(folder: Path, digits: str | None) -> Path:
    text = Config.load("bench").resolved_toml()
    text = text.replace("[source.gcs]", '[source.gcs]\nsigning_key_file = "link.key"', 1)
    text = text.replace('"socketcan"', '"virtual"').replace('"vcan0"', '"mavlink-border"')
    text = text.replace('url = "udpout:127.0.0.1:14550"', 'url = "udpin:127.0.0.1:0"')
    (folder / "config.toml").write_text(text)
    if digits is not None:
        (folder / "link.key").write_text(digits)
    return folder / "config.toml"


@pytest.mark.parametrize("digits", ["", KEY.hex()[:-1], KEY.hex() + "0", "x" * 64, "\xe9" * 64, None])
def test_a_key_that_is_none_is_said_and_not_shown(
    digits: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(write_config(tmp_path, digits))]) == 2
    error = capsys.readouterr().err
    assert error.startswith("navbridge: config.toml: source.gcs.signing_key_file: ")
    assert error.count("\n") == 1
    assert not digits or digits not in error


def test_the_key_is_in_no_capture(tmp_path: Path) -> None:
    """Nor is one that a ground station sends along to set signatures up."""
    config = Config.load(write_config(tmp_path, KEY.hex() + "\n"))
    assert config.keys == {"gcs": KEY}
    assert KEY.hex() not in repr(config)
    other = hashlib.sha256(b"another").digest()
    path = tmp_path / "a.mcap"
    peer = Peer(KEY, stamp=stamp_now())
    with Bridge(config, HostClock(), out=path) as bridge:
        (gcs,) = (source for source in bridge.sources if source.context.name == "gcs")
        with (
            socket.socket(fileno=socket.dup(gcs.descriptors()[0])) as bound,
            socket.socket(type=socket.SOCK_DGRAM) as sender,
        ):
            for packet in (
                peer.packet(),
                peer.packet(dialect.MAVLink_setup_signing_message(1, 1, other, 1)),
                Peer(bytes(32), stamp=stamp_now()).packet(),
            ):
                sender.sendto(packet, bound.getsockname())
        bridge.live().run(0.4)
    capture = Capture(path)
    frames = list(capture.frames())
    assert [frame.key for frame in frames if frame.source != BRIDGE] == [30]
    refused = [json.loads(frame.data) for frame in frames if frame.key == Event.REFUSED and not frame.source]
    assert {body["reason"]: body["packets"] for body in refused} == {"carries a key": 1, WRONG: 1}
    # the chunks are compressed: look at what is in them, and at the file as it is
    contents = [frame.data for frame in frames] + [path.read_bytes(), repr(capture.metadata).encode()]
    contents += list(capture.attachments.values())
    for secret in (KEY, other):
        for form in (secret, secret.hex().encode(), secret.hex().upper().encode()):
            assert not any(form in content for content in contents)
    assert b'signing_key_file = "link.key"' in capture.attachments["config.toml"]
    # and a replay needs none
    assert Config.from_attachments(capture.attachments).keys == {}
    assert main(["replay", str(path)]) == 0
