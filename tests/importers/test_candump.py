"""Logs of candump -l: every line accounted for, every frame as it was."""

from __future__ import annotations

import argparse
import gzip
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.errors import CaptureError, ConfigError
from bridge.frame import CAN_EFF, CAN_ERR, CAN_RTR, RawFrame
from bridge.importers import candump
from bridge.importers.candump import CandumpImport, Line, parse_line
from bridge.recording import Capture

CONFIG = """
[source.cabin]
type = "can"
interface = "virtual"
channel = "can1"

[source.nav]
type = "can"
interface = "virtual"
channel = "can2"

[device.log]
driver = "speed_can"
source = "nav"

[navigator.main]
devices = ["log"]
"""
ONE_SOURCE = CONFIG.replace('[source.cabin]\ntype = "can"\ninterface = "virtual"\nchannel = "can1"\n', "")

LOG = """\
(1627305599.790450) can2 009#95A44F410202B07F
(1627305599.792650) can1 7E8#034162BD00000000
(1627305599.800500) can2 17F00010#
(1627305599.800400) can1 123#R
(1627305599.810000) can2 1A0##1000102030405060708090A0B
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bench.toml").write_text(CONFIG)
    (tmp_path / "one.toml").write_text(ONE_SOURCE)
    (tmp_path / "drive.log").write_text(LOG)
    return tmp_path


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("(1627305599.790450) can2 009#95A4", Line(1627305599790450000, "can2", 9, b"\x95\xa4")),
        ("(0000000001.000001) vcan0 7FF#", Line(1000001000, "vcan0", 0x7FF, b"")),
        ("(1.5) can0 00000123#11", Line(1500000000, "can0", 0x123 | CAN_EFF, b"\x11")),
        ("(1.0) can0 1FFFFFFF#R8", Line(10**9, "can0", 0x1FFFFFFF | CAN_EFF | CAN_RTR, b"")),
        ("(1.0) can0 20000080#0000000000000000", Line(10**9, "can0", CAN_ERR | 0x80, bytes(8))),
        ("(1.0) can0 123##3" + "AB" * 64, Line(10**9, "can0", 0x123, b"\xab" * 64)),
        (
            "(1.0) can0 123#1122334455667788_E R",
            Line(10**9, "can0", 0x123, bytes.fromhex("1122334455667788")),
        ),
        ("(1.0) can0 1a0#ff T", Line(10**9, "can0", 0x1A0, b"\xff")),
    ],
)
def test_lines(text: str, expected: Line) -> None:
    assert parse_line(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "1627305599.79 can2 009#95A4",
        "(1627305599.79) can2 009",
        "(1627305599.79) can2 009#95A",
        "(1627305599.79) can2 009#112233445566778899",
        "(1627305599.79) can2 800#00",
        "(1627305599.79) can2 DFFFFFFF#00",
        "(1627305599.79) can2 0009#00",
        "(1627305599.79) can2 009##1" + "00" * 9,
        "(1627305599.79) can2 009#GG",
        "(nan.0) can2 009#00",
        "(1.0) can0  009   [2]  11 22",
        "# a comment",
        "(1627305599.79) can2 009#00 and more",
    ],
)
def test_what_is_no_frame(text: str) -> None:
    assert parse_line(text) is None


@settings(deadline=None)
@given(
    st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.binary(max_size=8),
    st.integers(0, 2_000_000_000_000_000),
)
def test_lines_that_python_can_writes(
    tmp_path_factory, ident: int, extended: bool, data: bytes, us: int
) -> None:
    ident = ident if extended else ident & 0x7FF
    path = tmp_path_factory.getbasetemp() / "written.log"
    message = can.Message(
        timestamp=us / 1e6,
        arbitration_id=ident,
        is_extended_id=extended,
        data=data,
        channel="can7",
        is_rx=False,
    )
    with can.CanutilsLogWriter(path) as writer:
        writer.on_message_received(message)
    line = parse_line(path.read_text().strip())
    assert line is not None
    assert (line.channel, line.data) == ("can7", data)
    assert line.key == ident | (CAN_EFF if extended else 0)
    # the float time stamp of a Message holds these years to a quarter of a microsecond
    assert abs(line.stamp_ns - us * 1000) <= 1000


@settings(deadline=None)
@given(st.text(max_size=60))
def test_no_text_breaks_the_parser(text: str) -> None:
    parse_line(text)


def test_every_frame_of_both_channels(folder: Path) -> None:
    job = CandumpImport(folder / "drive.log", folder / "bench.toml")
    frames = list(job.frames())
    s = 1_000_000_000
    assert frames == [
        RawFrame(0, s, 2, 9, bytes.fromhex("95A44F410202B07F")),
        RawFrame(1, s + 2_200_000, 1, 0x7E8, bytes.fromhex("034162BD00000000")),
        RawFrame(2, s + 10_050_000, 2, 0x17F00010 | CAN_EFF, b""),
        # 0.1 ms earlier than the frame before it: two sockets out of order; the stamp does not go back
        RawFrame(3, s + 10_050_000, 1, 0x123 | CAN_RTR, b""),
        RawFrame(4, s + 19_550_000, 2, 0x1A0, bytes(range(12))),
    ]
    assert job.report() == []
    assert job.utc_offset_ns == 1627305599790450000 - s


def test_lines_that_are_no_frames_are_counted(folder: Path) -> None:
    lines = LOG.splitlines()
    (folder / "bad.log").write_text(
        "\n".join(["junk", *lines[:2], "(1.0) can2 009#9", "", *lines[2:], "\x00\xff"])
    )
    job = CandumpImport(folder / "bad.log", folder / "bench.toml")
    assert len(list(job.frames())) == 5
    assert (job.malformed, job.lines) == (3, 8)
    assert "3 of 8 lines are not frames (line 1: junk; line 4: (1.0) can2 009#9; " in job.report()[0]
    assert len(list(job.frames())) == 5  # counts start anew
    assert job.malformed == 3


def test_a_clock_that_is_set_back_does_not_stop_time(folder: Path) -> None:
    stamps = [100.0, 100.5, 40.0, 40.25, 40.5]
    (folder / "step.log").write_text("\n".join(f"({t:.6f}) can2 009#00" for t in stamps))
    job = CandumpImport(folder / "step.log", folder / "bench.toml")
    times = [f.rx_ns / 1e9 for f in job.frames()]
    assert times == pytest.approx([1.0, 1.5, 1.5, 1.75, 2.0])
    assert job.clock_steps == 1
    assert "set back 1 times" in job.report()[0]
    assert job.utc_offset_ns == 0  # 100 s after 1970 is no date


def test_gzip_and_a_damaged_gzip(folder: Path) -> None:
    packed = gzip.compress((LOG * 2000).encode(), mtime=0)
    (folder / "drive.log.gz").write_bytes(packed)
    job = CandumpImport(folder / "drive.log.gz", folder / "bench.toml")
    assert len(list(job.frames())) == 10_000
    (folder / "cut.log.gz").write_bytes(packed[: len(packed) // 2])
    job = CandumpImport(folder / "cut.log.gz", folder / "bench.toml")
    assert 0 < len(list(job.frames())) < 10_000
    assert any("the compressed file is damaged" in note for note in job.report())


def test_a_channel_without_a_source_is_left_out_and_said(folder: Path) -> None:
    job = CandumpImport(folder / "drive.log", folder / "one.toml")
    assert [f.source for f in job.frames()] == [1, 1, 1]
    assert job.report() == [f"{folder / 'drive.log'}: 2 frames on can1 left out: no source has that channel"]


def test_channels_can_be_named(folder: Path) -> None:
    job = CandumpImport(folder / "drive.log", folder / "one.toml", {"can1": "nav"})
    assert [f.key for f in job.frames()] == [9, 0x7E8, 0x17F00010 | CAN_EFF, 0x123 | CAN_RTR, 0x1A0]
    with pytest.raises(
        ConfigError, match=r'one.toml: source of channel can1: found "navi", expected one of nav'
    ):
        CandumpImport(folder / "drive.log", folder / "one.toml", {"can1": "navi"})
    with pytest.raises(ConfigError, match=r'drive.log: channel: found "can3", expected .*one of can1, can2'):
        CandumpImport(folder / "drive.log", folder / "one.toml", {"can3": "nav"})


def test_one_channel_and_one_source_belong_together(folder: Path) -> None:
    (folder / "other.log").write_text("(1627305599.790450) slcan0 009#00\n")
    assert len(list(CandumpImport(folder / "other.log", folder / "one.toml").frames())) == 1
    with pytest.raises(
        ConfigError, match=r"found CAN sources cabin \(can1\), nav \(can2\), .* slcan0; name it"
    ):
        CandumpImport(folder / "other.log", folder / "bench.toml")


def test_a_file_that_is_no_log(folder: Path) -> None:
    with pytest.raises(CaptureError, match=r"none.log: cannot be read: No such file"):
        CandumpImport(folder / "none.log", folder / "bench.toml")
    with pytest.raises(CaptureError, match=r"bench.toml: no frame in \d+ lines; expected lines like"):
        CandumpImport(folder / "bench.toml", folder / "bench.toml")


def test_the_command_writes_a_capture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--out")
    candump.add_arguments(parser)
    (folder / "bad.log").write_text(LOG + "junk\n")
    out = folder / "drive.mcap"
    words = [str(folder / "bad.log"), "--config", str(folder / "bench.toml"), "--out", str(out)]
    done = candump.run(parser.parse_args(words))
    assert done.frames == {"cabin": 2, "nav": 3}
    assert "1 of 6 lines are not frames" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        parser.parse_args([*words, "--channel", "can1"])
    frames = [frame for frame in Capture(out).frames() if frame.source]
    assert [frame._replace(seq=0) for frame in frames] == [
        frame._replace(seq=0) for frame in CandumpImport(folder / "bad.log", folder / "bench.toml").frames()
    ]
