"""An alignment that goes over its data again behind a 1 kHz IMU, live: a bus, a recorder and real time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.config import Config
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import Health, ModeChange, Output, SolutionOut, Text
from bridge.recording import Capture
from nav.align.store import Piece, Track
from nav.types import Mode

REST_S = 16.0  # an alignment of 12 s, of which the first quarter is coarse
SECONDS = 14.5
SCENARIO = f"""
title = "A kilohertz at rest, live"
grade = "rlg"
[start]
lat_deg = 34.25
lon_deg = 108.9
height_m = 400.0
heading_deg = 37.0
[imu]
rate_hz = 1000.0
[gnss]
[navigator]
alignment = "rapid_gyrocompass"
[[manoeuvre]]
kind = "static"
duration_s = {REST_S}
"""


class Longest:
    """The most stored samples that one frame of a running engine worked off."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.samples = 0
        self._taken: set[int] = set()
        for way in ("ahead", "back"):
            patch.setattr(Track, way, self._counted(getattr(Track, way), way == "ahead"))
        feed = Engine.feed

        def fed(engine: Engine, frame: RawFrame) -> Sequence[Output]:
            self._taken.clear()
            out = feed(engine, frame)
            self.samples = max(self.samples, len(self._taken))
            return out

        patch.setattr(Engine, "feed", fed)

    def _counted(self, original: Callable[..., Piece], ahead: bool) -> Callable[..., Piece]:
        def counted(track: Track, place: int, most: int) -> Piece:
            piece = original(track, place, most)
            first = place if ahead else place - len(piece.t_ns)
            if piece.rows.shape[1] == 6 and (ahead or place < track.count):
                self._taken.update(range(first, first + len(piece.t_ns)))
            return piece

        return counted


def test_a_kilohertz_is_aligned_live_and_no_frame_is_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario, capture = tmp_path / "kilohertz.toml", tmp_path / "kilohertz.mcap"
    scenario.write_text(SCENARIO)
    words = [str(scenario), "--seconds", str(SECONDS), "--speed", "1", "--out", str(capture)]
    with monkeypatch.context() as patch:
        longest = Longest(patch)
        assert main(["demo", *words, "--no-view", "--mavlink", "none"]) == 0
    said = capsys.readouterr().out
    # every frame is worked off in pieces that do not grow with what is stored
    with capsys.disabled():
        print(f"\nlive at 1 kHz: {longest.samples} stored samples in the longest frame")
    assert 0 < longest.samples <= 64

    # the same frames once more, bit for bit
    assert main(["replay", str(capture), "--golden", said.split()[-1]]) == 0
    recorded = Capture(capture)
    engine = Engine(Config.for_capture(recorded.attachments, None), warm=False)
    outputs = [out for frame in recorded.frames() for out in engine.feed(frame)]
    imu = [out for out in outputs if isinstance(out, Health)][-1].devices["imu"]
    assert imu.samples == pytest.approx(1000 * SECONDS, abs=1100)
    assert (imu.missing, imu.bridged, dict(imu.rejects)) == (0, 0, {})
    assert not [out for out in outputs if isinstance(out, Text) and "refused" in out.text]

    # publication pauses while it catches up, and resumes with the first update after its last sample
    changes = [out for out in outputs if isinstance(out, ModeChange)]
    assert changes[-1].new is Mode.NAVIGATE
    begin_ns, end_ns = next(c.t_ns for c in changes if c.new is Mode.CATCH_UP), changes[-1].t_ns
    solutions = [out.solution for out in outputs if isinstance(out, SolutionOut)]
    assert not [s for s in solutions if begin_ns <= s.t_ns < end_ns]
    first_ns = next(s.t_ns for s in solutions if s.mode is Mode.NAVIGATE)
    assert first_ns - end_ns == pytest.approx(2e6, abs=2e4)
