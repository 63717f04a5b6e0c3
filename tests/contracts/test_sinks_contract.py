"""What every entry of SINKS promises; a new entry is held to it once it is registered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from bridge.mavlink.peer import MavlinkPeer
from bridge.options import SOURCE_OPTIONS, MavlinkSource, SinkOptions
from bridge.outputs import (
    Checkpoint,
    DeviceHealth,
    FixOut,
    Health,
    Innovation,
    ModeChange,
    Output,
    Progress,
    Reject,
    Severity,
    SolutionOut,
    Text,
    Transmit,
)
from bridge.sinks import SINKS, Sink, SinkContext
from bridge.strict import convert
from nav.types import FixType, GnssFix, Mode, S, Solution

DBC = b"""VERSION ""
NS_ :
BS_:
BU_: UNIT
BO_ 800 PLACE: 8 UNIT
 SG_ LAT : 0|32@1- (0.0000001,0) [-90|90] "deg" UNIT
 SG_ LON : 32|32@1- (0.0000001,0) [-180|180] "deg" UNIT
"""

LEAST: dict[str, dict[str, Any]] = {
    "dbc_map": {"dbc": "unit.dbc", "messages": {"PLACE": {"LAT": "lat", "LON": "lon"}}},
}
"""Keys that a sink cannot do without."""


def made(name: str) -> Sink:
    entry = SINKS[name]
    table = {"type": name, "source": "s", "navigator": "main", **LEAST.get(name, {})}
    options = convert(table, entry.options, "test.toml", "sink.s")
    peer = (
        MavlinkPeer(3, MavlinkSource(type="mavlink", url="udpout:x"))
        if entry.source_type == "mavlink"
        else None
    )
    return entry.factory(options, SinkContext("s", 3, peer, {"unit.dbc": DBC}))


def rows() -> Iterator[np.ndarray]:
    yield np.full(S.SIZE, math.nan)
    yield np.zeros(S.SIZE)
    for large in (1e6, -1e6):
        row = np.full(S.SIZE, large)
        row[S.LAT], row[S.LON] = math.copysign(1.5, large), math.copysign(3.1, large)
        yield row
    row = np.zeros(S.SIZE)
    row[S.LAT], row[S.LON], row[S.HEIGHT], row[S.Q] = 0.8, -3.1, 400.0, [1.0, 0.0, 0.0, 0.0]
    yield row


def outputs() -> Iterator[Output]:
    t = 10**12
    for second in range(5):
        for row in rows():
            t += 20_000_000
            for flags in (0, 0x3FF):
                yield SolutionOut("main", Solution(t, Mode.NAVIGATE, flags, row), t + 1)
                yield SolutionOut("other", Solution(t, Mode.ALIGN, flags, row), t + 1)
        t += 10**9
        yield ModeChange(t, "main", Mode.ALIGN, Mode.NAVIGATE, "x" * 500)
        yield Progress(t, "main", "alignment", second / 5)
        yield Innovation(t, "main", "gnss_position", (math.nan,) * 3, (1.0,) * 3, math.inf, False)
        yield Text(t, Severity.CRITICAL, "ä" * 300)
        yield Checkpoint(t, "main", second, "00")
        sigma = np.full(3, math.nan)
        yield FixOut(
            t, "gnss", GnssFix(t, 0.8, 0.1, 1e9, sigma, None, None, FixType.RTK_FIXED, "gnss", 2**62, 99)
        )
        counts = dict.fromkeys(Reject, 2**40)
        yield Health(t, {"imu": DeviceHealth(2**40, 1, 2**33, 0, 0, counts, 1e9, 1e12)}, 2**33, 2**33, 2**33)


@pytest.mark.parametrize("name", SINKS)
def test_a_sink_takes_whatever_the_engine_may_say(name: str) -> None:
    assert issubclass(SINKS[name].options, SinkOptions)
    assert SINKS[name].source_type in SOURCE_OPTIONS
    sink = made(name)
    sent = 0
    for output in outputs():
        for transmit in sink.consume([output]):
            assert isinstance(transmit, Transmit)
            assert transmit.source == 3
            assert transmit.data
            sent += 1
    assert sink.consume([]) is not None
    assert sent


@pytest.mark.parametrize("name", SINKS)
def test_a_sink_is_a_function_of_what_it_is_told(name: str) -> None:
    one, two = made(name), made(name)
    for output in outputs():
        assert one.consume([output]) == two.consume([output])
