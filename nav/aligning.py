"""The alignments of a navigator: those that run side by side until one of them hands over."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align import ALIGNMENTS, AlignStatus, NavInit, Run, advance, begin, result
from nav.events import AlignmentProgress, NavEvent, Notice
from nav.filter.settings import NavigatorConfig, align_config
from nav.rotation import dcm_from_quat, quat_from_dcm
from nav.types import Mode, S, Sample, Solution, SolutionFlag, Vector

_REPORT_NS: Final = 100_000_000
UNSAID_NS: Final = 100_000_000
"""Stored samples and late data that are worked off within this long change no mode."""


class Aligning:
    """Runs alignments side by side: the first to end hands over, the first named is reported."""

    def __init__(self, config: NavigatorConfig) -> None:
        self._config = config
        self._runs: list[Run] = []
        self._names: list[str] = []
        self._shown: tuple[list[float], Vector] = ([], np.empty(0))  # estimate q_gb and its q_gv
        self._report_ns = 0
        self._behind_ns: int | None = None
        self.running = False
        self.behind = False
        """Whether the last to be advanced goes through stored samples, and has not caught up for a tenth of a
        second: what is worked off in less is nobody's business."""
        self.ended = ""
        """The one that handed over."""

    @property
    def name(self) -> str:
        """The one that is reported."""
        return self._names[0]

    def begin(self, t_ns: int, *names: str) -> None:
        """Start these of `ALIGNMENTS` afresh at ``t_ns``."""
        config = align_config(self._config)
        self._names = list(dict.fromkeys(names))
        self._runs = [begin(ALIGNMENTS[name], config) for name in self._names]
        self._report_ns = t_ns
        self._behind_ns = None
        self.running = True
        self.behind = False

    def stop(self) -> None:
        """Drop them."""
        self._runs = []
        self.running = False

    def step(self, sample: Sample, events: list[NavEvent]) -> NavInit | None:
        """Take a sample; the initial state when one has ended. What there is to say goes to ``events``."""
        t, runs = sample.t_ns, self._runs
        for place in reversed(range(len(runs))):
            runs[place], status = advance(runs[place], sample)
            if status.done:
                self.ended = self._names[place]
                init = result(runs[place])
                self.stop()
                return init
        if status.refusal is not None:
            events.append(Notice(t, f"alignment starts again: {status.refusal}"))
        if not status.behind:
            self._behind_ns = None
        elif self._behind_ns is None:
            self._behind_ns = t
        self.behind = self._behind_ns is not None and t - self._behind_ns >= UNSAID_NS
        if t >= self._report_ns:
            self._report_ns = t + _REPORT_NS
            self._report(t, status, events)
        return None

    def _report(self, t: int, status: AlignStatus, events: list[NavEvent]) -> None:
        """What the alignment that was named first says of itself."""
        config = self._config
        sigma = np.sqrt(np.maximum(status.covariance.diagonal(), 0.0))
        east, north, up = sigma.tolist()
        limit_e, limit_n, limit_u = status.limit.tolist()
        events.append(
            AlignmentProgress(
                t,
                status.progress,
                (east, north, up),
                self.name,
                (limit_e, limit_n, limit_u),
                status.behind,
                self._runs[0].restarts,
            )
        )
        # an estimate from the midst of stored samples holds for another time
        if status.estimate is None or status.behind:
            return
        row = np.full(S.SIZE, math.nan)
        C_vb = config.C_vb
        estimate = status.estimate.tolist()
        if estimate != self._shown[0]:  # most stand for a second
            C_gb = dcm_from_quat(status.estimate)
            self._shown = estimate, quat_from_dcm(C_gb if C_vb is None else C_gb @ C_vb.T)
        row[S.Q] = self._shown[1]
        row[S.SIGMA_PHI] = sigma
        flags = int(SolutionFlag.LEVEL) if max(east, north) < config.heading_limit else 0
        if up < config.heading_limit:
            flags |= int(SolutionFlag.HEADING)
        if C_vb is not None:
            flags |= int(SolutionFlag.MOUNTING)
        events.append(Solution(t, Mode.ALIGN, flags, row))
