"""What a transfer alignment knows, on CAN, MAVLink and the terminal, and what a demo says of its end."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli import main
from bridge.commands import HINTS
from bridge.outputs import ModeChange, Transfer
from bridge.studies.transfer_end import TransferSink, misalignment
from bridge.view import ViewSink
from bridge.view_screen import plain_line
from nav.transfer import MATCHINGS, matching
from nav.types import Mode
from tests.sinks.made import out, solution
from tests.sinks.test_can_solution import DBC, read, sink
from tests.sinks.test_mavlink_telemetry import GroundStation, telemetry
from tests.sinks.test_view import Shown, drawn
from virtual_bus.bus import Bench
from virtual_bus.scenario import load

SECOND_NS = 1_000_000_000
LEFT = (("velocity east", 0.5), ("phi east", 0.131), ("phi north", 0.146), ("phi up", 1.0), ("delay", 0.03))


def known(t_ns: int = 4 * SECOND_NS, **more: Any) -> Transfer:
    mounting = tuple(math.radians(x) for x in (-0.043, 0.5, 3.25))
    sigma_mounting = tuple(math.radians(x) for x in (0.028, 0.052, 0.3))
    plain = Transfer(
        t_ns, "main", "velocity_attitude", (0.7e-3, 0.8e-3, 5.2e-3), mounting, sigma_mounting, LEFT,
        "wing rock", 0.875,
    )  # fmt: skip
    return replace(plain, **more)


def test_can_tells_mounting_observability_and_the_manoeuvre_that_helps() -> None:
    made = sink()
    frames = read(made.consume([known()]))
    first, second = frames["SOL_TRANSFER"], frames["SOL_TRANSFER_OBS"]
    # half a raw step of each signal
    assert [first[f"MOUNTING_{a}"] for a in "XYZ"] == pytest.approx([-0.043, 0.5, 3.25], abs=5.1e-4)
    assert [second[f"SIGMA_{a}"] for a in "XYZ"] == pytest.approx([0.028, 0.052, 0.3], abs=1.01e-3)
    assert [second[f"LEFT_{a}"] for a in "ENU"] == [13, 15, 100]
    assert first["QUALITY"] == pytest.approx(87.5, abs=0.5)
    choices = DBC.get_message_by_name("SOL_TRANSFER").get_signal_by_name("HINT").choices
    assert str(choices[first["HINT"]]) == "Wing rock"
    assert first["ALIVE"] == second["ALIVE"] == 0
    assert made.consume([known(navigator="other")]) == []
    # no signal for it: the frame is left out, the other one is not
    frames = read(made.consume([known(mounting=(0.2, 0.0, 0.0))]))
    assert set(frames) == {"SOL_TRANSFER_OBS"}
    # a copy estimates nothing
    frames = read(made.consume([known(observability=(), hint="", sigma_mounting=(0.2, 0.2, 0.2))]))
    assert [frames["SOL_TRANSFER_OBS"][f"LEFT_{a}"] for a in "ENU"] == [100] * 3
    assert frames["SOL_TRANSFER_OBS"]["SIGMA_X"] == pytest.approx(2.046)
    assert frames["SOL_TRANSFER"]["HINT"] == 0


def test_every_manoeuvre_that_a_matching_asks_for_has_its_number_on_the_wire() -> None:
    choices = DBC.get_message_by_name("SOL_TRANSFER").get_signal_by_name("HINT").choices
    said = {str(name).lower(): number for number, name in choices.items()}
    assert said == {(hint or "none").lower(): number for hint, number in HINTS.items()}
    ways = [one for one in vars(matching).values() if isinstance(one, matching.Matching)]
    assert {one.name for one in ways} == set(MATCHINGS)
    assert {hint for one in ways for hint in (one.level, one.heading)} <= set(HINTS)


def test_mavlink_tells_it_once_a_second_and_says_what_would_help() -> None:
    made, station = telemetry(), GroundStation()
    first = station.read(made.consume([known(t_ns=4 * SECOND_NS)]))
    values = {m.name: m.value for m in first if m.get_type() == "NAMED_VALUE_FLOAT"}
    assert values == pytest.approx(
        {
            "XferSigE": 0.7, "XferSigN": 0.8, "XferSigU": 5.2,
            "XferMntX": -0.043, "XferMntY": 0.5, "XferMntZ": 3.25, "XferAgree": 87.5,
        },
        rel=1e-6,
    )  # fmt: skip
    (text,) = [m.text for m in first if m.get_type() == "STATUSTEXT"]
    assert text == "velocity_attitude: wing rock would help"
    assert not [
        m for m in station.read(made.consume([known(t_ns=4 * SECOND_NS + 10**8)])) if "NAMED" in m.get_type()
    ]
    later = station.read(made.consume([known(t_ns=5 * SECOND_NS)]))
    assert sum(m.get_type() == "NAMED_VALUE_FLOAT" for m in later) == 7
    # it has said so
    assert not [m for m in later if m.get_type() == "STATUSTEXT"]
    assert made.consume([known(navigator="other", t_ns=9 * SECOND_NS)]) is not None


def test_attitude_and_position_are_shown_while_it_runs() -> None:
    made, station = telemetry(), GroundStation()
    messages = station.read(made.consume([out(solution(mode=Mode.TRANSFER))]))
    assert {"ATTITUDE", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT"} <= {m.get_type() for m in messages}


def test_the_terminal_shows_it() -> None:
    shown = Shown()
    view = ViewSink(shown, "main", clock=lambda: 0.0)
    view.consume([ModeChange(1, "main", Mode.STANDBY, Mode.TRANSFER, "start"), known()])
    picture = shown.pictures[-1]
    screen = drawn(picture)
    for words in (
        "TRANSFER",
        "E 0.70 mrad",
        "U 5.20 mrad",
        "13 %",
        "3.250±0.300°",
        "would help",
        "wing rock",
    ):
        assert words in screen
    assert "to master 0.70 0.80 5.20 mrad, wing rock would help" in plain_line(picture)
    # once it has handed over, nothing would help
    view.consume([ModeChange(2, "main", Mode.TRANSFER, Mode.NAVIGATE, "aligned")])
    view.show()
    assert "would help" not in drawn(shown.pictures[-1])
    assert "to master" not in plain_line(shown.pictures[-1])


def test_the_end_is_told_against_master_and_truth() -> None:
    bench = Bench("transfer", seed=3, seconds=10.0)
    assert bench.master is not None
    sunk = TransferSink(bench, "main", lambda: 0)
    assert sunk.lines() == []
    t_ns = 4 * SECOND_NS
    truth = bench.truth(t_ns)
    there = solution(t_ns, mode=Mode.TRANSFER)
    there.state[6:10] = truth.q_gb
    phi, relative = misalignment(bench, there, t_ns)
    assert phi == pytest.approx([0.0] * 3, abs=1e-9)
    # an attitude without error is off from the master by what the master is off
    assert relative == pytest.approx(-bench.master.errors(np.array([t_ns]))[0][0])
    sunk.consume([ModeChange(0, "main", Mode.STANDBY, Mode.TRANSFER, "start"), known(), out(there)])
    lines = sunk.lines()
    assert lines[0] == "transfer alignment by velocity_attitude: not handed over, wing rock would help"
    assert any(line.startswith("relative to the master, at the end") for line in lines)
    sunk.consume([out(there), ModeChange(5 * SECOND_NS, "main", Mode.TRANSFER, Mode.NAVIGATE, "aligned")])
    lines = sunk.lines()
    assert lines[0].endswith("handed over after 5.0 s")
    # this one did not look for the mounting
    assert not any("mounting" in line for line in lines)
    sunk.consume([known(observability=(*LEFT, ("mounting right", 0.1)))])
    assert "mounting found beyond the configured one: -0.043 ± 0.028, 0.500" in sunk.lines()[-1]
    (row,) = [line for line in lines if line.startswith("against truth, at the hand-over")]
    assert [float(x) for x in row.split()[-6:-3]] == pytest.approx([0.0] * 3, abs=0.006)
    with pytest.raises(ValueError, match="no master"):
        misalignment(Bench("drive", seconds=2.0), there, t_ns)


def test_a_demo_aligns_a_slave_and_says_how_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # either spelling
    words = ["demo", "transfer", "--manoeuvre", "wing-rock", "--matching", "velocity_attitude"]
    quick = ["--seconds", "7", "--speed", "max", "--mavlink", "none", "--no-view", "--out", "d.mcap"]
    assert main([*words, *quick]) == 0
    said = capsys.readouterr().out
    assert re.search(r"transfer alignment by velocity_attitude: handed over after [56]\.\d s", said)
    number = r" +(-?\d+\.\d\d)"
    rows = [rf"{what}, at the hand-over{number * 6}" for what in ("relative to the master", "against truth")]
    for row in rows:
        match = re.search(row, said)
        assert match is not None, said
        off, sigma = [float(x) for x in match.groups()[:3]], [float(x) for x in match.groups()[3:]]
        # chi-square of three at 99.9 %, of numbers with two places
        assert sum((a / b) ** 2 for a, b in zip(off, sigma, strict=True)) < 16.6
    assert main(["replay", "d.mcap"]) == 0
    digest = re.findall(r"solution sha256: [0-9a-f]{64}", said)
    assert digest == re.findall(r"solution sha256: [0-9a-f]{64}", capsys.readouterr().out)
    # off line it is the same alignment of the same samples
    assert main(["align", "d.mcap", "--json"]) == 0
    (again,) = json.loads(capsys.readouterr().out)["alignments"]
    handed_over = re.search(r"handed over after (\d\.\d) s", said)
    assert handed_over is not None
    assert again["ended_s"] == pytest.approx(float(handed_over.group(1)), abs=0.06)


def test_a_manoeuvre_or_matching_without_a_master_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for option, value in (("--manoeuvre", "s-turn"), ("--matching", "position")):
        assert main(["demo", "drive", option, value]) == 2
        assert f"{option}: found drive, expected a scenario with a master" in capsys.readouterr().err
    assert load("transfer").master is not None
