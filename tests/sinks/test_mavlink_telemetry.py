"""Telemetry as a ground station reads it: every packet goes through pymavlink's own parser."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import quaternion as pymavlink_quaternion
from pymavlink.dialects.v20 import common as dialect

from bridge.errors import ConfigError
from bridge.geoid import undulation
from bridge.mavlink.ned import LocalFrame, to_ned
from bridge.mavlink.peer import MavlinkPeer
from bridge.options import MavlinkSource
from bridge.outputs import (
    DeviceHealth,
    FixOut,
    Health,
    Innovation,
    ModeChange,
    Output,
    Progress,
    Reject,
    Severity,
    Text,
    Transmit,
)
from bridge.sinks import SINKS, SinkContext
from bridge.sinks.mavlink import DEFAULT_RATES_HZ, MavlinkTelemetry, MavlinkTelemetryOptions
from bridge.strict import convert
from nav import earth, rotation
from nav.types import FixType, GnssFix, Mode, S, Solution
from tests.sinks.made import out, solution, unknown


def telemetry(**rates_hz: float) -> MavlinkTelemetry:
    options = MavlinkTelemetryOptions(type="mavlink", navigator="main", source="gcs", rates_hz=rates_hz)
    source = MavlinkSource(type="mavlink", url="udpout:127.0.0.1:14550", system_id=7, component_id=1)
    made = SINKS["mavlink"].factory(options, SinkContext("telemetry", 2, MavlinkPeer(2, source)))
    assert isinstance(made, MavlinkTelemetry)
    return made


class GroundStation:
    """pymavlink's parser, with a check of the sequence numbers."""

    def __init__(self) -> None:
        self.parser = dialect.MAVLink(None)
        self.sequence = 0

    def read(self, sent: list[Transmit]) -> list[Any]:
        messages = []
        for packet in sent:
            (message,) = self.parser.parse_buffer(bytearray(packet.data))
            assert message.get_seq() == self.sequence
            self.sequence = (self.sequence + 1) % 256
            assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 1)
            assert packet.data[0] == dialect.PROTOCOL_MARKER_V2
            assert (packet.source, packet.key) == (2, message.id)
            messages.append(message)
        return messages


def by_name(messages: list[Any]) -> dict[str, Any]:
    return {message.get_type(): message for message in messages}


def fix(t_ns: int = 4_900_000_000) -> FixOut:
    sigma = np.array([0.3, 0.4, 1.0])
    lat, lon = math.radians(48.14), math.radians(11.58)
    v = np.array([3.0, 4.0, 0.0])
    made = GnssFix(t_ns, lat, lon, 600.0, sigma, v, np.full(3, 0.1), FixType.RTK_FIXED, "gnss", None, 17)
    return FixOut(t_ns, "gnss", made)


