"""A master that fails in every way before its slave is aligned: refused with the cause, told everywhere."""

from __future__ import annotations

import io
import re
from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as dialect

from bridge.assemble import make_sinks
from bridge.config import Config
from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import ModeChange, Output, SolutionOut, Text, Transfer, Transmit
from bridge.report import Printer
from bridge.view import ViewSink
from dbc.codec import contract
from nav import rotation as rot
from nav.types import Mode, S
from tests.sinks.test_view import Shown
from virtual_bus.bus import Bench
from virtual_bus.scenario import load

CAUSES = (
    (4.0, r"no message of the master for 2\.\d s"),
    (7.5, r"the master is frozen: it has said the same for 0\.\d s"),
    (11.0, r"the master's time jumped by -0\.20 s"),
    (17.0, r"the delay of the master's messages is off by (9\d|10\d) ms"),
)
"""From when each can be seen in the scenario: silence after 2 s, the same words after half a second."""
SOON_S = 0.6  # half of 20 messages, 50 a second, after ten that a clock set back makes stale
SECONDS = 28.0


def bench() -> Bench:
    what = load("transfer_faults")
    # half the frames
    return Bench(replace(what, imu=replace(what.imu, rate_hz=100.0)), seed=2, seconds=SECONDS)


@cache
def ran() -> tuple[list[tuple[float, Output]], list[Transmit], str, list[str]]:
    """Outputs with their times (s), what was sent on CAN and MAVLink, and what a terminal showed."""
    one = bench()
    files = one.files("virtual", "t", "udpout:127.0.0.1:14999")
    config = Config.from_files({name: text.encode() for name, text in files.items()})
    engine = Engine(config)
    printed, shown = io.StringIO(), Shown()
    view = ViewSink(shown, "main", clock=lambda: 0.0)
    sinks = [*make_sinks(config, engine), Printer(printed), view]
    outputs, sent = [], []
    for k, frame in enumerate(one.due(one.end_ns)):
        said = engine.feed(RawFrame(k, frame.t_ns, 1, frame.frame_id, bytes(frame.data)))
        outputs += [(1e-9 * frame.t_ns, output) for output in said]
        sent += [transmit for sink in sinks for transmit in sink.consume(said)]
    view.show()
    messages = [text for picture in shown.pictures for _, text in picture["messages"]]
    return outputs, sent, printed.getvalue(), messages


def of(kind: type) -> list[Any]:
    return [(t, output) for t, output in ran()[0] if isinstance(output, kind)]


def refusals() -> list[tuple[float, str]]:
    stem = "main: alignment starts again: "
    return [(t, o.text.removeprefix(stem)) for t, o in of(Text) if o.text.startswith(stem)]


def test_each_fault_is_refused_with_its_cause() -> None:
    told = refusals()
    for (from_s, cause), (t, text) in zip(CAUSES, told[: len(CAUSES)], strict=True):
        assert re.fullmatch(cause, text), told
        assert from_s < t < from_s + SOON_S, told


def test_it_is_told_on_every_side() -> None:
    texts = [text for _, text in refusals()]
    _, sent, printed, shown = ran()
    for text in texts:
        assert f"notice: main: alignment starts again: {text}\n" in printed
        assert f"main: alignment starts again: {text}" in shown
    parser = dialect.MAVLink(None)
    on_link = [parser.parse_buffer(bytearray(one.data))[0] for one in sent if one.source == 2]
    chunks: dict[int, str] = {}
    for m in on_link:
        if m.get_type() == "STATUSTEXT":
            chunks[m.id] = chunks.get(m.id, "") + m.text
    for text in texts:
        assert f"main: alignment starts again: {text}" in chunks.values()
    codec = contract()["SOL_ALIGN"]
    place = codec.signals.index("REFUSALS")
    on_bus = (one for one in sent if one.source == 1 and one.key == codec.frame_id)
    counted = [codec.decode(one.data)[place] for one in on_bus]
    assert counted == sorted(counted)
    assert counted[0] == 0
    # those that are told again within ten seconds are counted, too
    assert counted[-1] >= len(texts)


def test_in_the_end_it_is_aligned_and_right() -> None:
    changes = [change.new for _, change in of(ModeChange)]
    assert changes == [Mode.TRANSFER, Mode.NAVIGATE]
    one = bench()
    assert one.master is not None
    solution = of(SolutionOut)[-1][1].solution
    truth = one.truth(solution.t_ns)
    phi = rot.rotvec_from_quat(rot.quat_multiply(truth.q_gb, rot.quat_conjugate(solution.state[S.Q])))
    own = one.master.errors(np.array([solution.t_ns]))[0][0]
    sigma = np.array(of(Transfer)[-1][1].sigma)
    # chi-square of three at 99.9 %
    assert np.sum(((phi - own) / sigma) ** 2) < 16.3
    assert np.sum((phi / solution.state[S.SIGMA_PHI]) ** 2) < 16.3
