"""Accelerometers that sit apart, found by the rotations of a calibration and written into its file."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest

from bridge import calibrating
from bridge.arms import of_turns
from bridge.calibration import read_calibration
from bridge.calibration_capture import record
from bridge.calibration_plan import read
from bridge.config import Config
from bridge.frame import RawFrame
from bridge.importers.capture import write_capture
from bridge.recording import Capture
from bridge.studies.turntable import scenario_of
from nav.imu.size_effect import meeting_point
from nav.imu.size_fit import Arms
from tests.cli.test_calibrate import plan_text
from virtual_bus.bus import Bench

replace = msgspec.structs.replace
ARMS_MM = ((35.0, 10.0, -20.0), (15.0, -40.0, 10.0), (-10.0, 20.0, 45.0))


PLAN = read(plan_text(dwell=6.0).encode(), "plan.toml")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    scenario = scenario_of(PLAN, None, "rlg", 25.0)
    scenario = replace(scenario, imu=replace(scenario.imu, inner_arms_mm=ARMS_MM))
    bench = Bench(scenario, seed=5)
    config = Config.from_files(bench.files("virtual", "bench"))
    frames = [RawFrame(0, f.t_ns, 1, f.frame_id, f.data) for f in bench.due(bench.end_ns)]
    path = tmp_path_factory.mktemp("arms") / "table.mcap"
    write_capture(path, frames, config, 0, "the bench")
    return record(Capture(path), None)


@pytest.fixture(scope="module")
def result(recorded):
    return calibrating.calibrate(PLAN, None, [recorded])


def file_of(result):
    return read_calibration(calibrating.file_of(result).encode(), "imu.toml").calibration


def test_arms_are_found_with_the_coefficients(result):
    assert isinstance(result.arms, Arms)
    c = file_of(result)
    # counted from where the sensors' axes meet
    true = np.array(ARMS_MM)
    want = true - meeting_point(c.accel_axes, true)
    sigma = 1e3 * result.arms.sigma()
    # 60 deg/s for 5 s against 8 ug/sqrt(Hz): well below a millimetre along each axis
    assert sigma.max() < 1.0
    # whole pulses are taken for white noise, which makes sigmas too large, never too small
    assert np.abs((1e3 * c.accel_arms - want) / sigma).max() < 4.0
    document = calibrating.document_of(result)
    np.testing.assert_allclose(document["sigma"]["accel"]["lever_arm_mm"], sigma, atol=1e-6)
    assert any("accel z lever arm up" in line for line in calibrating.lines_of(result))
    # the sheet that the capture was made with has arms from the unit's origin, and they are replaced
    assert "lever_arm_m" not in document["accel"]


def test_what_the_rotations_do_not_show_is_named_and_what_was_known_stays(recorded, result):
    about_x = [one for one in result.intervals if not one.rotation or "x in" in one.name]
    with pytest.raises(ValueError, match="do not show the arm of accelerometer 1 right"):
        of_turns([recorded.stream], about_x, file_of(result))
    hidden = dataclasses.replace(result, arms="the turns do not show the arm of accelerometer 1 right")
    assert "arms of the accelerometers: the turns do not show" in "\n".join(calibrating.lines_of(hidden))
    np.testing.assert_allclose(1e3 * file_of(hidden).accel_arms, ARMS_MM, atol=1e-9)