def test_everything_is_sent_unasked_with_true_values() -> None:
    sink, station = telemetry(), GroundStation()
    messages = by_name(station.read(sink.consume([fix(), out(solution())])))
    assert set(messages) == set(DEFAULT_RATES_HZ) - {"GPS_GLOBAL_ORIGIN"}

    heartbeat = messages["HEARTBEAT"]
    assert heartbeat.system_status == dialect.MAV_STATE_ACTIVE
    assert heartbeat.custom_mode == 1000 + Mode.NAVIGATE
    assert heartbeat.type == dialect.MAV_TYPE_GROUND_ROVER

    attitude = messages["ATTITUDE"]
    assert attitude.time_boot_ms == 5000
    # single precision: 6e-8 of the value
    assert math.degrees(attitude.roll) == pytest.approx(2.0, abs=1e-6)
    assert math.degrees(attitude.pitch) == pytest.approx(-3.0, abs=1e-6)
    assert math.degrees(attitude.yaw) == pytest.approx(-160.0, abs=1e-5)
    assert (attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed) == pytest.approx((-0.02, 0.01, -0.03))

    position = messages["GLOBAL_POSITION_INT"]
    assert (position.lat, position.lon) == (481400000, 115800000)
    above_geoid = 600.0 - undulation(math.radians(48.14), math.radians(11.58))
    assert position.alt == pytest.approx(1e3 * above_geoid, abs=0.51)
    assert position.alt == pytest.approx(1e3 * (600.0 - 45.48), abs=20.0)  # EGM96 near Munich
    assert (position.vx, position.vy, position.vz) == (400, 300, 50)
    assert (position.relative_alt, position.hdg) == (0, 20000)

    gps = messages["GPS_RAW_INT"]
    assert (gps.fix_type, gps.satellites_visible, gps.vel, gps.cog) == (6, 17, 500, 3687)
    assert (gps.alt_ellipsoid, gps.h_acc, gps.v_acc) == (600_000, 500, 1000)

    assert messages["LOCAL_POSITION_NED"].x == 0.0
    assert messages["LOCAL_POSITION_NED"].vx == 4.0
    assert messages["ESTIMATOR_STATUS"].pos_horiz_accuracy == pytest.approx(math.hypot(0.4, 0.5))
    assert messages["ESTIMATOR_STATUS"].flags & dialect.ESTIMATOR_POS_HORIZ_ABS
    assert messages["HOME_POSITION"].altitude == position.alt


@given(roll=st.floats(-179.0, 179.0), pitch=st.floats(-89.0, 89.0), heading=st.floats(0.0, 359.9))
def test_quaternion_and_angles_agree_with_pymavlinks_own_conversion(
    roll: float, pitch: float, heading: float
) -> None:
    ned = to_ned(solution(roll_deg=roll, pitch_deg=pitch, heading_deg=heading))
    expected = pymavlink_quaternion.QuaternionBase([math.radians(a) for a in (roll, pitch, heading)]).q
    # the two signs of a quaternion are one rotation; to_ned chooses the one with w >= 0
    agreement = abs(float(np.dot(expected, ned.q)))
    assert agreement == pytest.approx(1.0, abs=1e-12)
    assert ned.q[0] >= 0.0
    assert (ned.roll, ned.pitch) == pytest.approx((math.radians(roll), math.radians(pitch)), abs=1e-9)
    assert math.cos(ned.yaw - math.radians(heading)) == pytest.approx(1.0, abs=1e-12)


def test_odometry_is_the_same_motion_in_body_axes() -> None:
    sink = telemetry()
    message = by_name(GroundStation().read(sink.consume([out(solution())])))["ODOMETRY"]
    q = pymavlink_quaternion.QuaternionBase(list(message.q))
    v_ned = np.array(q.dcm) @ np.array([message.vx, message.vy, message.vz])
    assert v_ned == pytest.approx([4.0, 3.0, 0.5], abs=1e-5)
    pose = message.pose_covariance
    assert [pose[k] for k in (0, 6, 11)] == pytest.approx([0.25, 0.16, 0.81])
    assert pose[20] == pytest.approx(math.radians(0.2) ** 2)
    velocity = message.velocity_covariance
    # the trace does not depend on the axes
    assert velocity[0] + velocity[6] + velocity[11] == pytest.approx(0.02**2 + 0.03**2 + 0.04**2)


def test_local_frame_against_a_meridian_arc_and_a_plumb_line() -> None:
    lat = math.radians(45.0)
    frame = LocalFrame(lat, 0.1, 100.0)
    assert frame.position(lat, 0.1, 130.0) == pytest.approx((0.0, 0.0, -30.0), abs=1e-8)
    # 1e-5 rad of latitude at 45 degrees: M = 6367381.8 m there (+ height), and the arc falls away by d^2 / 2R
    north, east, down = frame.position(lat + 1e-5, 0.1, 100.0)
    assert north == pytest.approx(1e-5 * (6367381.816 + 100.0), abs=1e-5)
    assert east == pytest.approx(0.0, abs=1e-8)
    assert down == pytest.approx(north**2 / 2.0 / 6.3675e6, rel=1e-3)


