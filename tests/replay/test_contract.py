"""A replay goes by the DBC file in the capture, whatever the packaged one says by then."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.config import ATTACHMENT, Config
from bridge.decoding import FrameDecoder
from bridge.digest import combine
from bridge.engine import Engine
from bridge.errors import CaptureError, ConfigError
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.importers.capture import write_capture
from bridge.inspection import inspect
from bridge.outputs import FixOut
from bridge.recording import Capture, Recorder
from bridge.wire import DBC_ATTACHMENT
from dbc.codec import Contract, contract, parse
from tests.engine.made import bench_config, bench_frames

SECONDS = 45.0  # aligned after 40
HEIGHT = b"HEIGHT : 12|27@1- (0.001,0) [-67108.864|67108.863]"
HALVES = HEIGHT.replace(b"(0.001,0) [-67108.864|67108.863]", b"(0.0005,0) [-33554.432|33554.4315]")
KEY = contract()["GNSS_HEIGHT"].frame_id


@pytest.fixture(scope="module")
def other() -> Contract:
    """The packaged contract, but for heights of fixes in steps of half a millimetre."""
    text = contract().text
    assert text.count(HEIGHT) == 3  # of the fix, of a master, and of the solution
    return parse(text.replace(HEIGHT, HALVES, 1), "other.dbc")


@pytest.fixture(scope="module")
def frames(other: Contract) -> list[RawFrame]:
    """What devices that keep to ``other`` would have sent on the drive."""
    ours, theirs = contract()["GNSS_HEIGHT"], other["GNSS_HEIGHT"]
    return [
        frame._replace(data=theirs.encode(ours.alive(frame.data), *ours.decode(frame.data)))
        if frame.key == KEY
        else frame
        for frame in bench_frames(SECONDS)[1]
    ]


@pytest.fixture(scope="module")
def digest() -> str:
    """Of the same drive with devices that keep to the packaged contract."""
    engine = Engine(bench_config(SECONDS))
    for frame in bench_frames(SECONDS)[1]:
        engine.feed(frame)
    return combine(engine.digests())


def record(path: Path, frames: list[RawFrame], attachments: Mapping[str, bytes], digest: str = "") -> Path:
    recorder = Recorder(
        path, sources={0: "bridge", 1: "can0"}, utc_offset_ns=0, attachments=attachments, lossless=True
    )
    for frame in frames:
        recorder.record(frame)
    recorder.record(RawFrame(len(frames), frames[-1].rx_ns, BRIDGE, Event.STOP, b'{"reason": "end"}'))
    if digest:
        recorder.finish({"solution_sha256": digest, "frames": str(len(frames) + 1)})
    recorder.close()
    return path


def attachments(dbc: bytes) -> dict[str, bytes]:
    return {**bench_config(SECONDS).attachments(), DBC_ATTACHMENT: dbc}


def test_half_the_step_and_twice_the_number_are_the_same_height(
    other: Contract,
    frames: list[RawFrame],
    digest: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A power of two in the scale costs no bit of the product, so the digest is the same."""
    path = record(tmp_path / "halves.mcap", frames, attachments(other.text), digest)
    assert main(["replay", str(path)]) == 0
    assert f"solution sha256: {digest}" in capsys.readouterr().out
    # the packaged contract in its place reads every height twice as high
    wrong = record(tmp_path / "wrong.mcap", frames, attachments(contract().text), digest)
    assert main(["replay", str(wrong)]) == 1
    assert "differs" in capsys.readouterr().err


def test_another_configuration_does_not_bring_another_contract(
    other: Contract, frames: list[RawFrame], tmp_path: Path
) -> None:
    capture = Capture(record(tmp_path / "a.mcap", frames[:2000], attachments(other.text)))
    ours = bench_frames(SECONDS)[1][:2000]

    def heights(config: Config, received: list[RawFrame]) -> list[float]:
        engine = Engine(config, warm=False)
        outputs = [out for frame in received for out in engine.feed(frame)]
        return [out.fix.height for out in outputs if isinstance(out, FixOut)]

    expected = heights(bench_config(SECONDS), ours)
    assert len(expected) > 3
    assert heights(Config.for_capture(capture.attachments), frames[:2000]) == expected
    assert heights(Config.for_capture(capture.attachments, "bench"), frames[:2000]) == expected
    assert heights(Config.load("bench"), frames[:2000]) == [2.0 * height for height in expected]


def test_viewers_go_by_it_too(other: Contract, frames: list[RawFrame]) -> None:
    files = attachments(other.text)
    decoder = FrameDecoder(files, Config.from_attachments(files))
    frame = next(frame for frame in frames if frame.key == KEY)
    decoded = decoder.decode(frame)
    assert decoded is not None
    assert decoded[1]["HEIGHT"] == other["GNSS_HEIGHT"].decode(frame.data)[0]
    assert decoder.units("GNSS_HEIGHT")["HEIGHT"] == "m"


def test_what_is_recorded_is_what_was_used(other: Contract, tmp_path: Path) -> None:
    files = attachments(other.text)
    config = Config.from_attachments(files)
    assert config.attachments() == files
    done = write_capture(tmp_path / "a.mcap", bench_frames(SECONDS)[1][:10], config, 0, "a test")
    assert Capture(done.path).attachments == files
    assert Config.load("bench").attachments()[DBC_ATTACHMENT] == contract().text


def test_a_damaged_attachment_says_so_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path / "a.mcap", bench_frames(SECONDS)[1][:2000], attachments(contract().text))
    data = bytearray(path.read_bytes())
    at = data.index(HEIGHT) + len("HEIGHT : 12|27@1- (0.00")
    data[at] = ord("3")
    path.write_bytes(data)
    for command in ("replay", "decode", "plot"):
        out = [] if command == "replay" else ["--out", str(tmp_path / command)]
        assert main([command, str(path), *out]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "a.mcap: damaged: the checksum of navbridge.dbc in it does not agree" in error
    capture = Capture(path)
    with pytest.raises(CaptureError):
        capture.attachments  # noqa: B018
    # what needs no contract is still there to be looked at
    report = inspect(capture)
    assert report.frames == 2001
    assert any("checksum of navbridge.dbc" in finding.text for finding in report.findings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: b'VERSION ""\n', "it holds no CAN messages"),
        (lambda text: b"\x00\x01 no DBC", "Invalid syntax"),
        (lambda text: text.replace(HEIGHT, HEIGHT.replace(b"0.001", b"0")), "HEIGHT has a factor of 0"),
        (lambda text: text.replace(b" GYRO_X ", b" OMEGA_X "), "GYRO_X"),
        (lambda text: text.replace(b"BO_ 288 ODO:", b"BO_ 288 WHEEL:"), "no message ODO"),
    ],
)
def test_a_contract_that_cannot_be_used_says_so_in_one_line(
    change: object, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = attachments(change(contract().text))  # type: ignore[operator]
    path = record(tmp_path / "a.mcap", bench_frames(SECONDS)[1][:100], files)
    assert main(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"navbridge: {DBC_ATTACHMENT}: ")
    assert words in error
    assert error.count("\n") == 1


def test_a_capture_without_a_contract_is_not_read_by_ours(tmp_path: Path) -> None:
    files = attachments(b"")
    del files[DBC_ATTACHMENT]
    with pytest.raises(ConfigError, match=r"found no navbridge\.dbc"):
        Config.from_attachments(files)
    assert ATTACHMENT in files
