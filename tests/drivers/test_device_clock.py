"""The clock model against simulated clocks whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.device_clock import POINTS, DeviceClock

US = 1_000
MS = 1_000_000
S = 1_000_000_000
U32_US = 2**32 * US
U16_100US = 2**16 * 100 * US
START = 7 * S


def arrivals(
    rate_hz: float,
    seconds: float,
    drift_ppm: float,
    delay_ns: Callable[[np.random.Generator], float],
    first_count: int = 123_456_789_000,
    tick_ns: int = US,
) -> Iterator[tuple[int, int, int]]:
    """(true engine time of the sample, device count, arrival) of a device that runs fast by drift_ppm."""
    rng = np.random.default_rng(20)
    for k in range(int(rate_hz * seconds)):
        since = round(k * 1e9 / rate_hz)
        count = first_count + round(since * (1 + drift_ppm * 1e-6)) // tick_ns * tick_ns
        yield START + since, count, START + since + round(delay_ns(rng))


def errors(points: Iterator[tuple[int, int, int]], modulus: int | None, latency_ns: int = 0) -> np.ndarray:
    port = DeviceClock().port(modulus, latency_ns)
    return np.array(
        [port.stamp(count % modulus if modulus else count, rx) - true for true, count, rx in points]
    )


@pytest.mark.parametrize("drift_ppm", [0.0, 100.0, -100.0, 5000.0])
def test_a_fast_counter_is_dated_to_microseconds(drift_ppm: float) -> None:
    """Delays of mean 1 ms, exponential: the least of 400 in a stretch is about 2.5 us; ticks of 1 us."""
    late = errors(arrivals(200, 120, drift_ppm, lambda r: r.exponential(MS)), U32_US)[200 * 20 :]
    assert np.max(np.abs(late)) < 5 * US
    assert np.std(late) < 2 * US


def test_the_start_is_as_good_as_the_delays() -> None:
    """Before there is a line, a stamp is late by no more than the least delay so far, of mean 1 ms / n."""
    first = errors(arrivals(200, 5, 100.0, lambda r: r.exponential(MS)), U32_US)
    assert np.max(np.abs(first[200:])) < 100 * US


@pytest.mark.parametrize("drift_ppm", [0.0, 100.0])
def test_a_receiver_of_five_fixes_a_second(drift_ppm: float) -> None:
    """Jitter of mean 5 ms, ten fixes in a stretch: the points that touch are about 0.1 ms late."""
    points = arrivals(5, 600, drift_ppm, lambda r: 60 * MS + r.exponential(5 * MS))
    late = errors(points, None, 60 * MS)[5 * 100 :]
    assert np.max(np.abs(late)) < 0.5 * MS


def test_a_narrow_counter_wraps_every_6_5_seconds() -> None:
    """Ticks of 100 us: the count is 0 to 100 us behind, the line follows those that are hardly behind."""
    points = list(arrivals(50, 60, 50.0, lambda r: r.exponential(0.3 * MS), tick_ns=100 * US))
    late = errors(iter(points), U16_100US)[50 * 10 :]
    assert np.max(np.abs(late)) < 130 * US


@given(first=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_wrap_is_not_seen(first: int) -> None:
    port = DeviceClock().port(U32_US, 0)
    clear = DeviceClock().port(None, 0)
    for true, count, rx in arrivals(20, 3, 30.0, lambda r: r.exponential(MS), first_count=first * US):
        assert port.stamp(count % U32_US, rx) == clear.stamp(count, rx), true
        assert port.elapsed_ns == clear.elapsed_ns


def test_elapsed_is_the_devices_own_interval() -> None:
    port = DeviceClock().port(U32_US, 0)
    port.stamp(2**32 * US - 5 * MS, START)
    assert port.elapsed_ns is None
    port.stamp(0, START + 9 * MS)
    assert port.elapsed_ns == 5 * MS


def test_a_reset_is_followed_within_the_time_it_takes_to_be_sure() -> None:
    clock = DeviceClock()
    port = clock.port(U32_US, 0)
    late = []
    for k in range(200 * 20):
        true = START + k * 5 * MS
        count = 900 * S + k * 5 * MS if k < 2000 else (k - 2000) * 5 * MS
        late.append(port.stamp(count, true + 200 * US) - true)
    assert clock.resets == 1
    # until then stamped by arrival, which is 200 us late, as the line is
    assert np.max(np.abs(np.array(late))) <= 201 * US


def test_a_jump_ahead_is_a_reset_too() -> None:
    clock = DeviceClock()
    port = clock.port(U32_US, 0)
    for k in range(2000):
        true = START + k * 5 * MS
        out = port.stamp((100 * S if k < 1000 else 400 * S) + k * 5 * MS, true)
        assert abs(out - true) < 1 * MS
    assert clock.resets == 1


def test_a_burst_after_a_stall_keeps_the_devices_times() -> None:
    """The program was held up for 2 s and then gets everything at once: times are still the device's."""
    clock = DeviceClock()
    port = clock.port(U32_US, 0)
    for k in range(2000):
        true = START + k * 5 * MS
        rx = START + 7 * S + (k - 1000) * 20 * US if 1000 <= k < 1400 else true + 100 * US
        out = port.stamp(k * 5 * MS, rx)
        assert abs(out - true) < 150 * US
    assert clock.resets == 0