def over_the_pole(seconds: float) -> Solution:
    """200 m/s level, nose ahead, 20 mm past the pole at 0 s, from Greenwich to the date line."""
    r_e = np.array([-200.0 * seconds, 0.02, earth.SEMI_MINOR + 3000.0])
    lat, lon, height = earth.xyz_to_geodetic(*r_e)
    C_ge = earth.position_matrix(lat, lon).T
    s = solution(
        round((seconds + 100.0) * 1e9), lat_deg=math.degrees(lat), lon_deg=math.degrees(lon), height=height
    )
    s.state[S.V] = C_ge @ [-200.0, 0.0, 0.0]
    # right, forward, up along y, -x, z of e
    s.state[S.Q] = rotation.quat_from_dcm(
        C_ge @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    )
    return s


def test_over_the_pole_every_message_is_valid_and_the_local_frame_stands_still() -> None:
    sink = telemetry(**dict.fromkeys(("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ODOMETRY"), 100.0))
    station = GroundStation()
    yaws, headings = [], []
    for tick in range(-100, 101):
        s = over_the_pole(0.02 * tick)
        messages = by_name(station.read(sink.consume([out(s)])))
        place = messages["GLOBAL_POSITION_INT"]
        assert abs(place.lat) <= 900_000_000
        assert abs(place.lon) <= 1_800_000_000
        assert place.hdg < 36_000
        headings.append(place.hdg)
        there = earth.ecef(math.radians(place.lat * 1e-7), math.radians(place.lon * 1e-7), s.height)
        # 1e-7 deg is 11 mm
        assert np.linalg.norm(there - earth.ecef(s.lat, s.lon, s.height)) < 0.01
        # the speed fits 16 bits of centimetres, and is the same whatever the axes are called
        assert math.hypot(place.vx, place.vy) == pytest.approx(20_000, abs=2)
        local, odometry = messages["LOCAL_POSITION_NED"], messages["ODOMETRY"]
        # the origin is 400 m before the pole: north there is ahead, and 0.02 m in 400 m to the left
        passed = 0.02 * tick + 2.0
        assert (local.x, local.y) == pytest.approx((200.0 * passed, 0.01 * passed), abs=1e-4)
        # level there falls away from the level of the pole by 400 m / 6.4e6 m
        assert (local.vx, local.vy) == pytest.approx((200.0, 0.01), abs=1e-4)
        assert local.vz == pytest.approx(200.0 * 6.3e-5, abs=1e-3)
        yaws.append(math.remainder(2.0 * math.atan2(odometry.q[3], odometry.q[0]), 2.0 * math.pi))
        assert (odometry.vx, odometry.vy) == pytest.approx((200.0, 0.0), abs=1e-4)
    assert yaws == pytest.approx(np.full(201, 5e-5), abs=1e-6)
    assert max(headings) - min(headings) > 17_000


def test_rates_are_kept() -> None:
    sink, station = telemetry(ATTITUDE=25.0), GroundStation()
    count: dict[str, int] = {}
    for tick in range(1000):  # ten seconds of a 100 Hz navigator
        for message in station.read(sink.consume([fix(), out(solution(10_000_000_000 + tick * 10_000_000))])):
            count[message.get_type()] = count.get(message.get_type(), 0) + 1
    expected = {**DEFAULT_RATES_HZ, "ATTITUDE": 25.0}
    for name, rate in expected.items():
        assert abs(count.get(name, 0) - 10.0 * rate) <= 1.0, name


