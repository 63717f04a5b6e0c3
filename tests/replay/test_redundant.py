"""A drive on which sensors of a redundant unit fail: it goes on, all hear of it, and a replay is equal."""

from __future__ import annotations

import re
from pathlib import Path

import can
import pytest

from bridge.cli import main
from bridge.cli.demo import CHANNEL
from dbc.codec import contract

FAULTS = """
[[fault]]
kind = "sensor_bias"
sensor = "gyro"
number = 4
start_s = 22.0
duration_s = 1e6
bias_deg_per_h = 180.0
[[fault]]
kind = "sensor_dead"
sensor = "accel"
number = 2
start_s = 26.0
duration_s = 1e6
told = true
"""
DRIVE = """
title = "cone"
grade = "fog"
[start]
lat_deg = 48.0
lon_deg = 11.0
heading_deg = 65.0
[imu]
axes = "cone"
rate_hz = 100.0
[odometer]
[baro]
[gnss]
[[manoeuvre]]
kind = "static"
duration_s = 16.0
[[manoeuvre]]
kind = "accelerate"
duration_s = 6.0
speed_m_s = 12.0
[[manoeuvre]]
kind = "turn"
duration_s = 6.0
angle_deg = 70.0
[[manoeuvre]]
kind = "s_turns"
duration_s = 8.0
angle_deg = 20.0
count = 1
"""
ROWS = ("horizontal (m)", "height (m)", "velocity (m/s)", "heading (deg)", "level (deg)")


def rms(said: str) -> dict[str, float]:
    return {row: float(re.findall(re.escape(row) + r"\s+([\d.]+)", said)[0]) for row in ROWS}


def test_navigation_goes_on_and_the_bus_names_the_axis(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--seed", "3", "--seconds", "36", "--speed", "max", "--no-view", "--mavlink", "none", "--out"]
    said = {}
    health = contract()["SOL_IMU_HEALTH"]
    told: list[tuple[float, ...]] = []
    for name, faults in (("failed", FAULTS), ("healthy", "")):
        path = tmp_path / f"{name}.toml"
        path.write_text(DRIVE + faults)
        with can.Bus(interface="virtual", channel=CHANNEL) as listener:
            assert main(["demo", str(path), *words, str(tmp_path / f"{name}.mcap")]) == 0
            said[name] = capsys.readouterr().out
            while (message := listener.recv(0)) is not None:
                if message.arbitration_id == health.frame_id and name == "failed":
                    assert health.crc_ok(bytes(message.data))
                    told.append(health.decode(bytes(message.data)))

    # 0.05 deg/s are 25 sigmas of a sample of 10 ms, and what the unit says of itself is known at once
    changes = re.findall(r"imu: (.*) after ([\d.]+) s", said["failed"])
    assert [text for text, _ in changes] == ["gyro 4 out", "gyro 4 out, accelerometer 2 out"]
    for (_, found_s), start_s in zip(changes, (22.0, 26.0), strict=True):
        assert 0.0 < float(found_s) - start_s < 0.03
    assert " out after " not in said["healthy"]
    # once a second, and at the changes
    masks = [frame[1:5] for frame in told]
    assert masks == sorted(masks)
    assert {*masks} == {(0, 0, 0, 0), (8, 0, 0, 0), (8, 0, 2, 0)}
    assert len(masks) == pytest.approx(35 + 2, abs=1)
    ages = [frame[5] for frame in told]
    assert [ages[masks.index(mask)] for mask in ((8, 0, 0, 0), (8, 0, 2, 0))] == [0, 0]

    failed, healthy = rms(said["failed"]), rms(said["healthy"])
    for row in ROWS:
        assert failed[row] < 2.0 * healthy[row], row

    capture = str(tmp_path / "failed.mcap")
    assert main(["replay", capture]) == 0
    agree = re.search(r"checkpoints: (\d+) of (\d+) agree", capsys.readouterr().out)
    assert agree is not None
    assert int(agree[1]) == int(agree[2]) > 15
    assert main(["inspect", capture]) == 0
    report = capsys.readouterr().out
    assert "gyro 4 out, 22.0 s after the start" in report
    assert "gyro 4 out, accelerometer 2 out, 26.0 s after the start" in report
