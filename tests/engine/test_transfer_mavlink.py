"""A slave on CAN whose master speaks MAVLink, through the engine."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from bridge.config import ATTACHMENT, Config
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import ModeChange, SolutionOut, Transfer
from nav import rotation as rot
from nav.types import Mode, S
from tests.engine.made import START_NS, bench_frames, fed
from tests.mavlink.speaking import attitude_and_place
from virtual_bus.bus import Bench

SECONDS = 9.0
SYSTEM = 9
LATE_NS = 3_000_000
DEVICE = f"""
[source.link]
type = "mavlink"
url = "udpin:127.0.0.1:14777"

[device.master]
driver = "master_mavlink"
source = "link"
system_id = {SYSTEM}
latency_ms = 3.0
"""


@pytest.fixture(scope="module")
def frames() -> list[RawFrame]:
    """The bench's own frames of the slave, and its master's words as packets, 50 of a kind a second."""
    bench = Bench("transfer", seed=5, seconds=SECONDS, start_ns=START_NS)
    assert bench.master is not None
    t_ns = np.arange(20_000_000, round(SECONDS * 1e9), 20_000_000)
    said = bench.master.block(t_ns)
    packer = dialect.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    made = []
    for k, t in enumerate(t_ns.tolist()):
        for late, message in enumerate(attitude_and_place(said, k, t // 1_000_000 + 5000)):
            rx_ns = START_NS + t + LATE_NS + 100_000 * late
            made.append(RawFrame(0, rx_ns, 2, message.get_msgId(), bytes(message.pack(packer))))
    own = [frame for frame in bench_frames(SECONDS, "transfer")[1] if not 0x140 <= frame.key < 0x150]
    return [f._replace(seq=k) for k, f in enumerate(sorted(own + made, key=lambda one: one.rx_ns))]


def test_it_is_aligned_within_what_it_says(frames: list[RawFrame]) -> None:
    files = bench_frames(SECONDS, "transfer")[0]
    text = files[ATTACHMENT].decode()
    a = text.index("[device.master]")
    b = text.index("[", a + 1)
    config = Config.from_files({**files, ATTACHMENT: (text[:a] + DEVICE + "\n" + text[b:]).encode()})
    engine = Engine(config)
    outputs = fed(engine, frames)
    changes = [o.new for o in outputs if isinstance(o, ModeChange)]
    assert changes == [Mode.TRANSFER, Mode.NAVIGATE]
    known = [o for o in outputs if isinstance(o, Transfer)][-1]
    solution = [o.solution for o in outputs if isinstance(o, SolutionOut)][-1]
    bench = Bench("transfer", seed=5, seconds=SECONDS, start_ns=START_NS)
    assert bench.master is not None
    truth = bench.truth(solution.t_ns)
    phi = rot.rotvec_from_quat(rot.quat_multiply(truth.q_gb, rot.quat_conjugate(solution.state[S.Q])))
    own = bench.master.errors(np.array([solution.t_ns - START_NS]))[0][0]
    # chi-square of three at 99.9 %
    assert np.sum(((phi - own) / np.array(known.sigma)) ** 2) < 16.3
