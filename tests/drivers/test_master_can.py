"""A master navigator on CAN: epochs of eight or ten frames, what is in them, and what is turned away."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.master_can import MasterCan, MasterCanOptions
from bridge.frame import RawFrame
from dbc import e2e
from dbc.codec import contract
from nav.rotation import euler_from_quat
from nav.types import MasterState
from tests.drivers.made import can, context, flipped, rejects
from virtual_bus.bus import Bench
from virtual_bus.flights import scenario_of

MS = 1_000_000
NAMES = ("LAT", "LON", "HEIGHT", "VEL_H", "VEL_U", "LEVEL", "HEADING", "RATE", "FORCE")
SAID: dict[str, tuple[float, ...]] = {
    "LAT": (47.123456789, 900.0),
    "LON": (-8.5, 1200.5),
    "HEIGHT": (5123.25, 7.5),
    "VEL_H": (150.0123, -132.5),
    "VEL_U": (0.25, 0.5, 0.1),
    "LEVEL": (30.00001, -2.5),
    "HEADING": (311.0, 0.006, 0.06),
    "RATE": (0.005, 70.0, -3.0),
    "FORCE": (1.5, -0.25, 9.75),
}


def master(**options: object) -> MasterCan:
    table = {"driver": "master_can", "source": "can0", "latency_ms": 4.0, **options}
    return MasterCan(MasterCanOptions(**table), context("boss"))  # type: ignore[arg-type]


def epoch(
    k: int,
    said: dict[str, tuple[float, ...]] | None = None,
    valid: int = 1,
    attitude: int = 1,
    rates: int = 1,
    step_ms: int = 20,
) -> list[RawFrame]:
    """The frames of epoch k; the first comes 4 ms late, the others behind it."""
    said = {**SAID, **(said or {})}
    rx, us = 10**9 + k * step_ms * MS + 4 * MS, 77_000_000_000 + k * step_ms * 1000
    left_out = {*(() if attitude else ("LEVEL", "HEADING")), *(() if rates else ("RATE", "FORCE"))}
    frames = [can("MASTER_TIME", k % 15, valid, attitude, rates, us, rx_ns=rx)]
    for place, name in enumerate(NAMES):
        if name not in left_out:
            late = rx + (place + 1) * 130_000
            frames.append(can(f"MASTER_{name}", k % 15, *said[name], rx_ns=late))
    return frames


def fed(driver: MasterCan, frames: list[RawFrame]) -> list[MasterState]:
    return [sample for frame in frames for sample in driver.feed(frame)]


def test_what_it_says_is_what_was_sent() -> None:
    (state,) = fed(master(), epoch(0))
    assert state.device == "boss"
    assert state.valid
    assert state.t_ns == 10**9
    assert np.degrees([state.lat, state.lon]) == pytest.approx([47.123456789, -8.5], abs=1e-9)
    assert state.height == 5123.25
    assert state.v_g == pytest.approx([150.0123, -132.5, 0.25])
    heading, pitch, roll = euler_from_quat(state.q_ga)
    assert np.degrees([heading, pitch, roll]) == pytest.approx([311.0, -2.5, 30.00001], abs=1e-9)
    assert np.degrees(state.w_ia_a) == pytest.approx([0.005, 70.0, -3.0])
    assert state.f_a == pytest.approx([1.5, -0.25, 9.75])
    assert state.sigma_position == pytest.approx([1200.5, 900.0, 7.5])
    assert state.sigma_velocity == pytest.approx([0.5, 0.5, 0.1])
    assert np.degrees(state.sigma_phi) == pytest.approx([0.006, 0.006, 0.06])


@given(
    lat=st.floats(-90, 90),
    lon=st.floats(-180, 180),
    v=st.tuples(*[st.floats(-3000, 3000)] * 3),
    angles=st.tuples(st.floats(0, 359.99), st.floats(-85, 85), st.floats(-179, 179)),
    w=st.tuples(*[st.floats(-300, 300)] * 3),
)
@settings(max_examples=60, deadline=None)
def test_values_go_round_to_the_wires_resolution(
    lat: float, lon: float, v: tuple[float, ...], angles: tuple[float, ...], w: tuple[float, ...]
) -> None:
    heading, pitch, roll = angles
    said = {
        "LAT": (lat, 1.0),
        "LON": (lon, 1.0),
        "VEL_H": v[:2],
        "VEL_U": (v[2], 0.1, 0.1),
        "LEVEL": (roll, pitch),
        "HEADING": (heading, 0.01, 0.1),
        "RATE": w,
    }
    (state,) = fed(master(), epoch(3, said))
    assert np.degrees([state.lat, state.lon]) == pytest.approx([lat, lon], abs=0.51e-9)
    assert state.v_g == pytest.approx(v, abs=0.51e-4)
    found = np.degrees(euler_from_quat(state.q_ga))
    off = (found - [heading, pitch, roll] + 180.0) % 360.0 - 180.0
    # half a step of 1e-5 deg, and what an arcsine at 85 deg makes of rounding
    assert np.abs(off).max() < 0.52e-5
    assert np.degrees(state.w_ia_a) == pytest.approx(w, abs=0.51 * 0.005)


def test_a_platform_has_no_rates_to_tell_and_a_blind_one_no_attitude() -> None:
    driver = master()
    (platform,) = fed(driver, epoch(0, rates=0))
    assert platform.w_ia_a is None
    assert platform.f_a is None
    assert platform.q_ga is not None
    (blind,) = fed(driver, epoch(1, rates=0, attitude=0))
    assert blind.q_ga is None
    assert blind.sigma_phi is None
    assert rejects(driver) == {}


def test_a_master_that_is_not_to_be_used_says_so_and_is_passed_on() -> None:
    (state,) = fed(master(), epoch(0, valid=0))
    assert not state.valid


def test_standard_deviations_that_are_too_good_are_not_believed() -> None:
    said = {"LAT": (1.0, 0.0), "LON": (1.0, 0.0), "VEL_U": (0.0, 0.0, 0.0), "HEADING": (1.0, 0.0, 0.0)}
    (state,) = fed(master(min_sigma_attitude_deg=0.01), epoch(0, said))
    assert state.sigma_position[:2] == pytest.approx([0.1, 0.1])
    assert state.sigma_velocity == pytest.approx([0.01] * 3)
    assert np.degrees(state.sigma_phi) == pytest.approx([0.01] * 3)


@pytest.mark.parametrize("lost", range(10))
def test_an_epoch_that_misses_a_frame_is_counted_and_the_next_is_whole(lost: int) -> None:
    driver = master()
    first = epoch(0)
    del first[lost]
    assert fed(driver, first) == []
    assert len(fed(driver, epoch(1))) == 1
    assert rejects(driver) == {"INCOMPLETE": 1}


def test_frames_may_come_in_any_order() -> None:
    frames = epoch(0)
    (state,) = fed(master(), frames[::-1])
    assert state.v_g == pytest.approx([150.0123, -132.5, 0.25])


def test_what_is_wrong_is_counted_by_reason() -> None:
    driver = master()
    good = epoch(0)
    assert driver.feed(flipped(good[0])) == ()
    assert driver.feed(good[0]._replace(data=b"\0" * 3)) == ()
    fed(driver, good)
    driver.feed(good[4])  # sent twice
    driver.feed(can("MASTER_VEL_H", 0, 1.0, 1.0))  # the same counter, something else
    assert driver.counters.duplicates == 1
    assert rejects(driver) == {"CRC": 1, "LENGTH": 1, "COUNTER": 1}
    wild = epoch(1)
    codec_frame = wild[1]
    # a latitude of 100 degrees with a right CRC: the raw value beyond what the signal may hold
    codec = contract()["MASTER_LAT"]
    raw = int.from_bytes(codec_frame.data, "little") & ~(((1 << 38) - 1) << 12) | (100 * 10**9 << 12)
    body = bytearray(raw.to_bytes(8, "little"))
    e2e.protect_p01(body, codec.data_id)
    wild[1] = codec_frame._replace(data=bytes(body))
    assert fed(driver, wild) == []
    assert rejects(driver)["RANGE"] == 1


def test_a_master_that_tells_the_same_time_again_is_stale() -> None:
    driver = master()
    fed(driver, epoch(0))
    again = [
        can("MASTER_TIME", 1, 1, 1, 1, 77_000_000_000, rx_ns=10**9 + 24 * MS),
        *(can(f"MASTER_{name}", 1, *SAID[name], rx_ns=10**9 + 25 * MS) for name in NAMES),
    ]
    assert fed(driver, again) == []
    assert rejects(driver) == {"STALE": 1}


def test_the_simulated_master_is_read_as_it_is() -> None:
    """Through the bench's own frames: ten seconds at 50 Hz, against the arrays of the same master."""
    bench = Bench(scenario_of("wing-rock"), seed=2, seconds=6.0)
    driver = master()
    keys = {key for _, key in driver.keys}
    frames = [f for f in bench.due(bench.end_ns) if f.frame_id in keys]
    raw = [RawFrame(0, f.t_ns, 1, f.frame_id, f.data) for f in frames]
    states = fed(driver, raw)
    assert len(states) in (298, 299, 300)
    assert rejects(driver) == {}
    truth = bench.trajectory.motion(np.array([s.t_ns for s in states]), np.zeros(3))
    v = np.array([s.v_g for s in states]) - truth.v_g
    # 0.5 m/s of its own, 20 mm/s of noise, dated to the jitter of a millisecond
    assert np.abs(v).max() < 2.5
    assert v.std(axis=0) == pytest.approx([0.02] * 3, rel=0.3)
    rolls = np.degrees([float(euler_from_quat(s.q_ga)[2]) for s in states])
    assert rolls.max() == pytest.approx(30.0, abs=0.3)
    assert math.degrees(max(abs(s.w_ia_a[1]) for s in states if s.w_ia_a is not None)) > 70.0
