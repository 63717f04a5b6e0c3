"""A redundant unit on the simulated turntable: its capture, and the calibration that the driver reads."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from bridge import calibration_plan
from bridge.calibration_sensors import RedundantFile, read_unit
from bridge.cli import main
from bridge.studies.turntable import scenario_of
from tests.cli.test_calibrate import RATE, SEED, plan_text
from virtual_bus.bus import Bench
from virtual_bus.grades import DEG_PER_H, UG


@pytest.mark.parametrize(("axes", "n"), [("cone", 6), ("skew", 5)])
def test_from_the_table_to_the_calibration_file(axes, n, tmp_path, capsys) -> None:
    plan, capture, out = tmp_path / "plan.toml", tmp_path / "table.mcap", tmp_path / "imu.toml"
    plan.write_text(plan_text())
    words = ["sim", "turntable", str(plan), "--grade", "rlg", "--rate-hz", str(RATE), "--axes", axes]
    assert main([*words, "--seed", str(SEED), "--out", str(capture)]) == 0
    capsys.readouterr()
    assert main(["calibrate", str(plan), str(capture), "--out", str(out)]) == 0
    report = capsys.readouterr().out
    assert f"gyro {n} bias" in report
    assert f"accel {n} axes z" in report

    file = read_unit(out.read_bytes(), "imu.toml")
    table = scenario_of(calibration_plan.load(plan), None, "rlg", RATE, axes=axes)
    unit = Bench(table, seed=SEED, seconds=1.0).imu_errors
    assert isinstance(file, RedundantFile)
    assert file.certificate is not None
    assert file.serial == unit.serial
    sigma = tomllib.loads(out.read_text())["sigma"]
    for found, true, told in (
        (file.gyros.bias, unit.gyro.bias, DEG_PER_H * np.array(sigma["gyro"]["bias_deg_per_h"])),
        (file.accels.bias, unit.accel.bias, UG * np.array(sigma["accel"]["bias_ug"])),
        (file.gyros.axes, unit.gyro.axes, np.array(sigma["gyro"]["axes"])),
        (file.accels.axes, unit.accel.axes, np.array(sigma["accel"]["axes"])),
    ):
        assert found.shape == true.shape == told.shape
        assert len(found) == n
        # those of one kind share the errors of the table, so that all may be off by the same three sigmas;
        # axes are as long as makes their part along the nominal one 1, which is another length by 1e-8
        assert np.sqrt(np.mean((found - true) ** 2 / (told**2 + 1e-16))) < 3.0
