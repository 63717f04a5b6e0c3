"""Every entry of ALIGNMENTS is configured, numbered and commanded, and keeps what the table promises."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import cantools
import pytest

from bridge.commands import CONFIGURED, METHODS, CommandCode, Reason, Result, judge
from nav.align import ALIGNMENTS

DBC: Any = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"), "dbc")
KINDS = {"gnss", "odometer", "speed", "baro"}


def test_the_numbers_of_alignments_are_those_of_the_wire() -> None:
    assert len(set(METHODS.values())) == len(METHODS)
    assert CONFIGURED not in METHODS.values()
    for message, signal in (("COMMAND", "ARGUMENT"), ("SOL_ALIGN", "METHOD")):
        choices = DBC.get_message_by_name(message).get_signal_by_name(signal).choices
        named = {str(name): number for number, name in choices.items() if number != CONFIGURED}
        assert named == METHODS
    # recorded commands and other people's tables hold them: they never change
    assert list(METHODS.values()) == list(range(1, len(METHODS) + 1))
    assert list(METHODS)[:5] == ["static", "motion", "analytic", "open_loop", "kalman_closed"]
    assert list(METHODS)[5:10] == [
        "kalman_open", "kalman_psi", "gyrocompass", "rapid_gyrocompass", "moving_gyrocompass",
    ]  # fmt: skip
    assert list(METHODS)[10:17] == [
        "inertial", "inertial_single", "inertial_wahba", "odometer", "gnss", "large_angle", "stored",
    ]  # fmt: skip


def test_the_reasons_of_a_refusal_are_those_of_the_wire() -> None:
    signals = DBC.get_message_by_name("COMMAND_ACK")
    assert set(signals.get_signal_by_name("REASON").choices) == {int(reason) for reason in Reason}
    assert {int(result) for result in Result} <= set(signals.get_signal_by_name("RESULT").choices)
    codes = DBC.get_message_by_name("COMMAND").get_signal_by_name("CODE").choices
    assert set(codes) == {int(code) for code in CommandCode}


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_an_alignment_has_a_number_and_needs_what_there_is(name: str) -> None:
    assert name in METHODS
    assert ALIGNMENTS[name].stages
    assert ALIGNMENTS[name].needs <= KINDS | {"heading"}


@pytest.mark.parametrize("name", ALIGNMENTS)
@pytest.mark.parametrize("code", [CommandCode.START_ALIGNMENT, CommandCode.RESTART])
def test_a_command_starts_it_where_nothing_is_lacking(name: str, code: CommandCode) -> None:
    able = dict.fromkeys(ALIGNMENTS, "")
    for lacks in ("position", "heading", *sorted(KINDS)):
        unable = able | {name: lacks}
        verdict = judge(code, METHODS[name], {"one": able, "two": unable})
        assert (verdict.result, verdict.reason) == (Result.ACCEPTED, Reason.NONE)
        assert verdict.methods == {"one": name}
        (text,) = verdict.texts
        assert text.startswith(f"two: alignment {name} refused: it needs ")
        verdict = judge(code, METHODS[name], {"two": unable})
        assert verdict.result is Result.DENIED
        assert verdict.reason not in (Reason.NONE, Reason.UNKNOWN_CODE, Reason.UNKNOWN_METHOD)
        assert verdict.methods == {}
