"""Accelerometers that sit apart, found by the rotations of a calibration and written into its file."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime

import msgspec
import numpy as np
import pytest
from scipy import stats

from bridge import calibrating
from bridge.arms import of_turns
from bridge.calibration import read_calibration
from bridge.calibration_capture import Recorded, record
from bridge.calibration_plan import read
from bridge.config import Config
from bridge.frame import RawFrame
from bridge.importers.capture import write_capture
from bridge.recording import Capture
from bridge.studies.calibration_campaign import RATE_HZ, counted, noise_of, nominal_of
from bridge.studies.turntable import scenario_of
from nav.imu.size_effect import meeting_point
from nav.imu.size_fit import Arms
from tests.cli.test_calibrate import plan_text
from virtual_bus.bus import Bench
from virtual_bus.grades import GRADES

replace = msgspec.structs.replace
ARMS_MM = ((35.0, 10.0, -20.0), (15.0, -40.0, 10.0), (-10.0, 20.0, 45.0))


UNITS = 6
PLAN = read(plan_text(dwell=6.0).encode(), "plan.toml")
SLOW = read(plan_text(dwell=6.0, rate=20.0).encode(), "slow.toml")
"""No faster than the counters of a unit without a bus at `RATE_HZ`."""


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


def test_arms_that_are_not_there_are_not_written():
    chi2 = []
    for seed in range(UNITS):
        made = calibrating.calibrate(SLOW, None, [without_arms(seed)])
        document = calibrating.document_of(made)
        # 1 in 1000 units would have some
        assert not any("lever_arm" in key for key in (*document["accel"], *document["sigma"]["accel"])), seed
        inverse = np.linalg.pinv(made.arms.covariance, rcond=1e-9, hermitian=True)
        chi2.append(made.arms.arms.ravel() @ inverse @ made.arms.arms.ravel())
        last = next(line for line in calibrating.lines_of(made) if line.startswith("arms of"))
        assert f"chi-square {chi2[-1]:.1f} of 6 degrees of freedom, by chance up to 22.5" in last
        assert last.endswith("not significant, not written")
    # three accelerometers' arms but for where they are counted from; 999 of 1000 such sums are between
    low, high = stats.chi2(6 * UNITS).ppf([5e-4, 1.0 - 5e-4])
    assert low < sum(chi2) < high


def without_arms(seed):
    """A capture of a unit whose accelerometers sit in one point, without a bus."""
    grade = GRADES["fog"]
    stream, _, _ = counted(scenario_of(SLOW, None, "fog", RATE_HZ), grade, "orthogonal", seed)
    began, none = datetime(2024, 2, 6, tzinfo=UTC), np.zeros((3, 3))
    nominal, noise = nominal_of(grade), noise_of(grade)
    return Recorded(stream, None, 1.0, began, seed, stream.temperature[:1], nominal, none, noise)


def test_known_arms_stay_unless_they_are_refuted():
    found = calibrating.calibrate(SLOW, None, [without_arms(UNITS)])
    sigma = found.arms.sigma().max()
    for size, stays in ((0.1 * sigma, True), (30.0 * sigma, False)):
        known = size * np.eye(3)[[1, 2, 0]]
        told = dataclasses.replace(found.recorded[0], arms=known)
        again = dataclasses.replace(found, recorded=(told,))
        np.testing.assert_allclose(file_of(again).accel_arms, known if stays else np.zeros((3, 3)))
        assert ("are not so" in "\n".join(calibrating.lines_of(again))) is not stays
