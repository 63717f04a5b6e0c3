"""What a run says to the person in front of it."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from numba import config

from bridge.outputs import Progress
from bridge.report import Printer, explain_wait


def test_a_wait_for_the_compiler_is_explained_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kernels"))
    said = io.StringIO()
    explain_wait(said)
    assert said.getvalue().startswith("compiling")
    (tmp_path / "kernels" / "strapdown").mkdir(parents=True)
    (tmp_path / "kernels" / "strapdown" / "step.nbi").touch()
    again = io.StringIO()
    explain_wait(again)
    assert again.getvalue() == ""


def told(*steps: tuple[str, float, int]) -> list[str]:
    """What is printed of method, fraction and restarts; from half way on heading is good to 1 deg."""
    said = io.StringIO()
    printer = Printer(said)
    for method, fraction, restarts in steps:
        sigma = (0.001, 0.001, 0.0175 if fraction > 0.5 else 3.0)
        printer.consume([Progress(0, "main", "alignment", fraction, sigma, method, restarts=restarts)])
    return said.getvalue().splitlines()


def test_an_alignment_is_told_of_when_it_begins_and_by_quarters() -> None:
    steps = [("gnss", fraction, 0) for fraction in (0.01, 0.1, 0.24, 0.26, 0.3, 0.6, 0.7, 1.0)]
    assert told(*steps) == [
        "main: alignment gnss 1 %",
        "main: alignment gnss 26 %",
        "main: alignment gnss 60 %, heading to 1 deg",
        "main: alignment gnss 100 %, heading to 1 deg",
    ]


def test_another_alignment_and_the_same_anew_are_told_of_and_a_refusal_tells_of_itself() -> None:
    static = [("static", 0.0, 0), ("static", 0.1, 0), ("static", 0.0, 0)]
    refused = [("static", 0.1, 0), ("static", 0.0, 1), ("static", 0.02, 1), ("static", 0.0, 2)]
    assert told(*static, *refused, ("gnss", 0.01, 0)) == [
        "main: alignment static 0 %",
        "main: alignment static 0 %",
        "main: alignment gnss 1 %",
    ]
