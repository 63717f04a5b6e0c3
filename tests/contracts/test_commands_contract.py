"""What every entry of COMMANDS and IMPORTERS promises; a new entry is held to it once it is registered."""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.writer import Writer

from bridge.cli import COMMANDS, main
from bridge.importers import IMPORTERS

CAPTURES = ("replay", "inspect", "align", "allan", "arms", "plot", "decode")
"""Commands that read a capture."""
CONFIGS = ("run", "check")
"""Commands that read a configuration."""
OUT = {"plot": ["--out"], "decode": ["--out"]}
OTHERS = {
    "demo": ["nowhere"],
    "sim": ["nowhere"],
    "import": ["candump", "nothing.log", "--config", "bench", "--out", "out.mcap"],
    "campaign": ["static", "--scenario", "nowhere", "--runs", "2", "--jobs", "1"],
    "figures": ["nowhere"],
    "calibrate": ["nowhere", "nothing.mcap", "--out", "imu.toml"],
    "busload": ["--bitrate", "1", "--json"],
}
"""A command line of each other command that cannot be done."""


def test_every_command_is_held_to_its_promises() -> None:
    assert {*CAPTURES, *CONFIGS, *OTHERS} == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_help(name: str) -> None:
    module = importlib.import_module(COMMANDS[name].module)
    subparsers = argparse.ArgumentParser(prog="navbridge").add_subparsers()
    module.add_parser(subparsers)
    assert len(subparsers.choices[name].format_help()) > 100
    assert callable(module.run)


def unreadable(kind: str, folder: Path) -> Path:
    path = folder / "x"
    if kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.touch()
    elif kind == "text":
        path.write_text("hello, this is a text file\n")
    elif kind == "noise":
        path.write_bytes(bytes(range(256)) * 20)
    elif kind == "foreign":
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.add_message(writer.register_channel("/imu", "json", 0), 1, b"{}", 1)
            writer.finish()
    return path


def failed(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = main(words)
    error = capsys.readouterr().err
    assert error.startswith("navbridge: ")
    assert error.count("\n") == 1, "one line"
    assert "fault of navbridge" not in error
    return status, error


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "noise", "foreign"])
@pytest.mark.parametrize("name", CAPTURES)
def test_what_is_no_capture_is_refused_in_a_line_that_names_it(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = unreadable(kind, tmp_path)
    words = [name, str(path)] + [item for key in OUT.get(name, []) for item in (key, str(tmp_path / "out"))]
    status, error = failed(words, capsys)
    assert status == 1
    assert str(path) in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "noise", "foreign"])
@pytest.mark.parametrize("name", CONFIGS)
def test_what_is_no_configuration_is_refused_in_a_line_that_names_it(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = unreadable(kind, tmp_path)
    status, error = failed([name, str(path)], capsys)
    assert status == 2
    assert path.name in error


@pytest.mark.parametrize("name", [name for name in OTHERS if name != "busload"])
def test_what_cannot_be_done_is_refused_in_a_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    status, error = failed([name, *OTHERS[name]], capsys)
    assert status in (1, 2)
    assert any(word in error for word in OTHERS[name])
    assert list(tmp_path.iterdir()) == [], "nothing was begun"


def test_a_bus_that_is_too_slow_is_a_result_not_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["busload", *OTHERS["busload"]]) == 1
    assert capsys.readouterr().err == ""


def test_the_package_runs_as_the_command() -> None:
    shown = subprocess.run(
        [sys.executable, "-m", "bridge", "--version"], capture_output=True, text=True, timeout=60, check=True
    )
    assert shown.stdout.startswith("navbridge ")


@pytest.mark.parametrize("name", IMPORTERS)
def test_an_importer_has_help(name: str) -> None:
    parser = argparse.ArgumentParser()
    IMPORTERS[name].add_arguments(parser)
    assert IMPORTERS[name].help
    assert len(parser.format_help()) > 100


@pytest.mark.parametrize("kind", ["missing", "folder", "empty", "text", "noise"])
@pytest.mark.parametrize("name", IMPORTERS)
def test_what_cannot_be_imported_is_refused_in_a_line_and_leaves_nothing(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = unreadable(kind, tmp_path), tmp_path / "out.mcap"
    more = ["--config", "bench"] if name == "candump" else []
    status, error = failed(["import", name, str(path), *more, "--out", str(out)], capsys)
    assert status in (1, 2)
    assert path.name in error
    assert not out.exists()
