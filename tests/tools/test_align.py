"""``navbridge align``: the table against truth, refusals, what is not run, and the pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from bridge.config import Config
from bridge.evaluate import truth_document
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.recording import Capture, Recorder
from bridge.studies.alignment_report import lines_of
from bridge.studies.alignment_table import Found, Trace, run_methods, samples_of
from nav.transfer import alignment, methods
from nav.types import ImuSample
from tests.engine.made import START_NS, bench_frames
from virtual_bus.bus import Bench

SECONDS = 50.0  # at rest, aligned after 40
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    files, frames = bench_frames(SECONDS, "static_rlg")
    text = files["config.toml"].replace(b"coarse_s = 60.0", b"coarse_s = 10.0")
    files = {**files, "config.toml": text.replace(b"fine_s = 240.0", b"fine_s = 30.0")}
    config = Config.from_files(files)
    assert config.navigators["main"].align.coarse_s + config.navigators["main"].align.fine_s == 40.0
    path = tmp_path_factory.mktemp("align") / "rest.mcap"
    sources = {0: "bridge", 1: "can0"}
    recorder = Recorder(
        path, sources=sources, utc_offset_ns=0, attachments=config.attachments(), lossless=True
    )
    for frame in frames:
        recorder.record(frame)
    bench = Bench("static_rlg", seed=5, seconds=SECONDS, start_ns=START_NS)
    for t_ns in range(START_NS, START_NS + round(SECONDS * 1e9), 100_000_000):
        truth = bench.truth(t_ns)
        document = truth_document(truth.lat, truth.lon, truth.height, truth.v_g, truth.q_gv, np.zeros(3))
        recorder.truth(t_ns, document)
    recorder.record(RawFrame(len(frames), frames[-1].rx_ns, BRIDGE, Event.STOP, b'{"reason": "end"}'))
    recorder.close()
    return path


def test_the_samples_are_those_of_the_navigator(capture: Path) -> None:
    config = Config.for_capture(Capture(capture).attachments, None)
    samples = list(samples_of(Capture(capture), config, "main"))
    inertial = [s for s in samples if isinstance(s, ImuSample)]
    assert len(inertial) == pytest.approx(SECONDS * 200, abs=5)
    # compensated: gravity, to the accelerometers' errors
    force = np.mean([s.dv / s.dt for s in inertial], axis=0)
    assert np.linalg.norm(force) == pytest.approx(9.81, abs=0.03)


def test_a_table_against_truth(capture: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "static.png"
    assert main(["align", str(capture), "--method", "static", "--json", "--out", str(out)]) == 0
    (found,) = json.loads(capsys.readouterr().out)["alignments"]
    assert found["ended_s"] == pytest.approx(40.0, abs=1.1)
    assert found["refusals"] == []
    # the coarse stage knows heading to 0.1 deg when it ends
    assert 2.0 < found["converged_s"] < 11.2
    assert 2.0 < found["right_s"] < 11.2
    sigma, error = found["sigma_deg"]["up"], found["error_deg"]["heading"]
    assert 0.5 * found["limit_deg"]["up"] < sigma < 1.0
    assert abs(error) < 4.0 * sigma
    assert (
        abs(found["error_deg"]["pitch"])
        < 4.0 * found["sigma_deg"]["east"] + 4.0 * found["sigma_deg"]["north"]
    )
    assert out.read_bytes().startswith(PNG)


def test_the_alignment_of_the_capture_by_default_and_a_bound(
    capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["align", str(capture), "--bound", "0.001"]) == 0
    head, _, row, *_ = capsys.readouterr().out.splitlines()
    assert head.split()[:4] == ["alignment", "heading", "pitch", "roll"]
    cells = row.split()
    assert cells[0] == "static"
    assert cells[7] == "-", "a thousandth of a degree is beyond these gyros"


def test_all_of_them_are_run_or_say_why_not(
    capture: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = tmp_path / "pictures"
    # eight seconds are too short for all but a stored attitude
    main(["align", str(capture), "--all", "--seconds", "8", "--out", str(folder)])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2 : 2 + len(methods())]] == list(methods())
    pictures = {path.stem for path in folder.iterdir()}
    skipped = {row.split()[0] for row in lines[2 : 2 + len(methods())] if "not run" in row}
    assert pictures | skipped == set(methods())
    assert not pictures & skipped
    assert "stored: not run, it needs a stored heading or an attitude in the configuration" in lines
    assert "moving_gyrocompass, odometer: not run, it needs an odometer" in lines


def test_a_refusal_is_told(capture: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = Capture(capture).attachments["config.toml"]
    wrong = tmp_path / "config.toml"
    # Earth turns otherwise at the equator
    wrong.write_bytes(
        text.replace(b"[navigator.main.align]", b"[navigator.main.align]\nposition_deg_m = [0.0, 0.0, 0.0]")
    )
    for name, content in Capture(capture).attachments.items():
        if name.endswith("calibration.toml"):
            (tmp_path / name).write_bytes(content)
    assert main(["align", str(capture), "--config", str(wrong), "--method", "static"]) == 1
    out = capsys.readouterr().out
    (refused,) = (line for line in out.splitlines() if line.startswith("static: refused after 10.0 s:"))
    assert "latitude" in refused


def test_later_and_no_navigator_and_no_alignment(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["align", str(capture), "--start", "30"]) == 1
    assert main(["align", str(capture), "--start", "60"]) == 1
    assert "no inertial sample for navigator main after 60 s" in capsys.readouterr().err
    assert main(["align", str(capture), "--out", "no folder/picture.png"]) == 1
    assert "no folder: No such file or directory" in capsys.readouterr().err
    assert main(["align", str(capture), "--navigator", "other"]) == 2
    assert 'no navigator "other", expected one of main' in capsys.readouterr().err
    assert main(["align", str(capture), "--method", "north"]) == 2
    assert 'no alignment "north", expected one of static, motion' in capsys.readouterr().err


def test_what_lacks_is_not_run(capture: Path) -> None:
    config = Config.for_capture(Capture(capture).attachments, None)
    kinds = {"imu", "gnss"}
    wanting = [name for name in methods() if alignment(name).needs - kinds]
    for one in run_methods(Capture(capture), config, wanting, seconds=1.0):
        needed = alignment(one.method).needs
        assert bool(one.lacks) == (one.trace is None)
        assert not one.lacks or one.lacks in needed


def test_what_is_told_of_several_is_told_once() -> None:
    pushed = "pushed: 0.2 m/s"
    first = Found("first", refusals=[(2.0, pushed), (4.0, "pushed: 0.3 m/s"), (5.0, "it drives")])
    other = Found("other", refusals=[(2.0, pushed), (4.0, "pushed: 0.1 m/s")])
    lacking = Found("lacking", lacks="odometer")
    *_, once, drives, not_run = lines_of([first, other, lacking], 1.0)
    assert once == "first, other: refused after 2.0 s: pushed: 0.2 m/s (and once more, till 4.0 s)"
    assert drives == "first: refused after 5.0 s: it drives"
    assert not_run == "lacking: not run, it needs an odometer"


def trace(sigma: list[float], error: list[float]) -> Found:
    n = len(sigma)
    column = np.column_stack([np.zeros((n, 2)), sigma])
    errors = np.column_stack([np.zeros((n, 2)), error])
    known = np.where(np.isfinite(errors), errors, 0.0)
    return Found("x", trace=Trace(np.arange(n) * 1.0, known, errors, column, column, np.zeros(n, dtype=bool)))


def test_converged_is_for_good() -> None:
    nan = math.nan
    found = trace([5.0, 0.5, 2.0, 0.9, 0.5], [nan, 3.0, 0.1, -1.5, 0.2])
    assert found.converged_s(1.0) == 3.0
    assert found.converged_s(0.1) is None
    assert found.right_s(1.0) == 4.0
    assert found.right_s(5.0) == 1.0
    assert found.right_s(0.1) is None
    assert Found("x").converged_s(1.0) is None
    assert Found("x").right_s(1.0) is None
