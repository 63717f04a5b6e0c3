"""Alignments run on a capture: what each of them finds, how well it says it knows it, and how soon.

The samples are those that the drivers of the engine make of the frames, compensation included; the
alignments get them as a navigator would, each from the same first sample on, until it hands over.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bridge.config import Config
from bridge.engine import build_drivers
from bridge.errors import CaptureError, ConfigError
from bridge.evaluate import TruthTable
from bridge.heard import heard
from bridge.navigators import lacking, navigator_config
from bridge.recording import Capture
from nav import rotation
from nav.align import AlignConfig, AlignStatus, NavInit, Run, advance, begin, result
from nav.earth import earth_rate_g
from nav.filter.settings import align_config
from nav.transfer import alignment
from nav.types import ImuFlag, ImuSample, Sample

Array = NDArray[np.float64]

_SAMPLED_NS: Final = 100_000_000
_TRUTH_GAP_NS: Final = 300_000_000
_FAULT: Final = int(ImuFlag.DEVICE_FAULT)
_DEG: Final = 180.0 / math.pi


@dataclass(frozen=True)
class Trace:
    """Ten times a second: ``t_s`` (n,) since the start, angles and their errors in deg, NaN while unknown.

    ``attitude``, ``error`` (n, 3) of pitch, roll, heading of the vehicle (of the IMU while the mounting is
    not known); a heading whose sigma is above 90 deg is not known. ``sigma``, ``limit`` (n, 3) about east,
    north, up.
    """

    t_s: Array
    attitude: Array
    error: Array
    sigma: Array
    limit: Array
    behind: NDArray[np.bool_]


@dataclass
class Found:
    """What one alignment came to.

    ``lacks`` names what it needs and does not get here; it was not run then. ``refusals`` are (s, why) of
    every start that it gave up, equal ones in a row once. ``ended_s`` is when it handed over. Of the
    attitude at the hand-over, or of the last one that it had: ``attitude_deg`` (pitch, roll, heading),
    ``sigma_deg`` and ``limit_deg`` (east, north, up), ``error_deg`` against truth where that is known. Sigmas
    are of the IMU's attitude, angles and errors of the vehicle's: ``mounting_sigma_deg`` of heading is to be
    added.
    """

    method: str
    lacks: str = ""
    refusals: list[tuple[float, str]] = field(default_factory=list)
    restarts: int = 0
    seconds: float = 0.0
    ended_s: float | None = None
    attitude_deg: tuple[float, ...] | None = None
    sigma_deg: tuple[float, ...] | None = None
    mounting_sigma_deg: float = 0.0
    limit_deg: tuple[float, ...] | None = None
    error_deg: tuple[float, ...] | None = None
    trace: Trace | None = None

    def converged_s(self, bound_deg: float) -> float | None:
        """When the sigma of heading fell below the bound for good; None: never."""
        if self.trace is None:
            return None
        known = np.isfinite(self.trace.attitude[:, 2])
        return _for_good(self.trace.t_s, known & (self.trace.sigma[:, 2] <= bound_deg))

    def right_s(self, bound_deg: float) -> float | None:
        """When the error of heading fell below the bound for good; None: never, or nobody knows."""
        if self.trace is None:
            return None
        known = np.isfinite(self.trace.error[:, 2])
        wrong = known & (np.abs(self.trace.error[:, 2]) > bound_deg)
        late = self.trace.t_s[wrong][-1] if wrong.any() else -math.inf
        after = self.trace.t_s[known & (self.trace.t_s > late)]
        return float(after[0]) if len(after) else None


def _for_good(t_s: Array, holds: NDArray[np.bool_]) -> float | None:
    """The time from which ``holds`` is true up to the end."""
    if len(holds) == 0 or not holds[-1]:
        return None
    never = np.flatnonzero(~holds)
    return float(t_s[0 if len(never) == 0 else never[-1] + 1])


def samples_of(capture: Capture, config: Config, navigator: str) -> Iterator[Sample]:
    """What a navigator's devices say, in the order of arrival."""
    drivers = build_drivers(config)
    for _, made in heard(capture, [drivers[name] for name in config.navigators[navigator].devices]):
        yield from made


