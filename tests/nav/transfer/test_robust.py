"""What goes wrong between master and slave is outlived or named, and no wrong answer given for a good one."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from nav.align.types import TransferConfig
from nav.transfer import MATCHINGS
from nav.types import ImuSample, MasterState
from tests.nav.transfer.making import T0_NS, Set, align, config, fly, straight, surprise

AT_NS = T0_NS + 2_300_000_000  # in the midst of the roll
LONG = Set(seconds=7.0, imu_hz=100.0)
GOAL = np.full(3, 2e-3)
WORST = chi2.ppf(0.999, 9)


def masters(change, from_ns=AT_NS):
    """Messages of the master from `AT_NS` on, or from another time, are changed (None: do not arrive)."""

    def faulty(samples):
        for sample in samples:
            late = isinstance(sample, MasterState) and sample.t_ns >= from_ns
            sample = change(sample) if late else sample
            if sample is not None:
                yield sample

    return faulty


def inertial(change, from_ns=0):
    """Inertial samples are changed."""

    def faulty(samples):
        for sample in samples:
            yield change(sample) if isinstance(sample, ImuSample) and sample.t_ns >= from_ns else sample

    return faulty


def outcome(matching, faulty, told=None, seed=1, flight_like=LONG):
    """Reasons why it began again, and whether it ended; an end must be honest."""
    flight = fly(flight_like, seed)
    init, reasons, _ = align(matching, flight, told or config(flight_like, sigma=GOAL), faulty)
    if init is not None:
        assert surprise(flight, init) < WORST
    return reasons, init is not None


def test_drop_out() -> None:
    """A second and a half of silence within the roll is outlived by the same run, more than two are not."""
    until = AT_NS + 1_500_000_000
    reasons, _ = outcome("velocity_attitude", masters(lambda m: None if m.t_ns < until else m))
    assert reasons == []
    reasons, ended = outcome("velocity_attitude", masters(lambda m: None))
    assert [re.sub(r"[0-9.]+ s", "s", reason) for reason in reasons] == ["no message of the master for s"]
    assert not ended


def test_frozen() -> None:
    """The same words with new times."""
    frozen = []

    def freeze(m):
        frozen.append(m)
        return frozen[0]._replace(t_ns=m.t_ns)

    reasons, ended = outcome("velocity_attitude", masters(freeze))
    assert not ended
    assert reasons[0].startswith("the master is frozen")


@pytest.mark.parametrize("jump_s", [0.3, -0.3, 0.05, -0.05])
def test_time_jump(jump_s: float) -> None:
    """Its clock steps; short of the lockout, as what no longer fits is refused at once."""
    jumped = masters(lambda m: m._replace(t_ns=m.t_ns + round(jump_s * 1e9)))
    reasons, _ = outcome("velocity_attitude", jumped)
    assert reasons[0] == f"the master's time jumped by {jump_s:.2f} s"


def older(samples):
    """A tenth of a second, all messages."""
    for sample in samples:
        yield sample._replace(t_ns=sample.t_ns + 100_000_000) if isinstance(sample, MasterState) else sample


@pytest.mark.parametrize("matching", ["velocity_attitude", "velocity", "one_shot"])
def test_latency_of_a_tenth_of_a_second(matching: str) -> None:
    """Said to be good to 10 ms: the roll shows that it is not."""
    reasons, ended = outcome(matching, older)
    assert not ended
    if matching == "velocity_attitude":
        assert reasons[0].startswith("the delay of the master's messages is off by")


@pytest.mark.parametrize("matching", ["velocity_attitude", "velocity", "one_shot"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_latency_straight_on(matching: str, seed: int) -> None:
    """Nothing shows a tenth of a second there; 20 m are within what an unsynchronised master is worth."""
    level = replace(LONG, profile=straight, seconds=5.5, dated=TransferConfig().latency)
    _, ended = outcome(matching, older, config(level, sigma=np.full(3, 1.0)), seed, level)
    assert ended


def test_latency_that_was_allowed_for() -> None:
    """Two sigma of latency: the roll measures it, and it is taken out."""
    s = Set(seconds=6.0, latency=0.02)
    flight = fly(s, 3)
    init, reasons, state = align("velocity_attitude", flight, config(s, sigma=GOAL))
    assert init is not None
    assert reasons == []
    assert surprise(flight, init) < WORST
    # 0.3 mrad at up to 60 deg/s, 50 times a second for a second: 0.1 ms
    assert state.slave.x[-4] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize("wrong", [(0.5, 0.0, 0.0), (0.0, 0.3, 0.4)])
def test_lever_arm_wrong_by_half_a_metre(wrong) -> None:
    """Said to be good to 2 cm; the velocity it makes in the roll is not there."""
    told = config(LONG, sigma=GOAL, lever_arm=LONG.lever + np.array(wrong))
    reasons, ended = outcome("velocity_attitude", None, told)
    assert not ended
    size = float(re.fullmatch(r"the lever arm is wrong by ([0-9.]+) m", reasons[0])[1])
    # along the axis of roll nothing shows: 0.4 m of the second
    assert size == pytest.approx(0.5 if wrong[0] else 0.4, abs=0.1)


@pytest.mark.parametrize("step", [1e-4, 1e-3, 1e-2])
def test_gyro_step(step: float) -> None:
    """20 deg/h from the midst of the roll on does no harm in 3 s; 200 and 2000 deg/h are found out."""
    wrong = inertial(lambda s: s._replace(dtheta=s.dtheta + np.array([0.0, step, 0.0]) * s.dt), AT_NS)
    reasons, ended = outcome("velocity_attitude", wrong)
    assert ended == (step == 1e-4)
    if not ended:
        assert any(reason.startswith("a gyro of the slave is wrong by") for reason in reasons[:2])


@pytest.mark.parametrize(
    ("order", "name"), [((1, 0, 2), "y, x, z"), ((0, 2, 1), "-?x, z, y"), ((2, 0, 1), "y, z, x")]
)
def test_swapped_axes(order, name: str) -> None:
    """The axes of the slave are mixed up: which, its master's turns and forces tell."""
    mixed = inertial(lambda s: s._replace(dtheta=s.dtheta[list(order)], dv=s.dv[list(order)]))
    reasons, ended = outcome("velocity_attitude", mixed)
    assert not ended
    expected = f"the slave's axes are not as configured: x, y, z seem to be {name}"
    assert any(re.fullmatch(expected, reason) for reason in reasons[:3]), reasons


