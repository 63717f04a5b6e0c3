"""What a navigator says of its alignment: when it is behind, and which parts of the attitude are known."""

from __future__ import annotations

import numpy as np
import pytest

from nav.align import ALIGNMENTS
from nav.align.types import AlignConfig, Alignment, AlignStatus, Stage
from nav.aligning import Aligning
from nav.events import NavEvent
from nav.filter.settings import ImuErrors, NavigatorConfig
from nav.jit import in_place
from nav.types import ImuSample, Solution, SolutionFlag, Vector

MS = 1_000_000


def told(
    monkeypatch: pytest.MonkeyPatch, behind: list[bool], sigma: tuple[float, float, float]
) -> tuple[list[bool], list[int]]:
    """What an alignment with these statuses, one a hundredth of a second, makes the navigator say."""

    def step(place: int, _sample: object) -> tuple[int, AlignStatus]:
        covariance = np.diag(np.square(sigma))
        estimate = np.array([1.0, 0.0, 0.0, 0.0])
        return place + 1, AlignStatus(estimate, covariance, np.zeros(3), 0.5, False, None, behind[place])

    stage = Stage(lambda _config, _given: 0, step, lambda _state: None)  # type: ignore[arg-type, return-value]
    monkeypatch.setitem(ALIGNMENTS, "made_up", Alignment(frozenset(), (stage,)))
    config = NavigatorConfig(
        ImuErrors(1e-6, 1e-5, 1e-8, 1e-5), align=AlignConfig(1e-8, 1e-5, 1e-6, 1e-5), heading_limit=0.01
    )
    aligning, said = Aligning(config), []
    events: list[NavEvent] = []
    aligning.begin(0, "made_up")
    rng = np.random.default_rng(1)
    for k in range(len(behind)):
        sample = ImuSample(10 * MS * k, 0.01, 1e-6 * rng.random(3), 1e-3 * rng.random(3), "imu")
        aligning.step(sample, events)
        said.append(aligning.behind)
    return said, [event.flags for event in events if isinstance(event, Solution)]


def test_it_is_behind_after_a_tenth_of_a_second_and_not_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    said, _ = told(monkeypatch, [k % 5 > 0 for k in range(50)], (1.0, 1.0, 1.0))
    assert not any(said)
    said, _ = told(monkeypatch, [False] * 5 + [True] * 30 + [False], (1.0, 1.0, 1.0))
    assert said == [False] * 15 + [True] * 20 + [False]


@pytest.mark.parametrize(
    ("sigma", "known"),
    [
        ((1.0, 1.0, 1.0), SolutionFlag.NONE),
        ((1e-4, 1e-4, 1.0), SolutionFlag.LEVEL),
        ((1e-4, 1e-4, 9e-3), SolutionFlag.LEVEL | SolutionFlag.HEADING),
    ],
)
def test_what_is_known_is_said_by_its_sigma(
    monkeypatch: pytest.MonkeyPatch, sigma: tuple[float, float, float], known: SolutionFlag
) -> None:
    _, flags = told(monkeypatch, [False] * 12, sigma)
    assert flags
    assert {flag & (SolutionFlag.LEVEL | SolutionFlag.HEADING) for flag in flags} == {known}


def test_a_kernel_in_place_returns_no_array() -> None:
    def out(x: Vector) -> Vector:
        return x

    with pytest.raises(TypeError, match="out returns Vector"):
        in_place(out)
