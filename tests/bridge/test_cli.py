"""The command line: fast help, one-line errors, exit statuses."""

import subprocess
import sys
from pathlib import Path

import pytest

from bridge.cli import COMMANDS, main


def navbridge(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bridge.cli", *arguments], capture_output=True, text=True, timeout=60
    )


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    for name, command in COMMANDS.items():
        assert name in text
        assert command.help in " ".join(text.split())


def test_help_loads_nothing_heavy() -> None:
    code = "import sys; from bridge.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    code += "print([name for name in ('numpy', 'numba', 'can', 'pymavlink', 'mcap') if name in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


def test_no_command_is_a_wrong_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "COMMAND" in capsys.readouterr().out


def test_an_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["fly"])
    assert ended.value.code == 2
    assert 'no command "fly"; expected one of demo, run, ' in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["reply", "x.mcap"])
    assert caught.value.code == 2
    assert capsys.readouterr().err.endswith('did you mean "replay"?\n')


def test_an_unknown_option_is_refused_by_the_command_itself(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["demo", "--sped", "3"])
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("usage: navbridge demo ")
    assert error.endswith('unrecognized arguments: --sped; did you mean "--speed"?\n')


@pytest.mark.parametrize("command", [["demo", "--mavlink", "none"], ["run", "bench"]])
def test_a_capture_that_cannot_be_written_is_told_before_anything_is_compiled(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def late(*_: object) -> None:
        raise AssertionError("too late")

    monkeypatch.setattr("bridge.engine.warm_up", late)
    for place, reason in ((tmp_path, "it is a folder"), (tmp_path / "none" / "a.mcap", "there is no folder")):
        assert main([*command, "--out", str(place)]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f"navbridge: {place}: cannot write the capture: {reason}")
        assert error.count("\n") == 1


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("navbridge ")


@pytest.mark.parametrize("command", ["run", "replay"])
def test_the_help_of_a_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert len(capsys.readouterr().out) > 300


def test_errors_are_one_line_and_verbose_adds_the_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.mcap").write_text("no capture")
    assert main(["replay", str(tmp_path / "a.mcap")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("navbridge: ")
    assert error.count("\n") == 1
    assert main(["--verbose", "replay", str(tmp_path / "a.mcap")]) == 1
    verbose = capsys.readouterr().err
    assert "Traceback" in verbose
    assert verbose.endswith(error)


def test_a_wrong_configuration_has_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "no-such-config"]) == 2
    assert "no-such-config" in capsys.readouterr().err


def test_a_fault_of_ours_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("bridge.cli.replay.run", lambda args: [][1])
    assert main(["replay", "x"]) == 70
    assert "--verbose shows where" in capsys.readouterr().err


def test_an_interrupt_has_its_own_status(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("bridge.cli.replay.run", interrupted)
    assert main(["replay", "x"]) == 130


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run"], "required: CONFIG"),
        (["run", "bench", "--seconds", "0"], 'found "0", expected a number of seconds above 0'),
        (["demo", "--seconds", "-1"], 'found "-1", expected a number of seconds above 0'),
        (["demo", "--seconds", "nan"], 'found "nan", expected a number of seconds above 0'),
        (["sim", "drive", "--seconds", "soon"], 'found "soon", expected a number of seconds above 0'),
        (["demo", "--speed", "0"], 'found "0", expected max or a number above 0'),
        (["demo", "--speed", "fast"], 'found "fast", expected max or a number above 0'),
        (["demo", "--seed", "-1"], 'found "-1", expected a whole number, 0 or more'),
        (["run", "bench", "--realtime-priority", "100"], "expected a whole number, from 1 to 99"),
        (["busload", "--imu-rate", "inf"], 'found "inf", expected a number above 0'),
        (["replay", "a.mcap", "--golden", "beef"], "expected the 64 hexadecimal digits of a SHA-256"),
        (["import", "csv", "m.toml", "--out", "o", "--gnss-outage", "nan,nan"], "expected a LENGTH above 0"),
    ],
)
def test_wrong_arguments_have_status_two_and_say_what_was_expected(
    arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert expected in capsys.readouterr().err


def test_a_reader_that_goes_away_is_no_error() -> None:
    shell = f"{sys.executable} -m bridge.cli --help | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr
