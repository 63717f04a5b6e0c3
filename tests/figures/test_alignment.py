"""Alignments: the truth that they are judged by, and what the figure says of runs that fail."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bridge.cli import main
from bridge.studies.alignment_runs import GRADE, SCENES, align, limit
from bridge.studies.alignment_truth import DEG_PER_H, HEIGHT, LAT, Base, left_by_constants
from bridge.studies.figures import alignment
from bridge.studies.figures.alignment_loops import growth
from bridge.studies.figures.result import Result
from nav.rotation import dcm_from_quat, quat_from_rotvec, quat_multiply
from virtual_bus.ellipsoid import OMEGA, axes_eg, gravity, to_ecef

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

C_EG = axes_eg(np.array(LAT), np.array(0.0))
PLACE = to_ecef(np.array(LAT), np.array(0.0), np.array(HEIGHT))


def swaying(rest_s: float) -> Base:
    swing = np.radians([[2.0, 1.0], [3.0, 2.0], [1.0, 4.0]])
    return Base(np.random.default_rng(3), swing, [4.0, 7.0], [0.3, -2.0, 1.0], rest_s=rest_s)


def inertial(base: Base, t: float) -> tuple[Array, Array]:
    """Position (3,) of the IMU from the centre of the Earth, and C_ib, in axes that do not turn."""
    s, c = math.sin(OMEGA * t), math.cos(OMEGA * t)
    C_ie = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    C_ib = C_ie @ C_EG @ base.C_gb(t)
    return C_ie @ PLACE + C_ib @ base.lever, C_ib


@pytest.mark.parametrize("rest_s", [0.0, 0.5])
def test_increments_of_a_swaying_base_are_those_of_its_path(rest_s: float) -> None:
    base, dt, n = swaying(rest_s), 1e-3, 2000
    dtheta, dv = base.increments(n, dt)
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(n):
        q = quat_multiply(q, quat_from_rotvec(dtheta[k]))
    turned = inertial(base, 0.0)[1].T @ inertial(base, n * dt)[1]
    # the turn of an increment is not quite its rotation vector: 0.5 rad/s x 3 rad/s^2 dt^3/12 of 2000
    assert dcm_from_quat(q) == pytest.approx(turned, abs=2.5e-7)
    # force of the middle of a sample: second difference of the path, which rounding of 6e6 m limits
    pull = axes_eg(np.array(LAT), np.array(0.0)) @ [
        0.0,
        *(float(x) for x in gravity(*map(np.array, (LAT, HEIGHT)))),
    ]
    for k in (700, 1500):
        t, h = (k + 0.5) * dt, 0.01
        (a, _), (b, C), (c, _) = (inertial(base, t + s * h) for s in (-1.0, 0.0, 1.0))
        turning = OMEGA**2 * np.array([1.0, 1.0, 0.0])
        centre = b - C @ base.lever
        C_ie = C @ (C_EG @ base.C_gb(t)).T
        gravitation = C_ie @ pull - turning * centre
        force = C.T @ ((a - 2.0 * b + c) / h**2 - gravitation)
        assert dv[k] / dt == pytest.approx(force, abs=2e-3)


def test_velocity_is_that_of_the_path() -> None:
    base, t, h = swaying(0.0), 1.3, 1e-4
    ahead, behind = (base.C_gb(t + s) @ base.lever for s in (h, -h))
    assert base.velocity(t) == pytest.approx((ahead - behind) / (2.0 * h), abs=1e-6)


def test_the_limit_is_the_bias_of_the_east_gyro() -> None:
    # 0.007 deg/h of 15.041 cos(34.18) is 0.03223 deg, the walk of 300 s 0.00797, tan L times 5e-5 0.00195
    assert math.degrees(limit(GRADE, 300.0, rigid=True)[2]) == pytest.approx(0.03326, abs=2e-5)
    eps, nabla = np.array([0.01 * DEG_PER_H, 0.0, 0.0]), np.zeros(3)
    found = left_by_constants(np.eye(3), eps, nabla)
    assert found == pytest.approx(-0.01 / (15.04107 * math.cos(LAT)), rel=1e-5)


def test_a_run_is_its_seed_and_its_imu_that_of_all_scenes() -> None:
    once, again, other = (SCENES[name](5, 0.05) for name in ("standing", "standing", "stops"))
    assert all(np.array_equal(a.dv, b.dv) for a, b in zip(once.samples, again.samples, strict=True))
    assert other.eps / other.config.gyro_bias == pytest.approx(once.eps / once.config.gyro_bias)
    assert align("static", once, 5).phi == pytest.approx(align("static", again, 5).phi, abs=0.0)


def test_the_interval_holds_the_true_value() -> None:
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        low, high = alignment.rms(2.0 * rng.standard_normal(8))[1]
        inside += low < 2.0 < high
    # 380 +- 4.4
    assert 360 < inside < 396


def test_refused_runs_are_told_and_are_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alignment, "CASES", (alignment.Case("driven off", "stops", "static", 0.1),))
    found = alignment.compute(runs=2, dt=0.05)
    row = found.rows[0]
    assert (row.name, row.ours, row.passed) == ("driven off: inside 3 sigma", 0.0, False)
    assert not found.passed
    assert any("2 of 2 runs refused" in note or "1 of 2 runs refused" in note for note in found.notes)


def test_the_printed_law_of_the_moving_base_diverges_at_any_speed_of_a_car() -> None:
    assert growth(0.0) < 0.0
    for speed in (3.0, 5.0, 8.0):
        assert growth(speed) > 0.02


def test_the_printed_methods_that_fail_are_told(computed: Callable[[str], Result]) -> None:
    notes = [note for note in computed("alignment").notes if "as printed" in note.lower()]
    assert len(notes) == 3


def test_runs_are_for_figures_that_have_some(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["figures", "coning", "--runs", "8"]) == 2
    assert "coning" in capsys.readouterr().err