@pytest.mark.parametrize("rate_hz", [200, 20, 5])
@pytest.mark.parametrize("modulus", [None, U32_US, U16_100US])
@pytest.mark.parametrize("worst_s", [0.6, 3.0, 9.0])
def test_a_host_that_falls_behind_does_not_move_the_devices_time(
    modulus: int | None, rate_hz: int, worst_s: float
) -> None:
    """Half as fast as it should be, then 20 s behind by a constant, then caught up in a burst, twice.

    Longer than a wrap of the narrow counter, too. The ticks of 100 us come on top of the jitter, of which
    the least of the frames before counts.
    """
    clock = DeviceClock()
    port = clock.port(modulus, 0)
    rng = np.random.default_rng(4)
    worst: list[float] = []
    for k in range(120 * rate_hz):
        since = k / rate_hz
        phase = since % 60.0
        behind = 0.0
        if phase > 20.0:
            behind = min((phase - 20.0) / 2.0, worst_s)
            behind = max(0.0, min(behind, worst_s - 20.0 * (phase - 50.0)))
        true = START + round(since * S)
        count = (10**18 + round(since * S)) // (100 * US) * 100 * US
        rx = true + round(behind * S + rng.exponential(0.3 * MS))
        worst.append(abs(port.stamp(count % modulus if modulus else count, rx) - true))
    assert clock.resets == 0
    # what is late by less than a quarter of a second bends the line: a few milliseconds for as long as it is
    assert max(worst[20 * rate_hz :]) < 8 * MS
    assert np.median(worst[20 * rate_hz :]) < 0.4 * MS


def test_a_counter_that_stood_is_found_out() -> None:
    """One that was stopped for 2 s and goes on looks like a link that is late; links are not for ever."""
    clock = DeviceClock()
    port = clock.port(U32_US, 0)
    for k in range(200 * 60):
        true = START + k * 5 * MS + (2 * S if k >= 1000 else 0)
        out = port.stamp(k * 5 * MS, true + 100 * US)
    assert clock.resets == 1
    assert abs(out - true) < 150 * US


def test_a_link_that_falls_behind_does_not_move_gps_time() -> None:
    """Ten seconds of fixes, each 2 s late: they are dated at their own time, to a millisecond."""
    clock = DeviceClock()
    port = clock.port(None, 60 * MS)
    rng = np.random.default_rng(1)
    for k in range(5 * 90):
        true = START + k * 200 * MS
        behind = 2 * S if 300 <= k < 350 else 0
        out = port.stamp(10**18 + k * 200 * MS, true + 60 * MS + behind + round(rng.exponential(5 * MS)))
        if k > 100:
            assert abs(out - true) < 1 * MS
    assert clock.resets == 0


def test_a_long_silence_is_bridged_by_the_drift() -> None:
    """After 10 min without a frame the line is off by what drift it had wrong: under 0.1 ppm of 600 s."""
    points = [
        p for p in arrivals(100, 700, 80.0, lambda r: r.exponential(MS)) if not 60 < (p[0] - START) / S < 660
    ]
    port = DeviceClock().port(U32_US, 0)
    late = [port.stamp(count % U32_US, rx) - true for true, count, rx in points]
    assert abs(late[6001]) < 60 * US
    assert max(abs(e) for e in late[6500:]) < 10 * US


def test_devices_of_one_clock_share_its_line() -> None:
    """A GNSS with much jitter profits from the IMU, which counts the same time modulo 2^32 us."""
    clock = DeviceClock()
    imu, gnss, odo = clock.port(U32_US, 0), clock.port(None, 60 * MS), clock.port(U16_100US, MS)
    rng = np.random.default_rng(3)
    gps = 1_400_000_000 * S + 17 * MS
    late: dict[str, list[int]] = {"imu": [], "gnss": [], "odo": []}
    for k in range(200 * 60):
        since = k * 5 * MS
        device, true = gps + since, START + since
        late["imu"].append(imu.stamp(device % U32_US, true + round(rng.exponential(0.1 * MS))) - true)
        if k % 40 == 0:
            late["gnss"].append(gnss.stamp(device, true + 60 * MS + round(rng.exponential(5 * MS))) - true)
        if k % 4 == 0:
            device = device // (100 * US) * 100 * US
            rx = true + MS + round(rng.exponential(0.1 * MS))
            late["odo"].append(odo.stamp(device % U16_100US, rx) - true)
    assert clock.resets == 0
    for name, bound in (("imu", 20 * US), ("gnss", 20 * US), ("odo", 120 * US)):
        assert np.max(np.abs(late[name][len(late[name]) // 6 :])) < bound, name


@given(
    st.lists(
        st.tuples(st.integers(0, 2**48), st.integers(-(2**40), 2**62)),
        min_size=1,
        max_size=300,
    ),
    st.sampled_from([None, U32_US, U16_100US]),
)
@settings(max_examples=50, deadline=None)
def test_whatever_comes_the_result_grows_and_memory_stays(
    points: list[tuple[int, int]], modulus: int | None
) -> None:
    clock = DeviceClock()
    port = clock.port(modulus, 0)
    last = -(2**63)
    for count, rx in points:
        out = port.stamp(count % modulus if modulus else count, rx)
        assert out > last
        last = out
    assert len(clock._points) <= POINTS + 1
