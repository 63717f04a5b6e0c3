"""The kernel for the frames of a solution against the codec, value by value."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.sinks.epoch import EPOCH
from bridge.sinks.packing import Packer
from dbc.codec import MessageCodec, contract

CODECS = [contract()[name] for name in EPOCH]
PACKER = Packer(CODECS)


def shown(name: str, step: float, most: float, value: float) -> float:
    """A standard deviation as it is sent: a step at least unless it is nothing, at most the most."""
    if not name.startswith("SIGMA_") or value == 0.0:
        return value
    return max(value, step) if 0.0 < value <= most else most


def one_by_one(codec: MessageCodec, alive: int, values: list[float]) -> bytes | None:
    values = [shown(s.name, s.factor, s.maximum, v) for s, v in zip(codec.info, values, strict=True)]
    try:
        return codec.encode(alive, *values)
    except ValueError:
        return None


@st.composite
def drawn(draw: st.DrawFn) -> list[list[float]]:
    """Values of every message: most of them in range, ties of the rounding and ends among them."""
    messages = []
    for codec in CODECS:
        values: list[float] = []
        for s in codec.info:
            lowest, highest = (
                round((s.minimum - s.offset) / s.factor),
                round((s.maximum - s.offset) / s.factor),
            )
            raw = draw(st.integers(lowest, highest) | st.sampled_from([lowest, highest]))
            part = draw(st.sampled_from([0.0, 0.0, 0.5, -0.5, 0.499999, 0.3]))
            value = (raw + part) * s.factor + s.offset if part else raw * s.factor + s.offset
            values.append(draw(st.sampled_from([value] * 40 + [math.nan, math.inf, -math.inf, 1e30])))
        messages.append(values)
    return messages


@given(st.integers(0, 14), drawn())
@settings(max_examples=300, deadline=None)
def test_the_kernel_writes_what_the_codec_writes(alive: int, messages: list[list[float]]) -> None:
    expected = [one_by_one(codec, alive, values) for codec, values in zip(CODECS, messages, strict=True)]
    assert PACKER.encode(alive, np.concatenate(messages)) == expected
