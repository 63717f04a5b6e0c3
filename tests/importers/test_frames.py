"""Columns as frames: nothing is lost in pulses, and an independent decoder reads back what was put in."""

from __future__ import annotations

from importlib.resources import files

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.importers import frames
from bridge.importers.frames import Fixes, PulseOverflow, Sent
from nav.types import FixType

DATABASE = cantools.database.load_string((files("dbc") / "navbridge.dbc").read_text("cp1252"))
assert isinstance(DATABASE, Database)
WEEK_NS = 604_800 * 10**9
ARCSEC = np.pi / 180 / 3600


def decoded(sent: Sent, id_offset: int = 0) -> dict[str, float]:
    assert isinstance(DATABASE, Database)
    values = DATABASE.decode_message(sent.key - id_offset, sent.data, decode_choices=False)
    assert isinstance(values, dict)
    return {name: float(value) for name, value in values.items()}  # type: ignore[arg-type]


@settings(max_examples=50, deadline=None)
@given(
    rates=st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=200),
    scale=st.floats(1e-6, 1e-3),
    asymmetry=st.floats(0.99, 1.01),
)
def test_pulses_never_differ_from_the_integral_by_one(
    rates: list[float], scale: float, asymmetry: float
) -> None:
    column = np.array(rates)
    w = np.column_stack([column, -column, np.abs(column)])
    dt = np.full(len(rates), 0.01)
    plus, minus = np.full(3, scale), np.full(3, scale * asymmetry)
    counts = frames.pulses(w, dt, plus, minus)
    exact = np.cumsum(w * 0.01 / np.where(w < 0, minus, plus), axis=0)
    # half a pulse of rounding, and the rounding of the sums themselves
    assert np.abs(np.cumsum(counts, axis=0) - exact).max() <= 0.5 + 1e-6


def test_a_count_beyond_sixteen_bits_is_refused_with_its_row() -> None:
    w = np.zeros((10, 3))
    w[7, 1] = 40000.0
    with pytest.raises(PulseOverflow, match="40000 pulses") as caught:
        frames.pulses(w, np.ones(10), np.ones(3), np.ones(3))
    assert caught.value.row == 7


def test_imu_frames_decode_to_counts_sample_and_time() -> None:
    week_s = 243_261.729
    times = [round(week_s * 1e9) + k * 10_000_000 for k in range(300)]
    rng = np.random.default_rng(1)
    gyro, accel = (rng.integers(-32768, 32768, (300, 3)).astype(float) for _ in range(2))
    samples = [k + (1 if k > 100 else 0) for k in range(300)]
    sent = list(
        frames.imu_frames(times, gyro, accel, samples, delay_ns=5_000, id_offset=0x20, temperature_deg_c=31.4)
    )
    assert len(sent) == 900
    for k in range(300):
        g, a, t = (decoded(item, 0x20) for item in sent[3 * k : 3 * k + 3])
        assert [g["GYRO_X"], g["GYRO_Y"], g["GYRO_Z"]] == gyro[k].tolist()
        assert [a["ACCEL_X"], a["ACCEL_Y"], a["ACCEL_Z"]] == accel[k].tolist()
        assert g["ALIVE"] == a["ALIVE"] == t["ALIVE"] == samples[k] % 15
        assert t["SAMPLE"] == samples[k] % 256
        assert t["TEMPERATURE"] == 31
        assert t["TIME"] == times[k] // 1000 % 2**32
        assert {item.t_ns for item in sent[3 * k : 3 * k + 3]} == {times[k] + 5_000}


def fixes(count: int, t0_s: float = 243_258.499, **changes: object) -> Fixes:
    steps = np.arange(count)
    base = Fixes(
        times_ns=[WEEK_NS * 2374 + round((t0_s + 0.25 * k) * 1e9) for k in range(count)],
        leap_seconds=18,
        lat_deg=40.0966268 + 1e-6 * steps,
        lon_deg=-105.1474483 - 1e-6 * steps,
        height=1601.474 + 0.01 * steps,
        sigma=np.tile([0.011, 0.012, 0.02], (count, 1)),
        velocity=np.column_stack([1.0 + steps, -2.0 - steps, 0.1 * steps]),
        sigma_velocity=np.tile([0.05, 0.06, 0.08], (count, 1)),
        fix_types=[FixType.RTK_FIXED] * count,
        satellites=17,
    )
    return base._replace(**changes)  # type: ignore[arg-type]


