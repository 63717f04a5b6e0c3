"""``navbridge run`` and ``navbridge replay`` on a small bench, through the command line."""

from pathlib import Path

import can
import pytest

from bridge.assemble import Bridge
from bridge.cli import main
from bridge.clock import SimulatedClock
from bridge.config import Config
from bridge.recording import Capture
from virtual_bus.bus import Bench

SECONDS = 4.0


class Driver:
    """The bench on one virtual bus, as the loop wants it."""

    def __init__(self, bench: Bench, bus: can.BusABC) -> None:
        self._bench = bench
        self._buses = dict.fromkeys(bench.channels, bus)

    def send_due(self, now_ns: int) -> None:
        self._bench.send_due(self._buses, now_ns)

    def next_ns(self) -> int | None:
        return self._bench.next_ns


def write_config(folder: Path, channel: str) -> Path:
    for name, text in Bench("drive", seconds=SECONDS).files("virtual", channel).items():
        (folder / name).write_text(text)
    return folder / "config.toml"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A capture of some seconds of the packaged drive, and its digest."""
    folder = tmp_path_factory.mktemp("bench")
    config = Config.load(write_config(folder, "replay-commands"))
    clock = SimulatedClock(utc_ns=1_700_000_000_000_000_000, monotonic_ns=1_000_000_000)
    bench = Bench("drive", seconds=SECONDS, start_ns=clock.monotonic_ns())
    path = folder / "a.mcap"
    with (
        can.Bus(interface="virtual", channel="replay-commands") as bus,
        Bridge(config, clock, out=path, lossless=True) as bridge,
    ):
        outcome = bridge.live(bench=Driver(bench, bus)).run()
    return path, outcome.digest


def test_a_bench_run_is_recorded_whole(recorded: tuple[Path, str]) -> None:
    capture = Capture(recorded[0])
    frames = list(capture.frames())
    # 200 Hz of three IMU frames, 50 Hz of odometer, 25 Hz of barometer, 5 Hz of six GNSS frames, and more
    assert len(frames) > SECONDS * (3 * 200 + 50 + 25 + 30)
    assert [frame.seq for frame in frames] == list(range(len(frames)))
    assert {"config.toml", "navbridge.dbc", "imu_calibration.toml"} <= set(capture.attachments)
    assert "filters" in capture.metadata


def test_replay_agrees_with_the_recording(
    recorded: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    path, digest = recorded
    assert main(["replay", str(path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"solution sha256: {digest}"


def test_golden_decides(recorded: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    path, digest = recorded
    assert main(["replay", str(path), "--golden", digest.upper()]) == 0
    assert main(["replay", str(path), "--golden", "0" * 64]) == 1
    assert f"expected {'0' * 64}, got {digest}" in capsys.readouterr().err


def test_a_capture_that_is_damaged_inside_is_not_said_to_differ(
    recorded: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(recorded[0].read_bytes())
    data[len(data) * 3 // 4] ^= 0x55  # behind the files that go with it
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data)
    assert main(["replay", str(path)]) == 1
    said = capsys.readouterr()
    assert "\ndamaged: a chunk cannot be read" in said.out
    assert "damaged, " in said.err
    assert "nothing behind the damage can be compared" in said.err


def test_a_capture_that_was_cut_off_early_does_not_claim_to_agree(
    recorded: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = recorded[0].read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: len(data) * 3 // 4])
    assert main(["replay", str(path)]) == 0
    out = capsys.readouterr().out
    assert "cut off: " in out
    assert "checkpoints: none in it" in out


def test_another_configuration_may_be_tried(
    recorded: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = recorded
    config = write_config(tmp_path, "other")
    assert main(["replay", str(path), "--config", str(config), "--csv", str(tmp_path / "a.csv")]) == 0
    # the same devices on another channel; four seconds may be too short for an attitude
    out = capsys.readouterr().out
    assert "solutions: 0 m horizontal, 0 m height, 0 m/s, 0 deg" in out or "nothing to compare" in out
    assert (tmp_path / "a.csv").read_text().startswith("t_ns,lat_deg,lon_deg,height_m,")


def test_run_records_and_prints_the_digest_last(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = write_config(tmp_path, "run-command")
    out = tmp_path / "run.mcap"
    assert main(["run", str(config), "--seconds", "0.3", "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("the time asked for is over")
    assert lines[-1].startswith("solution sha256: ")
    assert main(["replay", str(out), "--golden", lines[-1].split()[-1]]) == 0


def test_a_bus_that_is_not_there_leaves_no_capture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, "x")
    config.write_text(config.read_text().replace('"virtual"', '"socketcan"').replace('"x"', '"nosuchbus0"'))
    assert main(["run", str(config), "--out", str(tmp_path / "a.mcap")]) == 1
    assert 'cannot open socketcan "nosuchbus0"' in capsys.readouterr().err
    assert not (tmp_path / "a.mcap").exists()


def test_wishes_of_the_scheduler_that_are_refused_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, "refused")
    assert main(["run", str(config), "--seconds", "0.05", "--cpu", "9999"]) == 0
    assert "processor 9999 refused" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize(
    ("command", "option", "status"), [("replay", "--csv", 2), ("decode", "--out", 1), ("plot", "--out", 2)]
)
def test_a_disk_that_is_full_is_named(
    command: str, option: str, status: int, recorded: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, str(recorded[0]), option, "/dev/full"]) == status
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "/dev/full: " in error