def test_while_nothing_is_known_only_the_system_speaks() -> None:
    sink, station = telemetry(), GroundStation()
    change = ModeChange(1_000_000_000, "main", Mode.STANDBY, Mode.ALIGN, "started")
    outputs: list[Output] = [change, out(unknown(1_100_000_000))]
    messages = by_name(station.read(sink.consume(outputs)))
    assert messages["HEARTBEAT"].system_status == dialect.MAV_STATE_CALIBRATING
    assert set(messages) == {"HEARTBEAT", "SYS_STATUS", "SYSTEM_TIME", "ESTIMATOR_STATUS", "STATUSTEXT"}
    assert messages["STATUSTEXT"].text == "ALIGN: started"


def test_an_alignment_is_told_once_a_second() -> None:
    made, station = telemetry(HEARTBEAT=0.0, SYSTEM_TIME=0.0, SYS_STATUS=0.0), GroundStation()
    sigma, limit = (1e-3, 2e-3, math.nan), (1e-4, 1e-4, math.radians(0.5))
    told = [
        station.read(made.consume([Progress(t, "main", "alignment", 0.25, sigma, "static", limit)]))
        for t in range(0, 2_000_000_000, 100_000_000)
    ]
    (first, second) = (messages for messages in told if messages)
    assert first[0].text == "alignment static 25 %"
    values = {message.name: message.value for message in first[1:]}
    # a sigma that is not known is not told
    assert values == pytest.approx({"AlignPct": 25.0, "AlignSigL": math.degrees(2e-3), "AlignLimH": 0.5})
    assert len(second) == 3


def test_long_texts_come_in_chunks() -> None:
    text = "a device named imu sends nothing since 2.5 s; the navigator goes on without it until it returns"
    sent = telemetry().consume([Text(1_000_000_000, Severity.WARNING, text)])
    messages = [m for m in GroundStation().read(sent) if m.get_type() == "STATUSTEXT"]
    assert "".join(m.text for m in messages) == text
    assert [m.chunk_seq for m in messages] == [0, 1]
    assert len({m.id for m in messages}) == 1
    assert messages[0].id != 0


def test_a_flood_of_texts_leaves_the_link_free() -> None:
    sink, station = telemetry(), GroundStation()
    flood: list[Output] = [Text(1_000_000_000, Severity.NOTICE, f"again {count}") for count in range(100)]
    sent = [m for m in station.read(sink.consume(flood)) if m.get_type() == "STATUSTEXT"]
    assert [m.text for m in sent] == [f"again {count}" for count in range(5)]
    later = station.read(sink.consume([Text(2_000_000_000, Severity.NOTICE, "quiet")]))
    assert "(95 messages left out) quiet" in [m.text for m in later if m.get_type() == "STATUSTEXT"]


def test_health_and_innovations_are_shown() -> None:
    sink = telemetry()
    rejects = {Reject.CRC: 3, Reject.GATE: 2, Reject.STALE: 1}
    outputs: list[Output] = [
        Health(4_000_000_000, {"imu": DeviceHealth(frames=90, missing=4, rejects=rejects)}, 0, 10, 0),
        Innovation(4_500_000_000, "main", "gnss_position", (0.3, 0.0, 3.0), (0.1, 0.1, 0.5), 1.0, True),
        out(solution()),
    ]
    messages = by_name(GroundStation().read(sink.consume(outputs)))
    status = messages["SYS_STATUS"]
    assert (status.errors_count1, status.errors_count2, status.errors_count3, status.errors_count4) == (
        3,
        2,
        1,
        4,
    )
    assert status.drop_rate_comm == 1000  # 10 of 100, in 0.01 %
    assert status.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_AHRS
    assert messages["ESTIMATOR_STATUS"].pos_horiz_ratio == pytest.approx(1.0)
    assert messages["ESTIMATOR_STATUS"].pos_vert_ratio == pytest.approx(2.0)


def test_unknown_message_in_the_configuration_is_named() -> None:
    table = {"type": "mavlink", "navigator": "main", "source": "gcs", "rates_hz": {"ATITUDE": 1.0}}
    with pytest.raises(ConfigError, match="ATITUDE"):
        convert(table, MavlinkTelemetryOptions, "demo.toml", "sink.telemetry")
