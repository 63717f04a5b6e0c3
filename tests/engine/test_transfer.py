"""A slave that the engine aligns from a master on the bus: configuration, commands, outputs, hand-over."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

from bridge.commands import METHODS, CommandCode, Reason, Result
from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.errors import ConfigError
from bridge.navigators import navigator_config
from bridge.outputs import ModeChange, Output, Progress, SolutionOut, Text, Transfer, Transmit
from bridge.studies.transfer_scene import scene
from dbc.codec import contract
from nav import rotation as rot
from nav.events import TransferProgress
from nav.navigator import Navigator
from nav.transfer import MATCHINGS, PREFIX, methods
from nav.types import ImuSample, MasterState, Mode, S, Solution, SolutionFlag
from tests.engine.made import START_NS, bench_frames, fed
from virtual_bus.bus import Bench
from virtual_bus.master import master_of
from virtual_bus.sensors import generator

SECONDS = 9.0


def files() -> dict[str, bytes]:
    return bench_frames(SECONDS, "transfer")[0]


def config(text: bytes | None = None) -> Config:
    made = files()
    return Config.from_files({**made, ATTACHMENT: made[ATTACHMENT] if text is None else text})


@cache
def outputs() -> list[Output]:
    return fed(Engine(config()), bench_frames(SECONDS, "transfer")[1])


def of(kind: type) -> list:
    return [output for output in outputs() if isinstance(output, kind)]


def test_its_table_is_read_in_si() -> None:
    text = files()[ATTACHMENT].decode()
    head, table = text.split("[navigator.main.transfer]\n")
    own = """
