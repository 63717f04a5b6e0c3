"""Somebody else's DBC file: fixes put together from several frames, multiplexed ones among them."""

from __future__ import annotations

import math

import pytest

from bridge.frame import RawFrame
from nav.types import FixType, GnssFix
from tests.drivers.made import rejects
from tests.drivers.vendor import DEG, GNSS, MS, feed, frame, made


def fix_frames(rx_ns: int, **change: float) -> tuple[RawFrame, RawFrame, RawFrame]:
    v: dict[str, float] = {
        "Lat": 48.1234567, "Lon": 11.7654321, "Height": 512.34, "HAcc": 40, "VAcc": 30,
        "VelN": 300, "VelE": -400, "VelD": 50, "Fix": 9, "VelOk": 1, **change,
    }  # fmt: skip
    first = {k: v[k] for k in ("Lat", "Lon")}
    second = {k: v[k] for k in ("Height", "HAcc", "VAcc")}
    third = {k: v[k] for k in ("VelN", "VelE", "VelD", "Fix", "VelOk")}
    return (
        frame("Position", rx_ns, **first),
        frame("Motion", rx_ns + 5 * MS, Page=0, **second),
        frame("Motion", rx_ns + 10 * MS, Page=1, **third),
    )


def test_a_fix_of_three_frames_two_of_them_multiplexed() -> None:
    driver = made(GNSS, latency_ms=50.0)
    (fix,) = feed(driver, *fix_frames(1000 * MS))
    assert isinstance(fix, GnssFix)
    assert fix.t_ns == 950 * MS
    assert (fix.lat, fix.lon) == pytest.approx((48.1234567 * DEG, 11.7654321 * DEG), abs=1e-14)
    assert fix.height == pytest.approx(512.34)
    assert fix.sigma_position == pytest.approx([0.02, 0.02, 0.03])
    assert fix.v_g == pytest.approx([-4.0, 3.0, -0.5])
    assert fix.sigma_velocity == pytest.approx([0.05, 0.05, 0.2])
    assert fix.fix_type == FixType.RTK_FIXED
    assert fix.gps_ns is None


def test_a_multiplexer_value_that_nobody_maps_is_left_alone_and_an_unknown_one_counted() -> None:
    driver = made(GNSS)
    a, b, c = fix_frames(0)
    foreign = c._replace(data=bytes([2]) + c.data[1:])
    assert len(feed(driver, a, b, foreign, c)) == 1
    assert sum(rejects(driver).values()) == 1


def test_invalid_parts_of_a_fix() -> None:
    driver = made(GNSS)
    (fix,) = feed(driver, *fix_frames(0, VelOk=0))
    assert fix.v_g is None
    assert fix.sigma_velocity is None
    assert feed(driver, *fix_frames(1000 * MS, Fix=0), *fix_frames(2000 * MS, Fix=5)) == []
    assert rejects(driver) == {"INVALID": 2}


def test_an_epoch_that_stays_incomplete_is_counted_by_time_and_by_repetition() -> None:
    driver = made(GNSS)
    a, b, _ = fix_frames(0)
    assert feed(driver, a, b) == []
    assert len(feed(driver, *fix_frames(200 * MS))) == 1  # beyond the window of 30 ms
    assert rejects(driver) == {"INCOMPLETE": 1}
    a2, b2, c2 = fix_frames(400 * MS)
    assert len(feed(driver, a2, a2, b2, c2)) == 1  # a second position begins anew
    assert rejects(driver) == {"INCOMPLETE": 2}


def test_a_sigma_of_zero_means_less_than_half_a_step() -> None:
    driver = made(GNSS.replace('sigma_up = "VAcc"', 'sigma_up = { signal = "VAcc", unit = "cm" }'))
    (fix,) = feed(driver, *fix_frames(0, HAcc=0, VAcc=0))
    assert fix.sigma_position == pytest.approx([0.005, 0.005, 0.005])  # the floor, and half of 1 cm


def test_speed_and_course_become_a_velocity() -> None:
    polar = (
        GNSS.replace('vel_east = "VelE"', 'speed = "VelE"')
        .replace('vel_north = "VelN"', 'course = { signal = "VelN", unit = "deg" }')
        .replace('vel_up = "-VelD"', 'sigma_course = { value = 2.0, unit = "deg" }')
    )
    (fix,) = feed(made(polar), *fix_frames(0, VelE=1000, VelN=120))
    assert fix.v_g == pytest.approx([10.0 * math.sin(120 * DEG), 10.0 * math.cos(120 * DEG), 0.0])
    # along the course 5 cm/s; across it 10 m/s times 2 deg and the 5 cm/s
    along, across = 0.05, math.hypot(0.05, 10.0 * 2.0 * DEG)
    s, c = math.sin(120 * DEG), math.cos(120 * DEG)
    expected = [math.hypot(along * s, across * c), math.hypot(along * c, across * s), 0.2]
    assert fix.sigma_velocity == pytest.approx(expected)