class _Line:
    """One alignment under way, and what it said."""

    def __init__(self, method: str, config: AlignConfig, truth: _Truth) -> None:
        self.found = Found(method)
        self._config = config
        self._truth = truth
        self._run: Run = begin(alignment(method), config)
        self._start_ns: int | None = None
        self._next_ns = 0
        self._rows: list[tuple[int, AlignStatus]] = []
        self.done = False

    @property
    def begun(self) -> bool:
        """Whether there was an inertial sample."""
        return self._start_ns is not None

    def take(self, sample: Sample) -> None:
        """Give it the next sample."""
        inertial = isinstance(sample, ImuSample)
        if inertial and self._start_ns is None:
            self._start_ns = self._next_ns = sample.t_ns
        self._run, status = advance(self._run, sample)
        if status.refusal is not None:
            self._refuse(sample.t_ns, status.refusal)
        if status.done:
            self.done = True
            init = result(self._run)
            self.found.ended_s = (init.t_ns - (self._start_ns or init.t_ns)) * 1e-9
            self._rows.append((init.t_ns, status._replace(estimate=init.q_gb, covariance=init.P_phi)))
            self._finish(init)
        elif inertial and sample.t_ns >= self._next_ns:
            self._next_ns = sample.t_ns + _SAMPLED_NS
            self._rows.append((sample.t_ns, status))

    def _refuse(self, t_ns: int, why: str) -> None:
        refusals = self.found.refusals
        if not refusals or refusals[-1][1] != why:
            refusals.append(((t_ns - (self._start_ns or t_ns)) * 1e-9, why))

    def _finish(self, init: NavInit | None) -> None:
        found = self.found
        found.restarts = self._run.restarts
        if self._config.C_vb is not None:
            found.mounting_sigma_deg = self._config.sigma_mounting * _DEG
        elif init is not None and init.sigma_mounting is not None:
            found.mounting_sigma_deg = float(init.sigma_mounting[2]) * _DEG
        if not self._rows:
            return
        t_ns = np.array([row[0] for row in self._rows], dtype=np.int64)
        C_vb = self._config.C_vb if init is None or init.C_vb is None else init.C_vb
        q_bv = rotation.quat_from_dcm(np.eye(3) if C_vb is None else C_vb.T)
        unknown = np.full(4, math.nan)
        q_gb = np.array([unknown if s.estimate is None else s.estimate for _, s in self._rows])
        # an estimate from the midst of stored samples holds for another time
        behind = np.array([s.behind for _, s in self._rows])
        q_gb[behind] = math.nan
        attitude = _angles(rotation.quat_multiply(q_gb, np.broadcast_to(q_bv, q_gb.shape)))
        error = attitude - _angles(self._truth.at(t_ns))
        error = (error + math.pi) % (2.0 * math.pi) - math.pi
        sigma = np.sqrt(np.maximum([np.diag(s.covariance) for _, s in self._rows], 0.0))
        for values in (attitude, error):
            values[sigma[:, 2] > 0.5 * math.pi, 2] = math.nan
        found.trace = Trace(
            t_s=np.asarray((t_ns - (self._start_ns or 0)) * 1e-9, dtype=np.float64),
            attitude=attitude * _DEG,
            error=(error if C_vb is not None else np.full_like(error, math.nan)) * _DEG,
            sigma=sigma * _DEG,
            limit=np.array([s.limit for _, s in self._rows]) * _DEG,
            behind=behind,
        )
        found.seconds = float(found.trace.t_s[-1])
        known = np.flatnonzero(np.isfinite(found.trace.attitude[:, 0]))
        if len(known):
            last = int(known[-1])
            found.attitude_deg = _row(found.trace.attitude[last])
            found.sigma_deg, found.limit_deg = _row(found.trace.sigma[last]), _row(found.trace.limit[last])
            if math.isfinite(found.trace.error[last, 0]):
                found.error_deg = _row(found.trace.error[last])

    def close(self) -> Found:
        """What came of it; the capture is over, or nobody wants more."""
        if not self.done:
            self._finish(None)
        return self.found


