"""What the alignments by apparent velocity share: how they wait, take late aids and say what they know."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from nav.align import still as watch
from nav.align.apparent import Tracker, at, present
from nav.align.handover import Place
from nav.align.static import PATIENCE_S, UNKNOWN, limits
from nav.align.types import AlignConfig, AlignStatus
from nav.types import ImuSample, Sample, Vector

NO_PLACE: Final = "no position: no GNSS fix came and the configuration gives none"


class Tracked(Protocol):
    """What the state of such a stage has."""

    @property
    def config(self) -> AlignConfig:
        """What is known of sensors and place."""

    @property
    def track(self) -> Tracker | None:
        """The integrals since the beginning, None before it."""

    @property
    def status(self) -> AlignStatus | None:
        """At the last epoch."""


class Aid(Protocol):
    """A sample that comes late."""

    @property
    def t_ns(self) -> int:
        """When it holds."""


State = TypeVar("State", bound=Tracked)
Late = TypeVar("Late", bound=Aid)
Taken = tuple[State, str | None]


def stepping(
    aid: Callable[[State, Sample], Taken[State]],
    begin: Callable[[State, ImuSample], Taken[State]],
    take: Callable[[State, Tracker, ImuSample], Taken[State]],
    since: Callable[[State], tuple[Vector, Vector, Vector]],
) -> Callable[[State, Sample], tuple[State, AlignStatus]]:
    """The step of a stage; what can go wrong is said as a refusal.

    ``aid`` takes every other sample, ``begin`` the first inertial ones until there is a `Tracked.track`,
    ``take`` all from then on. ``since`` gives the row of the last estimate and, from it on, the rate (3,)
    rad/s of east-north-up and what else (3,) rad it has turned.
    """

    def step(state: State, sample: Sample) -> tuple[State, AlignStatus]:
        """Take any sample."""
        if isinstance(sample, ImuSample):
            reason = watch.fault(sample)
            if reason is None and state.track is None:
                state, reason = begin(state, sample)
            if reason is None and state.track is not None:
                state, reason = take(state, state.track, sample)
        else:
            state, reason = aid(state, sample)
        status = state.status
        if status is None:
            status = blank(state.config, None)
        if reason is not None:
            return state, status._replace(done=False, refusal=reason)
        if status.estimate is None or status.done or state.track is None:
            return state, status
        # the body moves between epochs
        q_gb = present(state.track, since(state)[0], status.estimate, *since(state)[1:])
        return state, AlignStatus(q_gb, status.covariance, status.limit, status.progress, False)

    return step


def duration(config: AlignConfig) -> float:
    """Seconds that an alignment is given."""
    return config.coarse_s + config.fine_s


def progress(config: AlignConfig, seconds: float) -> float:
    """What part of them is over."""
    return min(1.0, seconds / duration(config))


def blank(config: AlignConfig, place: Place | None) -> AlignStatus:
    """Nothing known of the attitude, at a place (rad, rad, m) or before there is one."""
    lat, height = (place[0], place[2]) if place is not None else (0.8, 0.0)
    limit = limits(config, lat, height, duration(config))
    return AlignStatus(None, UNKNOWN.copy(), limit, 0.0, False)


def without_place(waited: float) -> str | None:
    """What to say after ``waited`` seconds without a position."""
    return NO_PLACE if waited > PATIENCE_S else None


def due(
    track: Tracker, pending: tuple[Late, ...], age_ns: Callable[[Late], int]
) -> tuple[tuple[Vector, Late] | None, tuple[Late, ...]]:
    """The next aid whose time the inertial samples have reached, with its row, and those that wait.

    It holds ``age_ns`` before its time. What is from before the beginning, or too old, is left out.
    """
    newest = int(track.times[(int(track.written[0]) - 1) % len(track.times)])
    while pending:
        t_ns = pending[0].t_ns - age_ns(pending[0])
        if t_ns > newest:
            break
        row = at(track, t_ns)
        if row is not None:
            return (row, pending[0]), pending[1:]
        pending = pending[1:]
    return None, pending
