"""Replay: what agrees, what differs and by how much, and the table of solutions."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bridge.clock import SimulatedClock, WallClock
from bridge.live import Live
from bridge.outputs import SolutionOut
from bridge.recording import Capture, Recorder
from bridge.replay import replay
from bridge.solution_csv import COLUMNS, CsvWriter
from bridge.sources.base import SourceContext
from nav.types import Mode, S, Solution
from tests.bridge.fakes import FakeEngine, ListSource

Record = Callable[[FakeEngine], Capture]


@pytest.fixture
def record(tmp_path: Path) -> Record:
    def make(engine: FakeEngine) -> Capture:
        clock = SimulatedClock(utc_ns=0)
        where = SourceContext(1, "can0", clock, WallClock(clock))
        source = ListSource(where, [[(0, 1, bytes([i]))] for i in range(50)])
        path = tmp_path / "a.mcap"
        recorder = Recorder(path, sources={0: "bridge", 1: "can0"}, utc_offset_ns=0, lossless=True)
        Live(engine=engine, sources=[source], sinks=[], clock=clock, wall=where.wall, recorder=recorder).run(
            5.0
        )
        recorder.close()
        return Capture(path)

    return make


def test_an_equal_engine_agrees_with_every_checkpoint(record: Record) -> None:
    report = replay(record(FakeEngine()), FakeEngine())
    assert report.agrees
    assert (report.verified, report.checkpoints, report.failed) == (4, 4, None)
    assert report.digest == report.recorded
    assert report.seconds == 5.0
    assert report.machine == []
    assert not report.other_machine


def test_another_engine_differs_by_as_much_as_it_does(record: Record) -> None:
    bias = 1e-3
    report = replay(record(FakeEngine()), FakeEngine(bias))
    assert not report.agrees
    assert report.failed is not None
    assert report.failed.index == 1
    assert report.verified == 0
    # the bias decays by 0.9 a frame; every solution of the first second carries what is left of it
    assert 0.0 < report.deviation.height_m < bias
    assert report.deviation.compared == 4
    ratio = report.deviation.horizontal_m / (report.deviation.height_m * 6371e3)
    # the ellipsoid's radii differ from the sphere's by its flattening
    assert ratio == pytest.approx(math.sqrt(2.0), rel=4e-3)
    assert report.deviation.velocity_m_s == pytest.approx(
        math.sqrt(3.0) * report.deviation.height_m, rel=1e-9
    )
    assert "largest deviation in 4 solutions" in str(report.deviation)


def test_a_capture_from_another_machine_names_what_differs(record: Record) -> None:
    capture = record(FakeEngine())
    capture.metadata["cpu"] = "another"
    report = replay(capture, FakeEngine())
    assert report.machine == ["cpu"]
    assert report.other_machine
    capture = Capture(capture.path)
    capture.metadata["sources_sha256"] = "changed"
    assert not replay(capture, FakeEngine()).other_machine, "our own sources are not the machine"


def test_a_navigator_that_never_answers_does_not_agree(record: Record) -> None:
    class Mute(FakeEngine):
        def feed(self, frame: object) -> list[object]:  # type: ignore[override]
            return []

    report = replay(record(FakeEngine()), Mute())
    assert not report.agrees
    assert report.deviation.missing == 4


def solution(t_ns: int = 5) -> Solution:
    state = np.full(S.SIZE, np.nan)
    state[[S.LAT, S.LON, S.HEIGHT]] = [math.radians(50.0), math.radians(-8.0), 12.5]
    state[S.V] = [1.0, 2.0, 3.0]
    half = math.radians(-90.0) / 2.0
    state[S.Q] = [math.cos(half), 0.0, 0.0, math.sin(half)]  # heading 90 degrees: east
    state[S.SIGMA_P] = [0.1, 0.2, 0.3]
    state[S.SIGMA_V] = [0.4, 0.5, 0.6]
    state[S.SIGMA_PHI] = np.radians([0.7, 0.8, 0.9])
    return Solution(t_ns, Mode.NAVIGATE, 0, state)


def test_the_table_has_units_and_sigmas(tmp_path: Path) -> None:
    table = CsvWriter(tmp_path / "a.csv", ["main"])
    table.consume([SolutionOut("main", solution(), 5)])
    table.consume([SolutionOut("main", Solution(6, Mode.ALIGN, 0, np.full(S.SIZE, np.nan)), 6)])
    table.close()
    with (tmp_path / "a.csv").open() as file:
        first, second = csv.DictReader(file)
    assert tuple(first) == COLUMNS
    wanted = {
        "t_ns": 5,
        "lat_deg": 50.0,
        "lon_deg": -8.0,
        "height_m": 12.5,
        "vel_e_m_s": 1.0,
        "vel_n_m_s": 2.0,
        "vel_u_m_s": 3.0,
        "roll_deg": 0.0,
        "pitch_deg": 0.0,
        "heading_deg": 90.0,
        "sigma_e_m": 0.1,
        "sigma_n_m": 0.2,
        "sigma_u_m": 0.3,
        "sigma_vel_e_m_s": 0.4,
        "sigma_vel_n_m_s": 0.5,
        "sigma_vel_u_m_s": 0.6,
        # heading east: roll is about east, pitch about the right axis, which points south
        "sigma_roll_deg": 0.7,
        "sigma_pitch_deg": 0.8,
        "sigma_heading_deg": 0.9,
    }
    for name, value in wanted.items():
        assert float(first[name]) == pytest.approx(value, abs=1e-12), name
    assert (first["mode"], second["mode"]) == ("NAVIGATE", "ALIGN")
    assert {second[name] for name in COLUMNS[1:-1]} == {"nan"}


def test_each_navigator_has_its_own_table(tmp_path: Path) -> None:
    table = CsvWriter(tmp_path / "a.csv", ["main", "slave"])
    table.consume([SolutionOut("slave", solution(), 5)])
    table.close()
    assert len((tmp_path / "a-main.csv").read_text().splitlines()) == 1
    assert len((tmp_path / "a-slave.csv").read_text().splitlines()) == 2