def test_bad_messages_and_samples() -> None:
    """Messages that are no numbers, or not valid, are not there; inertial samples must not be missing."""
    bad = [np.full(3, np.nan), None]

    def spoil(m):
        k = (m.t_ns // 20_000_000) % 3
        return m if k == 0 else (m._replace(v_g=bad[0]) if k == 1 else m._replace(valid=False))

    reasons, ended = outcome("velocity_attitude", masters(spoil))
    assert reasons == []
    assert ended

    def hole(samples):
        for sample in samples:
            if not (isinstance(sample, ImuSample) and AT_NS <= sample.t_ns < AT_NS + 200_000_000):
                yield sample

    reasons, _ = outcome("velocity_attitude", hole)
    assert reasons[0].startswith("no inertial data for 0.2")


@pytest.mark.parametrize("matching", sorted(set(MATCHINGS) - {"velocity_rate"}))
def test_a_master_that_tells_no_rates(matching: str) -> None:
    """A platform tells attitude, velocity and position: enough for all but who compares rates."""
    silent = masters(lambda m: m._replace(w_ia_a=None, f_a=None), 0)
    reasons, ended = outcome(matching, silent, config(LONG, sigma=np.full(3, 1.0)))
    assert reasons == []
    assert ended


@pytest.mark.parametrize(
    ("matching", "change", "expected"),
    [
        ("velocity_rate", {"w_ia_a": None}, "message with rates"),
        ("velocity", {"q_ga": None}, "message with attitude"),
        ("one_shot", {"valid": False}, "valid message"),
    ],
)
def test_a_master_that_never_tells_what_is_needed(matching: str, change, expected: str) -> None:
    """It is told what, as often as nothing came for two seconds."""
    reasons, ended = outcome(matching, masters(lambda m: m._replace(**change), 0))
    assert not ended
    assert re.fullmatch(f"no {expected} of the master for 2[.][01] s", reasons[0])


@pytest.mark.parametrize("matching", ["velocity_attitude", "velocity_rate", "velocity", "one_shot"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wing_that_bends_five_times_as_much(matching: str, seed: int) -> None:
    """Said to be 0.3 mrad: who compares attitudes or rates refuses; who does not is not misled."""
    flight_like = replace(LONG, flexure=np.full(3, 1.5e-3))
    told = config(replace(LONG, flexure=np.full(3, 3e-4)), sigma=np.full(3, 1.0))
    reasons, ended = outcome(matching, None, told, seed, flight_like)
    assert ended != bool(reasons)
    assert ended == (matching in ("velocity", "one_shot"))
