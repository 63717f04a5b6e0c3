"""Calibration of units with squares and products of specific force, on the bench."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge import calibrating
from bridge.calibration import read_calibration
from bridge.calibration_capture import record
from bridge.calibration_plan import PACKAGED, Site, load, read
from bridge.cli import main
from bridge.errors import CalibrationError, ConfigError
from bridge.recording import Capture
from bridge.studies import calibration_campaign as study
from bridge.studies.turntable import scenario_of
from virtual_bus.bus import Bench
from virtual_bus.grades import GRADES

SITE = Site(45.0, 0.0)
SQUARES = (PACKAGED / "positions_18_squares.toml").read_bytes().replace(b"dwell_s = 120.0", b"dwell_s = 20.0")


def test_units_with_second_order_terms_come_back() -> None:
    """One unit of the bench; the band is that of one."""
    found = study.run_calibrations(read(SQUARES, "squares.toml"), SITE, "dtg", 1)
    assert found.passed, study.lines([found])
    assert sum("square" in name or "product" in name for name in found.names) == 18


def test_a_plan_of_faces_is_refused_with_the_edges_that_it_needs() -> None:
    faces = (
        SQUARES.split(b"[[position]]\nattitude_deg")[0]
        + b"[[rotation]]"
        + SQUARES.split(b"[[rotation]]", 1)[1]
    )
    plan = read(faces, "faces.toml")
    model = calibrating.model_of(plan, plan.at(SITE)[1], study.nominal_of(GRADES["dtg"]))
    with pytest.raises(CalibrationError) as error:
        calibrating.look(plan, model, study.noise_of(GRADES["dtg"]))
    text = str(error.value)
    assert text.startswith("faces.toml: the plan does not show ")
    assert "accelerometer x product toward y" in text
    assert "gyro z product xy" in text
    for k in "xyz":
        assert f"accelerometer {k} asymmetry and accelerometer {k} square one from another" in text
    assert "attitude_deg" in text.split("add to the plan: ")[1]


def test_the_promise_names_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "positions_18_squares", "--config", "bench", "--site", "45,0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    units = {line.split("  ")[0]: line.split()[-1] for line in lines if "product" in line or "square" in line}
    assert units["accelerometer x square"] == "ug/g2"
    assert units["gyro z product yz"] == "deg/h/g2"
    assert len(units) == 18


SOAKED = (
    (PACKAGED / "positions_18_squares.toml").read_bytes().replace(b"dwell_s = 120.0", b"dwell_s = 10.0")
    + b"""
[temperature]
soak_deg_c = [-20.0, 25.0, 60.0]
reference_deg_c = 25.0
order = 2
"""
)


def test_temperature_comes_back() -> None:
    found = study.run_calibrations(read(SOAKED, "soaked.toml"), SITE, "dtg", 1)
    assert found.passed, study.lines([found])
    assert sum("temperature" in name for name in found.names) == 24


SMALL = (
    (PACKAGED / "positions_18_squares.toml")
    .read_bytes()
    .replace(b"dwell_s = 120.0", b"dwell_s = 6.0")
    .replace(b"turns = 3", b"turns = 1")
    .replace(b"rate_deg_per_s = 10.0", b"rate_deg_per_s = 20.0")
    .replace(b"rate_deg_per_s = -10.0", b"rate_deg_per_s = -20.0")
    + b"""
[site]
lat_deg = 45.0
[temperature]
soak_deg_c = [25.0, 60.0]
reference_deg_c = 25.0
order = 1
"""
)
SEED = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of two temperatures, and the capture of each."""
    folder = tmp_path_factory.mktemp("soaked")
    (folder / "plan.toml").write_bytes(SMALL)
    for soak in ("25", "60"):
        words = ["sim", "turntable", str(folder / "plan.toml"), "--grade", "dtg", "--rate-hz", "25"]
        assert main([*words, "--seed", str(SEED), "--soak", soak, "--out", str(folder / f"{soak}.mcap")]) == 0
    return folder


def words_of(folder: Path, *soaks: str) -> list[str]:
    return ["calibrate", str(folder / "plan.toml"), *(str(folder / f"{soak}.mcap") for soak in soaks)]


