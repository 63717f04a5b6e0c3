"""Configuration errors: each names file, key, what was found and what was expected."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bridge.calibration import read_calibration
from bridge.cli import main
from bridge.config import ATTACHMENT, PACKAGED, Config
from bridge.engine import Engine
from bridge.errors import ConfigError
from bridge.navigators import navigator_config

BENCH = (PACKAGED / "bench.toml").read_text()
FOG = (PACKAGED / "fog.toml").read_text()


def built(tmp_path: Path, config: str, calibration: str = FOG) -> Config:
    (tmp_path / "fog.toml").write_text(calibration)
    path = tmp_path / "own.toml"
    path.write_text(config)
    loaded = Config.load(path)
    Engine(loaded)
    return loaded


def test_the_example_is_in_order(tmp_path: Path) -> None:
    config = built(tmp_path, BENCH)
    assert config.source_number("can0") == 1
    assert config.source_number("gcs") == 2
    assert config.file == "own.toml"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        # what is wrong, and the parts that the message must have
        ("calibration =", "calibraton =", ["device.imu.calibraton", "unknown key", '"calibration"']),
        ("m_per_tick = 0.02", "m_per_tick = -0.02", ["device.odometer.m_per_tick", "-0.02", "> 0.0"]),
        ("m_per_tick = 0.02", "mm_per_tick = 20.0", ["device.odometer.mm_per_tick", '"m_per_tick"']),
        ("m_per_tick = 0.02", 'm_per_tick = "0.02"', ["device.odometer.m_per_tick", '"0.02"', "a number"]),
        ("m_per_tick = 0.02", "m_per_tick = nan", ["device.odometer.m_per_tick", "nan", "a finite number"]),
        ("m_per_tick = 0.02", "", ["device.odometer.m_per_tick", "found nothing"]),
        ('driver = "imu_can"', 'driver = "imu_cann"', ["device.imu.driver", '"imu_cann"', 'mean "imu_can"']),
        ('driver = "imu_can"', "driver = 3", ["device.imu.driver", "found 3"]),
        ('driver = "imu_can"', "", ["device.imu.driver", "found nothing", "imu_can"]),
        ('"fog.toml"', '"fogg.toml"', ["device.imu.calibration", '"fogg.toml"', "expected a file in"]),
        ('type = "can"', 'type = "cann"', ["source.can0.type", '"cann"', 'mean "can"']),
        ('interface = "socketcan"', "interface = 1", ["source.can0.interface", "found 1", "text"]),
        ('type = "can_solution"', 'type = "can_solutions"', ["sink.solution.type", 'mean "can_solution"']),
        ('source = "gcs"', 'source = "can0"', ["sink.telemetry.source", "can0", '"mavlink"']),
        ('source = "gcs"', 'source = "gsc"', ["sink.telemetry.source", '"gsc"', 'mean "gcs"']),
        ('navigator = "main"', 'navigator = "mian"', ["navigator", '"mian"', 'mean "main"']),
        ('"gnss", "baro"]', '"gns", "baro"]', ["navigator.main.devices[2]", '"gns"', 'mean "gnss"']),
        ('"gnss", "baro"]', '"gnss", "gnss"]', ["navigator.main.devices[3]", "once"]),
        ('["imu", "odometer"', '["odometer"', ["navigator.main.devices", "no IMU", "exactly one"]),
        ('alignment = "static"', 'alignment = "statik"', ["navigator.main.alignment", 'mean "static"']),
        ("alignment =", 'azimuth = "freee"\nalignment =', ["navigator.main.azimuth", 'mean "free"']),
        (
            "alignment =",
            "azimuth_rate_deg_per_h = 60.0\nalignment =",
            ["navigator.main.azimuth_rate_deg_per_h", "60.0", "(wander)"],
        ),
        ("alignment =", 'azimuth = "rotating"\nalignment =', ["azimuth_rate_deg_per_h", "other than 0"]),
        (
            "[source.can0]",
            "[navigator.main.height_channel]\norder = 4\n[source.can0]",
            ["navigator.main.height_channel.order", "4", "<= 3"],
        ),
        ("alignment =", "samples_per_update = 7\nalignment =", ["navigator.main.samples_per_update", "<= 6"]),
        ("[-0.5, -0.5, 1.1]", "[-0.5, -0.5]", ["navigator.main.gnss_lever_arm_m", "length 3"]),
        ("[-0.5, -0.5, 1.1]", '[-0.5, "x", 1.1]', ["navigator.main.gnss_lever_arm_m[1]", '"x"', "a number"]),
        (
            "gyro_bias_deg_per_h",
            "gyro_bias_deg_per_s",
            ["imu_errors.gyro_bias_deg_per_s", "gyro_bias_deg_per_h"],
        ),
        ("[sink.solution]", "[sinc.solution]", ["sinc", "unknown table", "sink"]),
        ("[sink.solution]", "[sink]\nx = 1\n[sink.solution]", ["sink.x", "found 1", "a table"]),
        ("rate_hz = 50.0", "rate_hz = 5000.0", ["sink.solution.rate_hz", "5000.0", "<= 1000.0"]),
        ("[source.can0]", "[source.can0", ["not valid TOML", "line"]),
    ],
)
def test_an_error_says_where_and_what(tmp_path: Path, old: str, new: str, says: list[str]) -> None:
    assert old in BENCH
    with pytest.raises(ConfigError) as error:
        built(tmp_path, BENCH.replace(old, new, 1))
    text = str(error.value)
    assert text.startswith("own.toml: ")
    assert "\n" not in text
    for part in says:
        assert part in text, text


def test_motion_alignment_needs_gnss(tmp_path: Path) -> None:
    text = BENCH.replace('alignment = "static"', 'alignment = "motion"').replace('"odometer", "gnss", ', "")
    with pytest.raises(ConfigError, match=r"own.toml: navigator.main.alignment: .*gnss"):
        built(tmp_path, text)


def test_no_position_at_all(tmp_path: Path) -> None:
    text = BENCH.replace('"odometer", "gnss", ', "")
    with pytest.raises(ConfigError, match=r"navigator.main.align.position_deg_m: found nothing"):
        built(tmp_path, text)
    built(tmp_path, text + "\n[navigator.main.align]\nposition_deg_m = [47.0, 8.0, 400.0]\n")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("bias_deg_per_h", "bias_deg_h", ["gyro.bias_deg_h", "unit", "bias_deg_per_h"]),
        ("scale_m_s_per_pulse", "scale_m_per_pulse", ["accel.scale_m_per_pulse", "scale_m_s_per_pulse"]),
        ("[0.1, 0.1, 0.1]", "[0.1, 0.1]", ["gyro.scale_arcsec_per_pulse", "three numbers"]),
        ("[0.1, 0.1, 0.1]", "[0.1, 0.0, 0.1]", ["gyro.scale", "not zero"]),
        ("[0.1, 0.1, 0.1]", "[0.1, inf, 0.1]", ["gyro.scale_arcsec_per_pulse[1]", "inf", "finite"]),
        ("[0.1, 0.1, 0.1]", '[0.1, "a", 0.1]', ["gyro.scale_arcsec_per_pulse", '"a"']),
        ("[[0.0, 0.0, 0.0],", "[[0.1, 0.0, 0.0],", ["gyro.misalignment", "scale errors belong in scale"]),
        ("[accel]", "[acel]", ["acel", "unknown table", "accel"]),
        ("[device]", "[device]\nserial = 1.5", ["device.serial", "1.5", "an integer"]),
        ("scale_arcsec_per_pulse = [0.1, 0.1, 0.1]", "", ["gyro", "found no scale"]),
        ("bias_ug =", "bias_mg = [0.0, 0.0, 0.0]\nbias_ug =", ["accel.bias_ug", "once"]),
    ],
)
def test_a_calibration_says_so_too(tmp_path: Path, old: str, new: str, says: list[str]) -> None:
    assert old in FOG
    with pytest.raises(ConfigError) as error:
        built(tmp_path, BENCH, FOG.replace(old, new, 1))
    assert str(error.value).startswith("fog.toml: ")
    for part in says:
        assert part in str(error.value), str(error.value)


def test_units_of_a_calibration() -> None:
    text = b"""
    [gyro]
    scale_urad_per_pulse = [1, 2, 3]
    scale_negative_arcsec_per_pulse = [1, 1, 1]
    bias_deg_per_h = [3600, 0, 0]
    g_sensitivity_deg_per_h_per_g = [[3600, 0, 0], [0, 0, 0], [0, 0, 0]]
    misalignment_mrad = [[0, 1, 0], [0, 0, 0], [0, 0, 0]]
    [accel]
    scale_ug_s_per_pulse = [10, 10, 10]
    bias_mg = [1, 0, 0]
    axes = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    """
    c = read_calibration(text, "c.toml").calibration
    deg = math.pi / 180.0
    np.testing.assert_allclose(c.gyro_scale_plus, [1e-6, 2e-6, 3e-6])
    np.testing.assert_allclose(c.gyro_scale_minus, deg / 3600.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(c.gyro_bias, [deg, 0, 0])
    assert c.gyro_g[0, 0] == pytest.approx(deg / 9.80665)
    assert c.gyro_axes[0, 1] == pytest.approx(1e-3)
    np.testing.assert_allclose(c.accel_scale_plus, 10e-6 * 9.80665)
    assert c.accel_bias[0] == pytest.approx(9.80665e-3)
    np.testing.assert_allclose(c.accel_axes, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])


def test_units_of_a_navigator(tmp_path: Path) -> None:
    text = BENCH.replace('alignment = "static"', 'alignment = "static"\nmounting_deg = [0.0, 0.0, 90.0]')
    config = navigator_config("main", built(tmp_path, text))
    assert config.imu.angle_random_walk == pytest.approx(0.01 * math.pi / 180.0 / 60.0)
    assert config.imu.gyro_bias == pytest.approx(math.radians(0.1) / 3600.0)
    assert config.imu.velocity_random_walk == pytest.approx(40e-6 * 9.80665)
    # an IMU that heads right in the vehicle: its forward axis is the vehicle's right
    assert config.C_vb is not None
    np.testing.assert_allclose(config.C_vb @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    assert config.odometer
    assert config.odometer_quantum == 0.02
    assert (config.azimuth, config.samples_per_update) == ("wander", 2)
    turning = 'azimuth = "rotating"\nazimuth_rate_deg_per_h = 60.0\nsamples_per_update = 4\nalignment ='
    config = navigator_config("main", built(tmp_path, BENCH.replace("alignment =", turning, 1)))
    assert config.azimuth_rate == pytest.approx(math.radians(1.0 / 60.0))
    assert config.height_channel is None
    channel = BENCH + "\n[navigator.main.height_channel]\norder = 3\n"
    assert navigator_config("main", built(tmp_path, channel)).height_channel == (3, 30.0)
    with pytest.raises(ConfigError, match=r"height_channel: found no barometer"):
        navigator_config("main", built(tmp_path, channel.replace(', "baro"]', "]")))
    assert config.samples_per_update == 4


def test_equal_names_of_different_files_are_kept_apart(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "cal.toml").write_text(FOG + f"# {folder}\n")
    second = """
