"""The alignments of a navigator: those that run side by side until one of them hands over."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align import AlignStatus, NavInit, Run, advance, begin, result
from nav.align.handover import imu_place
from nav.earth import earth_rate_g
from nav.events import AlignmentProgress, NavEvent, Notice
from nav.filter.settings import NavigatorConfig, align_config
from nav.rotation import cross, dcm_from_quat, quat_from_dcm
from nav.transfer import alignment
from nav.transfer.report import Report
from nav.transfer.states import ACCEL_BIAS, GYRO_BIAS, PHI, POSITION, VELOCITY, place
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

    @property
    def mode(self) -> Mode:
        """What it is called to run the one that is reported."""
        return Mode.TRANSFER if "master" in self._runs[0].alignment.needs else Mode.ALIGN

    def begin(self, t_ns: int, *names: str) -> None:
        """Start these (`nav.transfer.alignment`) afresh at ``t_ns``."""
        config = align_config(self._config)
        self._names = list(dict.fromkeys(names))
        self._runs = [begin(alignment(name), config) for name in self._names]
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
        for k in reversed(range(len(runs))):
            runs[k], status = advance(runs[k], sample)
            if status.done:
                self.ended = self._names[k]
                if status.transfer is not None:
                    self._report(t, status, events)
                init = result(runs[k])
                self.stop()
                return init
        if status.refusal is not None:
            events.append(Notice(t, f"alignment starts again: {status.refusal}"))
        if not status.behind:
            self._behind_ns = None
        elif self._behind_ns is None:
            self._behind_ns = t
        self.behind = self._behind_ns is not None and t - self._behind_ns >= UNSAID_NS
        # once it has started a matching says when there is something to report, and of what time that holds
        unasked = self.mode is not Mode.TRANSFER or status.estimate is None
        if status.transfer is not None or (unasked and t >= self._report_ns):
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
        if status.transfer is not None:
            events.append(status.transfer.progress)
            events.append(_transferred(t, status.transfer, config))
            return
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


def _transferred(t: int, said: Report, config: NavigatorConfig) -> Solution:
    """The solution of a transfer alignment under way, which navigates already."""
    C_vb = np.eye(3) if config.C_vb is None else config.C_vb
    C_gb = dcm_from_quat(said.q_gb)
    out = config.output_point
    row = np.full(S.SIZE, math.nan)
    # the IMU's place is under the output point as it would be under an antenna
    row[S.LAT], row[S.LON], row[S.HEIGHT] = imu_place((said.lat, said.lon, said.height), C_gb @ -out)
    row[S.V] = said.v_g + C_gb @ cross(said.w_b - C_gb.T @ earth_rate_g(said.lat), out)
    row[S.Q] = quat_from_dcm(C_gb @ C_vb.T)
    row[S.W], row[S.F] = C_vb @ said.w_b, C_vb @ said.f_b
    row[S.GYRO_BIAS], row[S.ACCEL_BIAS] = said.x[place(GYRO_BIAS)], said.x[place(ACCEL_BIAS)]
    sigma = np.sqrt(said.P.diagonal())
    row[S.SIGMA_P], row[S.SIGMA_V], row[S.SIGMA_PHI] = sigma[POSITION], sigma[VELOCITY], sigma[PHI]
    row[S.SIGMA_GYRO_BIAS], row[S.SIGMA_ACCEL_BIAS] = sigma[GYRO_BIAS], sigma[ACCEL_BIAS]
    flags = int(SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL)
    if sigma[PHI][2] < config.heading_limit:
        flags |= int(SolutionFlag.HEADING)
    if config.C_vb is not None:
        flags |= int(SolutionFlag.MOUNTING)
    return Solution(t, Mode.TRANSFER, flags, row)
