"""The one stage of every matching: a slave that navigates, corrected by its master's messages."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nav import rotation as rot
from nav.align.handover import hand_over
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage, TransferConfig
from nav.earth import gravity_g, position_matrix
from nav.filter.kalman import GATES
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from nav.transfer import model
from nav.transfer.correction import Use, correct, take, weigh
from nav.transfer.matching import Matching
from nav.transfer.moved import moved
from nav.transfer.report import Report, ratios, report
from nav.transfer.slave import Slave
from nav.transfer.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    DELAY,
    MOVED,
    PHI,
    POSITION,
    SIZE,
    VELOCITY,
    X_ERRORS,
    X_REST,
    X_SIZE,
    place,
)
from nav.transfer.watch import AGREE, CAUSES, Watch
from nav.types import ImuFlag, ImuSample, MasterState, Sample

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

REPORT_NS: Final = 100_000_000
AHEAD_NS: Final = 100_000_000
"""A message that is dated further ahead of the newest inertial sample is refused."""
_MISSING_NS: Final = 100_000_000  # of inertial samples: a longer silence is no alignment any more
_UNKNOWN: Final = np.eye(3) * math.pi**2
_ALL: Final = np.full(3, Use.COPY, dtype=np.int64)
_CAUSES: Final = np.array(CAUSES)
_UNUSABLE: Final = int(ImuFlag.SATURATED)


class Transfer:
    """State of the stage; it is used up by `step`."""

    def __init__(self, config: AlignConfig, matching: Matching) -> None:
        self.config = config
        self.transfer = config.transfer or TransferConfig()
        self.matching = matching
        self.told = model.told(self.transfer)
        self.mask = matching.mask
        self.rows = np.empty(3), np.empty((3, SIZE)), np.empty((3, 3))  # residual, H, R of a kind
        self.kinds = tuple(
            (kind, np.array(uses, dtype=np.int64), own, make)
            for kind, uses, own, make in (
                ("position", matching.position, POSITION, model.position_rows),
                ("velocity", matching.velocity, VELOCITY, model.velocity_rows),
                ("attitude", matching.attitude, PHI, model.attitude_rows),
                ("rate", matching.rate, PHI, model.rate_rows),
            )
            if any(uses)
        )
        self.slave = Slave(config, self.transfer)
        self.watch = Watch(self.transfer.lockout, matching.white)
        self.pending: deque[MasterState] = deque()
        self.last: MasterState | None = None
        self.began_ns: int | None = None  # first sample
        self.start_ns = 0  # first message in use
        self.first = np.ones(SIZE)  # sigmas when the filter started
        self.report_ns = 0
        self.status = AlignStatus(None, _UNKNOWN, np.zeros(3), 0.0, False)

    # ---- samples -------------------------------------------------------------------------------

    def inertial(self, s: ImuSample) -> str | None:
        """Take a sample; why it cannot go on, or None."""
        newest = self.slave.newest_ns
        if self.began_ns is None:
            self.began_ns = self.report_ns = s.t_ns
        elif s.t_ns - newest - s.dt * 1e9 > _MISSING_NS:
            return f"no inertial data for {(s.t_ns - newest) * 1e-9:.1f} s"
        if s.flags & _UNUSABLE and self.slave.started:
            return "an inertial sensor was at the end of its range"
        self.slave.add(s)
        self._work_off()
        return self._verdict(s.t_ns)

    def message(self, m: MasterState) -> None:
        """Take a message of the master, in the order of arrival."""
        if self.began_ns is None:
            return
        expected = self._expected(m)
        if expected:
            self.watch.turn_away(expected, self.slave.newest_ns)
            return
        if not self.watch.hear(m, self.slave.newest_ns):
            return
        if m.t_ns - self.slave.newest_ns < AHEAD_NS:
            self.pending.append(m)
            self._work_off()

    def _expected(self, m: MasterState) -> str:
        """What a message of the master should be and is not; nothing if it is of use."""
        if not m.valid or not _finite(m):
            return "valid message"
        needs = self.matching.needs
        if m.q_ga is None and (not self.slave.started or "q_ga" in needs):
            return "message with attitude"
        return "message with rates" if m.w_ia_a is None and "w_ia_a" in needs else ""

    def _work_off(self) -> None:
        """Use the messages whose time has come by the inertial samples."""
        slave, pending = self.slave, self.pending
        while pending:
            t_ns = pending[0].t_ns
            if slave.started:
                t_ns -= round(float(slave.x[X_ERRORS + DELAY - MOVED]) * 1e9)
            if t_ns + slave.ahead_ns > slave.newest_ns:
                return
            m = pending.popleft()
            if slave.started:
                if t_ns <= slave.anchor_ns:
                    continue
                self._compare(m, t_ns)
            elif slave.covers(t_ns):
                self._start(m)
            self.last = m

    # ---- the filter ----------------------------------------------------------------------------

    def _start(self, m: MasterState) -> None:
        """Take everything over from the master: position, velocity, attitude."""
        assert m.q_ga is not None
        transfer, slave = self.transfer, self.slave
        C_gb = rot.dcm_from_quat(m.q_ga) @ transfer.C_ab
        x = np.zeros(X_SIZE)
        x[X_Q : X_Q + 4] = rot.quat_from_dcm(C_gb)
        x[X_V : X_V + 3] = m.v_g
        x[X_C : X_C + 9] = position_matrix(m.lat, m.lon).ravel()
        x[X_H] = m.height
        x[X_REST : X_REST + 3] = C_gb.T @ -gravity_g(m.lat, m.height)
        P = model.initial_covariance(self.config, transfer)
        slave.begin(m.t_ns, x, P)
        now, seen, dx = slave.instant(m.t_ns), model.master(m), np.zeros(SIZE)
        scene = model.scene(x, now, seen, self.told)
        r, H, R = self.rows
        for make, own in (
            (model.attitude_rows, PHI),
            (model.velocity_rows, VELOCITY),
            (model.position_rows, POSITION),
        ):
            _, share = make(x, now, seen, self.told, scene, r, H, R)
            K, W, S, e, _ = weigh(P, H, r, R, _ALL, own.start, self.mask, share, dx, _CAUSES)
            take(P, dx, K, W, S, e)
        correct(x, dx)
        slave.P = P
        slave.run_on()
        self.start_ns = m.t_ns
        self.first = np.sqrt(np.diag(P))

    def _compare(self, m: MasterState, t_ns: int) -> None:
        """Compare a message with the slave at its time, and correct."""
        slave = self.slave
        before = slave.x[X_Q : X_Q + 4].copy()
        slave.advance(t_ns)
        dx = np.zeros(SIZE)
        now, seen = slave.instant(t_ns), model.master(m)
        scene = model.scene(slave.x, now, seen, self.told)
        self._moved(before, m, now, seen, scene)
        r, H, R = self.rows
        for kind, uses, own, make in self.kinds:
            straight, share = make(slave.x, now, seen, self.told, scene, r, H, R)
            if not straight:
                continue
            K, W, S, e, whitened = weigh(slave.P, H, r, R, uses, own.start, self.mask, share, dx, _CAUSES)
            passed = float(whitened[:, 0] @ whitened[:, 0]) <= GATES[len(e)]
            if self.watch.see(kind, t_ns, passed, whitened) and passed:
                take(slave.P, dx, K, W, S, e)
        correct(slave.x, dx)
        slave.run_on()

    def _moved(self, before: Vector, m: MasterState, now: Vector, seen: Vector, scene: Vector) -> None:
        """Tell the watch how master and slave moved since the last message."""
        last, slave = self.last, self.slave
        if last is None or last.q_ga is None or m.q_ga is None or m.t_ns <= last.t_ns:
            return
        seconds = (m.t_ns - last.t_ns) * 1e-9
        turn, turned, force = moved(slave.x, before, model.master(last), seen, seconds, now, scene, self.told)
        self.watch.moved(turn, turned, force, slave.force)

    # ---- what it comes to ----------------------------------------------------------------------

    def _verdict(self, t_ns: int) -> str | None:
        """Renew the status when it is time; why it cannot go on, or None."""
        if t_ns < self.report_ns:
            if self.status.transfer is not None:
                self.status = self.status._replace(transfer=None)
            return None
        self.report_ns = t_ns + REPORT_NS
        assert self.began_ns is not None
        transfer, slave = self.transfer, self.slave
        reason = self.watch.cause(t_ns)
        if not slave.started or reason is not None:
            return reason
        said = self.report()
        quality = said.progress.quality
        sigma = np.array(said.progress.sigma)
        seconds = (t_ns - self.start_ns) * 1e-9
        known = not self.matching.estimated or bool(np.all(sigma <= transfer.sigma))
        done = known and seconds >= transfer.duration and quality >= AGREE
        progress = min(1.0, seconds / transfer.duration)
        if not known:
            progress *= float(np.min(np.minimum(1.0, transfer.sigma / sigma)))
        self.status = AlignStatus(said.q_gb, said.P[PHI, PHI], transfer.sigma, progress, done, transfer=said)
        if not done and seconds > transfer.patience:
            return f"phi is not known well enough after {transfer.patience:.0f} s"
        return None

    def report(self) -> Report:
        """What is known now."""
        assert self.last is not None
        slave = self.slave
        seen = ratios(slave.P, self.first, self.matching)
        quality = self.watch.quality(slave.newest_ns)
        return report(slave, self.matching, self.transfer, self.last, seen, quality)


def _finite(m: MasterState) -> bool:
    parts = [m.v_g, *(p for p in (m.q_ga, m.w_ia_a) if p is not None)]
    return math.isfinite(m.lat + m.lon + m.height + sum(float(np.sum(p)) for p in parts))


def stage(matching: Matching) -> Stage[Transfer]:
    """The stage of a matching."""

    def init(config: AlignConfig, given: NavInit | None) -> Transfer:
        return Transfer(config, matching)

    def step(state: Transfer, sample: Sample) -> tuple[Transfer, AlignStatus]:
        if type(sample) is ImuSample:
            reason = state.inertial(sample)
            return state, state.status if reason is None else state.status._replace(
                done=False, refusal=reason
            )
        if isinstance(sample, MasterState):
            state.message(sample)
        # only an inertial sample ends it: the hand-over is at its time
        return state, state.status._replace(done=False, transfer=None)

    return Stage(init=init, step=step, finish=finish)


def finish(state: Transfer) -> NavInit:
    """The live state with the covariance it has against the truth: the master's own errors are in it."""
    state.slave.advance(state.slave.newest_ns)
    said = state.report()
    x = said.x
    # the accelerometers' bias is what is wrong at rest, in this attitude
    rest = rot.quat_rotate(rot.quat_conjugate(said.q_gb), -gravity_g(said.lat, said.height))
    turned = np.kron(np.eye(3), rest - x[X_REST : X_REST + 3])
    T = np.zeros((15, SIZE))
    T[:, :15] = np.diag([*(-1.0,) * 6, *(1.0,) * 3, *(-1.0,) * 6])
    T[ACCEL_BIAS, ACCEL_AXES] = -turned
    biases = x[X_ERRORS : X_ERRORS + 6].copy()
    biases[3:] += turned @ x[place(ACCEL_AXES)]
    P = T @ said.P @ T.T
    there = (said.lat, said.lon, said.height)
    return hand_over(state.slave.newest_ns, there, said.v_g, said.q_gb, biases, P, None, None)
