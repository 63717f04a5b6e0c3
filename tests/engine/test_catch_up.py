"""An alignment that goes over its data again behind a 1 kHz IMU on CAN: nothing is missed."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import Health, ModeChange, Output, Progress, SolutionOut
from nav.types import Mode
from tests.engine.made import START_NS
from virtual_bus.bus import Bench
from virtual_bus.scenario import load

SECONDS = 12.0
SCENARIO = """
title = "A kilohertz at rest"
grade = "rlg"
[start]
lat_deg = 34.25
lon_deg = 108.9
height_m = 400.0
heading_deg = 37.0
[imu]
rate_hz = 1000.0
[gnss]
[[manoeuvre]]
kind = "static"
duration_s = 30.0
"""


@pytest.fixture(scope="module")
def kilohertz(tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, list[RawFrame]]:
    path: Path = tmp_path_factory.mktemp("kilohertz") / "kilohertz.toml"
    path.write_text(SCENARIO)
    bench = Bench(load(path), seed=5, seconds=SECONDS, start_ns=START_NS)
    files = {name: text.encode() for name, text in bench.files("virtual", "test").items()}
    head, table, rest = files[ATTACHMENT].partition(b"[navigator.main.align]\n")
    assert table
    rest = rest[rest.index(b"[") :]
    head = head.replace(b'alignment = "static"', b'alignment = "rapid_gyrocompass"')
    files[ATTACHMENT] = head + table + b"coarse_s = 4.0\nfine_s = 4.0\n" + rest
    frames = [
        RawFrame(seq, frame.t_ns, 1, frame.frame_id, bytes(frame.data))
        for seq, frame in enumerate(bench.due(bench.end_ns))
    ]
    return Config.from_files(files), frames


def test_a_kilohertz_loses_nothing_while_it_catches_up(
    kilohertz: tuple[Config, list[RawFrame]],
) -> None:
    config, frames = kilohertz
    digests, said = [], []
    for _ in range(2):
        engine = Engine(config, warm=False)
        outputs: list[Output] = [out for frame in frames for out in engine.feed(frame)]
        digests.append(engine.digests())
        said.append([out for out in outputs if isinstance(out, ModeChange | Progress)])
    assert digests[0] == digests[1]
    assert said[0] == said[1]

    changes = [out for out in said[0] if isinstance(out, ModeChange)]
    assert changes[-1].new is Mode.NAVIGATE
    spans = [(a.t_ns, b.t_ns) for a, b in itertools.pairwise(changes) if a.new is Mode.CATCH_UP]
    begin_ns, end_ns = spans[-1]
    # back and ahead again over 8 s, 64 samples of 1 ms with each that comes, from when these are over
    assert (end_ns - changes[0].t_ns) * 1e-9 - 8.0 > 0.9 * 2.0 * 8.0 / 64.0
    behind = [out for out in said[0] if isinstance(out, Progress) and out.behind]
    # told ten times a second
    assert len([out for out in behind if begin_ns <= out.t_ns <= end_ns]) >= 2
    solutions = [out.solution for out in outputs if isinstance(out, SolutionOut)]
    assert not [s for s in solutions if begin_ns <= s.t_ns < end_ns], "publication pauses"
    under_way = np.array([s.t_ns for s in solutions if s.mode is Mode.NAVIGATE])
    # and resumes with the first update of two samples after the last that the alignment used
    assert under_way[0] - changes[-1].t_ns == pytest.approx(2e6, abs=2e4)
    assert np.diff(under_way).max() == pytest.approx(2e6, abs=2e4)

    health = [out for out in outputs if isinstance(out, Health)][-1]
    imu = health.devices["imu"]
    assert imu.samples == pytest.approx(1000 * SECONDS, abs=1100)
    assert (imu.missing, imu.bridged, dict(imu.rejects)) == (0, 0, {})