lever_arm_m = [1.0, 2.0, 3.0]
lever_arm_sigma_m = 0.1
mounting_deg = [0.0, 0.0, 90.0]
mounting_sigma_deg = 1.0
velocity_noise_m_s = 0.5
attitude_noise_mrad = 2.0
position_noise_m = 3.0
rate_noise_deg_per_s = 4.0
latency_sigma_ms = 7.0
latest_ms = 300.0
flexure_mrad = [1.0, 2.0, 3.0]
flexure_s = [0.1, 0.2, 0.3]
duration_s = 8.0
sigma_mrad = [4.0, 5.0, 6.0]
patience_s = 60.0
lockout_s = 3.0
"""
    rest = table[table.index("\n[") :]
    t = navigator_config(
        "main", config((head + "[navigator.main.transfer]" + own + rest).encode())
    ).align.transfer
    assert t is not None
    assert t.lever_arm.tolist() == [1.0, 2.0, 3.0]
    # a slave that heads to the master's right: its forward axis is the master's right one
    np.testing.assert_allclose(t.C_ab @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(t.sigma_mounting, np.radians([1.0] * 3))
    found = (t.sigma_lever_arm, t.sigma_velocity, t.sigma_attitude, t.sigma_position, t.sigma_rate, t.latency)
    assert found == pytest.approx((0.1, 0.5, 2e-3, 3.0, np.radians(4.0), 7e-3))
    assert (t.latest_s, t.duration, t.patience, t.lockout) == pytest.approx((0.3, 8.0, 60.0, 3.0))
    assert t.flexure == pytest.approx([1e-3, 2e-3, 3e-3])
    assert t.flexure_time == pytest.approx([0.1, 0.2, 0.3])
    assert t.sigma == pytest.approx([4e-3, 5e-3, 6e-3])


def test_the_bench_tells_what_it_is() -> None:
    t = navigator_config("main", config()).align.transfer
    scenario = Bench("transfer", seed=5, seconds=SECONDS).scenario
    assert t is not None
    assert t.lever_arm == pytest.approx(scenario.lever_arm())
    assert scenario.flexure is not None
    assert scenario.master is not None
    assert t.flexure == pytest.approx(1e-3 * np.array(scenario.flexure.sigma_mrad))
    assert t.sigma_velocity >= scenario.master.velocity_noise_m_s
    assert t.sigma_attitude >= 1e-3 * scenario.master.attitude_noise_mrad


@pytest.mark.parametrize(
    ("imu", "master", "expected"),
    [(None, None, 0.04), ("a", None, 0.04), ("a", "b", 0.04), ("a", "a", 0.001)],
)
def test_dating_is_trusted_where_the_clock_is_the_same(imu, master, expected: float) -> None:
    text = re.sub("latency_sigma_ms = .*\n", "", files()[ATTACHMENT].decode())
    for device, clock in (("imu", imu), ("master", master)):
        if clock is not None:
            text = text.replace(f"[device.{device}]\n", f'[device.{device}]\nclock = "{clock}"\n')
    t = navigator_config("main", config(text.encode())).align.transfer
    assert t is not None
    assert t.latency == pytest.approx(expected)


@pytest.mark.parametrize("name", MATCHINGS)
def test_a_matching_needs_a_master(name: str) -> None:
    method = PREFIX + name
    assert method in METHODS
    text = files()[ATTACHMENT].replace(b'devices = ["imu", "master"]', b'devices = ["imu"]')
    text = text.replace(b'alignment = "transfer_velocity_attitude"', f'alignment = "{method}"'.encode())
    with pytest.raises(ConfigError, match=f'"{method}", expected a device that provides master'):
        navigator_config("main", config(text))


def test_every_alignment_can_be_configured_by_its_name() -> None:
    assert set(METHODS) == set(methods())
    text = files()[ATTACHMENT].replace(b"transfer_velocity_attitude", b"transfer_velocity_attitud")
    with pytest.raises(ConfigError, match='mean "transfer_velocity_attitude"'):
        navigator_config("main", config(text))


def command(code: CommandCode, method: str) -> bytes:
    return contract()["COMMAND"].encode(0, code, METHODS[method])


@pytest.mark.parametrize(
    ("scenario", "method", "result", "reason"),
    [
        ("transfer", "transfer_velocity", Result.ACCEPTED, Reason.NONE),
        ("drive", "transfer_velocity", Result.DENIED, Reason.NO_MASTER),
    ],
)
def test_a_command_asks_for_a_matching_by_its_number(
    scenario: str, method: str, result: Result, reason: Reason
) -> None:
    made, frames = bench_frames(SECONDS if scenario == "transfer" else 90.0, scenario)
    engine = Engine(Config.from_files(made), warm=False)
    fed(engine, frames[:2000])
    now = frames[1999]
    order = now._replace(key=0x180, data=command(CommandCode.START_ALIGNMENT, method))
    said = engine.feed(order)
    answers = [o for o in said if isinstance(o, Transmit) and o.key == 0x181]
    assert [contract()["COMMAND_ACK"].decode(o.data)[1:] for o in answers] == [(result, reason)]
    if result is Result.DENIED:
        assert "it needs a master navigator" in "".join(o.text for o in said if isinstance(o, Text))
    else:
        later = fed(engine, frames[2000:3000])
        assert "transfer_velocity" in {o.method for o in later if isinstance(o, Progress)}


def test_it_says_what_it_knows_ten_times_a_second_and_hands_over() -> None:
    changes = [(c.old, c.new) for c in of(ModeChange)]
    assert changes == [(Mode.STANDBY, Mode.TRANSFER), (Mode.TRANSFER, Mode.NAVIGATE)]
    handed_ns = of(ModeChange)[1].t_ns
    # not before the five seconds that it takes at least
    assert handed_ns - START_NS > 5_000_000_000
    said = of(Transfer)
    seconds = (handed_ns - START_NS) * 1e-9
    assert len(said) == pytest.approx(10 * seconds, abs=4)
    assert {s.matching for s in said} == {"velocity_attitude"}
    assert {s.navigator for s in said} == {"main"}
    first, last = said[0], said[-1]
    assert first.hint == "wing rock"
    assert last.hint == ""
    assert max(last.sigma) <= 1e-3
    assert max(first.sigma) > 4e-3
    assert dict(last.observability)["phi up"] < 0.2
    assert last.quality > 0.9


def test_while_it_runs_the_solution_is_whole() -> None:
    during = [o.solution for o in of(SolutionOut) if o.solution.mode is Mode.TRANSFER]
    assert len(during) > 45
    whole = int(SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL)
    for solution in during[5:]:
        assert solution.flags & whole == whole
        assert np.isfinite(solution.state[: S.F.stop]).all()


def test_it_agrees_with_the_truth_and_with_the_master_within_what_it_says() -> None:
    bench = Bench("transfer", seed=5, seconds=SECONDS, start_ns=START_NS)
    assert bench.scenario.master is not None
    master = master_of(bench.scenario.master, bench.trajectory, generator(5, "master"))
    solution = of(SolutionOut)[-1].solution
    truth = bench.truth(solution.t_ns)
    off = rot.quat_multiply(truth.q_gb, rot.quat_conjugate(solution.state[S.Q]))
    phi = rot.rotvec_from_quat(off)
    own, own_v, _ = (x[0] for x in master.errors(np.array([solution.t_ns - START_NS])))
    relative = np.array(of(Transfer)[-1].sigma)
    # chi-square of three at 99.9 %
    assert np.sum(((phi - own) / relative) ** 2) < 16.3
    assert np.sum((phi / solution.state[S.SIGMA_PHI]) ** 2) < 16.3
    assert np.abs(solution.v_g - truth.v_g - own_v).max() < 0.1
    # the mounting that it found: what the unit is really turned by
    built = navigator_config("main", config()).align.transfer
    assert built is not None
    C_ab = bench.trajectory.vehicle.C_vb
    true = rot.rotvec_from_quat(rot.quat_from_dcm(C_ab @ built.C_ab.T))
    said = of(Transfer)[-1]
    assert np.sum(((true - said.mounting) / np.array(said.sigma_mounting)) ** 2) < 16.3
    # degrees, known to tenths of a milliradian
    assert np.abs(true).max() > 3.0 * max(said.sigma_mounting)


def test_the_same_frames_give_the_same_bits() -> None:
    frames = bench_frames(SECONDS, "transfer")[1]
    digests = []
    for _ in range(2):
        engine = Engine(config())
        fed(engine, frames)
        digests.append(engine.digests())
    assert digests[0] == digests[1]


def test_a_scene_without_a_bus_has_the_same_truth_and_set_up() -> None:
    bench = Bench("transfer", seed=5, seconds=6.0)
    made = scene(bench.scenario, 5, 6.0)
    kinds = [type(sample) for sample in made.samples]
    # 200 samples and 50 messages a second, those of the first instant and of the last included
    assert (kinds.count(ImuSample), kinds.count(MasterState)) == (1200, 301)
    now, then = made.flown.trajectory.state(4_000_000_000), bench.trajectory.state(4_000_000_000)
    assert now.q_gb.tolist() == then.q_gb.tolist()
    assert made.config.align.transfer is not None
    assert made.config.align.transfer.lever_arm.tolist() == bench.scenario.lever_arm().tolist()
    navigator = Navigator(made.config)
    navigator.start(0)
    said = [event for sample in made.samples for event in navigator.step(sample)]
    assert navigator.mode is Mode.NAVIGATE
    last = [event for event in said if isinstance(event, TransferProgress)][-1]
    solution = [event for event in said if isinstance(event, Solution)][-1]
    truth = made.flown.trajectory.state(solution.t_ns)
    off = rot.quat_multiply(truth.q_gb, rot.quat_conjugate(solution.state[S.Q]))
    own = made.flown.master.errors(np.array([solution.t_ns]))[0][0]
    # chi-square of three at 99.9 %
    assert np.sum(((rot.rotvec_from_quat(off) - own) / np.array(last.sigma)) ** 2) < 16.3
