"""The navigator: samples in, solutions and events out, in the order in which they arrive.

A pure fold: no clock is read, nothing is drawn. Modes: STANDBY until `Navigator.start`, ALIGN (TRANSFER with
a master) until the alignment hands over, then NAVIGATE; CATCH_UP while stored samples are gone through, by
an alignment or to work in late data, DEGRADED while an aid that the configuration counts on is missing,
FAULT when the state is no longer a number or the azimuth law is about to fail.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from nav.align import NavInit
from nav.aligning import UNSAID_NS, Aligning
from nav.events import ModeChange, NavEvent, Notice, Refusal
from nav.filter.aiding import Aiding
from nav.filter.history import Timeline
from nav.filter.initial import initial_state
from nav.filter.mounting import MountingSearch, settle
from nav.filter.reconfigured import more_walk, reconfigured
from nav.filter.report import solution_covariance
from nav.filter.settings import ImuErrors, NavigatorConfig, parameters
from nav.filter.standstill import Rest, Standstill
from nav.strapdown.azimuth import NorthLawRefusal, refuse_latitude
from nav.transfer import alignment
from nav.types import (
    BaroSample,
    FixType,
    GnssFix,
    ImuChange,
    ImuFlag,
    ImuSample,
    Mode,
    OdoSample,
    S,
    Sample,
    Solution,
    SolutionFlag,
    SpeedSample,
    Vector,
)

__all__ = ["ImuErrors", "NavInit", "Navigator", "NavigatorConfig"]

_CHECK_NS: Final = 100_000_000
_RECENT_NS: Final = 2_000_000_000
_GAP_SHOWN_NS: Final = 5_000_000_000
_BRIDGED: Final = int(ImuFlag.BRIDGED)
_SATURATED: Final = int(ImuFlag.SATURATED)
_FAULT: Final = int(ImuFlag.DEVICE_FAULT)
_GAP: Final = int(ImuFlag.GAP)
_AIDED: Final = int(SolutionFlag.GNSS | SolutionFlag.ODOMETER)
_ALIGNED: Final = int(SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL)


class Navigator:
    """One navigator; see the module."""

    def __init__(self, config: NavigatorConfig) -> None:
        self.config = config
        self.mode = Mode.STANDBY
        self._samples = config.samples_per_update
        self._timeline = Timeline(
            config.states, parameters(config), config.lockout, config.replay_updates, self._samples
        )
        self._aiding = Aiding(config, self._timeline)
        self._standstill = Standstill(config)
        self._events: list[NavEvent] = []
        self._aligning = Aligning(config)
        self._pending: list[ImuSample] = []
        self._imu_ns: int | None = None
        self._check_ns = 0
        self._gap_ns: int | None = None
        self._rest_ns: int | None = None
        self._degraded: str | None = None
        self._behind_ns: int | None = None  # late data is being worked in since then
        self._search = MountingSearch()
        self._flags = 0

    # ---- commands ------------------------------------------------------------------------------

    def start(self, t_ns: int, method: str | None = None) -> list[NavEvent]:
        """Begin with alignment at ``t_ns``, whatever the mode was.

        ``method`` is a name that `nav.transfer.alignment` knows; None: the configured one.
        """
        self._align(t_ns, "start", self.config.alignment if method is None else method)
        return self._drain()

    def begin(self, init: NavInit) -> list[NavEvent]:
        """Navigate from ``init``, without alignment."""
        self._navigate(init, "initial state given")
        return self._drain()

    def stop(self, t_ns: int) -> list[NavEvent]:
        """Go to STANDBY."""
        self._aligning.stop()
        self._change(t_ns, Mode.STANDBY, "stop")
        return self._drain()

    def covariance(self) -> Vector:
        """Covariance (9, 9) of the present solution's errors, see `solution_covariance`; while navigating."""
        live = self._timeline.live
        return solution_covariance(live.x, live.P, self._timeline.par)

    # ---- samples -------------------------------------------------------------------------------

    def step(self, sample: Sample) -> list[NavEvent]:
        """Take one sample, in the order of arrival; returns what came of it.

        A solution comes with every navigation update, by default with every second inertial sample. Aids
        may be late: they are used at their own time, as far back as the history reaches (2048 updates);
        later than that they are refused.
        """
        mode = self.mode
        if type(sample) is ImuChange:
            self._timeline.walk[:] = more_walk(sample, self.config.imu)
        if mode is Mode.STANDBY or mode is Mode.FAULT:
            if isinstance(sample, ImuSample):
                self._imu_ns = sample.t_ns
            return self._drain()
        if type(sample) is ImuSample:
            self._inertial(sample)
        elif type(sample) is ImuChange:
            if not self._aligning.running:
                self._timeline.act(sample.t_ns, reconfigured(sample, not self._flags & _AIDED))
        elif self._aligning.running:
            self._align_on(sample)
        else:
            self._aid(sample)
        if self._timeline.behind and self.mode is not Mode.FAULT and not self._aligning.running:
            self._catch_up()
        return self._drain()

    def _drain(self) -> list[NavEvent]:
        events = self._events
        if self._timeline.events:
            events.extend(self._timeline.events)
            self._timeline.events.clear()
        if events:
            self._events = []
        return events

    def _change(self, t_ns: int, mode: Mode, reason: str) -> None:
        if mode is not self.mode:
            self._events.append(ModeChange(t_ns, self.mode, mode, reason))
            self.mode = mode

    # ---- alignment -----------------------------------------------------------------------------

    def _align(self, t_ns: int, reason: str, *names: str) -> None:
        self._aligning.begin(t_ns, *names)
        self._pending = []
        self._change(t_ns, self._aligning.mode, reason)

    def _align_on(self, sample: Sample) -> None:
        aligning, t = self._aligning, sample.t_ns
        init = aligning.step(sample, self._events)
        if init is not None:
            self._navigate(init, f"aligned by {aligning.ended}")
        elif aligning.behind:
            self._change(t, Mode.CATCH_UP, f"{aligning.name} goes through stored samples")
        else:
            self._change(t, aligning.mode, "caught up")

    def _navigate(self, init: NavInit, reason: str) -> None:
        self._aligning.stop()
        x, P, mounted = initial_state(init, self.config)
        self._timeline.begin(init.t_ns, x, P)
        self._timeline.rest[:] = 0.0
        self._standstill = Standstill(self.config, init)
        self._search = MountingSearch()
        self._pending = []
        self._imu_ns = init.t_ns
        self._check_ns = init.t_ns
        self._gap_ns = self._rest_ns = self._degraded = self._behind_ns = None
        self._aiding.begin(init.t_ns, mounted)
        self._flags = _ALIGNED
        self._change(init.t_ns, Mode.NAVIGATE, reason)
        self._stay_below(init.t_ns, init.lat)

    # ---- inertial samples ----------------------------------------------------------------------

    def _inertial(self, s: ImuSample) -> None:
        t = s.t_ns
        last = self._imu_ns
        if s.flags & _FAULT:
            self._events.append(Refusal(t, s.device, "invalid"))
            return
        if last is not None:
            silent = t - last - s.dt * 1e9
            if t <= last:
                self._events.append(Refusal(t, s.device, "stale"))
                return
            if silent > 0.5e9 * s.dt + 1e6 or (s.flags & _GAP and silent > 0.0):
                self._silence(last, silent, t)
                if self.mode is Mode.FAULT:
                    self._imu_ns = t
                    return
        if self._aligning.running:
            # an alignment goes on with what it gathered; a state that is no number ends navigation
            if not math.isfinite(sum(s.dtheta.tolist()) + sum(s.dv.tolist())):
                self._events.append(Refusal(t, s.device, "invalid"))
                return
            self._imu_ns = t
            self._align_on(s)
            return
        self._imu_ns = t
        pending = self._pending
        pending.append(s)
        if len(pending) < self._samples:
            return
        self._pending = []
        flags, dt = 0, 0.0
        for sample in pending:
            flags |= sample.flags
            dt += sample.dt
        noise = 1.0 if not flags & (_BRIDGED | _SATURATED) else (1e4 if flags & _SATURATED else 100.0)
        row = self._timeline.advance(t, dt, noise, pending)
        if row is None:
            self._change(t, Mode.FAULT, "the state is not finite")
            return
        if t >= self._check_ns:
            self._check_ns = t + _CHECK_NS
            self._check(t, row)
            if self.mode is Mode.FAULT:
                return
        if self._timeline.rest[0] >= self.config.rest_interval - 1e-6:
            self._interval(t, row[S.V], float(row[19]))
        if not self._aiding.mounted:
            row[S.SIGMA_MOUNTING] = math.pi
        self._events.append(Solution(t, self.mode, self._flags, row))

    def _silence(self, last: int, silent: float, t: int) -> None:
        """Inertial samples are missing between ``last`` and the sample at ``t``."""
        if self._aligning.running:
            # the alignment's stages judge gaps by the times of their samples
            return
        if silent > self.config.gap_limit * 1e9:
            # it may stand or be on its way: whichever alignment can end takes over
            names = [self.config.alignment, "motion"]
            if "heading" in alignment(names[0]).needs:
                # what was known of the heading beforehand may be so no more
                del names[0]
            self._align(t, f"no inertial data for {silent * 1e-9:.1f} s", *names)
            return
        pending, self._pending = self._pending, []
        if pending:
            duration = sum(sample.dt for sample in pending)
            if self._timeline.advance(last, duration, 1.0, pending) is None:
                self._change(last, Mode.FAULT, "the state is not finite")
                return
        self._timeline.rest[:] = 0.0
        self._timeline.bridge(last + round(silent), silent * 1e-9)
        self._gap_ns = t
        self._check_ns = t

    def _interval(self, t: int, v_g: Vector, sigma: float) -> None:
        rest = self._standstill.interval(t, self._timeline.rest, v_g, sigma)
        if rest is not None:
            self._at_rest(rest)

    def _at_rest(self, rest: Rest) -> None:
        config = self.config
        self._rest_ns = rest.end_ns
        if config.zero_velocity is not None:
            self._timeline.measure("zero_velocity", rest.end_ns, np.array([0.0, config.zero_velocity]))
        if config.zero_rate is not None:
            duration = (rest.end_ns - rest.start_ns) * 1e-9
            z = np.array([0.0, duration, *rest.rate_b, config.zero_rate])
            self._timeline.measure("zero_rate", rest.end_ns, z)

    def _catch_up(self) -> None:
        timeline = self._timeline
        timeline.catch_up()
        if timeline.behind:
            if self._behind_ns is None:
                self._behind_ns = timeline.t_ns
            if timeline.t_ns - self._behind_ns >= UNSAID_NS:
                self._change(timeline.t_ns, Mode.CATCH_UP, "late data")
            return
        self._behind_ns = None
        if self.mode is Mode.CATCH_UP:
            if timeline.solution() is None:
                self._change(timeline.t_ns, Mode.FAULT, "the state is not finite")
            else:
                mode = Mode.NAVIGATE if self._degraded is None else Mode.DEGRADED
                self._change(timeline.t_ns, mode, "caught up")

    # ---- aids ----------------------------------------------------------------------------------

    def _aid(self, s: Sample) -> None:
        silent = s.t_ns - (self._imu_ns or s.t_ns)
        if silent > self.config.gap_limit * 1e9 and self.mode is Mode.NAVIGATE:
            self._change(s.t_ns, Mode.DEGRADED, f"no inertial data for {silent * 1e-9:.1f} s")
        used = True
        if isinstance(s, GnssFix):
            if s.fix_type < FixType.FIX_3D:
                self._events.append(Refusal(s.t_ns, s.device, "invalid"))
                return
            used = self._aiding.gnss(s)
        elif isinstance(s, OdoSample):
            rest = self._standstill.odometer(s)
            if rest is not None:
                self._at_rest(rest)
            self._aiding.odometer(s)
        elif isinstance(s, SpeedSample):
            used = self._aiding.speed(s)
        elif isinstance(s, BaroSample):
            used = self._aiding.barometer(s)
        if not used:
            self._events.append(Refusal(s.t_ns, s.device, "stale"))

    # ---- every tenth of a second ---------------------------------------------------------------

    def _stay_below(self, t: int, lat: float) -> None:
        try:
            refuse_latitude(self.config.azimuth, lat)
        except NorthLawRefusal as refusal:
            self._change(t, Mode.FAULT, str(refusal))

    def _check(self, t: int, row: Vector) -> None:
        config, timeline = self.config, self._timeline
        self._stay_below(t, row[0])
        if not self._aiding.mounted:
            mounting = self._search.look(row)
            if mounting is not None:
                timeline.act(t, settle(mounting))
                self._aiding.settled(t)
                self._events.append(Notice(t, "mounting of the IMU in the vehicle found"))
        self._aiding.check(t)

        gnss = max(timeline.last_accepted("gnss_position"), timeline.last_accepted("gnss_velocity"))
        wheel = max(timeline.last_accepted("odometer"), timeline.last_accepted("speed"))
        flags = _ALIGNED
        if row[24] < config.heading_limit:
            flags |= int(SolutionFlag.HEADING)
        if self._aiding.mounted:
            flags |= int(SolutionFlag.MOUNTING)
        if timeline.used("gnss_position", "gnss_velocity") and t - gnss < _RECENT_NS:
            flags |= int(SolutionFlag.GNSS)
        if t - timeline.last_accepted("gnss_position") >= _RECENT_NS:
            flags |= int(SolutionFlag.DEAD_RECKONING)
        if timeline.used("odometer", "speed") and t - wheel < _RECENT_NS:
            flags |= int(SolutionFlag.ODOMETER)
        if self._rest_ns is not None and t - self._rest_ns < round(2e9 * config.rest_interval):
            flags |= int(SolutionFlag.STANDSTILL)
        if self._gap_ns is not None and t - self._gap_ns < _GAP_SHOWN_NS:
            flags |= int(SolutionFlag.IMU_GAP)
        self._flags = flags

        missing = None
        for name, limit, latest in (
            ("GNSS", config.gnss_timeout, gnss),
            ("odometer", config.odometer_timeout, wheel),
            ("barometer", config.barometer_timeout, timeline.last_accepted("barometer")),
        ):
            if limit is not None and t - latest > limit * 1e9:
                missing = f"no {name} for {limit:g} s"
                break
        self._degraded = missing
        if missing is not None and self.mode is Mode.NAVIGATE:
            self._change(t, Mode.DEGRADED, missing)
        elif missing is None and self.mode is Mode.DEGRADED:
            self._change(t, Mode.NAVIGATE, "aids are back")