[device.imu2]
driver = "imu_can"
source = "can0"
calibration = "b/cal.toml"
rate_hz = 200.0
id_offset = 0x400
"""
    path = tmp_path / "two.toml"
    path.write_text(BENCH.replace('"fog.toml"', '"a/cal.toml"') + second)
    config = Config.load(path)
    assert set(config.files) == {"cal.toml", "2-cal.toml"}
    again = Config.from_attachments(config.attachments())
    assert again.files["2-cal.toml"].endswith(b"# b\n")
    assert again.devices["imu2"].calibration == "2-cal.toml"  # type: ignore[attr-defined]


def test_attachments_that_lack_something() -> None:
    with pytest.raises(ConfigError, match=r"found no config.toml"):
        Config.from_attachments({})
    with pytest.raises(ConfigError, match=r"device.imu.calibration"):
        Config.from_attachments({ATTACHMENT: BENCH.encode()})
    with pytest.raises(ConfigError, match="not UTF-8"):
        Config.from_attachments({ATTACHMENT: b"\xff"})


def test_check_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "bench"]) == 0
    assert "in order" in capsys.readouterr().out
    assert main(["check", "bench", "--resolved"]) == 0
    assert "[navigator.main.imu_errors]" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "none.toml")]) == 2
    assert "no such file" in capsys.readouterr().err
    path = tmp_path / "wrong.toml"
    path.write_text(BENCH.replace("calibration =", "calibraton ="))
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "device.imu.calibraton" in error


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'interface = "socketcan"',
            'interface = "sockatcan"',
            'c.toml: source.can0.interface: found "sockatcan", expected one of',
        ),
        ('url = "udpout:', 'url = "http:', 'c.toml: source.gcs.url: found "http:'),
        (
            'type = "can_solution"\nsource = "can0"\nnavigator = "main"\nrate_hz = 50.0',
            'type = "dbc_map"\nsource = "can0"\nnavigator = "main"\ndbc = "canmod-gps.dbc"\n'
            'messages = { nosuch = { roll = "roll" } }',
            'sink.solution.messages.nosuch: found "nosuch"',
        ),
    ],
)
def test_check_finds_what_only_sources_and_sinks_know(
    old: str, new: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in BENCH
    (tmp_path / "c.toml").write_text(BENCH.replace(old, new))
    for command in ("check", "run"):
        assert main([command, str(tmp_path / "c.toml")]) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert error.count("\n") == 1
