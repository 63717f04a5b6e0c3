"""A navigator that is aligned from its master: modes, solutions on the way, and what follows."""

from __future__ import annotations

import numpy as np
import pytest

from nav.events import ModeChange, TransferProgress
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.rotation import quat_conjugate, quat_multiply, rotvec_from_quat
from nav.transfer import MATCHINGS, alignment, methods
from nav.types import Mode, S, Solution, SolutionFlag
from tests.nav.transfer.making import T0_NS, Set, config, fly


def navigate(s, method, seed=1, **changes):
    """Events of a navigator over a whole flight."""
    imu = ImuErrors(s.arw, s.vrw, s.gyro_bias, s.accel_bias)
    navigator = Navigator(NavigatorConfig(imu, alignment=method, align=config(s, **changes)))
    events = navigator.start(T0_NS)
    flight = fly(s, seed)
    for sample in flight.samples:
        events += navigator.step(sample)
    return flight, events


@pytest.mark.parametrize("method", ["transfer_one_shot", "transfer_velocity_attitude"])
def test_modes_and_solutions(method: str) -> None:
    """TRANSFER from the start, ten good solutions a second, NAVIGATE when it is known well enough."""
    s = Set(seconds=6.5)
    flight, events = navigate(s, method, duration=5.0)
    changes = [(e.old, e.new, e.reason) for e in events if isinstance(e, ModeChange)]
    assert changes == [
        (Mode.STANDBY, Mode.TRANSFER, "start"),
        (Mode.TRANSFER, Mode.NAVIGATE, f"aligned by {method}"),
    ]
    solutions = [e for e in events if isinstance(e, Solution)]
    under_way = [e for e in solutions if e.mode is Mode.TRANSFER]
    assert 48 <= len(under_way) <= 52
    needed = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING
    for e in under_way:
        i = int(np.searchsorted(flight.t_ns, e.t_ns))
        turned = rotvec_from_quat(quat_multiply(flight.q_gb[i], quat_conjugate(e.state[S.Q])))
        # 99.99 % of a normal, for 150 angles and velocities: 4.9 sigma
        assert np.all(np.abs(turned) < 4.9 * e.state[S.SIGMA_PHI])
        assert np.all(np.abs(flight.v_g[i] - e.v_g) < 4.9 * e.state[S.SIGMA_V])
        assert e.flags & needed == needed
    after = [e for e in solutions if e.mode is Mode.NAVIGATE]
    i = int(np.searchsorted(flight.t_ns, after[-1].t_ns))
    assert np.all(np.abs(flight.v_g[i] - after[-1].v_g) < 4.9 * after[-1].state[S.SIGMA_V])


def test_a_message_that_comes_before_the_sample_of_its_time_shows_no_other_mode() -> None:
    """Messages dated ahead of the newest inertial sample, as clocks of two devices have it on a bus."""
    s = Set(seconds=2.0, master_hz=200.0, late=-0.004)
    _, events = navigate(s, "transfer_velocity_attitude", duration=5.0)
    solutions = [e for e in events if isinstance(e, Solution)]
    assert {e.mode for e in solutions} == {Mode.TRANSFER}
    assert all(e.flags & SolutionFlag.POSITION for e in solutions)


def test_mounting_is_found_and_told() -> None:
    """Wing rock shows how the slave is mounted; the last report has it."""
    flight, events = navigate(Set(seconds=6.0), "transfer_velocity_attitude")
    last = [e for e in events if isinstance(e, TransferProgress)][-1]
    assert last.matching == "velocity_attitude"
    assert last.sigma_mounting[2] < 3e-4
    assert np.all(np.abs(flight.mounting - last.mounting) < 4.0 * np.array(last.sigma_mounting))
    seen = dict(last.observability)
    # 30 degrees of roll, 0.3 mrad: heading of the mounting known to a fiftieth; biases hardly in 5 s
    assert seen["mounting up"] < 0.05
    assert seen["gyro bias right"] > 0.9
    assert last.hint == ""


def test_hints() -> None:
    """Straight on nothing shows the heading: each matching says what would."""
    for name, expected in (
        ("velocity_attitude", "wing rock"),
        ("velocity", "S-turn"),
        ("velocity_heading", "S-turn"),
    ):
        s = Set(seconds=6.0, profile=lambda t: (0.0 * t, 0.0 * t))
        _, events = navigate(s, "transfer_" + name, sigma=np.full(3, 2e-3))
        assert not any(isinstance(e, ModeChange) and e.new is Mode.NAVIGATE for e in events)
        last = [e for e in events if isinstance(e, TransferProgress)][-1]
        assert last.hint == expected


def test_names() -> None:
    """Both tables are one to whoever asks by name."""
    assert {"transfer_" + name for name in MATCHINGS} < set(methods())
    assert all(alignment(name).stages for name in methods())
    with pytest.raises(KeyError):
        alignment("transfer_none")
    with pytest.raises(KeyError):
        alignment("one_shot")
