"""The demo as a user sees it: what it prints, what it leaves, and that nothing but its seed matters."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.clock import SimulatedClock
from bridge.evaluate import TruthTable
from bridge.recording import Capture
from tests.clients.conftest import SCENARIO

NUMBER = r"\s+-?[\d.]+"


def options(folder: Path, speed: str) -> list[str]:
    scenario = folder / "round.toml"
    scenario.write_text(SCENARIO)
    out = ["--out", str(folder / "demo.mcap"), "--mavlink", "none"]
    return ["demo", str(scenario), "--seconds", "30", "--speed", speed, "--seed", "3", *out]


def test_pace_hash_seed_process_and_folder_change_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*options(tmp_path, "max"), "--no-view"]) == 0
    *_, share, title, horizontal, height, velocity, heading, level, digest = (
        capsys.readouterr().out.splitlines()
    )
    found = re.fullmatch(r"navigated ([\d.]+) of 30\.0 s \(([\d.]+)%\), aligned after ([\d.]+) s", share)
    assert found is not None, share
    navigated, percent, aligned = map(float, found.groups())
    assert navigated + aligned == pytest.approx(30.0, abs=0.3)
    assert percent == pytest.approx(navigated / 0.3, abs=0.3)
    assert title.split() == ["error", "against", "truth", "RMS", "largest", "final", "error/sigma"]
    rows = {"horizontal (m)": horizontal, "height (m)": height, "velocity (m/s)": velocity}
    rows |= {"heading (deg)": heading, "level (deg)": level}
    for name, row in rows.items():
        assert re.fullmatch(re.escape(name) + 4 * NUMBER, row), row
    # seconds after alignment, aided by a receiver good to half a metre
    assert float(horizontal.split()[2]) < 1.0
    assert re.fullmatch(r"solution sha256: [0-9a-f]{64}", digest)

    capture = Capture(tmp_path / "demo.mcap")
    truth = TruthTable.from_documents(capture.truth())
    assert len(truth.t_ns) > 100  # ten a second since there were solutions
    assert capture.metadata["seed"] == "3"

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "bridge.cli", *options(elsewhere, "20")],
        capture_output=True,
        text=True,
        timeout=240.0,
        check=True,
        cwd=elsewhere,
        env={**os.environ, "PYTHONHASHSEED": "4711"},
    )
    lines = done.stdout.splitlines()
    assert lines[-1] == digest
    assert lines[-8:-1] == [share, title, horizontal, height, velocity, heading, level]
    # the view prints plain lines where there is no terminal
    assert any("ALIGN" in line for line in lines)


def test_an_unknown_scenario_is_one_line_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "drvie", "--speed", "max"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "drvie" in complaint
    assert "drive" in complaint


def test_paced_clock_waits_for_the_host_but_not_for_itself() -> None:
    clock = SimulatedClock(utc_ns=10**18, speed=10.0, monotonic_ns=5)
    start = time.monotonic()
    clock.wait_until(1_000_000_005)  # a second at ten times: a tenth
    assert 0.09 < time.monotonic() - start < 5.0
    assert clock.monotonic_ns() == 1_000_000_005
    assert clock.utc_ns() == 10**18 + 1_000_000_000
    time.sleep(0.05)
    assert clock.monotonic_ns() == 1_000_000_005  # stands still while the program works
    clock.wait_until(0)
    assert clock.monotonic_ns() == 1_000_000_005  # and never goes back


def test_paced_clock_wakes_for_input() -> None:
    inlet, outlet = os.pipe()
    try:
        os.write(outlet, b"x")
        clock = SimulatedClock(utc_ns=0, speed=1.0)
        start = time.monotonic()
        clock.wait_until(3_600_000_000_000, [inlet])
        assert time.monotonic() - start < 60.0
        assert clock.monotonic_ns() < 60_000_000_000
    finally:
        os.close(inlet)
        os.close(outlet)
