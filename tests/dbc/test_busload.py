"""Frame lengths against frames stuffed bit by bit, published numbers, and the default set."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.bus_messages import buses
from bridge.cli import busload as command
from bridge.config import Config
from bridge.errors import ConfigError
from dbc.busload import (
    FD_LENGTHS,
    Stream,
    bus_load,
    classic_bits,
    default_streams,
    default_table,
    fd_bits,
)
from virtual_bus.bus import Bench


def stuff_bits(bits: list[int]) -> int:
    """Stuff bits that a sender inserts: after five equal bits one of the other kind, which counts."""
    count, run, last = 0, 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run, last = count + 1, 1, 1 - bit
    return count


def worst_pattern(length: int) -> list[int]:
    """Five equal bits, then fours: 11111 0000 1111 ... makes every stuff bit the first of the next run."""
    bits, bit = [1] * 5, 0
    while len(bits) < length:
        bits += [bit] * 4
        bit = 1 - bit
    return bits[:length]


def crc15(bits: list[int]) -> list[int]:
    """ISO 11898-1: the generator of classic CAN, 0x4599."""
    crc = 0
    for bit in bits:
        invert = bit ^ (crc >> 14)
        crc = (crc << 1) & 0x7FFF
        if invert:
            crc ^= 0x4599
    return [crc >> i & 1 for i in range(14, -1, -1)]


def classic_frame(frame_id: int, data: bytes) -> list[int]:
    """All bits of a base-format data frame with the three bits between frames, without stuff bits."""
    bits = [0, *(frame_id >> i & 1 for i in range(10, -1, -1)), 0, 0, 0]
    bits += [len(data) >> i & 1 for i in range(3, -1, -1)]
    bits += [byte >> i & 1 for byte in data for i in range(7, -1, -1)]
    return bits + crc15(bits) + [1] * 13


@settings(deadline=None)
@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_a_real_frame_lies_between_the_bounds(frame_id: int, data: bytes) -> None:
    bits = classic_frame(frame_id, data)
    assert len(bits) == sum(classic_bits(len(data), stuffed=False))
    assert len(bits) + stuff_bits(bits[:-13]) <= sum(classic_bits(len(data), stuffed=True))


@pytest.mark.parametrize("length", range(9))
@pytest.mark.parametrize(("extended", "exposed"), [(False, 34), (True, 54)])
def test_the_classic_bound_is_reached(length: int, extended: bool, exposed: int) -> None:
    plain = sum(classic_bits(length, extended=extended, stuffed=False))
    worst = sum(classic_bits(length, extended=extended, stuffed=True))
    assert plain == exposed + 8 * length + 13
    assert worst - plain == stuff_bits(worst_pattern(exposed + 8 * length))


def test_published_lengths() -> None:
    # Davis et al. 2007: (55 + 10 s) bits with 11-bit, (80 + 10 s) bits with 29-bit identifiers
    for s in range(9):
        assert classic_bits(s, stuffed=True) == (55 + 10 * s, 0)
        assert classic_bits(s, extended=True, stuffed=True) == (80 + 10 * s, 0)


@pytest.mark.parametrize("length", FD_LENGTHS)
@pytest.mark.parametrize(("extended", "head"), [(False, 17), (True, 36)])
def test_fd_frames_field_by_field(length: int, extended: bool, head: int) -> None:
    plain = fd_bits(length, extended=extended, stuffed=False)
    worst = fd_bits(length, extended=extended, stuffed=True)
    crc, fixed = (17, 6) if length <= 16 else (21, 7)
    assert plain == (head + 2 + 7 + 3, 1 + 4 + 8 * length + 4 + crc + fixed + 1)
    assert sum(worst) - sum(plain) == stuff_bits(worst_pattern(head + 5 + 8 * length))
    assert worst.arbitration >= plain.arbitration
    assert worst.data >= plain.data


@pytest.mark.parametrize("length", [-1, 9, 64])
def test_no_such_classic_frame(length: int) -> None:
    with pytest.raises(ValueError, match=f"0 to 8 bytes, not {length}"):
        classic_bits(length, stuffed=True)


def test_no_such_fd_frame() -> None:
    with pytest.raises(ValueError, match="not 33"):
        fd_bits(33, stuffed=True)


def test_load_of_a_known_set() -> None:
    # 1000 frames of 135 bits a second and 100 of 111..., by hand
    load = bus_load("two", [Stream("a", 1, 8, False, 1000.0), Stream("b", 0x800, 0, False, 100.0)], 500_000)
    assert load.load_worst == pytest.approx((1000 * 135 + 100 * 80) / 500_000)
    assert load.load_plain == pytest.approx((1000 * 111 + 100 * 67) / 500_000)


def test_the_data_phase_runs_at_its_own_rate() -> None:
    stream = [Stream("a", 1, 64, True, 1000.0)]
    slow, fast = bus_load("", stream, 1_000_000), bus_load("", stream, 1_000_000, 4_000_000)
    bits = fd_bits(64, stuffed=True)
    assert slow.load_worst == pytest.approx(1e-3 * sum(bits))
    assert fast.load_worst == pytest.approx(1e-3 * (bits.arbitration + bits.data / 4))


def test_the_default_set_fits_one_megabit() -> None:
    low, high = default_table()
    assert 0.0 < low.load_plain < low.load_worst < high.load_worst
    assert low.load_worst < 0.4
    # three frames of 135 bits at 1 kHz alone are 40.5 %
    assert 0.405 < high.load_worst < 0.8
    sample = {row.name: row.rate_hz for row in high.rows}
    assert sample["IMU_GYRO"] == sample["IMU_TIME"] == 1000.0
    assert sample["SOL_LAT"] == 50.0
    assert sample["ODO"] == 100.0
    assert sample["SOL_REJECTS"] == 11.0
    # which come ten times a second while there is an alignment, whatever the solution's rate
    assert sample["SOL_ALIGN"] == sample["SOL_TRANSFER"] == 10.0
    assert "COMMAND" not in sample
    assert "IMU_FD" not in sample


def test_the_fd_set_replaces_the_three_frames() -> None:
    names = {stream.name for stream in default_streams(200.0, fd=True)}
    assert "IMU_FD" in names
    assert not names & {"IMU_GYRO", "IMU_ACCEL", "IMU_TIME"}


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return parser.parse_args(["busload", *words])


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    status = command.run(parsed(*words))
    return status, capsys.readouterr().out


def test_the_command_prints_tables(capsys: pytest.CaptureFixture[str]) -> None:
    status, out = run(capsys)
    assert status == 0
    assert "IMU 200 Hz" in out
    assert "IMU 1000 Hz" in out
    assert out.count("fits:") == 2


def test_the_command_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    status, out = run(capsys, "--json", "--imu-rate", "400", "--fd", "--data-bitrate", "4000000")
    (load,) = json.loads(out)
    assert status == 0
    assert load["data_bitrate"] == 4_000_000
    assert load["load_worst"] == pytest.approx(sum(row["load_worst"] for row in load["rows"]))


def test_an_overloaded_bus_is_said_and_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    status, out = run(capsys, "--imu-rate", "1000", "--bitrate", "500000")
    assert status == 1
    assert "does not fit" in out


@pytest.mark.parametrize("scenario", ["redundant", "transfer", "mems_drive"])
def test_a_configuration_has_the_messages_that_are_sent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scenario: str
) -> None:
    bench = Bench(scenario, seconds=10.0)
    for name, text in bench.files("virtual", "bench").items():
        (tmp_path / name).write_text(text)
    status, out = run(capsys, str(tmp_path / "config.toml"), "--json")
    loads = json.loads(out)
    assert status == 0
    told = {row["frame_id"]: row["rate_hz"] for load in loads for row in load["rows"]}
    heard = Counter(frame.frame_id for frame in bench.due(bench.end_ns))
    # those of the bridge begin at 0x200
    assert set(heard) == {key for key in told if key < 0x200}
    imu = bench.scenario.imu.rate_hz
    assert told[0x100] == told[0x102] == imu
    assert (0x105 in told) == (scenario == "redundant")
    assert told.get(0x106, imu) == imu
    # the bench's other devices may be set to other rates than the contract's
    assert told[0x200] == 50.0
    assert (0x20F in told) == (scenario == "redundant")
    assert (0x210 in told) == (scenario == "transfer")


def test_what_a_configuration_says_is_not_said_twice(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--imu-rate: found one with bench, which has its own"):
        command.run(parsed("bench", "--imu-rate", "200"))
    (load,) = buses(Config.load("bench"), 125_000, None, fd=True)
    assert load.load.bitrate == 125_000
    names = [row.name for row in load.load.rows]
    assert "IMU_FD" in names
    assert "IMU_GYRO" not in names
    (log,) = buses(Config.load("can_gnss_imu_log"), 1_000_000, None, fd=False)
    assert log.others


@pytest.mark.parametrize("words", [("--imu-rate", "0"), ("--imu-rate", "nan"), ("--bitrate", "-1")])
def test_senseless_arguments_are_refused(capsys: pytest.CaptureFixture[str], words: tuple[str, str]) -> None:
    with pytest.raises(SystemExit):
        run(capsys, *words)
