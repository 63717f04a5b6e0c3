"""A slave aligned from a master that is another process, over a real bus; judged by candump's log."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.commands import METHODS
from bridge.config import Config
from bridge.engine import Engine
from bridge.recording import Capture
from bridge.replay import replay
from nav import rotation as rot
from nav.types import Mode, SolutionFlag
from tests.socketcan.candump import read_log
from tests.socketcan.session import ANSWER_S, END_S, READY_S
from tests.socketcan.test_session import DATABASE, NAMES, ROOT
from tests.socketcan.uml import CHANNEL, Machine
from virtual_bus.bus import Bench

Frames = list[tuple[str, dict[str, Any]]]


@pytest.fixture(scope="module")
def folder(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one session: bus.log, run.mcap, run.txt, sim.txt."""
    where = tmp_path_factory.mktemp("transfer")
    for name, text in Bench("transfer", seed=1).files("socketcan", CHANNEL).items():
        (where / name).write_text(text)
    Engine(Config.load(where / "config.toml"))  # compiles what is not in the cache, much faster out here
    outcome = machine.run(
        [sys.executable, "-m", "tests.socketcan.transfer_session", str(where)],
        work=where,
        timeout_s=READY_S + 4.0 * ANSWER_S + END_S,
        env={"PYTHONPATH": str(ROOT)},
    )
    texts = [where / name for name in ("run.txt", "sim.txt")]
    said = "\n".join(path.read_text()[-2000:] for path in texts if path.exists())
    assert outcome.status == 0, f"{outcome.output}\n{said}\n{outcome.console[-2000:]}"
    assert json.loads(outcome.output) == {"sim_status": 0, "run_status": 0}, said
    return where


@pytest.fixture(scope="module")
def bus(folder: Path) -> Frames:
    raw = read_log(folder / "bus.log")
    return [
        (NAMES[key], dict(DATABASE.decode_message(key, data, decode_choices=False)))  # type: ignore[arg-type]
        for _, key, data in raw
    ]


def of(bus: Frames, name: str) -> list[dict[str, Any]]:
    return [signals for found, signals in bus if found == name]


def test_it_is_aligned_from_the_master_and_navigates_on(bus: Frames) -> None:
    modes = [Mode(signals["MODE"]) for signals in of(bus, "SOL_TIME")]
    order = list(dict.fromkeys(modes))
    assert [mode for mode in order if mode is not Mode.STANDBY] == [Mode.TRANSFER, Mode.NAVIGATE]
    assert modes[-1] is Mode.NAVIGATE
    assert {said["METHOD"] for said in of(bus, "SOL_ALIGN")} == {METHODS["transfer_velocity_attitude"]}
    known = of(bus, "SOL_TRANSFER")
    # ten a second over five seconds and more
    assert len(known) > 45
    assert len(known) == len(of(bus, "SOL_TRANSFER_OBS"))
    choices = DATABASE.get_message_by_name("SOL_TRANSFER").get_signal_by_name("HINT").choices
    assert str(choices[known[5]["HINT"]]) == "Wing rock"
    assert known[-1]["HINT"] == 0
    first, last = of(bus, "SOL_TRANSFER_OBS")[0], of(bus, "SOL_TRANSFER_OBS")[-1]
    assert max(last[f"LEFT_{axis}"] for axis in "ENU") < 50 <= max(first[f"LEFT_{axis}"] for axis in "ENU")


def test_no_frame_of_the_master_is_lost_or_refused(bus: Frames) -> None:
    health = of(bus, "SOL_HEALTH")[-1]
    assert {health[name] for name in ("DROPPED", "UNRECORDED", "UNKNOWN", "MISSING")} == {0}
    counts = [len(of(bus, name)) for name in ("MASTER_TIME", "MASTER_LEVEL", "MASTER_FORCE")]
    assert max(counts) - min(counts) <= 1
    assert max(counts) > 300


def test_its_attitude_is_that_of_the_store(bus: Frames) -> None:
    """In level flight, which it is for the whole minute after the wings were rocked, but for what bends."""
    # when the bench has ended, the mode alone is sent
    last = [signals for signals in of(bus, "SOL_HEADING") if signals["FLAGS"]][-1]
    flags = SolutionFlag(last["FLAGS"])
    whole = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING
    assert whole & flags == whole
    level, heading = of(bus, "SOL_LEVEL")[-1], last["HEADING"]
    sigma = of(bus, "SOL_SIGMA_ATT")[-1]
    truth = Bench("transfer", seed=1).truth(10_000_000_000)
    roll, pitch, ahead = np.degrees([truth.roll, truth.pitch, truth.heading])
    bends = np.degrees(1e-3)  # 0.3 mrad there and here, three of them together
    for found, expected, own in (
        (level["ROLL"], roll, sigma["SIGMA_ROLL"]),
        (level["PITCH"], pitch, sigma["SIGMA_PITCH"]),
        ((heading - ahead + 180.0) % 360.0 - 180.0, 0.0, sigma["SIGMA_HEADING"]),
    ):
        assert abs(found - expected) < 4.0 * own + bends


def test_the_mounting_that_it_found_is_the_real_one(bus: Frames) -> None:
    bench = Bench("transfer", seed=1)
    built = bench.scenario.vehicle.mounting_deg
    pitch, roll, heading = np.radians(built)
    C_ab = rot.dcm_from_euler(heading, pitch, roll)
    true = np.degrees(rot.rotvec_from_quat(rot.quat_from_dcm(bench.trajectory.vehicle.C_vb @ C_ab.T)))
    found, sigma = of(bus, "SOL_TRANSFER")[-1], of(bus, "SOL_TRANSFER_OBS")[-1]
    for axis, expected in zip("XYZ", true, strict=True):
        # four sigmas, and half a step of both signals
        assert abs(found[f"MOUNTING_{axis}"] - expected) < 4.0 * (sigma[f"SIGMA_{axis}"] + 1e-3) + 5e-4


def test_the_run_replays_to_its_own_digest(folder: Path) -> None:
    capture = Capture(folder / "run.mcap")
    report = replay(capture, Engine(Config.from_attachments(capture.attachments)), lambda _: None)
    printed = (folder / "run.txt").read_text().rstrip().splitlines()[-1]
    assert printed == f"solution sha256: {report.digest}"
    assert report.verified == report.checkpoints > 5