def test_gnss_epochs_decode_to_what_was_put_in() -> None:
    table = fixes(40)
    keep = [k % 4 == 0 for k in range(40)]
    sent = list(frames.gnss_frames(table, keep, delay_ns=0, id_offset=0))
    assert len(sent) == 60
    for epoch in range(10):
        row = 4 * epoch
        six = sent[6 * epoch : 6 * epoch + 6]
        assert [item.key for item in six] == [0x130, 0x131, 0x132, 0x133, 0x134, 0x135]
        value: dict[str, float] = {}
        for item in six:
            signals = decoded(item)
            assert signals["ALIVE"] == epoch % 15
            value |= signals
        assert value["TOW"] == table.times_ns[row] % WEEK_NS // 1000
        assert value["WEEK"] == 2374
        # half a bit of each signal
        assert value["LAT"] == pytest.approx(table.lat_deg[row], abs=0.51e-9)
        assert value["LON"] == pytest.approx(table.lon_deg[row], abs=0.51e-9)
        assert value["HEIGHT"] == pytest.approx(table.height[row], abs=0.51e-3)
        assert table.velocity is not None
        for name, column in (("VEL_E", 0), ("VEL_N", 1), ("VEL_U", 2)):
            assert value[name] == pytest.approx(table.velocity[row, column], abs=0.00251)
        assert (value["SIGMA_E"], value["SIGMA_N"]) == pytest.approx((0.011, 0.012), abs=0.00101)
        assert (value["SIGMA_VE"], value["SIGMA_VN"]) == pytest.approx((0.05, 0.06), abs=1e-9)
        assert (value["FIX_TYPE"], value["SATELLITES"], value["VEL_VALID"]) == (6, 17, 1)


def test_the_week_rolls_over_with_the_time() -> None:
    table = fixes(4, t0_s=604_799.6)
    times = [decoded(item) for item in frames.gnss_frames(table, [True] * 4, delay_ns=0, id_offset=0)][::6]
    assert [item["WEEK"] for item in times] == [2374, 2374, 2375, 2375]
    assert times[2]["TOW"] == 100_000


def test_without_velocity_it_is_marked_not_valid_and_a_large_sigma_saturates() -> None:
    table = fixes(1, velocity=None, sigma=np.array([[99.0, 1.0, 1.0]]))
    value = {
        key: item
        for sent in frames.gnss_frames(table, [True], delay_ns=0, id_offset=0)
        for key, item in decoded(sent).items()
    }
    assert value["VEL_VALID"] == 0
    assert value["SIGMA_E"] == pytest.approx(16.382)


def test_ticks_are_the_distance_in_either_direction() -> None:
    times = [k * 10_000_000 for k in range(1000)]
    speed = np.where(np.arange(1000) < 500, 7.3, -2.1)
    speed[900:] = 0.0
    last = [decoded(item) for item in frames.odometer_frames(times, speed, 0.05, delay_ns=0, id_offset=0)]
    # the first speed has no interval before it
    distance = (499 * 7.3 + 400 * 2.1) * 0.01
    assert last[-1]["TICKS"] == round(distance / 0.05)
    assert [last[k]["DIRECTION"] for k in (0, 499, 500, 899)] == [1, 1, 2, 2]
    assert (last[899]["STANDSTILL"], last[900]["STANDSTILL"]) == (0, 1)
    assert last[700]["TIME"] == pytest.approx(7.0e6 % 6_553_600)


def test_pressure_crosses_unchanged() -> None:
    sent = list(frames.baro_frames([123_456_789_000], np.array([83412.34]), 21.5, delay_ns=7, id_offset=0))
    value = decoded(sent[0])
    assert sent[0].t_ns == 123_456_789_007
    assert value["PRESSURE"] == pytest.approx(83412.34, abs=0.0051)
    assert (value["TEMPERATURE"], value["VALID"]) == (pytest.approx(21.5), 1)
