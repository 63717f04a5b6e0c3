"""What every entry of SINKS promises; a new entry is held to it once it is registered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
BO_ 768 OUT: 8 UNIT
 SG_ ROLL : 0|16@1- (0.01,0) [-180|180] "deg" UNIT
"""

LEAST: dict[str, dict[str, Any]] = {
    "dbc_map": {"dbc": "unit.dbc", "messages": {"OUT": {"ROLL": "roll"}}},
}

SOURCE = 5


def made(name: str) -> Sink:
    entry = SINKS[name]
    table = {"type": name, "navigator": "main", "source": "here", **LEAST.get(name, {})}
    options = convert(table, entry.options, "t.toml", "sink.out")
    peer = MavlinkPeer(SOURCE, MavlinkSource(type="mavlink", url="udpin:127.0.0.1:0"))
    return entry.factory(options, SinkContext("out", SOURCE, peer, {"unit.dbc": DBC}))


def numbers(count: int) -> st.SearchStrategy[Any]:
    known = st.floats(-1.5, 1.5)  # within the range of every angle
    return st.lists(known | st.just(math.nan), min_size=count, max_size=count).map(np.array)


def rows() -> st.SearchStrategy[Any]:
    return st.builds(stretched, numbers(S.SIZE), st.sampled_from([1.0, 1e6]))


def stretched(row: Any, factor: float) -> Any:
    """Beyond what any wire can carry, but still on the Earth."""
    out = row * factor
    out[S.LAT], out[S.LON] = row[S.LAT], row[S.LON]
    return out


def outputs() -> st.SearchStrategy[Output]:
    t_ns, text = st.integers(0, 10**12), st.text(max_size=120)
    navigator, mode = st.sampled_from(["main", "other"]), st.sampled_from(Mode)
    solution = st.builds(Solution, t_ns, mode, st.integers(0, 1023), rows())
    sigmas, angle = numbers(3), st.floats(-1.5, 1.5)
    fix = st.builds(
        GnssFix, t_ns, angle, angle, angle, sigmas, st.none() | numbers(3), st.none() | sigmas,
        st.sampled_from(FixType), st.just("gnss"), st.none() | t_ns, st.none() | st.integers(0, 300),
    )  # fmt: skip
    rejects = st.dictionaries(st.sampled_from(Reject), st.integers(0, 10**6))
    count = st.integers(0, 2**40)
    device = st.builds(DeviceHealth, count, count, count, count, count, rejects)
    values = st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3).map(tuple)
    kind = st.sampled_from(["gnss_position", "gnss_velocity", "barometer", "odometer"])
    return st.one_of(
        st.builds(SolutionOut, navigator, solution, t_ns),
        st.builds(ModeChange, t_ns, navigator, mode, mode, text),
        st.builds(Progress, t_ns, navigator, text, st.floats(0.0, 1.0)),
        st.builds(FixOut, t_ns, st.just("gnss"), fix),
        st.builds(Innovation, t_ns, navigator, kind, values, values, st.floats(0.0), st.booleans()),
        st.builds(Health, t_ns, st.dictionaries(st.just("imu"), device), count, count, count),
        st.builds(Text, t_ns, st.sampled_from(Severity), text),
        st.builds(Checkpoint, t_ns, navigator, st.integers(0), st.just("0" * 64)),
        st.builds(Transmit, st.just(1), st.just(2), st.binary(max_size=8)),
    )


@pytest.mark.parametrize("name", SINKS)
def test_entry_is_complete(name: str) -> None:
    entry = SINKS[name]
    assert issubclass(entry.options, SinkOptions)
    assert entry.options.__doc__ is not None
    assert f'"{name}"' in entry.options.__doc__
    assert entry.source_type in SOURCE_OPTIONS


@pytest.mark.parametrize("name", SINKS)
@settings(max_examples=60, deadline=None)
@given(steps=st.lists(st.lists(outputs(), max_size=3), max_size=8))
def test_nothing_the_engine_can_put_out_makes_it_raise_and_equal_in_is_equal_out(
    name: str, steps: list[list[Output]]
) -> None:
    first, second = made(name), made(name)
    for step in steps:
        sent = first.consume(step)
        assert sent == second.consume(step)
        assert all(isinstance(frame, Transmit) and frame.source == SOURCE for frame in sent)
