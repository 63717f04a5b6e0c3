"""Navigators that follow another one of the same process: the order they run in, and what they are told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from bridge.options import NavigatorOptions
from nav.types import MasterState, Mode, S, Solution, SolutionFlag

_WHOLE: Final = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING
_UNDER_WAY: Final = (Mode.NAVIGATE, Mode.DEGRADED)


def in_order(navigators: Mapping[str, NavigatorOptions]) -> list[str]:
    """Names of all, each behind the one that it follows; otherwise as they stand.

    Raises ValueError with a name that follows itself in the end.
    """
    done: list[str] = []
    for name in navigators:
        way: list[str] = []
        at: str | None = name
        while at is not None and at not in done:
            if at in way:
                raise ValueError(at)
            way.append(at)
            at = navigators[at].master_navigator
        done += reversed(way)
    return done


def as_master(solution: Solution, name: str) -> MasterState:
    """What a navigator called ``name`` tells those who follow it: its output point, vehicle axes for a."""
    x = solution.state
    return MasterState(
        t_ns=solution.t_ns,
        lat=solution.lat,
        lon=solution.lon,
        height=solution.height,
        v_g=x[S.V],
        q_ga=x[S.Q],
        w_ia_a=x[S.W],
        f_a=x[S.F],
        sigma_position=x[S.SIGMA_P],
        sigma_velocity=x[S.SIGMA_V],
        sigma_phi=x[S.SIGMA_PHI],
        valid=solution.mode in _UNDER_WAY and solution.flags & _WHOLE == _WHOLE,
        device=name,
    )


class Follower:
    """Lets so many solutions a second through to one that follows."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._slot = -1

    def wants(self, t_ns: int) -> bool:
        """Whether a solution of ``t_ns`` is the first in its interval."""
        slot = t_ns // self._period_ns
        if slot == self._slot:
            return False
        self._slot = slot
        return True
