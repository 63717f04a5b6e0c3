"""No kernel is compiled once the engine is there: a compilation takes seconds, a sample comes every 5 ms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys
from numba.core.registry import CPUDispatcher
from bridge.config import Config
from bridge.engine import Engine
from tests.engine.made import bench_frames

def compiled():
    return {
        (name, thing.__name__): len(thing.signatures)
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("nav", "bridge")
        for thing in vars(module).values()
        if isinstance(thing, CPUDispatcher)
    }

files, frames = bench_frames()
for alignment in (b"motion", b"static"):
    text = files["config.toml"].replace(b'alignment = "static"', b'alignment = "' + alignment + b'"')
    engine = Engine(Config.from_files({**files, "config.toml": text}))
    # half a second of imports, but not in the middle of the static alignment
    assert "filterpy" in sys.modules
    before = compiled()
    # from 60 s on the receiver is two seconds late besides, so that the history is rewound
    start = frames[0].rx_ns + 60 * 10**9
    gnss = range(0x130, 0x140)
    late = [f._replace(rx_ns=f.rx_ns + 2 * 10**9 * (f.key in gnss and f.rx_ns > start)) for f in frames]
    for frame in sorted(late, key=lambda f: f.rx_ns):
        engine.feed(frame)
    assert engine._lines[0].navigator.mode >= 2, engine._lines[0].navigator.mode
    new = [name for name, count in compiled().items() if count != before.get(name, 0)]
    assert not new, new
"""


def test_everything_is_compiled_beforehand() -> None:
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
