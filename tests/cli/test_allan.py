"""``navbridge allan``: the noise of a simulated unit is found, and what cannot be looked at is refused."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bridge.cli import main
from bridge.config import Config
from bridge.frame import RawFrame
from bridge.importers.capture import write_capture
from tests.realdata.mems_drive import FOLDER
from tests.recordings import needs_recording
from virtual_bus import scenario
from virtual_bus.bus import Bench
from virtual_bus.grades import GRADES

replace = msgspec.structs.replace
SECONDS = 240.0


def captured(
    path: Path, seconds: float, name: str = "static_rlg", keep: Callable[[int], bool] = lambda t_ns: True
) -> Path:
    """A unit of the middle grade at 50 Hz; frames that are not to be kept are lost."""
    what = scenario.load(name)
    what = replace(what, grade="fog", gnss=None, fault=[], imu=replace(what.imu, rate_hz=50.0))
    bench = Bench(what, seed=4, seconds=seconds)
    config = Config.from_files(bench.files("virtual", "bench"))
    frames = [RawFrame(0, f.t_ns, 1, f.frame_id, f.data) for f in bench.due(bench.end_ns) if keep(f.t_ns)]
    write_capture(path, frames, config, 0, "the bench")
    return path


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return captured(tmp_path_factory.mktemp("allan") / "a.mcap", SECONDS)


def test_the_grade_of_a_unit_is_found(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, out = tmp_path / "a.png", tmp_path / "a.toml"
    assert main(["allan", str(capture), "--picture", str(picture), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert picture.read_bytes().startswith(b"\x89PNG")
    grade = GRADES["fog"]
    for kind, size, pulse in (
        ("gyro", grade.gyro_random_walk_deg_per_sqrt_h, grade.gyro_arcsec_per_pulse),
        ("accel", grade.accel_random_walk_ug_per_sqrt_hz, 1e3 * grade.accel_m_s_per_pulse),
    ):
        for axis in found[kind]["axes"].values():
            # 12000 samples tell a walk to 1 %, beside the rounding to 2 %: three sigmas are 6 %
            assert axis["random walk"]["value"] == pytest.approx(size, rel=0.06)
            # an even distribution over a pulse
            low, high = axis["quantisation"]["interval"]
            assert low < 1.2 * pulse / np.sqrt(12.0)
            assert high > 0.8 * pulse / np.sqrt(12.0)
            # 30 minutes of correlation do not show in four
            assert axis["drift"]["value"] is None
    lines = out.read_text()
    table = tomllib.loads(lines)["navigator"]["main"]["imu_errors"]
    own = tomllib.loads(Bench(scenario.load("static_rlg"), seconds=1.0).config_toml("virtual", "x"))
    assert set(table) <= set(own["navigator"]["main"]["imu_errors"])
    assert table["gyro_random_walk_deg_per_sqrt_h"] == pytest.approx(
        grade.gyro_random_walk_deg_per_sqrt_h, rel=0.06
    )
    assert "# gyro_instability_deg_per_h does not show: below" in lines
    assert main(["allan", str(capture)]) == 0
    said = capsys.readouterr().out
    assert "a.mcap: imu, 240 s at rest, 50 Hz" in said
    assert said.endswith(lines)


def test_a_part_of_it_is_asked_for(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["allan", str(capture), "--start", "20", "--seconds", "60", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["seconds"] == pytest.approx(60.0, abs=0.05)


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["allan", *words]) in (1, 2)
    return capsys.readouterr().err


def test_what_cannot_be_looked_at_is_refused(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused([str(capture), "--seconds", "8"], capsys)
    assert " samples in 8.0 s, expected at least 576 and 10 s" in said
    assert 'device: found "gnss", expected one of imu' in refused([str(capture), "--device", "gnss"], capsys)
    gap = captured(tmp_path / "gap.mcap", 40.0, keep=lambda t_ns: not 20.0e9 < t_ns < 20.5e9)
    said = refused([str(gap)], capsys)
    assert "gap.mcap: imu: samples are missing before it, 20.4" in said
    moving = captured(tmp_path / "moving.mcap", 90.0, "mems_drive")
    said = refused([str(moving)], capsys)
    assert "moving.mcap: imu: the unit was moved" in said
    assert "see --start and --seconds" in said


@needs_recording("drive_mems_rtk")
def test_a_real_unit_on_a_standing_car(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its curve against a sum over the table itself; what its engine shakes is told to be no noise."""
    path = tmp_path / "drive.mcap"
    assert main(["import", "csv", "drive_mems_rtk", "--data", str(FOLDER), "--out", str(path)]) == 0
    capsys.readouterr()
    assert "the unit was moved" in refused([str(path)], capsys)
    assert main(["allan", str(path), "--seconds", "18", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["gyro"]
    table = np.genfromtxt(FOLDER / "imu.csv", delimiter=",", names=True)
    # the first row only begins the first interval
    rate = 3600.0 * table["gyro_z_deg_s"][1 : 1 + round(18.0 / 0.01)]
    angle = np.concatenate(([0.0], np.cumsum(rate)))
    for place in (0, 3, 6):
        m = 2**place
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        want = np.sqrt(np.mean(second**2) / 2.0) / m
        # the mounting of the sensor's axes, and the last samples of the 18 s
        assert found["deviation"][2][place] == pytest.approx(want, rel=0.02)
    assert main(["allan", str(path), "--seconds", "18"]) == 0
    assert "no such sum" in capsys.readouterr().out
