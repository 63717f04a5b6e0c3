"""The engine as a fold: what goes in comes out the same, and nothing stops it."""

from __future__ import annotations

import itertools
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from bridge.commands import METHODS, CommandCode, Reason, Result
from bridge.config import ATTACHMENT, Config
from bridge.digest import DigestChain
from bridge.engine import Engine
from bridge.frame import BRIDGE, CAN_EFF, CAN_ERR, Event, RawFrame
from bridge.outputs import (
    Checkpoint,
    FixOut,
    Health,
    ModeChange,
    Output,
    Progress,
    Reject,
    Severity,
    SolutionOut,
    Text,
    Transmit,
)
from dbc.codec import contract
from nav.align import ALIGNMENTS
from nav.types import GnssFix, Mode
from tests.engine.made import START_NS, bench_config, bench_frames, event, fed
from virtual_bus.bus import Bench

S = 10**9
Kind = TypeVar("Kind", bound=Output)


def of(kind: type[Kind], outputs: list[Output]) -> list[Kind]:
    return [output for output in outputs if isinstance(output, kind)]


@pytest.fixture(scope="module")
def drive() -> tuple[Engine, list[Output]]:
    """Ninety seconds: a minute at rest, aligned after forty, then driving."""
    engine = Engine(bench_config())
    return engine, fed(engine, bench_frames()[1])


def test_a_bench_is_aligned_and_navigated(drive: tuple[Engine, list[Output]]) -> None:
    outputs = drive[1]
    modes = [(m.old, m.new) for m in of(ModeChange, outputs)]
    assert modes == [(Mode.STANDBY, Mode.ALIGN), (Mode.ALIGN, Mode.NAVIGATE)]
    last = of(SolutionOut, outputs)[-1]
    truth = Bench("drive", seed=5, seconds=90.0, start_ns=START_NS).truth(last.solution.t_ns)
    # the GNSS of the scenario is 0.5 m; aided for 50 s, a metre is far outside of three sigma
    assert abs(last.solution.lat - truth.lat) * 6.4e6 < 1.0
    assert abs(last.solution.height - truth.height) < 1.0
    np.testing.assert_allclose(last.solution.v_g, truth.v_g, atol=0.1)


def test_solutions_come_in_order_and_at_the_rate_of_two_samples(drive: tuple[Engine, list[Output]]) -> None:
    solutions = [out for out in of(SolutionOut, drive[1]) if out.solution.mode is Mode.NAVIGATE]
    times = np.array([out.solution.t_ns for out in solutions])
    assert np.all(np.diff(times) > 0)
    assert np.median(np.diff(times)) == pytest.approx(10e6, rel=1e-3)
    ages = np.array([out.latest_rx_ns - out.solution.t_ns for out in solutions])
    assert np.all(ages >= 0)
    assert np.median(ages) < 2e6


