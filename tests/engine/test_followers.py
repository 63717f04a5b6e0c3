"""A navigator that is aligned from another one of the same process."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.errors import ConfigError
from bridge.followers import Follower, as_master, in_order
from bridge.options import NavigatorOptions
from bridge.outputs import ModeChange, Output, SolutionOut, Transfer
from nav import rotation as rot
from nav.types import Mode, S
from tests.engine.made import bench_frames, fed
from tests.sinks.made import solution

SLAVE = """
[navigator.slave]
devices = ["imu"]
alignment = "transfer_velocity_attitude"
master_navigator = "main"
mounting_deg = [0.6, -0.4, 1.5]
non_holonomic = false
zero_velocity_sigma_m_s = 0.0

[navigator.slave.transfer]
mounting_deg = [0.6, -0.4, 1.5]
mounting_sigma_deg = 0.2
sigma_mrad = [2.0, 2.0, 5.0]

[navigator.main]
"""
SECONDS = 90.0


def made(text: str = SLAVE) -> Config:
    files = bench_frames(SECONDS)[0]
    whole = files[ATTACHMENT].decode().replace("[navigator.main]\n", text)
    return Config.from_files({**files, ATTACHMENT: whole.encode()})


@cache
def ran() -> tuple[list[Output], dict[str, str]]:
    engine = Engine(made())
    return fed(engine, bench_frames(SECONDS)[1]), engine.digests()


def outputs() -> list[Output]:
    return ran()[0]


def options(master: str | None) -> NavigatorOptions:
    return NavigatorOptions(devices=["imu"], master_navigator=master)


def test_each_runs_behind_the_one_that_it_follows() -> None:
    table = {"c": options("b"), "x": options(None), "b": options("a"), "a": options(None)}
    assert in_order(table) == ["a", "b", "c", "x"]
    # those that follow nobody stay as they stand
    assert in_order({name: options(None) for name in "zay"}) == ["z", "a", "y"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"main"', '"mian"', 'navigator.slave.master_navigator: found "mian", expected one of main, slave'),
        ('"main"', '"slave"', 'navigator.slave.master_navigator: found "slave", expected a navigator that'),
        ('master_navigator = "main"\n', "", "expected a device that provides master"),
    ],
)
def test_a_master_that_cannot_be_is_refused(old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        Engine(made(SLAVE.replace(old, new)), warm=False)
    assert says in str(error.value), error.value


def test_a_ring_is_refused() -> None:
    with pytest.raises(ConfigError, match="does not follow this one in its turn"):
        made(SLAVE + 'master_navigator = "slave"\n')


def test_what_it_is_told_is_the_solution() -> None:
    s = solution(heading_deg=123.0)
    told = as_master(s, "main")
    assert (told.t_ns, told.lat, told.lon, told.height) == (s.t_ns, s.lat, s.lon, s.height)
    assert told.v_g.tolist() == s.v_g.tolist()
    assert told.q_ga is not None
    assert told.q_ga.tolist() == s.state[S.Q].tolist()
    assert told.valid
    assert told.device == "main"
    for mode in (Mode.ALIGN, Mode.TRANSFER, Mode.CATCH_UP, Mode.FAULT):
        assert not as_master(solution(mode=mode), "main").valid
    assert not as_master(solution(flags=7), "main").valid  # its heading is not known


def test_so_many_a_second_are_taken() -> None:
    follower = Follower(50.0)
    assert sum(follower.wants(10_000_000 * k + 3_000_000) for k in range(100)) == 50


def test_the_slave_is_aligned_as_soon_as_its_master_is_and_agrees_with_it() -> None:
    changes = [(o.navigator, o.new, o.t_ns) for o in outputs() if isinstance(o, ModeChange)]
    ready = next(t for name, mode, t in changes if (name, mode) == ("main", Mode.NAVIGATE))
    handed = next(t for name, mode, t in changes if (name, mode) == ("slave", Mode.NAVIGATE))
    assert ("slave", Mode.TRANSFER) in {(name, mode) for name, mode, _ in changes}
    # its heading is seen once the vehicle turns
    assert 5.0 <= (handed - ready) * 1e-9 < 35.0
    last = {o.navigator: o.solution for o in outputs() if isinstance(o, SolutionOut)}
    at = {
        name: next(o.solution for o in outputs() if isinstance(o, SolutionOut) and o.navigator == name
                   and o.solution.t_ns >= handed and o.solution.mode is Mode.NAVIGATE)
        for name in last
    }  # fmt: skip
    q_main, q_slave = (at[name].state[S.Q] for name in ("main", "slave"))
    off = rot.rotvec_from_quat(rot.quat_multiply(q_main, rot.quat_conjugate(q_slave)))
    known = [o for o in outputs() if isinstance(o, Transfer) and o.navigator == "slave"][-1]
    # chi-square of three at 99.9 %
    assert np.sum((off / np.array(known.sigma)) ** 2) < 16.3
    assert np.abs(at["main"].v_g - at["slave"].v_g).max() < 0.1
    # the same unit on the same mounting
    assert np.sum((np.array(known.mounting) / np.array(known.sigma_mounting)) ** 2) < 16.3


def test_both_have_their_digests_and_the_slave_changes_nothing_for_its_master() -> None:
    alone = Engine(Config.from_files(bench_frames(SECONDS)[0]))
    fed(alone, bench_frames(SECONDS)[1])
    both = ran()[1]
    assert set(both) == {"main", "slave"}
    assert both["main"] == alone.digests()["main"]
