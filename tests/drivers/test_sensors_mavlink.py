"""MAVLink sensor messages: axes, units, intervals and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from bridge.drivers.sensors_mavlink import MESSAGES, SensorsMavlink, SensorsMavlinkOptions
from bridge.errors import ConfigError
from bridge.frame import RawFrame
from bridge.geoid import undulation
from bridge.strict import convert
from nav.types import BaroSample, FixType, GnssFix, ImuFlag, ImuSample, OdoSample
from tests.drivers.made import context, rejects

G = 9.80665
MS = 1_000_000
ALL = 0x1FFF


def driver(*messages: str, **options: Any) -> SensorsMavlink:
    table = {"driver": "sensors_mavlink", "source": "link", "messages": list(messages), **options}
    return SensorsMavlink(convert(table, SensorsMavlinkOptions, "t.toml"), context("mav"))


def packet(message: Any, rx_ns: int = 0, system: int = 7, component: int = 1) -> RawFrame:
    packer = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    return RawFrame(0, rx_ns, 1, message.id if message.id < 1000 else 0, bytes(message.pack(packer)))


def of(name: str, message: Any, rx_ns: int = 0, **sender: int) -> RawFrame:
    return packet(message, rx_ns, **sender)._replace(key=getattr(dialect, f"MAVLINK_MSG_ID_{name}"))


def highres(k: int, dt_us: int = 10_000, x: float = 1.0, updated: int = ALL, sensor: int = 0) -> RawFrame:
    message = dialect.MAVLink_highres_imu_message(
        1_000_000 + k * dt_us, x, 2.0, -G, 0.1, 0.2, -0.3, 0, 0, 0, 898.745, 0, 0, 20, updated, sensor
    )
    return of("HIGHRES_IMU", message, 10**9 + k * dt_us * 1000)


def test_front_right_down_becomes_right_forward_up() -> None:
    imu = driver("HIGHRES_IMU", rate_hz=100.0)
    samples = [s for k in range(5) for s in imu.feed(highres(k))]
    assert len(samples) == 5
    for s in samples:
        assert isinstance(s, ImuSample)
        np.testing.assert_allclose(s.dv, np.array([2.0, 1.0, G]) * 0.01, rtol=1e-6)
        np.testing.assert_allclose(s.dtheta, np.array([0.2, 0.1, 0.3]) * 0.01, rtol=1e-6)
        assert s.dt == pytest.approx(0.01)
        assert s.flags == ImuFlag.OK
    assert samples[-1].t_ns == 10**9 + 40 * MS


def test_the_actual_interval_counts() -> None:
    imu = driver("HIGHRES_IMU", rate_hz=100.0)
    imu.feed(highres(0, 11_000))
    (sample,) = imu.feed(highres(1, 11_000))
    assert isinstance(sample, ImuSample)
    assert sample.dt == pytest.approx(0.011)
    np.testing.assert_allclose(sample.dv, np.array([2.0, 1.0, G]) * 0.011, rtol=1e-6)


def test_a_ramp_is_integrated_exactly() -> None:
    """Point samples of a linear force: the trapezium is its integral; lost messages do not change that."""
    imu = driver("HIGHRES_IMU", rate_hz=100.0)
    kept = [k for k in range(30) if not 10 <= k < 13]
    samples = [s for k in kept for s in imu.feed(highres(k, x=0.5 * k))]
    assert len(samples) == 30
    forward = sum(s.dv[1] for s in samples[1:])  # type: ignore[union-attr]
    assert forward == pytest.approx(0.5 * 29**2 / 2 * 0.01, rel=1e-6)
    flags = [s.flags for s in samples]  # type: ignore[union-attr]
    assert [k for k, flag in enumerate(flags) if flag == ImuFlag.BRIDGED] == [10, 11, 12]
    assert (imu.counters.missing, imu.counters.bridged) == (3, 3)


def test_a_long_gap_is_flagged() -> None:
    imu = driver("HIGHRES_IMU", rate_hz=100.0)
    samples = [s for k in (0, 1, 2, 30, 31) for s in imu.feed(highres(k))]
    assert [s.flags for s in samples] == [0, 0, 0, ImuFlag.GAP, 0]  # type: ignore[union-attr]


def test_units_of_the_scaled_messages() -> None:
    scaled = dialect.MAVLink_scaled_imu_message(1000, 1000, 500, -1000, 100, 200, -300, 0, 0, 0)
    imu = driver("SCALED_IMU", rate_hz=50.0)
    (sample,) = imu.feed(of("SCALED_IMU", scaled))
    assert isinstance(sample, ImuSample)
    np.testing.assert_allclose(sample.dv, np.array([0.5, 1.0, 1.0]) * G * 0.02)
    np.testing.assert_allclose(sample.dtheta, np.array([0.2, 0.1, 0.3]) * 0.02)
    raw = dialect.MAVLink_raw_imu_message(1_000_000, 100, 50, -100, 10, 20, -30, 0, 0, 0)
    imu = driver("RAW_IMU", rate_hz=50.0, raw_accel_mg_per_count=10.0, raw_gyro_mrad_s_per_count=10.0)
    (sample,) = imu.feed(of("RAW_IMU", raw))
    assert isinstance(sample, ImuSample)
    np.testing.assert_allclose(sample.dv, np.array([0.5, 1.0, 1.0]) * G * 0.02)
    np.testing.assert_allclose(sample.dtheta, np.array([0.2, 0.1, 0.3]) * 0.02)


def test_hil_sensor_brings_its_pressure() -> None:
    imu = driver("HIL_SENSOR", rate_hz=100.0, pressure=True)
    baros = []
    for k in range(50):
        message = dialect.MAVLink_hil_sensor_message(
            1000 + k * 10_000, 0, 0, -G, 0, 0, 0, 0, 0, 0, 898.745, 0, 0, 20, ALL, 0
        )
        samples = imu.feed(of("HIL_SENSOR", message, 10**9 + k * 10 * MS))
        baros += [s for s in samples if isinstance(s, BaroSample)]
    assert len(baros) == 5
    assert baros[0].height == pytest.approx(1000.0, abs=0.2)


LAT, LON = 47.3977, 8.5456


def gps_input(k: int = 0, **changed: Any) -> RawFrame:
    values = {
        "time_usec": 5_000_000 + k * 200_000,
        "gps_id": 0,
        "ignore_flags": 0,
        "time_week_ms": 1000 + 200 * k,
        "time_week": 2300,
        "fix_type": 3,
        "lat": round(LAT * 1e7),
        "lon": round(LON * 1e7),
        "alt": 400.0,
        "hdop": 1.0,
        "vdop": 1.0,
        "vn": 1.0,
        "ve": 2.0,
        "vd": 3.0,
        "speed_accuracy": 0.1,
        "horiz_accuracy": 1.0,
        "vert_accuracy": 2.0,
        "satellites_visible": 12,
        **changed,
    }
    return of("GPS_INPUT", dialect.MAVLink_gps_input_message(**values), 10**9 + k * 200 * MS)


def test_gps_input() -> None:
    gnss = driver("GPS_INPUT")
    (fix,) = gnss.feed(gps_input())
    assert isinstance(fix, GnssFix)
    assert math.degrees(fix.lat) == pytest.approx(LAT, abs=1e-9)
    assert math.degrees(fix.lon) == pytest.approx(LON, abs=1e-9)
    # altitude above the geoid; near Zurich it lies 47 m above the ellipsoid
    assert fix.height == pytest.approx(400.0 + undulation(fix.lat, fix.lon))
    assert 46.0 < fix.height - 400.0 < 49.0
    np.testing.assert_allclose(fix.v_g, [2.0, 1.0, -3.0])  # type: ignore[arg-type]
    np.testing.assert_allclose(fix.sigma_position, [math.sqrt(0.5), math.sqrt(0.5), 2.0])
    np.testing.assert_allclose(fix.sigma_velocity, [0.1] * 3, rtol=1e-6)  # type: ignore[arg-type]
    assert fix.gps_ns == 2300 * 604_800 * 10**9 + 10**9
    assert fix.satellites == 12
    (fix,) = gnss.feed(gps_input(1, ignore_flags=8 | 32 | 64 | 128))
    assert isinstance(fix, GnssFix)
    assert fix.v_g is None
    np.testing.assert_allclose(fix.sigma_position, [2.0, 2.0, 4.0])
    assert gnss.feed(gps_input(2, ignore_flags=1)) == ()
    assert gnss.feed(gps_input(3, fix_type=1)) == ()
    assert gnss.feed(gps_input(4, alt=math.nan)) == ()
    assert gnss.feed(gps_input(5, lat=910_000_000)) == ()
    assert gnss.feed(gps_input(6, vn=math.nan)) == ()
    assert rejects(gnss) == {"INVALID": 2, "RANGE": 3}


def test_a_sender_without_a_clock_is_dated_by_arrival() -> None:
    gnss = driver("GPS_INPUT", latency_ms=50.0)
    fixes = [fix for k in range(5) for fix in gnss.feed(gps_input(k, time_usec=0))]
    assert [fix.t_ns for fix in fixes] == [10**9 + k * 200 * MS - 50 * MS for k in range(5)]


def test_gps_raw_int_has_speed_and_course() -> None:
    message = dialect.MAVLink_gps_raw_int_message(
        1, 5, 470_000_000, 80_000_000, 400_000, 100, 100, 1000, 9000, 9, 447_000, 500, 800, 100, 0
    )
    (fix,) = driver("GPS_RAW_INT").feed(of("GPS_RAW_INT", message))
    assert isinstance(fix, GnssFix)
    assert fix.height == pytest.approx(447.0)
    assert fix.fix_type == FixType.DGPS + 1
    np.testing.assert_allclose(fix.v_g, [10.0, 0.0, 0.0], atol=1e-12)  # type: ignore[arg-type]
    assert fix.sigma_velocity is not None
    assert fix.sigma_velocity[2] == 10.0


def test_hil_gps() -> None:
    message = dialect.MAVLink_hil_gps_message(
        1, 3, 470_000_000, 80_000_000, 400_000, 100, 100, 0, 100, 200, -300, 0, 255
    )
    (fix,) = driver("HIL_GPS").feed(of("HIL_GPS", message))
    assert isinstance(fix, GnssFix)
    np.testing.assert_allclose(fix.v_g, [2.0, 1.0, 3.0])  # type: ignore[arg-type]
    assert fix.satellites is None


def wheel(k: int, *distances: float) -> RawFrame:
    filled = [*distances, *[0.0] * (16 - len(distances))]
    message = dialect.MAVLink_wheel_distance_message(1000 + k * 20_000, len(distances), filled)
    return of("WHEEL_DISTANCE", message, 10**9 + k * 20 * MS)


def test_wheels_are_averaged() -> None:
    odo = driver("WHEEL_DISTANCE", wheels=[0, 1])
    assert odo.feed(wheel(0, 10.0, 20.0)) == ()
    (sample,) = odo.feed(wheel(1, 10.2, 20.4))
    assert isinstance(sample, OdoSample)
    assert sample.distance == pytest.approx(0.3)
    assert sample.dt == pytest.approx(0.02)
    assert odo.feed(wheel(2, 10.3)) == ()
    assert odo.feed(wheel(3, math.nan, 20.0)) == ()
    assert odo.feed(wheel(4, 1000.0, 2000.0)) == ()
    assert rejects(odo) == {"INVALID": 1, "RANGE": 2}


def test_scaled_pressure() -> None:
    baro = driver("SCALED_PRESSURE")
    (sample,) = baro.feed(of("SCALED_PRESSURE", dialect.MAVLink_scaled_pressure_message(5, 1013.25, 0, 0)))
    assert isinstance(sample, BaroSample)
    assert sample.height == pytest.approx(0.0, abs=1e-3)
    assert baro.feed(of("SCALED_PRESSURE", dialect.MAVLink_scaled_pressure_message(6, math.nan, 0, 0))) == ()
    assert rejects(baro) == {"RANGE": 1}


def test_what_is_turned_away() -> None:
    imu = driver("HIGHRES_IMU", rate_hz=100.0, system_id=7)
    assert imu.feed(highres(0, updated=0)) == ()
    assert imu.feed(highres(1, x=math.nan)) == ()
    assert imu.feed(highres(2, x=5000.0)) == ()
    assert imu.feed(highres(3, sensor=2)) == ()
    good = highres(4)
    assert len(imu.feed(good)) == 1
    assert imu.feed(good) == ()  # time stands still
    assert imu.feed(good._replace(data=good.data[:-1] + b"\x00")) == ()
    assert imu.feed(good._replace(data=good.data[:4])) == ()
    assert imu.feed(good._replace(data=b"")) == ()
    other = dialect.MAVLink_heartbeat_message(1, 1, 1, 1, 1, 3)
    assert imu.feed(packet(other)) == ()
    counts = rejects(imu)
    counts_of_bad_packets = counts.pop("CRC") + counts.pop("LENGTH")
    assert counts == {"INVALID": 1, "RANGE": 2, "UNKNOWN": 2, "STALE": 1}
    assert counts_of_bad_packets == 3


@given(st.sampled_from(MESSAGES), st.binary(max_size=300))
@settings(max_examples=100, deadline=None)
def test_garbage_is_counted(name: str, data: bytes) -> None:
    listener = driver(name, rate_hz=100.0)
    assert listener.feed(RawFrame(0, 0, 1, listener.keys[0][1], data)) == ()
    assert sum(rejects(listener).values()) == 1


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"messages": ["HIGHRES_IMUU"], "rate_hz": 1.0}, "HIGHRES_IMU"),
        ({"messages": ["HIGHRES_IMU", "HIL_SENSOR"], "rate_hz": 1.0}, "one of a kind"),
        ({"messages": ["HIGHRES_IMU"]}, "rate_hz"),
        ({"messages": []}, "messages"),
    ],
)
def test_options_that_cannot_be(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        convert(
            {"driver": "sensors_mavlink", "source": "l", **table}, SensorsMavlinkOptions, "t.toml", "device.x"
        )
