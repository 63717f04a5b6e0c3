"""Calibration of units with squares and products of specific force, on the bench."""

from __future__ import annotations

import pytest

from bridge import calibrating
from bridge.calibration_plan import PACKAGED, Site, read
from bridge.cli import main
from bridge.errors import CalibrationError
from bridge.studies import calibration_campaign as study

SITE = Site(45.0, 0.0)
SQUARES = (PACKAGED / "positions_18_squares.toml").read_bytes().replace(b"dwell_s = 120.0", b"dwell_s = 30.0")


def test_units_with_second_order_terms_come_back() -> None:
    """Two units of the bench; the band is that of so few."""
    found = study.run_calibrations(read(SQUARES, "squares.toml"), SITE, "dtg", 2)
    assert found.passed, study.lines([found])
    assert sum("square" in name or "product" in name for name in found.names) == 18
    # 30 s of 10 ug per root Hz and of an instability of 15 ug: without the terms it would be far off
    plain = SQUARES.replace(b"second_order = true", b"second_order = false")
    assert not study.run_calibrations(read(plain, "plain.toml"), SITE, "dtg", 1).passed


def test_a_plan_of_faces_is_refused_with_the_edges_that_it_needs() -> None:
    faces = (
        SQUARES.split(b"[[position]]\nattitude_deg")[0]
        + b"[[rotation]]"
        + SQUARES.split(b"[[rotation]]", 1)[1]
    )
    plan = read(faces, "faces.toml")
    model = calibrating.model_of(plan, plan.at(SITE)[1], study.nominal_of(study.GRADES["dtg"]))
    with pytest.raises(CalibrationError) as error:
        calibrating.look(plan, model, study.noise_of(study.GRADES["dtg"]))
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
