"""The navigator's modes against a small model of them, over sequences that nobody thought of.

The vehicle stands still. The model knows times and causes and nothing of navigation: when an alignment can
be done, how long a master must be heard, how long an aid may be missing, how much late data can be worked in
at once. Where these depend on details (blocks of the alignment, the distance to a snapshot) it allows either
mode for as long as they may.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from nav.align import AlignConfig
from nav.align.types import TransferConfig
from nav.events import ModeChange, Refusal
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.types import ImuFlag, ImuSample, MasterState, Mode, S, Sample, Solution, SolutionFlag
from tests.nav.truth import Drive, fix, hand_over

DT = 0.05
FIX_EVERY = 4  # samples
ALIGN_S = 4.0
TRANSFER_S = 2.0  # of messages of a master, which come as often as fixes
LATER = 0.3  # its first message may come too early to be used, and each is used a sample later
GNSS_S = 1.0
GAP_S = 0.5
TINY = 1e-6  # of float times, where the navigator counts nanoseconds
BUDGET = 5  # stored updates a call works off; a snapshot is at most 8 updates back
LATE_S = 3.05  # 30 updates
CATCHING = 18  # samples: 30 and 9 updates and half as many stops for fixes, 5 a sample, one more every second
SOON = 4  # samples: 2 and 9 updates, and stops
SAID = 3  # samples: after a tenth of a second, at the end of an update, it is said that this takes time
EARLY, SLACK = 0.11, 0.26  # looked at every 0.1 s, at the end of an update of 0.1 s

STILL = Drive(radius=0.0, sway=0.0, nod=0.0)
TURN, PUSH = (increments[0] for increments in STILL.increments(1, DT))
LEVEL = hand_over(STILL).q_gb
PLACE = tuple(float(x) for x in STILL.geodetic(0.0)[:3])
CONFIG = NavigatorConfig(
    ImuErrors(1e-5, 1e-4, 1e-6, 1e-4),
    gnss_timeout=GNSS_S,
    gap_limit=GAP_S,
    replay_updates=BUDGET,
    zero_velocity=None,
    align=AlignConfig(
        1e-6,
        1e-4,
        1e-5,
        1e-4,
        coarse_s=2.0,
        fine_s=2.0,
        position=PLACE,
        C_vb=np.eye(3),
        transfer=TransferConfig(duration=TRANSFER_S),
    ),
)
COPIED = "transfer_one_shot"

NO_NUMBERS = (math.nan, math.inf, -math.inf)
ALIGNING = {Mode.ALIGN, Mode.TRANSFER}
UNDER_WAY = {Mode.NAVIGATE, Mode.DEGRADED, Mode.CATCH_UP}
LOST, FOUND, GONE = "no inertial data for .* s", "aids are back", "no GNSS for 1 s"
CAUSES: dict[tuple[Mode, Mode], str] = {
    **{(mode, new): "start" for mode in (Mode.STANDBY, Mode.FAULT) for new in ALIGNING},
    (Mode.ALIGN, Mode.TRANSFER): "start",
    (Mode.TRANSFER, Mode.ALIGN): "start",
    (Mode.ALIGN, Mode.NAVIGATE): "aligned by (static|motion)",
    (Mode.TRANSFER, Mode.NAVIGATE): f"aligned by ({COPIED}|motion)",
    (Mode.NAVIGATE, Mode.DEGRADED): f"{GONE}|{LOST}",
    (Mode.DEGRADED, Mode.NAVIGATE): FOUND,
    (Mode.NAVIGATE, Mode.CATCH_UP): "late data",
    (Mode.DEGRADED, Mode.CATCH_UP): "late data",
    (Mode.CATCH_UP, Mode.NAVIGATE): "caught up",
    (Mode.CATCH_UP, Mode.DEGRADED): "caught up",
    **{(mode, new): f"start|{LOST}" for mode in UNDER_WAY for new in ALIGNING},
    **{(mode, Mode.FAULT): "the state is not finite" for mode in UNDER_WAY},
    **{(mode, Mode.STANDBY): "stop" for mode in Mode if mode is not Mode.STANDBY},
}
"""Every change of mode that there is, and the reasons that may be given."""


class Model:
    """Which modes are possible, from times and causes alone; ``mode`` is the one that was found to be."""

    def __init__(self, configured: str) -> None:
        self.configured = configured
        self.mode = Mode.STANDBY
        self.imu_s = 0.0
        self.aligned_after = self.aligned_by = 0.0
        self.begun_s = 0.0  # navigating since
        self.fix_s = 0.0  # last one that counted
        self.unseen_s = -math.inf  # until then the navigator could not see whether fixes come
        self.behind = 0  # samples for which late data may still be worked in
        self.unsaid = 0  # samples after which that must have been said
        self.before, self.before_fix_s = Mode.NAVIGATE, 0.0  # when that began
        self.poisoned = 0  # samples after which a number that is none must have been noticed

        self.heard_s = -math.inf  # the master

    def align(self, now: float, method: str) -> set[Mode]:
        self.behind = self.unsaid = self.poisoned = 0
        if method == COPIED:
            self.aligned_after = self.aligned_by = math.inf  # until the master is heard
            return {Mode.TRANSFER}
        self.aligned_after, self.aligned_by = now + ALIGN_S - EARLY, now + ALIGN_S + SLACK
        return {Mode.ALIGN}

    def message(self, now: float) -> set[Mode]:
        self.heard_s = now
        if self.mode is Mode.TRANSFER:
            self.aligned_after = min(self.aligned_after, now + TRANSFER_S - EARLY)
            if self.aligned_by == math.inf:
                self.aligned_by = now + TRANSFER_S + LATER + SLACK
        return {self.mode}

    def navigate(self, now: float) -> set[Mode]:
        self.behind = self.unsaid = self.poisoned = 0
        self.begun_s = self.fix_s = now
        self.unseen_s = -math.inf
        return {Mode.NAVIGATE}

    def sample(self, now: float, finite: bool) -> set[Mode]:
        silent = now - self.imu_s - DT
        aligning = self.mode in ALIGNING or (self.mode in UNDER_WAY and silent > GAP_S + TINY)
        if finite or not aligning:  # an alignment does not take what is no number
            self.imu_s = now
        if self.mode is Mode.ALIGN:
            if silent > TINY or not finite:  # it may go on or begin anew
                self.aligned_by = now + ALIGN_S + SLACK
            possible = {Mode.ALIGN} if now < self.aligned_by else set()
            return possible | ({Mode.NAVIGATE} if now > self.aligned_after else set())
        if self.mode is Mode.TRANSFER:
            if silent > TINY or not finite or now - self.heard_s > FIX_EVERY * DT + TINY:
                self.aligned_by = math.inf  # it may begin anew with the next message
            possible = {Mode.TRANSFER} if now < self.aligned_by else set()
            return possible | ({Mode.NAVIGATE} if now > self.aligned_after else set())
        if self.mode not in UNDER_WAY:
            return {self.mode}
        if silent > GAP_S + TINY:
            possible = self.align(now - DT, self.configured)
            if self.configured == COPIED:
                self.aligned_after = now + ALIGN_S - EARLY  # the alignment in motion runs beside it
            return possible
        if silent > TINY:
            self.unseen_s = now  # what came and went meanwhile is looked at only now
        if not finite:
            self.poisoned = 3
        if self.poisoned:
            self.poisoned -= 1
            self.unsaid = 0
            return {Mode.FAULT, self.mode, *self.aided(now)} if self.poisoned else {Mode.FAULT}
        possible = self.aided(now)
        if self.unsaid:
            self.unsaid -= 1
            return possible if self.unsaid else {Mode.CATCH_UP}
        return possible

    def aided(self, now: float) -> set[Mode]:
        without = now - self.fix_s
        possible = {self.mode} if now < self.unseen_s + SLACK else set()
        if without < GNSS_S + SLACK:
            possible.add(Mode.NAVIGATE)
        if without > GNSS_S - TINY:
            possible.add(Mode.DEGRADED)
        if self.behind:
            self.behind -= 1
            # what came meanwhile counts only when the late data is worked in
            possible |= {Mode.CATCH_UP, self.before}
            if now - self.before_fix_s > GNSS_S - TINY:
                possible.add(Mode.DEGRADED)  # what came meanwhile does not count yet
            self.unseen_s = now
        return possible

    def fix(self, made: float, now: float) -> set[Mode]:
        if self.mode not in UNDER_WAY:
            return {self.mode}
        late = made < now - DT
        if late and not self.behind:
            self.before, self.before_fix_s = self.mode, self.fix_s
        if made > self.fix_s:
            if now - self.fix_s > GNSS_S - TINY or self.behind:
                self.unseen_s = now
            self.fix_s = made
        if late:
            long = now - made > LATE_S - 0.1
            if long and not self.behind:
                self.unsaid = SAID
            self.behind = max(self.behind, CATCHING if long else SOON)
            return {self.mode, *self.aided(now)}
        if self.mode is Mode.NAVIGATE and now - self.imu_s > GAP_S + TINY:
            return {Mode.DEGRADED}
        return {self.mode, *self.aided(now)} if self.behind else {self.mode}


class Modes(RuleBasedStateMachine):
    """The navigator and the model side by side."""

    def __init__(self) -> None:
        super().__init__()
        self.navigator = Navigator(CONFIG)
        self.model = Model(CONFIG.alignment)
        self.count = 0  # of sample periods since the beginning
        self.shown_ns = -1

    @property
    def now(self) -> float:
        return self.count * DT

    def found(self, said: list[object], possible: set[Mode]) -> None:
        """Check what the navigator said against what the model allows."""
        mode = self.model.mode
        for event in said:
            if isinstance(event, ModeChange):
                assert event.old is mode
                assert (event.old, event.new) in CAUSES or event.reason == "initial state given", event
                if event.reason != "initial state given":
                    assert re.fullmatch(CAUSES[event.old, event.new], event.reason), event
                mode = event.new
            elif isinstance(event, Solution):
                assert event.mode is mode
                assert mode not in (Mode.STANDBY, Mode.FAULT)
                if event.flags & SolutionFlag.POSITION:
                    known = event.state[: S.F.stop] if mode is Mode.TRANSFER else event.state
                    assert np.all(np.isfinite(known))
                assert event.t_ns > self.shown_ns
                self.shown_ns = event.t_ns
        assert mode is self.navigator.mode
        assert mode in possible, f"at {self.now:.2f} s: {mode.name}, expected {possible}"
        if mode is Mode.NAVIGATE and self.model.mode in ALIGNING:
            self.model.navigate(self.now)
        self.model.mode = mode

    def sample(self, **change: object) -> ImuSample:
        return ImuSample(round(self.now * 1e9), DT, TURN, PUSH, "imu")._replace(**change)

    def run(self, samples: int, fixes: bool) -> None:
        for _ in range(samples):
            self.count += 1
            self.found(self.navigator.step(self.sample()), self.model.sample(self.now, True))
            if fixes and self.count % FIX_EVERY == 0:
                self.take_fix(self.now)
                self.hear_master()

    def hear_master(self) -> None:
        """Of one that stands there, too; a height that is always the same would be that of a frozen one."""
        lat, lon, height = PLACE
        m = MasterState(
            t_ns=round(self.now * 1e9),
            lat=lat,
            lon=lon,
            height=height + 1e-3 * (self.count // FIX_EVERY % 2),
            v_g=np.zeros(3),
            q_ga=LEVEL,
            w_ia_a=None,
            f_a=None,
            sigma_position=np.ones(3),
            sigma_velocity=np.full(3, 0.1),
            sigma_phi=np.full(3, 1e-3),
            valid=True,
            device="master",
        )
        self.found(self.navigator.step(m), self.model.message(self.now))

    def take_fix(self, made: float) -> None:
        self.found(self.navigator.step(fix(STILL, made)), self.model.fix(made, self.now))

    @initialize(
        configured=st.sampled_from(["static", COPIED]),
        state=st.sampled_from(["standing by", "aligning", "navigating", "navigating"]),
    )
    def wake(self, configured: str, state: str) -> None:
        self.navigator = Navigator(replace(CONFIG, alignment=configured))
        self.model = Model(configured)
        self.run(10, False)
        if state == "aligning":
            self.command("start")
        elif state == "navigating":
            self.command("begin")

    @rule(what=st.sampled_from(["start", "static", COPIED, "stop", "begin"]))
    def command(self, what: str) -> None:
        t_ns = round(self.now * 1e9)
        if what == "start":
            self.found(self.navigator.start(t_ns), self.model.align(self.now, self.model.configured))
        elif what in ("static", COPIED):
            self.found(self.navigator.start(t_ns, what), self.model.align(self.now, what))
        elif what == "stop":
            self.found(self.navigator.stop(t_ns), {Mode.STANDBY})
        else:
            self.model.imu_s = self.now
            init = replace(hand_over(STILL), t_ns=t_ns)
            self.found(self.navigator.begin(init), self.model.navigate(self.now))
            self.shown_ns = t_ns

    @rule(samples=st.sampled_from([1, 7, 20, 60]), fixes=st.booleans())
    def stand(self, samples: int, fixes: bool) -> None:
        self.run(samples, fixes)

    @precondition(lambda self: self.model.mode in UNDER_WAY)
    @rule(samples=st.integers(15, 35))
    def lose_fixes_for_a_while(self, samples: int) -> None:
        self.run(samples, False)
        self.run(12, True)

    @precondition(lambda self: self.model.mode in ALIGNING)
    @rule()
    def wait_for_alignment(self) -> None:
        self.run(math.ceil((ALIGN_S + SLACK) / DT) + 1, True)
        assert self.navigator.mode is Mode.NAVIGATE

    @rule(periods=st.sampled_from([1, 4, 9, 12, 40]), fixes=st.booleans())
    def lose_inertial_data(self, periods: int, fixes: bool) -> None:
        for _ in range(periods):
            self.count += 1
            if fixes and self.count % FIX_EVERY == 0:
                self.take_fix(self.now)
                self.hear_master()
        self.run(1, False)

    @precondition(lambda self: self.model.mode in UNDER_WAY)
    @rule(
        age=st.sampled_from([0.16, LATE_S]), fixes=st.booleans(), then=st.sampled_from(["", "start", "stop"])
    )
    def hear_of_it_late(self, age: float, fixes: bool, then: str) -> None:
        while self.model.mode in UNDER_WAY and self.now < self.model.begun_s + 5.0:
            self.run(10, fixes)
        if self.model.mode in UNDER_WAY:
            self.take_fix(self.now - age)
            if then:
                self.command(then)

    @precondition(lambda self: self.model.mode in UNDER_WAY)
    @rule()
    def hear_of_it_much_too_late(self) -> None:
        made = self.model.begun_s - 1.0
        self.refused(fix(STILL, made), "stale")

    @precondition(lambda self: self.model.mode in UNDER_WAY | ALIGNING)
    @rule(what=st.sampled_from(["number", "sample", "device"]), name=st.sampled_from(["dtheta", "dv"]))
    def harm(self, what: str, name: str) -> None:
        """A number that is none, a sample that was there before, a device that calls its sample worthless."""
        if what == "sample":
            self.refused(self.sample(t_ns=round(self.model.imu_s * 1e9)), "stale")
            return
        self.count += 1
        if what == "device":
            self.refused(self.sample(flags=int(ImuFlag.DEVICE_FAULT)), "invalid")
        else:
            bad = self.sample(**{name: np.array([0.0, NO_NUMBERS[self.count % 3], 0.0])})
            self.found(self.navigator.step(bad), self.model.sample(self.now, False))

    def refused(self, sample: Sample, reason: str) -> None:
        said = self.navigator.step(sample)
        assert Refusal(sample.t_ns, sample.device, reason) in said
        self.found(said, {self.model.mode, *(self.model.aided(self.now) if self.model.behind else ())})

    @invariant()
    def one_mode(self) -> None:
        assert self.navigator.mode is self.model.mode


Modes.TestCase.settings = settings(
    max_examples=60, stateful_step_count=25, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
TestModes = Modes.TestCase
