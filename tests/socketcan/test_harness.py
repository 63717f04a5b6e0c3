"""The harness itself: a bus is there, it carries frames, and nothing hangs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.socketcan.candump import read_log
from tests.socketcan.conftest import absence
from tests.socketcan.smoke import FRAMES
from tests.socketcan.uml import Machine

ROOT = Path(__file__).parents[2]


def test_frames_cross_a_real_bus(machine: Machine, tmp_path: Path) -> None:
    outcome = machine.run(
        [sys.executable, "-m", "tests.socketcan.smoke", str(tmp_path)],
        work=tmp_path,
        timeout_s=60,
        env={"PYTHONPATH": str(ROOT)},
    )
    assert outcome.status == 0, outcome.output + outcome.console
    report = json.loads(outcome.output)
    assert len(report["received"]) == FRAMES
    logged = read_log(tmp_path / "smoke.log")
    assert [(key, data.hex()) for _, key, data in logged] == [
        (key, data) for key, data, _ in report["received"]
    ]
    # kernel stamps lie between the clock readings around the traffic
    assert all(
        report["before_s"] - 1e-3 <= stamp <= report["after_s"] + 1e-3 for _, _, stamp in report["received"]
    )
    assert report["link"]["stats64"]["tx"]["dropped"] == 0


def test_a_command_that_hangs_is_ended(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.socketcan.uml.BOOT_S", 4.0)
    outcome = machine.run(["sleep", "600"], work=tmp_path, timeout_s=1.0)
    assert outcome.status is None
    assert outcome.seconds < 30


def test_the_exit_status_comes_out(machine: Machine, tmp_path: Path) -> None:
    outcome = machine.run(["sh", "-c", "echo said; exit 7"], work=tmp_path, timeout_s=20)
    assert (outcome.status, outcome.output) == (7, "said\n")


def test_a_missing_bus_fails_in_ci_and_skips_elsewhere() -> None:
    with pytest.raises(pytest.fail.Exception, match="CI must run"):
        absence("no bus", ci=True)
    with pytest.raises(pytest.skip.Exception, match="no bus"):
        absence("no bus", ci=False)
