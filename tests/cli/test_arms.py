"""Arms of a simulated unit that sways about a fixed point, out of a capture and back into its calibration."""

from __future__ import annotations

import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bridge.calibration import read_calibration
from bridge.cli import main
from bridge.config import Config
from bridge.frame import RawFrame
from bridge.importers.capture import write_capture
from virtual_bus import scenario
from virtual_bus.bus import Bench
from virtual_bus.scenario import Scenario
from virtual_bus.truth import mounting_matrix

replace = msgspec.structs.replace
ARMS = ((35.0, 10.0, -20.0), (15.0, -40.0, 10.0), (-10.0, 20.0, 45.0))
SECONDS = 25.0


def swaying() -> Scenario:
    """Heading, pitch and roll swing about the place where the vehicle stands, from the first instant on."""
    what = scenario.load("dithered")
    assert what.sway is not None
    imu = replace(what.imu, dither_hz=None, inner_arms_mm=ARMS, rate_hz=100.0)
    vehicle = replace(what.vehicle, imu_m=(0.02, 0.03, 0.05))
    sway = replace(what.sway, heading_deg=6.0, begins_s=None)
    navigator = replace(what.navigator, whole_cycle=None)
    return replace(what, imu=imu, vehicle=vehicle, sway=sway, navigator=navigator, gnss=None, fault=[])


def captured(path: Path, what: Scenario) -> Path:
    bench = Bench(what, seed=3, seconds=SECONDS)
    config = Config.from_files(bench.files("virtual", "bench"))
    frames = [RawFrame(0, f.t_ns, 1, f.frame_id, f.data) for f in bench.due(bench.end_ns)]
    write_capture(path, frames, config, 0, "the bench")
    return path


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return captured(tmp_path_factory.mktemp("arms") / "a.mcap", swaying())


def test_arms_are_found_within_their_sigmas(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["arms", str(capture), "--origin", "turn", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    what = swaying()
    # the bench's unit hangs on its mounting angles, off the point about which all sways
    C_vb = mounting_matrix(*what.vehicle.mounting_deg)
    want = 1e3 * np.array(what.vehicle.imu_m) @ C_vb + np.array(ARMS)
    sigma = np.array(found["sigma_mm"])
    assert sigma.max() < 1.0
    z = (np.array(found["lever_arm_mm"]) - want) / sigma
    # whole pulses are taken for white noise, which makes sigmas too large, never too small
    assert np.abs(z).max() < 4.0


def test_arms_go_into_the_calibration(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "with.toml"
    assert main(["arms", str(capture), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^y +-?\d+\.\d+ \+-", said, re.MULTILINE)
    made = read_calibration(out.read_bytes(), "with.toml").calibration
    sheet = Bench(swaying(), seed=3, seconds=1.0).calibration_toml()
    old = read_calibration(sheet.encode(), "old").calibration
    np.testing.assert_array_equal(made.table(), old.table())
    # from where the axes meet: 60 mm up of where the unit was held, and what was known before is replaced
    along = np.einsum("ij,ij->i", made.accel_arms, made.accel_axes)
    across = made.accel_arms - along[:, None] * made.accel_axes
    assert np.abs(np.sum(across, axis=0)).max() < 1e-4
    assert main(["arms", str(capture), "--calibration", str(out), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(again["lever_arm_mm"], 1e3 * made.accel_arms, atol=1e-3)


def test_turns_about_one_axis_are_told_not_to_be_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    what = swaying()
    assert what.sway is not None
    heading = replace(what.sway, pitch_deg=0.0, roll_deg=0.0)
    vehicle = replace(what.vehicle, mounting_deg=(0.0, 0.0, 0.0), roll_deg_per_g=0.0)
    path = captured(tmp_path / "b.mcap", replace(what, sway=heading, vehicle=vehicle))
    assert main(["arms", str(path)]) == 1
    said = capsys.readouterr().err
    shown = "the turns do not show the arm of accelerometer 1 up, accelerometer 2 up, accelerometer 3 right"
    assert shown in said
    assert main(["arms", str(path), "--calibration", str(tmp_path / "none.toml")]) == 2
    assert "no such file" in capsys.readouterr().err
