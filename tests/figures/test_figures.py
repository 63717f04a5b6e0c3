"""What every figure promises: it stays inside its own tolerances, prints, and draws a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge.cli import main
from bridge.studies import figures
from bridge.studies.figures import FIGURES, load
from bridge.studies.figures.result import Result, Row


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_inside_its_tolerances(name: str, computed: Callable[[str], Result]) -> None:
    result = computed(name)
    outside = [row for row in result.rows if row.passed is False]
    assert not outside
    assert result.passed
    assert any(row.passed for row in result.rows), "something is judged"


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_says_what_it_compares(name: str, computed: Callable[[str], Result]) -> None:
    rows = computed(name).rows
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        assert row.name
        assert math.isfinite(row.ours)
        assert row.tolerance or row.passed is None, f"{row.name}: judged by an unnamed tolerance"


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_prints(name: str, computed: Callable[[str], Result]) -> None:
    result = computed(name)
    lines = result.lines()
    for row in result.rows:
        assert any(row.name in line for line in lines)
    assert max(map(len, lines)) <= 160
    document = json.loads(json.dumps(result.document(), allow_nan=False))
    assert document["passed"] is True
    assert len(document["rows"]) == len(result.rows)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_draws_a_picture(name: str, computed: Callable[[str], Result], tmp_path: Path) -> None:
    path = tmp_path / "figure.png"
    load(name).draw(computed(name), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000


def test_the_command_lists_what_each_reproduces(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["figures"]) == 0
    text = capsys.readouterr().out
    for name, figure in FIGURES.items():
        assert f"{name} " in text
        assert figure.summary in text
        assert figure.source in text
    assert main(["figures", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == set(FIGURES)


def test_an_unknown_figure_is_a_wrong_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["figures", "nowhere"]) == 2
    assert "coning" in capsys.readouterr().err
    assert main(["figures", "--out", "all.png"]) == 2


def test_a_picture_that_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(figures, "load", lambda name: pytest.fail("computed"))
    for path in (tmp_path, tmp_path / "missing" / "x.png"):
        assert main(["figures", "coning", "--out", str(path)]) == 1
        assert str(tmp_path) in capsys.readouterr().err


def stand_in(passed: bool | None) -> SimpleNamespace:
    rows = [
        Row("first", 1.0, 1.0, "1e-3", True, "m"),
        Row("second", 2.0, 3.0, "1e-3", passed, "m", "a misprint", 3.0),
    ]
    return SimpleNamespace(
        compute=lambda: Result("A figure", rows, ["a remark"], {"n": 1}),
        draw=lambda result, path: path.write_text("drawn"),
    )


@pytest.mark.parametrize(("passed", "status"), [(True, 0), (None, 0), (False, 1)])
def test_the_exit_status_says_whether_all_rows_are_inside(
    passed: bool | None,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(figures, "load", lambda name: stand_in(passed))
    path = tmp_path / "x.png"
    assert main(["figures", "coning", "--out", str(path)]) == status
    assert path.exists(), "drawn also when it is outside"
    out = capsys.readouterr().out
    assert ("OUTSIDE" in out) == (passed is False)
    assert "a misprint" in out
    assert "a remark" in out
    assert main(["figures", "coning", "--json"]) == status
    document = json.loads(capsys.readouterr().out)
    assert document["passed"] is (passed is not False)
    assert document["rows"][1]["why"] == "a misprint"
