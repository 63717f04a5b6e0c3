"""Somebody else's DBC file: odometers and speeds."""

from __future__ import annotations

import math

import pytest

from nav.types import OdoSample, SpeedSample
from tests.drivers.made import rejects
from tests.drivers.vendor import MS, ONE_FRAME_IMU, feed, frame, made


def test_ticks_wrap_and_the_reverse_signal_turns_their_sign() -> None:
    driver = made(
        '[odometer]\nticks = "Ticks"\nm_per_tick = 0.02\n'
        'reverse = { "Wheel.Back" = 1 }\nstandstill = { Stop = 1 }\n'
    )
    samples = feed(
        driver,
        frame("Wheel", 0, Ticks=65_500),
        frame("Wheel", 100 * MS, Ticks=64),
        frame("Wheel", 300 * MS, Ticks=114, Back=1),
        frame("Wheel", 400 * MS, Ticks=114, Stop=1),
    )
    assert all(isinstance(s, OdoSample) for s in samples)
    assert [s.distance for s in samples] == pytest.approx([2.0, -1.0, 0.0])
    assert [s.dt for s in samples] == pytest.approx([0.1, 0.2, 0.1])
    assert [s.standstill for s in samples] == [False, False, True]


def test_a_distance_that_counts_down_goes_back_and_a_jump_is_refused() -> None:
    driver = made('[odometer]\ndistance = "Trip"\nmax_speed_m_s = 50\n')
    samples = feed(
        driver,
        frame("Wheel", 0, Trip=0.3),
        frame("Wheel", 100 * MS, Trip=6553.5),
        frame("Wheel", 200 * MS, Trip=3000.0),
        frame("Wheel", 300 * MS, Trip=3001.0),
    )
    assert [s.distance for s in samples] == pytest.approx([-0.4, 1.0])
    assert rejects(driver) == {"RANGE": 1}


def test_speed_in_its_own_unit_and_direction() -> None:
    driver = made(
        '[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\nreverse = { "Speedo.Back" = 1 }\n'
    )
    samples = feed(driver, frame("Speedo", 0, Kmh=36.0), frame("Speedo", 100 * MS, Kmh=3.6, Back=1))
    assert all(isinstance(s, SpeedSample) for s in samples)
    assert [s.speed for s in samples] == pytest.approx([10.0, -1.0])
    assert samples[0].sigma == pytest.approx(0.3 / 3.6)
    assert feed(driver, frame("Speedo", 200 * MS, Kmh=300.5)) == []
    assert rejects(driver) == {"RANGE": 1}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_float_that_is_no_number_is_refused(value: float) -> None:
    driver = made('[speed]\nspeed = "Fast"\nsigma = { value = 0.1, unit = "m/s" }\n')
    assert feed(driver, frame("Floats", 0, Fast=value)) == []
    assert rejects(driver) == {"RANGE": 1}
    assert feed(driver, frame("Floats", MS, Fast=-2.5))[0].speed == -2.5


def test_what_no_vehicle_does_is_refused_where_the_file_declares_no_range() -> None:
    driver = made('[speed]\nspeed = "Fast"\nsigma = { value = 0.1, unit = "m/s" }\n')
    assert feed(driver, frame("Floats", 0, Fast=3e38)) == []
    assert rejects(driver) == {"RANGE": 1}
    wild = made(
        ONE_FRAME_IMU.replace('z = "-W" }', 'z = "-W", unit = "rpm" }').replace(
            '"W"', '{ signal = "W", scale = 100 }'
        )
    )
    assert feed(wild, frame("Single", 0, W=300.0, Ok=1)) == []
    assert rejects(wild) == {"RANGE": 1}


def test_channels_of_one_device_share_its_frames() -> None:
    text = '[speed]\nspeed = "Kmh"\nsigma = { value = 0.3, unit = "km/h" }\n' + (
        '[odometer]\ndistance = { signal = "Kmh", unit = "m" }\nmax_speed_m_s = 1e6\n'
    )
    driver = made(text)
    kinds = [
        type(s).__name__ for s in feed(driver, *(frame("Speedo", i * 100 * MS, Kmh=i) for i in range(3)))
    ]
    assert kinds == ["SpeedSample", "SpeedSample", "OdoSample", "SpeedSample", "OdoSample"]