def _row(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _angles(q_gv: Array) -> Array:
    """Pitch, roll, heading (n, 3) rad."""
    heading, pitch, roll = rotation.euler_from_quat(q_gv)
    return np.stack([pitch, roll, heading], axis=-1)


class _Truth:
    """The true attitude at any time, between instants that are close enough."""

    def __init__(self, table: TruthTable) -> None:
        self._table = table
        self.known = len(table.t_ns) > 0

    def at(self, t_ns: NDArray[np.int64]) -> Array:
        """``q_gv`` (n, 4); NaN where there is no truth on both sides."""
        table = self._table
        out = np.full((len(t_ns), 4), math.nan)
        if not self.known:
            return out
        right = np.clip(np.searchsorted(table.t_ns, t_ns), 0, len(table.t_ns) - 1)
        left = np.where(table.t_ns[right] == t_ns, right, np.maximum(right - 1, 0))
        span_ns = table.t_ns[right] - table.t_ns[left]
        inside = (table.t_ns[left] <= t_ns) & (t_ns <= table.t_ns[right]) & (span_ns <= _TRUTH_GAP_NS)
        # from either side by its rate, the nearer one counting more
        ends = []
        for side in (left, right):
            w_ie_g = np.array([earth_rate_g(lat) for lat in table.lat[side]]).reshape(-1, 3)
            w_gv_v = table.w_iv_v[side] - rotation.quat_rotate(
                rotation.quat_conjugate(table.q_gv[side]), w_ie_g
            )
            dt = ((t_ns - table.t_ns[side]) * 1e-9)[:, None]
            ends.append(rotation.quat_multiply(table.q_gv[side], rotation.quat_from_rotvec(w_gv_v * dt)))
        x = np.where(span_ns > 0, (t_ns - table.t_ns[left]) / np.maximum(span_ns, 1), 0.0)[:, None]
        apart = rotation.rotvec_from_quat(rotation.quat_multiply(rotation.quat_conjugate(ends[0]), ends[1]))
        out[inside] = rotation.quat_multiply(ends[0], rotation.quat_from_rotvec(x * apart))[inside]
        return out


def run_methods(
    capture: Capture,
    config: Config,
    methods: Sequence[str],
    *,
    navigator: str | None = None,
    start_s: float = 0.0,
    seconds: float | None = None,
) -> list[Found]:
    """Run ``methods`` side by side on the samples of a capture.

    ``navigator`` is the one whose devices and configuration count, by default the first; ``start_s`` of its
    samples are left out, and after ``seconds`` more it ends.

    Raises:
        ConfigError: an alignment or a navigator that there is not.
        CaptureError: there are no inertial samples in it.
    """
    name = next(iter(config.navigators)) if navigator is None else navigator
    if name not in config.navigators:
        known = ", ".join(config.navigators)
        raise ConfigError(f'{config.file}: found no navigator "{name}", expected one of {known}')
    lacks = lacking(name, config)
    for method in methods:
        if method not in lacks:
            raise ConfigError(f'found no alignment "{method}", expected one of {", ".join(lacks)}')
    align = align_config(navigator_config(name, config))
    truth = _Truth(TruthTable.from_documents(capture.truth()))
    lines = {method: _Line(method, align, truth) for method in methods if not lacks[method]}
    waiting = list(lines.values())
    first_ns = last_ns = None
    for sample in samples_of(capture, config, name):
        if type(sample) is ImuSample:
            # as in the navigator: what the device disowns and what runs backwards is not used
            if sample.flags & _FAULT or (last_ns is not None and sample.t_ns <= last_ns):
                continue
            last_ns = sample.t_ns
            first_ns = last_ns if first_ns is None else first_ns
        if first_ns is None or sample.t_ns < first_ns + round(start_s * 1e9):
            continue
        if seconds is not None and sample.t_ns > first_ns + round((start_s + seconds) * 1e9):
            break
        for line in waiting:
            line.take(sample)
        if any(line.done for line in waiting):
            waiting = [line for line in waiting if not line.done]
        if not waiting:
            break
    if lines and not any(line.begun for line in lines.values()):
        after = f" after {start_s:g} s" if first_ns is not None else ""
        raise CaptureError(f"{capture.path}: found no inertial sample for navigator {name}{after}")
    return [lines[m].close() if m in lines else Found(m, lacks=lacks[m]) for m in methods]