def test_from_two_soaks_to_a_file_that_holds_at_both(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "imu.toml"
    assert main([*words_of(folder, "25", "60"), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "gyro x scale temperature 1" in text
    assert "accel z product yz" in text
    document = tomllib.loads(out.read_text())
    assert set(document["sigma"]["gyro"]) == set(document["gyro"])
    assert document["temperature"] == {"reference_deg_c": 25.0, "range_deg_c": [25.0, 60.0]}
    c = read_calibration(out.read_bytes(), "imu.toml").calibration
    recorded = [record(Capture(folder / f"{soak}.mcap"), None) for soak in ("25", "60")]
    result = calibrating.calibrate(load(folder / "plan.toml"), None, recorded)
    unit = Bench(scenario_of(load(folder / "plan.toml"), None, "dtg", 25.0), seed=SEED).imu_errors
    for temperature in (25.0, 60.0):
        d = temperature - 25.0
        held = c.at(temperature)
        for kind, triad in (("gyro", unit.gyro), ("accel", unit.accel)):
            found, along = result.of(kind), np.diag(triad.axes)
            powers = [d, d * d]
            # mean of both signs, and an axis that has a one along its own: between 25 and 60 a line is enough
            scale = triad.scale * (1.0 + triad.scale_temperature @ powers) / along
            mean = 0.5 * (getattr(held, f"{kind}_scale_plus") + getattr(held, f"{kind}_scale_minus"))
            sigma = found.sigma["scale"] / triad.scale + d * found.sigma["scale_temperature"][:, 0]
            assert np.all(np.abs(mean / scale - 1.0) < 4.5 * sigma)
            bias = (triad.bias + triad.bias_temperature @ powers) / along
            sigma = found.sigma["bias"] + d * found.sigma["bias_temperature"][:, 0]
            assert np.all(np.abs(getattr(held, f"{kind}_bias") - bias) < 4.5 * sigma)


def test_what_does_not_fit_the_plans_temperatures_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words_of(folder, "60", "25")) == 1
    said = capsys.readouterr().err
    assert "position 1, UNW, 25 degC: the unit told 60.0 degC, expected 25 degC" in said
    assert main(words_of(folder, "25")) == 1
    assert "60 degC): missing: the capture ends before it" in capsys.readouterr().err
    plan = load(folder / "plan.toml")
    recorded = [record(Capture(folder / f"{soak}.mcap"), None) for soak in ("25", "60")]
    silent = replace(recorded[0], stream=replace(recorded[0].stream, temperature=np.zeros(0)))
    with pytest.raises(CalibrationError, match="the unit told no temperature, expected 25 degC"):
        calibrating.calibrate(plan, None, [silent, recorded[1]])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[25.0, 60.0]", "[25.0]", "temperature.soak_deg_c: found"),
        ("[25.0, 60.0]", "[25.0, 25.0]", "expected different temperatures"),
        ("order = 1", "order = 2", "temperature.order: found 2, expected less than the 2 of soak_deg_c"),
        ("order = 1", "order = 0", "temperature.order"),
        ("reference_deg_c = 25.0", "reference_deg_c = 20.0", "expected one between those of soak_deg_c"),
        ("[25.0, 60.0]", "[25.0, 600.0]", "soak_deg_c: found [25.0, 600.0], expected a number <= 140.0"),
    ],
)
def test_a_wrong_plan_of_temperatures_says_what_is_wrong(old: str, new: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        read(SMALL.replace(old.encode(), new.encode(), 1), "plan.toml")
    assert said in str(error.value)


def test_a_table_without_that_temperature_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", "turntable", str(folder / "plan.toml"), "--soak", "40", "--out", "x.mcap"]) == 2
    assert "temperature.soak_deg_c: found [25.0, 60.0], expected 40 among them" in capsys.readouterr().err


def test_the_promise_of_a_plan_of_temperatures(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(folder / "plan.toml"), "--config", "bench"]) == 0
    text = capsys.readouterr().out
    assert "ppm/degC" in text
    assert "deg/h/degC" in text
