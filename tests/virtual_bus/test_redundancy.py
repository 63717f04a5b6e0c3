"""Redundant units on the bench: directions, frames, faults of single sensors, the bridge's files."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from bridge.cli import main
from dbc.codec import contract
from nav.imu.geometry import GEOMETRIES
from virtual_bus import scenario
from virtual_bus.bus import Bench
from virtual_bus.faults import Faults, SensorBias, SensorDead, SensorStuck
from virtual_bus.grades import ARCSEC, GRADES, draw_imu
from virtual_bus.redundancy import AXES, NO_COUNT
from virtual_bus.scenario import ScenarioError
from virtual_bus.sensors import Imu, generator

replace = msgspec.structs.replace


@pytest.mark.parametrize("name", AXES)
def test_the_sensors_look_where_the_program_believes(name: str) -> None:
    np.testing.assert_allclose(AXES[name], GEOMETRIES[name], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(AXES[name], axis=1), 1.0, atol=1e-15)


def counts(ride, faults: list, seconds: int = 12) -> np.ndarray:
    grade = GRADES["fog"]
    unit = draw_imu(grade, generator(1, "unit"), AXES["cone"])
    imu = Imu(ride, grade, unit, generator(1, "imu"), Faults(faults))
    t = np.arange(seconds * 100 + 1) * 10_000_000
    return np.concatenate([imu.block(t[k : k + 101])[0] for k in range(0, 100 * seconds, 100)])


def test_a_fault_is_of_its_sensor_and_its_time(ride) -> None:
    plain = counts(ride, [])
    assert plain.shape == (1200, 12)
    faults = [
        SensorBias(start_s=3.0, duration_s=2.0, sensor="gyro", number=4, bias_deg_per_h=360.0),
        SensorBias(start_s=4.0, duration_s=4.0, sensor="accel", number=1, bias_ug=1000.0, ramp_s=2.0),
        SensorStuck(start_s=5.0, duration_s=1.0, sensor="gyro", number=6),
        SensorDead(start_s=6.0, duration_s=1.0, sensor="accel", number=6),
        SensorDead(start_s=7.0, duration_s=1.0, sensor="accel", number=2, told=True),
    ]
    failed = counts(ride, faults)
    off = failed - plain
    assert {int(k) for k in np.flatnonzero(np.any(off != 0, axis=0))} == {3, 5, 6, 7, 11}
    # 0.1 deg/s for two seconds in pulses of 0.1 arcsec, a scale within 300 ppm; what rounds stays within one
    np.testing.assert_allclose(off[:, 3].sum(), 0.2 * 3600.0 / 0.1, rtol=2e-3)
    assert np.flatnonzero(np.abs(off[:, 3]) > 1).tolist() == list(range(300, 500))
    # the line of 1 mg in two seconds, over four: 8 mg s / 2
    np.testing.assert_allclose(off[:, 6].sum() * 2e-5, 4e-3 * 9.80665, rtol=2e-3)
    # a count is there at the end of its sample
    assert (failed[499:599, 5] == plain[498, 5]).all()
    assert not failed[599:699, 11].any()
    assert (failed[699:799, 7] == NO_COUNT).all()


@pytest.mark.parametrize(("axes", "n"), [("cone", 6), ("skew", 5)])
def test_five_frames_carry_a_sample(axes: str, n: int) -> None:
    what = scenario.load("redundant")
    bench = Bench(replace(what, imu=replace(what.imu, axes=axes), fault=[]), seed=2, seconds=1.0)
    names = ("IMU_GYRO", "IMU_GYRO_2", "IMU_ACCEL", "IMU_ACCEL_2", "IMU_TIME")
    codecs = {contract()[name].frame_id: contract()[name] for name in names}
    frames = [f for f in bench.due(bench.end_ns) if f.frame_id in codecs]
    assert [codecs[f.frame_id].name for f in frames] == list(names) * (len(frames) // 5)
    for k in range(0, len(frames), 5):
        five = frames[k : k + 5]
        assert len({codecs[f.frame_id].alive(f.data) for f in five}) == 1
        assert all(codecs[f.frame_id].crc_ok(f.data) for f in five)
        for place in (0, 2):
            values = [v for f in five[place : place + 2] for v in codecs[f.frame_id].decode(f.data)[3:]]
            assert all(v != NO_COUNT for v in values[:n])
            assert all(v == NO_COUNT for v in values[n:])
    sheet = bench.calibration_toml()
    assert "misalignment" not in sheet
    assert bench.imu_errors.calibrated_gyro.axes.shape == (n, 3)
    # tilted by as much as the factory found
    tilt = np.abs(bench.imu_errors.calibrated_gyro.axes - AXES[axes]).max()
    assert 0.0 < tilt < 5.0 * 10.0 * GRADES["fog"].gyro_misalignment_arcsec * ARCSEC
    config = bench.config_toml("virtual", "bench")
    assert "[device.imu.redundant]" in config
    assert "latency_ms = 0.92" in config  # 0.4 and four frames of 0.13


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('axes = "cone"', 'axes = "skew"\nfd = true', "imu.fd: found True"),
        ('axes = "cone"', 'axes = "pyramid"', "imu.axes"),
        ('axes = "cone"', 'axes = "cone"\ndither_hz = [400.0, 410.0, 420.0]', "imu.dither_hz"),
        ("number = 4", "number = 7", r"fault\[0\].number"),
        ("bias_deg_per_h = 180.0", "bias_ug = 180.0", "expected bias_deg_per_h and no other"),
        ('axes = "cone"', "", r"fault\[0\].number: found 4, expected 1 to 3"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, old: str, new: str, says: str) -> None:
    text = (scenario.PACKAGED / "redundant.toml").read_text()
    assert old in text
    path = tmp_path / "own.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ScenarioError, match=says):
        scenario.load(path)


def test_only_a_redundant_unit_says_that_a_sensor_is_dead(tmp_path) -> None:
    text = (scenario.PACKAGED / "drive.toml").read_text()
    fault = '[[fault]]\nkind = "sensor_dead"\nsensor = "gyro"\nnumber = 1\nstart_s = 1.0\nduration_s = 1.0\n'
    path = tmp_path / "own.toml"
    path.write_text(text + fault)
    assert scenario.load(path).fault
    path.write_text(text + fault + "told = true\n")
    with pytest.raises(ScenarioError, match=r"fault\[0\].told: found true, expected imu.axes"):
        scenario.load(path)


def test_the_bridge_takes_what_is_written_for_it(tmp_path, capsys) -> None:
    bench = Bench("redundant", seed=2, seconds=1.0)
    for file, text in bench.files("virtual", "bench").items():
        (tmp_path / file).write_text(text)
    assert main(["check", str(tmp_path / "config.toml")]) == 0
    said = f"for serial number {bench.imu_errors.serial}, 6 gyros and 6 accelerometers, no certificate"
    assert said in capsys.readouterr().out
