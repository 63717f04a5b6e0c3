"""Somebody else's DBC file: what devices and whoever writes the mapping do wrong."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drivers.dbc_map import DbcMap, DbcMapOptions
from bridge.errors import ConfigError
from bridge.frame import CAN_EFF, RawFrame
from bridge.strict import convert
from nav.types import ImuSample
from tests.drivers.made import context, rejects
from tests.drivers.vendor import GNSS, MS, TWO_FRAME_IMU, feed, frame, made


def test_lengths() -> None:
    driver = made('[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\n')
    good = frame("Speedo", 0, Kmh=36.0)
    assert feed(driver, good._replace(data=good.data[:3]), good._replace(data=b"")) == []
    assert rejects(driver) == {"LENGTH": 2}
    # padded to eight bytes, as many devices do
    assert feed(driver, good._replace(data=good.data.ljust(8, b"\xcc")))[0].speed == pytest.approx(10.0)


@settings(deadline=None, max_examples=60)  # every example reads the DBC file anew
@given(
    st.lists(
        st.tuples(
            st.sampled_from([1041 | CAN_EFF, 1042, 1060, 1061, 1070, 1072]),
            st.integers(-10 * MS, 200 * MS),
            st.binary(max_size=64),
        ),
        max_size=40,
    )
)
def test_no_frame_raises_and_time_never_goes_back(parts: list[tuple[int, int, bytes]]) -> None:
    driver = made(
        TWO_FRAME_IMU + GNSS + '[odometer]\ndistance = "Trip"\n'
        '[speed]\nspeed = "Fast"\nsigma = { value = 1, unit = "m/s" }\n'
    )
    rx_ns, last = 0, {}
    for key, step, data in parts:
        rx_ns += step
        for sample in driver.feed(RawFrame(0, rx_ns, 1, key, data)):
            assert sample.t_ns > last.get(type(sample), -(2**62))
            last[type(sample)] = sample.t_ns
            if isinstance(sample, ImuSample):
                assert sample.dt > 0.0
    assert driver.counters.frames == len(parts)


# --- what mappings do wrong


@pytest.mark.parametrize(
    ("text", "key", "says"),
    [
        ("", "dbc", 'found "vendor.dbc", expected at least one of the tables imu, gnss, speed, odometer'),
        (TWO_FRAME_IMU.replace("RateFwd", "RateForward"), "imu.gyro.y", 'found "RateForward", expected'),
        (
            TWO_FRAME_IMU.replace("AccUp", "Forces.AccDown"),
            "imu.accel.z",
            "one of Forces.AccFwd, Forces.AccLeft, Forces.AccUp",
        ),
        (
            TWO_FRAME_IMU.replace('"Rates.Ok"', '"Ok"'),
            "imu.valid.Ok",
            "there are several: Rates.Ok or Forces.Ok or Single.Ok",
        ),
        (
            TWO_FRAME_IMU.replace('"AccUp" }', '"AccUp", unit = "m/s" }'),
            "imu.accel.x.unit",
            'found "m/s", expected a unit of accel',
        ),
        (
            TWO_FRAME_IMU.replace('"AccUp"', '"RateUp"'),
            "imu.accel.z",
            '(the DBC file says "deg/s"), as unit = one of m/s^2,',
        ),
        (TWO_FRAME_IMU.replace('"Count"', '"Counter"'), "imu.counter", 'found "Rates.Counter", expected'),
        (
            TWO_FRAME_IMU.replace("rate_hz = 100", "rate_hz = 0"),
            "imu.rate_hz",
            "found 0, expected a number > 0",
        ),
        (TWO_FRAME_IMU.replace("rate_hz = 100", ""), "imu.rate_hz", "found nothing"),
        (TWO_FRAME_IMU + 'gravity = "up"\n', "imu.gravity", "found an unknown key"),
        (TWO_FRAME_IMU + 'time = { value = 1, unit = "s" }\n', "imu.time", "expected a signal"),
        (
            GNSS.replace("sigma_horizontal", "sigma_east"),
            "gnss",
            "expected either sigma_horizontal, or sigma_east and",
        ),
        (GNSS.replace('vel_east = "VelE"', ""), "gnss", "expected for a velocity vel_east, vel_north"),
        (GNSS.replace("RTK_FIXED", "RTK"), "gnss.fix_type.values.9", 'found "RTK", expected one of DGPS'),
        (GNSS.replace("9 =", "nine ="), "gnss.fix_type.values", 'found "nine", expected a number as key'),
        (
            GNSS.replace("value = 5,", 'value = 5, signal = "VelE",'),
            "gnss.sigma_speed",
            "both or none of signal and value",
        ),
        (GNSS.replace(', unit = "cm/s"', ""), "gnss.sigma_speed", "a value without unit"),
        ('[speed]\nspeed = "Odd"\nsigma = "Fast"\n', "speed.speed", 'the DBC file says "smoot"'),
        ('[odometer]\nticks = "Ticks"\n', "odometer", "expected either distance, or ticks and m_per_tick"),
        (
            '[odometer]\ndistance = { signal = "Fast", unit = "m" }\n',
            "odometer.distance",
            "an integer signal",
        ),
    ],
)
def test_mistakes_in_a_mapping_are_named(text: str, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made(text)
    assert str(caught.value).startswith(f"test.toml: device.dev.{key}: ")
    assert says in str(caught.value)


def test_a_file_that_is_no_dbc_is_named() -> None:
    options = convert({"driver": "dbc_map", "source": "s", "dbc": "x.dbc"}, DbcMapOptions, "t")
    with pytest.raises(
        ConfigError, match=r'test.toml: device.dev.dbc: found "x.dbc", expected a DBC file \('
    ):
        DbcMap(options, context(files={"x.dbc": b"\x7fELF not a DBC"}))
