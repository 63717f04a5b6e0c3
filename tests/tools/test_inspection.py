"""Inspecting, decoding and plotting captures: counts, complaints, and files that were cut off."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from bridge.cli import decode as decode_command
from bridge.cli import inspect as inspect_command
from bridge.cli import plot as plot_command
from bridge.config import Config
from bridge.errors import CaptureError
from bridge.frame import RawFrame
from bridge.importers import frames as wire
from bridge.importers.capture import write_capture
from bridge.inspection import inspect
from bridge.recording import Capture
from dbc.codec import contract
from nav.types import FixType

SECONDS = 12.0
CONFIG = """
[source.can0]
type = "can"
interface = "virtual"
channel = "x"
bitrate = 500000
[device.imu]
driver = "imu_can"
source = "can0"
calibration = "imu.toml"
rate_hz = 100
id_offset = 0x40
[device.gnss]
driver = "gnss_can"
source = "can0"
[device.odometer]
driver = "odometer_can"
source = "can0"
m_per_tick = 0.01
[navigator.main]
devices = ["imu", "gnss", "odometer"]
"""
CALIBRATION = """
[gyro]
scale_arcsec_per_pulse = [0.1, 0.1, 0.1]
[accel]
scale_m_s_per_pulse = [1e-5, 1e-5, 1e-5]
"""
OFFSET_NS = 1_750_000_000_000_000_000

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """A capture of a vehicle at rest; the keywords put something wrong into it."""

    def build(
        gravity: float = 9.81,
        sigma: float = 1.0,
        lose: tuple[int, int] = (0, 0),
        spoil: int = 0,
        stranger: int = 0,
    ) -> Path:
        (tmp_path / "c.toml").write_text(CONFIG)
        (tmp_path / "imu.toml").write_text(CALIBRATION)
        config = Config.load(tmp_path / "c.toml")
        n = round(SECONDS * 100)
        rng = np.random.default_rng(2)
        times = [1_000_000_000 + k * 10_000_000 for k in range(n)]
        dt = np.full(n, 0.01)
        rate = 0.001 * rng.standard_normal((n, 3))
        force = np.array([0.0, 0.0, gravity]) + 0.01 * rng.standard_normal((n, 3))
        arcsec = np.pi / 180.0 / 3600.0
        gyro = wire.pulses(rate, dt, np.full(3, 0.1 * arcsec), np.full(3, 0.1 * arcsec))
        accel = wire.pulses(force, dt, np.full(3, 1e-5), np.full(3, 1e-5))
        sent = list(
            wire.imu_frames(
                times, gyro, accel, list(range(n)), delay_ns=0, id_offset=0x40, temperature_deg_c=20.0
            )
        )
        sent = [item for k, item in enumerate(sent) if not lose[0] <= k // 3 < lose[1]]
        count = round(SECONDS * 5)
        fixes = wire.Fixes(
            [1_000_000_000 + k * 200_000_000 for k in range(count)],
            18,
            np.full(count, 48.0),
            np.full(count, 11.0),
            np.full(count, 500.0),
            np.full((count, 3), sigma),
            np.zeros((count, 3)),
            np.full((count, 3), 0.05),
            [FixType.FIX_3D] * count,
            9,
        )
        sent += wire.gnss_frames(fixes, [True] * count, delay_ns=60_000_000, id_offset=0)
        sent.sort(key=lambda item: item.t_ns)
        received = [RawFrame(k, item.t_ns, 1, item.key, item.data) for k, item in enumerate(sent)]
        for k in range(spoil):
            at = next(i for i, f in enumerate(received) if i > 300 + 90 * k and f.key == 0x142)
            data = bytearray(received[at].data)
            data[3] ^= 0x10
            received[at] = received[at]._replace(data=bytes(data))
        last = received[-1]
        received += [last._replace(key=0x555) for _ in range(stranger)]
        path = tmp_path / "run.mcap"
        write_capture(path, received, config, OFFSET_NS, "made up")
        return path

    return build


def text_of(path: Path) -> list[str]:
    return [f"{finding.device}: {finding.text}" for finding in inspect(Capture(path)).findings]


def test_a_sound_capture_is_counted(make: Make) -> None:
    report = inspect(Capture(make()))
    # nobody put an odometer on this bus
    assert [finding.device for finding in report.findings] == ["odometer"]
    assert "no frame of it" in report.findings[0].text
    assert (report.damage, report.complete, report.origin) == (None, True, "made up")
    imu, gnss, odometer = report.devices
    assert (imu.samples, imu.frames, imu.missing, imu.gaps, imu.rejects) == (1200, 3600, 0, 0, {})
    assert imu.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert (gnss.samples, gnss.rate_hz) == (60, pytest.approx(5.0, rel=1e-3))
    assert odometer.frames == 0
    streams = {row.key: row for row in report.streams}
    assert streams["140"].name == "IMU_GYRO"  # shifted by id_offset
    assert streams["130"].name == "GNSS_TIME"
    # 300 frames a second of 8 bytes and 6 x 5 more: 111 bits each without stuffing, at 500 kbit/s
    assert report.buses[0].load == pytest.approx(330 * 111 / 500_000, rel=0.02)
    assert report.buses[0].load_worst == pytest.approx(330 * 135 / 500_000, rel=0.02)


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ({"gravity": 1.0}, "m/s^2, expected 9.8; looks like g where m/s^2 is meant"),
        ({"gravity": -9.81}, "imu: gravity lies along -z, expected +z"),
        ({"sigma": 0.0}, "gnss: SIGMA_E is zero in 60 frames"),
    ],
)
def test_what_is_wrong_is_said(make: Make, what: dict[str, float], expected: str) -> None:
    found = text_of(make(**what))
    assert any(expected in line for line in found), found


def test_two_devices_on_one_identifier_are_named(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.tools.test_inspection.CONFIG", CONFIG.replace("0x40", "0x20"))
    assert "odometer: takes identifier 120 on can0, as imu does" in text_of(make())


def test_losses_and_bad_frames_are_counted(make: Make) -> None:
    report = inspect(Capture(make(lose=(500, 520), spoil=3, stranger=7)))
    imu = report.devices[0]
    assert imu.gaps >= 1
    assert imu.longest_gap_ms == pytest.approx(210.0, abs=1.0)
    # the twenty that are not there and the three whose last frame failed its CRC, these made up by the driver
    assert (imu.missing, imu.bridged) == (23, 3)
    assert "23 samples missing, 3 of them made up" in [finding.text for finding in report.findings]
    assert imu.rejects["CRC"] == 3
    assert report.unknown_frames == 7
    assert {row.key: row.name for row in report.streams}["555"] == ""


@pytest.mark.parametrize(
    ("lose", "expected"),
    [
        ((300, 450), ["imu: silent for 1.5 s, 3.0 s after the start"]),
        ((900, 1200), ["imu: silent for the last 2.9 s of the capture"]),
        ((300, 330), []),
    ],
)
def test_a_device_that_falls_silent_looks_wrong(
    make: Make, lose: tuple[int, int], expected: list[str]
) -> None:
    # the last sample left is that of 9.99 s; the GNSS goes on, its last fix of 12.8 s arriving 60 ms later
    assert [text for text in text_of(make(lose=lose)) if "silent" in text] == expected


def test_a_cut_off_capture_is_inspected_up_to_the_cut(make: Make, tmp_path: Path) -> None:
    path = make()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.7)])
    report = inspect(Capture(cut))
    assert report.damage
    assert any(report.damage in finding.text for finding in report.findings)
    assert not report.complete
    assert 0 < report.devices[0].samples <= 1200


def run(module: object, words: list[str]) -> int:
    parser = argparse.ArgumentParser()
    module.add_parser(parser.add_subparsers())  # type: ignore[attr-defined]
    return int(module.run(parser.parse_args(words)))  # type: ignore[attr-defined]


def test_the_command_prints_for_people_and_for_programs(
    make: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make(gravity=1.0)
    assert run(inspect_command, ["inspect", str(path)]) == 0
    said = capsys.readouterr().out
    assert "IMU_GYRO" in said
    assert "specific force when quiet" in said
    assert run(inspect_command, ["inspect", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["devices"][0]["samples"] == 1200
    assert document["findings"][0]["device"] in ("imu", "odometer")


def test_the_view_holds_every_message_decoded(make: Make, tmp_path: Path) -> None:
    path, out = make(stranger=3), tmp_path / "view.mcap"
    assert run(decode_command, ["decode", str(path), "--out", str(out)]) == 0
    topics: dict[str, list[dict[str, float]]] = {}
    with out.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            assert json.loads(schema.data)["type"] == "object"
            topics.setdefault(channel.topic, []).append(json.loads(message.data))
            assert message.log_time >= OFFSET_NS
    assert len(topics["/can0/IMU_GYRO"]) == 1200
    assert len(topics["/can0/GNSS_LAT"]) == 60
    assert topics["/can0/GNSS_LAT"][0] == {"LAT": 48.0, "SIGMA_N": 1.0}
    assert set(topics["/can0/IMU_TIME"][0]) == set(contract()["IMU_TIME"].signals)
    assert "/bridge/START" in topics
    assert not any("555" in topic for topic in topics)


def test_a_capture_is_not_overwritten_by_its_own_view(make: Make) -> None:
    path = make()
    with pytest.raises(CaptureError, match="is the capture itself"):
        run(decode_command, ["decode", str(path), "--out", str(path)])
    assert inspect(Capture(path)).devices[0].samples == 1200


def test_plot_names_the_pictures_it_wrote(
    make: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(plot_command, ["plot", str(make()), "--out", str(tmp_path / "new" / "folder")]) == 0
    paths = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert {"track", "rates"} <= {path.stem for path in paths}
    assert all(path.is_file() for path in paths)
