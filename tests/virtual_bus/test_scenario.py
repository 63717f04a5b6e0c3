"""Scenarios: the packaged ones, strict reading, cutting and extending."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.calibration import CalibrationFile
from bridge.calibration_sensors import read_unit
from bridge.config import Config
from virtual_bus import scenario
from virtual_bus.bus import CALIBRATION, Bench
from virtual_bus.configuration import imu_errors
from virtual_bus.grades import ARCSEC, DEG_PER_H, GRADES, REFERENCE_DEG_C, UG, draw_imu
from virtual_bus.scenario import ScenarioError
from virtual_bus.tables import ImuTable
from virtual_bus.truth import mounting_matrix

UNITS = 200
NAMES = sorted(scenario.packaged())
GOOD = """
title = "t"
grade = "fog"
[start]
lat_deg = 48.0
lon_deg = 11.0
[[manoeuvre]]
kind = "static"
duration_s = 5.0
"""


def write(tmp_path, text):
    path = tmp_path / "own.toml"
    path.write_text(text)
    return path


def test_there_are_the_packaged_ones():
    assert {"drive", "drive_outage", "static_rlg", "mems_drive", "long_drive"} <= set(NAMES)
    drive = scenario.load("drive")
    assert drive.seconds() == 300.0
    assert drive.manoeuvre[0].duration_s == 60.0
    assert scenario.load("long_drive.toml").seconds() == 3600.0


@pytest.mark.parametrize("name", NAMES)
def test_a_packaged_scenario_runs_and_its_configuration_loads(name, tmp_path):
    bench = Bench(name, seed=2, seconds=3.0)
    assert sum(1 for _ in bench.due(bench.end_ns)) > 500
    for file, text in bench.files("virtual", "bench", "udpout:127.0.0.1:14550").items():
        (tmp_path / file).write_text(text)
    config = Config.load(tmp_path / "config.toml")
    assert set(config.devices) == set(bench.scenario.devices())
    assert {sink.type for sink in config.sinks.values()} == {"can_solution", "mavlink"}
    file = read_unit(config.files[CALIBRATION], CALIBRATION)
    assert file.serial == bench.imu_errors.serial
    if isinstance(file, CalibrationFile):
        c = file.calibration
        read = (c.gyro_bias, c.accel_bias, c.gyro_axes, c.gyro_scale_plus, c.accel_scale_plus, c.gyro_g)
    else:
        g, a = file.gyros, file.accels
        read = (g.bias, a.bias, g.axes, g.scale_plus, a.scale_plus, g.g_sensitivity)
    gyro, accel = bench.imu_errors.calibrated_gyro, bench.imu_errors.calibrated_accel
    written = (gyro.bias, accel.bias, gyro.axes, gyro.scale, accel.scale, gyro.g_sensitivity)
    units = (DEG_PER_H, UG, ARCSEC, 1e-6 * ARCSEC, 1e-9, DEG_PER_H)
    for found, expected, unit in zip(read, written, units, strict=True):
        assert found == pytest.approx(expected, abs=1e-9 * unit)


def test_lever_arms_are_told_in_imu_axes():
    bench = Bench("mems_drive", seed=1, seconds=1.0)
    vehicle = bench.scenario.vehicle
    text = bench.config_toml("virtual", "x")
    line = next(row for row in text.splitlines() if row.startswith("gnss_lever_arm_m"))
    arm_b = np.array([float(v) for v in line.split("[")[1].rstrip("]").split(",")])
    arm_v = mounting_matrix(*vehicle.mounting_deg) @ arm_b
    assert arm_v == pytest.approx(np.array(vehicle.antenna_m) - np.array(vehicle.imu_m), abs=1e-12)
    assert 'mounting_deg = "find"' in text


def test_noise_figures_say_at_least_what_the_unit_does():
    for grade in GRADES.values():
        figures = imu_errors(grade, ImuTable())
        assert figures["accel_bias_ug"] >= grade.accel_bias_ug
        assert figures["gyro_random_walk_deg_per_sqrt_h"] == grade.gyro_random_walk_deg_per_sqrt_h


@pytest.mark.parametrize("cold", [25.0, 10.0, -40.0])
def test_noise_figures_cover_what_calibration_leaves_of_temperature_and_force(cold):
    grade, imu = GRADES["dtg"], ImuTable(temperature_deg_c=(cold, 40.0), warm_up_s=300.0)
    figures = imu_errors(grade, imu)
    units = [draw_imu(grade, np.random.default_rng(seed)) for seed in range(UNITS)]
    t = np.array([0.0, 30.0, 100.0, 300.0, 378.0, 600.0, 1500.0])
    away = 40.0 - (40.0 - cold) * np.exp(-t / 300.0) - REFERENCE_DEG_C
    powers = np.stack((away, away**2))
    for name, unit, sheet, size, standing in (
        ("gyro", "deg_per_h", "calibrated_gyro", DEG_PER_H, 1.0),
        ("accel", "ug", "calibrated_accel", UG, 0.0),
    ):
        left = [
            (getattr(u, name).bias_temperature - getattr(u, sheet).bias_temperature) @ powers for u in units
        ]
        drift = np.reshape(left, (-1, len(t))) / size
        # what it is at first, with what the force at rest adds to the drift of gyros
        force = standing * grade.gyro_g_sensitivity_deg_per_h_per_g
        constant = np.hypot(getattr(grade, f"{name}_bias_{unit}"), force)
        first = np.hypot(constant, np.sqrt(np.mean(drift[:, 0] ** 2)))
        # 3 sigmas of an rms of so many
        most = 1.0 + 3.0 / np.sqrt(2.0 * len(drift))
        assert first < most * figures[f"{name}_bias_{unit}"]
        # what it moves by from then on, beside the walk of the sensor itself
        moved = np.mean((drift[:, 1:] - drift[:, :1]) ** 2, axis=0)
        own, said = (2.0 * one**2 / grade.correlation_s for one in (
            getattr(grade, f"{name}_instability_{unit}"), figures[f"{name}_instability_{unit}"]
        ))  # fmt: skip
        ratio = np.sqrt(moved / ((said - own) * t[1:]))
        assert ratio.max() < most
        # and no more than that: at some instant it is as much
        assert ratio.max() > 0.8


def test_cut_and_extended(tmp_path):
    path = write(
        tmp_path,
        GOOD.replace('title = "t"', 'title = "t"\nrepeat_from = 1')
        + '[[manoeuvre]]\nkind = "accelerate"\nduration_s = 4.0\nspeed_m_s = 10.0\n'
        + '[[manoeuvre]]\nkind = "brake"\nduration_s = 3.0\n',
    )
    assert scenario.load(path).seconds() == 12.0
    short, long = Bench(path, seconds=7.0), Bench(path, seconds=33.0)
    assert max(f.t_ns for f in short.due(short.end_ns)) <= 7_000_000_000
    # 5 s at rest, then 7 s of go and stop for ever: the second and the third go begin alike
    speed = long.trajectory.profile.speed(np.array([7.0, 14.0, 21.0, 28.0]) * 1e9)
    assert speed == pytest.approx([speed[0]] * 4)
    assert speed[0] > 1.0
    assert sum(1 for f in long.due(long.end_ns) if f.frame_id == 0x100) == pytest.approx(6600, abs=1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("lat_deg", "latitude"), r"own.toml: start\.\w+: found .* expected"),
        (("48.0", '"north"'), r"own.toml: start.lat_deg: found 'north', expected float"),
        (("48.0", "95.0"), r"own.toml: start.lat_deg: found 95.0, expected float <= 90.0"),
        (("48.0", "nan"), r"own.toml: start.lat_deg: found nan, expected a finite number"),
        (('"fog"', '"fgo"'), r'own.toml: grade: found "fgo", expected one of dtg, fog, mems, rlg'),
        (('"static"', '"hover"'), r'manoeuvre\[0\].kind: found "hover", expected one of accelerate, .*turn'),
        (("5.0", "-5.0"), r"own.toml: manoeuvre\[0\]: duration_s: found -5.0, expected a positive"),
        (("[start]", "[[start]]"), r"own.toml: start: found .* expected object"),
        (
            ("5.0", "5.0\nspeed = 3"),
            r"manoeuvre\[0\].speed: found an unknown key, expected one of duration_s",
        ),
        (("[start]", "[gnss]\nwhite = 3\n[start]"), r"gnss.white: found an unknown key, .*white_m"),
        (("[start]", "repeat_from = 7\n[start]"), r"repeat_from: found 7, expected -1 to 0"),
        (("[start]", "[start"), r"own.toml: not valid TOML"),
        (
            ("[start]", "[sway]\nfastest_hz = 0.05\n[start]"),
            r"sway.fastest_hz: found 0.05, expected at least",
        ),
        (("[start]", "[sway]\nfastest_hz = 5.0\n[start]"), r"sway.fastest_hz: found 5.0, .* <= 1.2"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, change, message):
    with pytest.raises(ScenarioError, match=message):
        scenario.load(write(tmp_path, GOOD.replace(*change)))


@pytest.mark.parametrize("begins_s", [None, 20.0])
def test_a_base_sways_about_its_place_as_fast_as_is_told(tmp_path, begins_s):
    begins = "" if begins_s is None else f"begins_s = {begins_s}\n"
    rms = {"heading_deg": 0.4, "pitch_deg": 0.7, "roll_deg": 1.5}
    table = "".join(f"{key} = {value}\n" for key, value in rms.items())
    path = write(tmp_path, f"{GOOD}[sway]\n{table}{begins}[navigator]\nalignment_s = 60.0\n")
    bench = Bench(path, seed=4, seconds=600.0)
    motion = bench.trajectory.motion(np.arange(60_000_000_000, 600_000_000_000, 100_000_000))
    pitch, roll = np.arcsin(motion.C_gv[:, 2, 1]), np.arctan2(-motion.C_gv[:, 2, 0], motion.C_gv[:, 2, 2])
    for angle, sigma in ((pitch, 0.7), (roll, 1.5)):
        # waves of 9 minutes and known strength: what is left of the phases at the ends
        assert np.degrees(np.std(angle)) == pytest.approx(sigma, rel=0.05)
    told = next(row for row in bench.config_toml("virtual", "x").splitlines() if row.startswith("sway_m_s"))
    # the rates are drawn from a band, eight to an axis
    assert float(told.split()[2]) == pytest.approx(np.sqrt(np.mean(motion.v_g**2)), rel=0.3)
    # the place itself stays where it is, to rounding of the radius of the Earth
    middle = bench.trajectory.motion(np.array([0, 500_000_000_000]), np.zeros(3))
    assert middle.r_e[0] == pytest.approx(middle.r_e[1], abs=1e-8)
    first = bench.trajectory.motion(np.arange(0, 15_000_000_000, 100_000_000))
    assert (np.abs(first.v_g).max() < 1e-9) == (begins_s is not None)
    assert "coarse_s = 15.0\nfine_s = 45.0" in bench.config_toml("virtual", "x")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            'kind = "drop"\ndevice = "odometer"\nstart_s = 1.0\nduration_s = 1.0',
            r'fault\[0\].device: found "odom',
        ),
        ('kind = "drop"\nstart_s = 1.0\nduration_s = 1.0', r"fault\[0\].device: found nothing"),
        (
            'kind = "drop"\ndevice = "imu"\nstart_s = 1.0\nduration_s = 0.0',
            r"fault\[0\]: .*positive duration",
        ),
        ('kind = "dorp"\nstart_s = 1.0\nduration_s = 1.0', r'fault\[0\].kind: found "dorp", .*gnss_outage'),
        (
            'kind = "reset"\ndevice = "imu"\nstart_s = 1\nduration_s = 1\nx = 1',
            r"fault\[0\].x: found an unknown",
        ),
    ],
)
def test_what_is_wrong_with_a_fault_is_said(tmp_path, more, message):
    with pytest.raises(ScenarioError, match=message):
        scenario.load(write(tmp_path, f"{GOOD}[[fault]]\n{more}\n"))


def test_what_cannot_be_driven_is_said(tmp_path):
    text = GOOD + '[[manoeuvre]]\nkind = "accelerate"\nduration_s = 4.0\nspeed_m_s = 10.0\n'
    with pytest.raises(ScenarioError, match=r"own.toml: manoeuvre\[2\]: static entered at 10.0 m/s"):
        scenario.load(write(tmp_path, text + '[[manoeuvre]]\nkind = "static"\nduration_s = 4.0\n'))
    with pytest.raises(ScenarioError, match=r"manoeuvre\[0\]: static entered"):
        scenario.load(write(tmp_path, text.replace('title = "t"', 'title = "t"\nrepeat_from = 0')))


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ScenarioError, match=r"no such scenario; expected .* dithered, drive, drive_off,"):
        scenario.load("driev")
    with pytest.raises(ScenarioError, match="seconds: found -1"):
        Bench("drive", seconds=-1.0)
