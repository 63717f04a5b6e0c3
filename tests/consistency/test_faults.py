"""Sensors that fail, a few runs of each sort; the whole campaign is ``navbridge campaign faults``."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bridge.cli import main
from bridge.studies import fault_campaign as study
from bridge.studies.fault_bound import least
from bridge.studies.fault_runs import FAULTS, KINDS, RATE_HZ, Case
from nav.imu.geometry import GEOMETRIES
from nav.imu.many import ideal
from nav.imu.redundant import Monitor, Noise, Redundant


def outcomes(geometry: str, multiple: float) -> list[study.Outcome]:
    return [
        study.look(0, Case(geometry, kind, fault, k, multiple))
        for kind in KINDS
        for fault in FAULTS
        for k in range(len(GEOMETRIES[geometry]))
    ]


def test_a_fault_of_any_sort_and_axis_of_the_cone_is_found_and_its_sensor_alone_excluded() -> None:
    rows = study.pooled(outcomes("cone", 3.0))
    assert len(rows) == len(KINDS) * len(FAULTS)
    for row in rows:
        assert (row.axes, row.missed, row.wrong, row.open) == ("told apart", 0, 0, 0), row
        # at most the window of 10 s, or for a ramp the time to its size
        assert row.late is not None
        assert row.late < 20.0, row
        assert row.least < row.worst < study.TWICE, row
        assert row.last <= row.worst, row


def test_of_two_askew_y_and_z_are_found_but_not_told_apart() -> None:
    assert study.twins(GEOMETRIES["skew"]) == {1, 2}
    assert study.twins(GEOMETRIES["cone"]) == set()
    for row in study.pooled(outcomes("skew", 3.0)):
        alike = row.axes == "alike"
        assert (row.runs, row.missed, row.wrong) == (2 if alike else 3, 0, 0), row
        assert row.open == (row.runs if alike else 0), row
        assert alike or row.worst < study.TWICE, row


def test_any_two_sensors_of_the_cone_may_fail() -> None:
    for one in study.dead(1):
        assert one.done == one.pairs
        # chi-square of three degrees: beyond 5 sigmas in 1 of 60 000
        assert one.sigmas < 5.0


def test_the_command_tells_what_it_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("MULTIPLES", (3.0,)), ("FAULTS", ("step",)), ("KINDS", ("gyro",))):
        monkeypatch.setattr(study, name, value)
    monkeypatch.setattr(study, "ALARMS", 1)
    assert main(["campaign", "faults", "--runs", "1", "--jobs", "1"]) == 0
    text = capsys.readouterr().out
    assert text.endswith("passed\n")
    assert main(["campaign", "faults", "--runs", "1", "--jobs", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["rows"][2]["delay"] is None
    assert [row["axes"] for row in document["rows"]] == ["told apart", "told apart", "alike"]
    assert [one["expected"] for one in document["false_alarms"]] == [1.0, 1.0]


@pytest.mark.parametrize("chance", [0.01, 1e-12])
def test_the_least_error_in_closed_form(chance: float) -> None:
    """White noise and a constant bias: lambda = b^2 T |v|^2 / q^2. Half are out at the larger of two."""
    fusion = Redundant(ideal(GEOMETRIES["cone"]), Noise(1e-6), RATE_HZ, Monitor(isolation=chance))
    seconds, share = 10.0, 0.5  # of a cone's sensor: in parity space, and in the fused increment
    alarm = stats.norm.isf(fusion.monitor.false_alarms * seconds / 3600.0)
    neighbour = math.sqrt(5.0) / 3.0  # the sine to the cosine of 2/3
    root = max(alarm, stats.norm.isf(chance) / neighbour)
    assert (root == alarm) == (chance == 0.01)
    bias = root * 1e-6 / math.sqrt(share * seconds)
    m = round(seconds * RATE_HZ)
    moved = np.zeros((m, 3))
    found = least(fusion, 1, np.full(m, bias / RATE_HZ), moved, 0, np.array([seconds]), RATE_HZ)
    assert found[0] / (bias * seconds * share) ** 2 == pytest.approx(0.5, rel=1e-9)


def test_what_theory_does_not_allow_is_complained_of() -> None:
    row = study.Row("cone", "gyro", "told apart", "step", 2.0, 1000, 0, 0, 0, 0, 1.0, 2.0, 1.2, 1.0, 1.1)
    found = study.Faults((row,), (study.Quiet("cone", 1.0, 100.0, 100),), (), 0, 1.0)
    assert found.complaints() == []
    assert found.quiet[0].chance == pytest.approx(1.0, abs=0.05)
    # of 1000 one may be missed and one wrong: 10 of a Poisson number of 1 never are
    worse = replace(row, missed=10, wrong=10, worst=3.0)
    assert len(replace(found, rows=(worse,)).complaints()) == 3
    # what cannot be told apart or is smaller than can be detected need not be out in time
    for other in (replace(row, worst=3.0, axes="alike"), replace(row, worst=3.0, multiple=0.5)):
        assert replace(found, rows=(other,)).complaints() == []
    # Poisson of 100: 150 is five sigmas off
    assert replace(found, quiet=(study.Quiet("cone", 1.0, 100.0, 150),)).complaints()
    assert replace(found, dead=(study.Dead("two", 15, 14, math.pi),)).complaints()
