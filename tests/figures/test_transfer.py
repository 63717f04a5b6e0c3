"""Transfer alignment in flights of seconds: what a run is made of, and what the figure says of it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from bridge.studies.consistency import band
from bridge.studies.figures import transfer
from bridge.studies.figures.result import Result
from bridge.studies.transfer_runs import Outcome, Trial, flight, follow, least
from nav.transfer.matching import ATTITUDE_16
from nav.types import ImuSample, MasterState

BRIEF = Trial("straight", 1.0, 100.0, 10.0)


def test_the_wing_rock_finds_the_azimuth_that_straight_flight_leaves(
    computed: Callable[[str], Result],
) -> None:
    cells = computed("transfer").numbers["cells"]
    rocked, straight = (cells[name] for name in ("wing rock, attitude", "straight, attitude"))
    # mounted to 0.3 deg: nothing else is known of the azimuth
    mounted = 1e3 * math.radians(0.3)
    assert straight["bound_mrad"][2] == pytest.approx(mounted, rel=0.01)
    # published: 1 mrad; an independent simulation with white flexure: 0.19
    assert 0.19 < rocked["bound_mrad"][2] < 1.0
    assert rocked["relative"]["rms"][2][0] < 0.25 * straight["relative"]["rms"][2][0]
    # level both times by the accelerometers, 1 mg: 1 mrad, and what the start knows of it
    assert straight["bound_mrad"][0] == pytest.approx(1.0, rel=0.05)


def test_against_truth_comes_what_the_master_is_wrong_by(computed: Callable[[str], Result]) -> None:
    cell = computed("transfer").numbers["cells"]["wing rock, attitude"]
    # 0.1 mrad level, 1 mrad heading when it begins
    assert cell["own_mrad"] == pytest.approx([0.1, 0.1, 1.0], rel=0.05)
    truth, relative = (np.array(cell[what]["mrad"]) for what in ("truth", "relative"))
    own = truth - relative
    low, high = band(1, len(own))
    assert low < np.mean(own[:, 2] ** 2) < high


def test_a_flight_is_its_seed_and_draws_what_is_told_wrongly() -> None:
    once, again, other = (flight(BRIEF, seed) for seed in (3, 3, 4))
    for a, b in zip(once.samples, again.samples, strict=True):
        assert a.t_ns == b.t_ns
        if isinstance(a, ImuSample) and isinstance(b, ImuSample):
            assert np.array_equal(a.dv, b.dv)
    told = [one.config.transfer for one in (once, other)]
    assert told[0] is not None
    assert told[1] is not None
    assert not np.array_equal(told[0].lever_arm, told[1].lever_arm)
    first = [next(s.t_ns for s in one.samples if isinstance(s, MasterState)) for one in (once, other)]
    assert first[0] != first[1]


def test_the_bound_sinks_with_time_and_does_not_know_the_seed() -> None:
    sigma = least(ATTITUDE_16, BRIEF, [0.3, 1.0])
    assert sigma.shape == (2, 3)
    assert np.all(sigma[1] < sigma[0])


def test_refused_flights_are_told_and_are_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(matching: str, *rest: object) -> Outcome:
        nothing = np.full((transfer.EPOCHS, 3), math.nan)
        covariance = np.full((transfer.EPOCHS, 3, 3), math.nan)
        return Outcome(nothing, covariance, nothing, covariance, "no master", 0.0, -4.0)

    monkeypatch.setattr(transfer, "follow", refused)
    pair = transfer.Pair("in vain", BRIEF, "velocity_attitude")
    found = transfer.compute(2, pairs=(pair,), others=())
    assert [(row.name, row.ours, row.passed) for row in found.rows] == [("in vain: refused", 100.0, False)]
    told = 'in vain: one of 2 refused, its messages dated 4.0 sigma wrong: "no master"'
    assert found.notes.count(told) == 2


def test_a_flight_that_ends_too_early_is_refused() -> None:
    made = flight(BRIEF, 0)
    found = follow("one_shot", made, [0.5, 10.0])
    assert found.refusal == "it did not come so far"
    assert np.all(np.isfinite(found.phi[0]))
    assert np.all(np.isnan(found.phi[1]))


def test_too_few_states_are_judged_by_what_they_can_know_beside_print_and_bound() -> None:
    rng = np.random.default_rng(5)
    spread = np.repeat(rng.standard_normal((24, 1, 3)), transfer.EPOCHS, axis=1) * 1e-3
    known = np.broadcast_to(1e-6 * np.eye(3), (24, transfer.EPOCHS, 3, 3))

    def judged(factor: float, short: bool) -> dict[str, tuple[bool | None, str]]:
        runs = [
            Outcome(factor * phi, P, factor * phi, P, "", 1.0, 0.0)
            for phi, P in zip(spread, known, strict=True)
        ]
        pair = transfer.Pair("few", BRIEF, "velocity", (1.0, 1.0, 1.0), "five", short)
        numbers = transfer._numbers(pair, runs, np.full((transfer.EPOCHS, 3), 2e-4))
        rows = transfer._judged(pair, numbers)
        assert {row.published for row in rows} == {1.0, None}
        return {row.name: (row.passed, row.why) for row in rows}

    # 1 mrad where half of it is asked, which is what it says of itself; explained all the same
    assert judged(1.0, False)["few: east"] == (False, "five")
    assert judged(1.0, True)["few: east"] == (True, "five")
    assert judged(1.0, True)["few: NEES"][0]
    assert judged(0.4, False)["few: east"] == (True, "")
    # twice what it says is not what it can know
    assert judged(2.0, True)["few: east"][0] is False
    assert judged(2.0, True)["few: NEES"][0] is False


def test_what_the_document_promises_of_velocity_is_judged_with_five_states_and_eleven() -> None:
    named = {pair.name: pair for pair in transfer.PAIRS}
    for flight_, level in (("S-turns", (1.0, 1.0, 1.0)), ("straight", (1.0, 1.0, math.inf))):
        for states in (5, 11):
            assert named[f"{flight_}, velocity {states}"].published == level
    assert [pair.name for pair in transfer.PAIRS if pair.short] == ["S-turns, velocity 5"]