def test_the_digest_is_that_of_the_solutions(drive: tuple[Engine, list[Output]]) -> None:
    engine, outputs = drive
    chain = DigestChain("main")
    checkpoints = [chain.add(out.solution) for out in of(SolutionOut, outputs)]
    assert engine.digests() == {"main": chain.final()}
    assert of(Checkpoint, outputs) == [c for c in checkpoints if c is not None]
    # one a second from the first attitude of the alignment on
    seconds = [out.solution.t_ns // S for out in of(SolutionOut, outputs)]
    assert len(of(Checkpoint, outputs)) == seconds[-1] - seconds[0] > 60


def test_a_replay_gives_the_same_outputs(drive: tuple[Engine, list[Output]]) -> None:
    engine = Engine(Config.from_attachments(bench_config().attachments()))
    frames = bench_frames()[1][:15_000]
    again = Engine(bench_config())
    for frame in frames:
        one, two = engine.feed(frame), again.feed(frame)
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            if isinstance(a, SolutionOut | FixOut):
                continue  # arrays; the digest compares them
            assert a == b
    assert engine.digests() == again.digests()


def test_fixes_are_shown_before_any_gate(drive: tuple[Engine, list[Output]]) -> None:
    fixes = of(FixOut, drive[1])
    assert len(fixes) == pytest.approx(90 * 5, abs=2)
    assert all(isinstance(out.fix, GnssFix) and out.device == "gnss" for out in fixes)


def test_health_once_a_second(drive: tuple[Engine, list[Output]]) -> None:
    reports = of(Health, drive[1])
    assert [h.t_ns // S for h in reports] == list(range(START_NS // S + 1, START_NS // S + 1 + len(reports)))
    assert len(reports) == pytest.approx(90, abs=2)
    assert reports[-1].devices["imu"].rate_hz == pytest.approx(200.0, rel=0.02)
    assert reports[-1].devices["gnss"].samples == pytest.approx(89 * 5, abs=6)
    assert (reports[-1].unknown_frames, reports[-1].dropped_frames, reports[-1].unrecorded_frames) == (
        0,
        0,
        0,
    )


def test_unknown_identifiers_are_counted() -> None:
    engine = Engine(bench_config())
    frames = bench_frames()[1][:1500]
    strange = [
        RawFrame(0, frames[0].rx_ns, 1, key, b"\x01\x02")
        for key in (0x7FF, 0x100 | CAN_EFF, 0x100 | CAN_ERR, 0x181)
    ]
    health = of(Health, fed(engine, [frames[0], *strange, *frames[1:]]))
    assert health[0].unknown_frames == len(strange)


def test_events_of_the_border_are_counted_and_told() -> None:
    engine = Engine(bench_config())
    frames = [
        event(Event.START, START_NS, utc_ns=1, monotonic_ns=START_NS),
        event(Event.DROPPED, START_NS, source=1, frames=7),
        event(Event.UNRECORDED, START_NS, frames=3),
        event(Event.CLOCK_STEP, START_NS, step_ns=-2_500_000_000),
        event(Event.BUS_STATE, START_NS, source=1, state="off", text="bus off"),
        event(Event.PEER, START_NS, source=1, text="a peer"),
        event(Event.REFUSED, START_NS, source=1, reason="not signed", packets=1),
        event(Event.REFUSED, START_NS + 1, source=1, reason="not signed", packets=4),
        event(Event.REFUSED, START_NS + 1, source=1, reason="no packet", bytes=17),
        event(Event.TICK, START_NS + 2 * S),
    ]
    outputs = fed(engine, frames)
    (health,) = of(Health, outputs)
    assert (health.dropped_frames, health.unrecorded_frames) == (7, 3)
    assert health.refused == {"not signed": 5, "no packet": 17}
    texts = of(Text, outputs)
    assert [t.severity for t in texts] == [
        Severity.WARNING,
        Severity.ERROR,
        Severity.NOTICE,
        Severity.WARNING,
        Severity.INFO,
        Severity.WARNING,
        Severity.WARNING,
    ]
    assert "-2.500 s" in texts[2].text
    # the same again is counted, and not said again so soon
    assert texts[5].text == "can0: refused, not signed: 1 packet"
    assert texts[6].text == "can0: refused, no packet: 17 bytes"


def test_events_that_make_no_sense_stop_nothing() -> None:
    engine = Engine(Config.load("bench"))
    bodies = [
        b"",
        b"{",
        b"[]",
        b"null",
        b'{"frames": "x"}',
        b"\xff\xfe",
        b'{"command": 3}',
        b'{"frames": -1}',
    ]
    for key in (*Event, 99):
        for body in bodies:
            engine.feed(RawFrame(0, START_NS, BRIDGE, key, body))
    outputs = fed(engine, bench_frames()[1][:5000])
    assert of(Health, outputs)[-1].devices["imu"].samples > 1000


def test_frames_back_in_time_are_turned_away() -> None:
    engine = Engine(bench_config())
    frames = bench_frames()[1][:5000]
    old = [frame._replace(rx_ns=frame.rx_ns - 60 * S) for frame in frames[4000:4100]]
    outputs = fed(engine, [*frames[:4100], *old, *frames[4100:]])
    health = of(Health, outputs)[-1]
    assert sum(d.rejects.get(Reject.STALE, 0) for d in health.devices.values()) == 100
    times = [out.t_ns for out in of(Health, outputs)]
    assert times == sorted(times)


def test_crossed_stamps_of_two_sockets_are_nothing_special() -> None:
    engine = Engine(bench_config())
    frames = bench_frames()[1][:5000]
    frames = [f._replace(rx_ns=f.rx_ns - (300_000 if i % 7 == 0 else 0)) for i, f in enumerate(frames)]
    health = of(Health, fed(engine, frames))[-1]
    assert all(not device.rejects for device in health.devices.values())


# commands


def command(code: int, alive: int = 0, rx_ns: int = START_NS, argument: int = 0) -> RawFrame:
    codec = contract()["COMMAND"]
    return RawFrame(0, rx_ns, 1, codec.frame_id, codec.encode(alive, code, argument))


def acknowledged(outputs: list[Output]) -> list[tuple[float, ...]]:
    codec = contract()["COMMAND_ACK"]
    acks = [out for out in of(Transmit, outputs) if out.key == codec.frame_id]
    assert all(codec.crc_ok(out.data) for out in acks)
    return [codec.decode(out.data) for out in acks]


def test_commands_on_can() -> None:
    engine = Engine(bench_config())
    frames = bench_frames()[1]
    fed(engine, frames[:1000])
    now = frames[999].rx_ns
    outputs = fed(engine, [command(CommandCode.STOP, 0, now), command(CommandCode.START_ALIGNMENT, 1, now)])
    assert [(m.old, m.new) for m in of(ModeChange, outputs)] == [
        (Mode.ALIGN, Mode.STANDBY),
        (Mode.STANDBY, Mode.ALIGN),
    ]
    assert acknowledged(outputs) == [(2, 0, 0), (1, 0, 0)]
    assert acknowledged(fed(engine, [command(77, 2, now)])) == [(77, 3, Reason.UNKNOWN_CODE)]
    bad = command(CommandCode.STOP, 3, now)
    assert fed(engine, [bad._replace(data=bad.data[:-1] + b"\x99"), bad._replace(data=b"")]) == []


def methods(outputs: list[Output]) -> set[str]:
    return {progress.method for progress in of(Progress, outputs)}


def test_a_command_picks_the_alignment() -> None:
    engine = Engine(bench_config())
    frames = bench_frames()[1]
    assert methods(fed(engine, frames[:2000])) == {"static"}
    now = frames[1999].rx_ns
    start, restart, stop = CommandCode.START_ALIGNMENT, CommandCode.RESTART, CommandCode.STOP
    outputs = fed(engine, [command(start, 0, now, METHODS["motion"])])
    assert acknowledged(outputs) == [(start, 0, 0)]
    assert methods(fed(engine, frames[2000:4000])) == {"motion"}
    # aborted, and again as configured
    now = frames[3999].rx_ns
    outputs = fed(engine, [command(stop, 1, now), command(restart, 2, now)])
    assert of(ModeChange, outputs)[-1].new is Mode.ALIGN
    assert methods(fed(engine, frames[4000:6000])) == {"static"}


@pytest.mark.parametrize("number", [63, -1, METHODS["motion"], METHODS["stored"]])
def test_an_alignment_that_cannot_be_is_refused_with_a_reason(number: int) -> None:
    files = dict(bench_frames()[0])
    text = files[ATTACHMENT].decode().replace(', "gnss"]', "]")
    table = "[navigator.main.align]\n"
    files[ATTACHMENT] = text.replace(table, f"{table}position_deg_m = [47.0, 8.0, 400.0]\n").encode()
    engine = Engine(Config.from_files(files))
    frames = bench_frames()[1]
    fed(engine, frames[:1000])
    outputs = fed(engine, [command(CommandCode.RESTART, 0, frames[999].rx_ns, number)])
    reason, says = {
        METHODS["motion"]: (Reason.NO_GNSS, "main: alignment motion refused: it needs a GNSS receiver"),
        METHODS["stored"]: (Reason.NO_HEADING, "main: alignment stored refused: it needs a stored heading"),
    }.get(number, (Reason.UNKNOWN_METHOD, f"there is no alignment number {number}"))
    if number == METHODS["stored"] and "stored" not in ALIGNMENTS:
        reason, says = Reason.UNKNOWN_METHOD, f"there is no alignment number {number}"
    assert acknowledged(outputs) == [(CommandCode.RESTART, Result.DENIED, reason)]
    (text,) = of(Text, outputs)
    assert says in text.text
    # what ran goes on
    assert of(ModeChange, outputs) == []
    assert methods(fed(engine, frames[1000:2000])) == {"static"}


def test_commands_from_the_console() -> None:
    engine = Engine(bench_config())
    outputs = fed(engine, [event(Event.COMMAND, START_NS, command="stop")])
    assert of(ModeChange, outputs)[-1].new is Mode.STANDBY
    outputs = fed(engine, [event(Event.COMMAND, START_NS, command="restart")])
    assert of(ModeChange, outputs)[-1].new is Mode.ALIGN
    fed(engine, [event(Event.COMMAND, START_NS, command="start_alignment", method="motion")])
    assert methods(fed(engine, bench_frames()[1][:2000])) == {"motion"}


def test_without_autostart_it_waits_for_a_command() -> None:
    files = dict(bench_frames()[0])
    text = files[ATTACHMENT].decode().replace("autostart = true", "autostart = false")
    files[ATTACHMENT] = text.encode()
    engine = Engine(Config.from_files(files))
    outputs = fed(engine, bench_frames()[1][:5000])
    assert of(ModeChange, outputs) == []
    assert of(SolutionOut, outputs) == []
    outputs = fed(engine, [command(CommandCode.START_ALIGNMENT, 0, bench_frames()[1][5000].rx_ns)])
    assert of(ModeChange, outputs)[0].new is Mode.ALIGN


def test_commands_over_mavlink() -> None:
    engine = Engine(Config.load("bench"))
    assert list(engine.peers) == [2]
    message = dialect.MAVLink_command_long_message(
        1, 1, dialect.MAV_CMD_USER_1, 0, float(CommandCode.STOP), 0, 0, 0, 0, 0, 0
    )
    data = bytes(message.pack(dialect.MAVLink(None, srcSystem=255, srcComponent=190)))
    outputs = fed(
        engine,
        [event(Event.TICK, START_NS), RawFrame(0, START_NS, 2, dialect.MAVLINK_MSG_ID_COMMAND_LONG, data)],
    )
    assert of(ModeChange, outputs)[-1].new is Mode.STANDBY
    (ack,) = of(Transmit, outputs)
    assert (ack.source, ack.key) == (2, dialect.MAVLINK_MSG_ID_COMMAND_ACK)


def test_a_method_over_mavlink_is_refused_with_a_reason() -> None:
    engine = Engine(Config.load("bench"))
    message = dialect.MAVLink_command_long_message(
        1, 1, dialect.MAV_CMD_USER_1, 0, float(CommandCode.START_ALIGNMENT), 63.0, 0, 0, 0, 0, 0
    )
    data = bytes(message.pack(dialect.MAVLink(None, srcSystem=255, srcComponent=190)))
    outputs = fed(
        engine,
        [event(Event.TICK, START_NS), RawFrame(0, START_NS, 2, dialect.MAVLINK_MSG_ID_COMMAND_LONG, data)],
    )
    (packet,) = of(Transmit, outputs)
    ack = dialect.MAVLink(None).decode(bytearray(packet.data))
    assert (ack.result, ack.result_param2) == (dialect.MAV_RESULT_DENIED, Reason.UNKNOWN_METHOD)
    assert [text.text for text in of(Text, outputs)] == ["command refused: there is no alignment number 63"]


def test_who_listens_to_what() -> None:
    accept = Engine(Config.load("bench")).accept
    assert list(accept) == [1]
    names = ("IMU_GYRO", "IMU_TIME", "IMU_FD", "ODO", "GNSS_ACC", "BARO", "COMMAND")
    assert {contract()[name].frame_id for name in names} <= accept[1]
    assert contract()["SOL_TIME"].frame_id not in accept[1]


# garbage


@given(st.data())
@settings(max_examples=20, deadline=None)
def test_whatever_arrives_the_fold_goes_on(data: st.DataObject) -> None:
    """Real frames and garbage under known and unknown keys: no exception, time never goes back."""
    engine = Engine(Config.load("bench"))
    real = iter(bench_frames()[1][: data.draw(st.integers(0, 400))])
    keys = [key for _, key in engine._routes]
    garbage = st.builds(
        RawFrame,
        st.just(0),
        st.one_of(st.integers(START_NS - S, START_NS + 5 * S), st.integers(-(2**63), 2**63 - 1)),
        st.integers(0, 3),
        st.one_of(st.sampled_from(keys), st.sampled_from(list(Event)), st.integers(0, 2**32 - 1)),
        st.binary(max_size=64),
    )
    last = 0
    for frame in itertools.chain(data.draw(st.lists(garbage, max_size=60)), real):
        for output in engine.feed(frame):
            if isinstance(output, Health):
                assert output.t_ns >= last
                last = output.t_ns


def test_spoilt_frames_cost_samples_and_nothing_else() -> None:
    """Every hundredth frame with a flipped bit: counted, mostly bridged, still navigating."""
    engine = Engine(bench_config())
    frames = [
        f._replace(data=bytes([f.data[0] ^ 0x10]) + f.data[1:]) if i % 101 == 0 else f
        for i, f in enumerate(bench_frames()[1])
    ]
    outputs = fed(engine, frames)
    health = of(Health, outputs)[-1]
    spoilt = sum(1 for i, f in enumerate(frames) if i % 101 == 0 and f.rx_ns <= health.t_ns)
    counted: Any = sum(d.rejects.get(Reject.CRC, 0) for d in health.devices.values())
    assert counted == pytest.approx(spoilt, abs=2)
    assert health.devices["imu"].bridged == health.devices["imu"].missing > 100
    assert of(ModeChange, outputs)[-1].new is Mode.NAVIGATE
