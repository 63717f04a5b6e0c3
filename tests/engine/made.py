"""Configurations and frames for engine tests."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.outputs import Output
from virtual_bus.bus import Bench

START_NS = 10**12

ALIGN = """
[navigator.main.align]
coarse_s = 10.0
fine_s = 30.0
"""


@cache
def bench_frames(seconds: float = 90.0, scenario: str = "drive") -> tuple[dict[str, bytes], list[RawFrame]]:
    """Attachments of a bench's configuration, and every frame of its first seconds."""
    bench = Bench(scenario, seed=5, seconds=seconds, start_ns=START_NS)
    files = {name: text.encode() for name, text in bench.files("virtual", "test").items()}
    if b"[navigator.main.align]" not in files[ATTACHMENT]:
        files[ATTACHMENT] += ALIGN.encode()
    frames = [
        RawFrame(seq, frame.t_ns, 1, frame.frame_id, bytes(frame.data))
        for seq, frame in enumerate(bench.due(bench.end_ns))
    ]
    return files, frames


def bench_config(seconds: float = 90.0) -> Config:
    return Config.from_files(bench_frames(seconds)[0])


def event(key: Event, rx_ns: int, /, **body: Any) -> RawFrame:
    return RawFrame(0, rx_ns, BRIDGE, key, json.dumps(body).encode() if body else b"")


def fed(engine: Engine, frames: list[RawFrame]) -> list[Output]:
    return [output for frame in frames for output in engine.feed(frame)]
