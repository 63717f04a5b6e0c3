"""An operator is told of a device that falls silent, once, and when it is back."""

from __future__ import annotations

from itertools import pairwise

import pytest

from bridge.engine import Engine
from bridge.frame import Event, RawFrame
from bridge.outputs import Severity, Text
from tests.engine.made import START_NS, bench_config, bench_frames, event

S = 10**9
IMU = (0x100, 0x101, 0x102, 0x103)


def texts(frames: list[RawFrame], until_s: int) -> list[tuple[float, Severity, str]]:
    """What the engine says about frames; ticks fill the silence as the live loop does."""
    ticks = [event(Event.TICK, START_NS + k * S // 10) for k in range(10 * until_s)]
    engine = Engine(bench_config())
    return [
        ((output.t_ns - START_NS) / S, output.severity, output.text)
        for frame in sorted([*frames, *ticks], key=lambda frame: frame.rx_ns)
        for output in engine.feed(frame)
        if isinstance(output, Text) and output.severity <= Severity.NOTICE and "main" not in output.text
    ]


def frames(until_s: float) -> list[RawFrame]:
    return [frame for frame in bench_frames()[1] if frame.rx_ns < START_NS + until_s * S]


def test_a_bench_in_order_gives_no_cause() -> None:
    assert texts(frames(12.0), 12) == []


def test_a_cable_that_is_pulled_and_put_back() -> None:
    gap = (START_NS + 6 * S, START_NS + 14 * S)
    said = texts([f for f in frames(18.0) if f.key not in IMU or not gap[0] <= f.rx_ns < gap[1]], 18)
    (gone_s, severity, gone), (back_s, _, back) = said
    # silent for two seconds, noticed at the next full one
    assert gone_s == pytest.approx(8.0, abs=1.1)
    assert (severity, gone.split(":")[0]) == (Severity.WARNING, "imu")
    assert "silent for" in gone
    assert back_s == pytest.approx(14.0, abs=1.1)
    assert back in ("imu: samples again, after about 8 s", "imu: samples again, after about 9 s")


def test_a_device_that_was_never_there() -> None:
    said = texts([f for f in frames(8.0) if f.key != 0x122], 20)
    assert [text for _, _, text in said if text.startswith("baro")] == [
        "baro: nothing heard in 5 s: is it connected, are source and identifiers right?"
    ]
    # and everybody is silent when the bus has gone
    assert {text.split(":")[0] for _, _, text in said} == {"baro", "imu", "odometer", "gnss"}


def test_frames_of_which_none_is_any_good_say_why() -> None:
    bad = [
        f._replace(data=bytes([f.data[0] ^ 0xFF]) + f.data[1:])
        if f.key == 0x120 and f.rx_ns > START_NS + 4 * S
        else f
        for f in frames(12.0)
    ]
    (said,) = texts(bad, 12)
    assert said[2].startswith("odometer: frames come but no sample for")
    assert "crc" in said[2]


def test_a_slow_device_is_not_called_silent() -> None:
    # a fix every two seconds
    epochs = [
        f for f in frames(20.0) if not 0x130 <= f.key <= 0x135 or (f.rx_ns - START_NS) // (S // 5) % 10 == 1
    ]
    assert [text for _, _, text in texts(epochs, 20) if text.startswith("gnss")] == []


def test_an_alignment_that_cannot_be_says_why_now_and_then() -> None:
    # driving, the IMU begins after the minute at rest: a static alignment is refused at every sample
    late = START_NS + 62 * S
    engine = Engine(bench_config())
    said = [
        output
        for frame in bench_frames()[1]
        if frame.rx_ns >= late
        for output in engine.feed(frame)
        if isinstance(output, Text) and "odometer rolls" in output.text
    ]
    times = [text.t_ns for text in said]
    assert 1 <= len(said) <= 4  # in 28 s
    assert all(b - a >= 10 * S for a, b in pairwise(times))
