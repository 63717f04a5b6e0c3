"""A table off by a tenth of a degree that says so on the bus, from ``sim turntable`` to ``calibrate``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bridge import calibrating
from bridge.calibration_capture import record
from bridge.calibration_plan import load, read
from bridge.cli import main
from bridge.errors import CalibrationError, ConfigError
from bridge.recording import Capture
from bridge.studies import calibration_campaign as study
from bridge.studies.turntable import scenario_of
from tests.cli.test_calibrate import plan_text
from virtual_bus.bus import Bench
from virtual_bus.sensors import generator

SEED, RATE = 3, 25.0
OFF = "[table]\nposition_arcsec = 360.0\n"
TELLS = "[encoder]\nsigma_arcsec = 2.0\n"


def plan_of(*tables):
    head, _, steps = plan_text().partition("[[position]]")
    return f"{head}{''.join(tables)}[[position]]{steps}"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("encoder")
    (folder / "plan.toml").write_text(plan_of(OFF, TELLS))
    words = ["sim", "turntable", str(folder / "plan.toml"), "--grade", "rlg", "--rate-hz", str(RATE)]
    assert main([*words, "--seed", str(SEED), "--out", str(folder / "table.mcap")]) == 0
    return folder


@pytest.fixture(scope="module")
def recorded(bench):
    return record(Capture(bench / "table.mcap"), None)


def errors_of(bench, result):
    scenario = scenario_of(load(bench / "plan.toml"), None, "rlg", RATE)
    unit = Bench(scenario, seed=SEED).imu_errors
    delta, gravity = scenario.drawn(generator(SEED, "vehicle/mounting"))
    truth = np.concatenate((study.truth(result.fit.model, unit), delta, [gravity / scenario.gravity - 1.0]))
    return (result.fit.theta - truth) / result.fit.sigma


def test_the_unit_is_found_as_well_as_the_encoder_is(bench, recorded, capsys):
    result = calibrating.calibrate(load(bench / "plan.toml"), None, [recorded])
    error = errors_of(bench, result)
    assert np.abs(error).max() < 4.5
    assert np.mean(np.abs(error[:-4]) < 2.0) > 0.8
    assert 0.3 < result.fit.chi2 / result.fit.freedom < 2.0
    # 2 arcsec of gravity are 10 ug in a position, a tenth of a degree 1700
    sigma = result.of("accel").sigma["bias"] / 9.80665e-6
    assert sigma.max() < 15.0
    assert main(["calibrate", str(bench / "plan.toml"), str(bench / "table.mcap")]) == 0
    assert "attitudes and turns: as the table told them" in capsys.readouterr().out


def test_without_its_encoder_the_table_is_as_wrong_as_the_plan_says(bench, recorded):
    plan = load(bench / "plan.toml")
    result = calibrating.calibrate(plan, None, [replace(recorded, table=None)])
    assert np.abs(errors_of(bench, result)).max() < 4.5
    assert result.of("accel").sigma["bias"].min() / 9.80665e-6 > 300.0
    # and a plan that takes the table to be right is told that it is not
    with pytest.raises(CalibrationError, match=r"the table was moved|does not stand"):
        calibrating.calibrate(read(plan_of().encode(), "x.toml"), None, [replace(recorded, table=None)])


def test_angles_are_dated_by_their_own_clock(recorded):
    """Told times are those of the unit's clock: while it turns the angle is that of the unit to 20 us."""
    told, stream = recorded.table, recorded.stream
    assert told is not None
    assert len(told.time) == pytest.approx(50.0 * stream.dt.sum(), abs=3)
    assert np.all(np.diff(told.time) > 0.0)
    # jitter of 0.1 ms of both devices, of which either clock's model keeps the least delayed
    assert np.median(np.diff(told.time)) == pytest.approx(0.02, abs=5e-6)


def test_units_on_such_tables_are_as_wrong_as_they_say():
    plan = study.encoded(read(plan_text(dwell=6.0).encode(), "plan.toml"))
    told = study.run_calibrations(plan, None, "rlg", 2, seed_base=20)
    assert told.passed
    # as the plan says without its encoder
    blind = study.run_calibrations(replace(plan, encoded=False), None, "rlg", 2, seed_base=20)
    assert blind.passed


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '[encoder]\naxes = "zzx"\n',
            'encoder.axes: found "zzx", expected three axes of which neighbours differ',
        ),
        ('[encoder]\naxes = "abc"\n', "encoder.axes"),
        ("[encoder]\nsigma_arcsec = 0.0\n", "encoder.sigma_arcsec"),
        ("[table]\nposition_arcsec = -1.0\n", "table.position_arcsec"),
    ],
)
def test_a_wrong_table_says_what_is_wrong(text, said):
    with pytest.raises(ConfigError) as error:
        read(plan_of(text).encode(), "plan.toml")
    assert said in str(error.value)
