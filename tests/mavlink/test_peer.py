"""The protocol machines, spoken to as a ground station does; every answer is read by pymavlink."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from bridge.commands import Command, CommandCode
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.mavlink.parameters import flatten
from bridge.mavlink.peer import MavlinkPeer
from bridge.options import MavlinkSource
from bridge.outputs import Transmit
from bridge.sinks import SinkContext
from bridge.sinks.mavlink import MavlinkTelemetry, MavlinkTelemetryOptions
from tests.sinks.made import out, solution

CONFIG = {
    "source": {"gcs": {"type": "mavlink", "system_id": 7}},
    "device": {"imu": {"driver": "imu_can", "rate_hz": 200.0}},
    "navigator": {
        "main": {
            "non_holonomic": True,
            "gnss_lever_arm_m": [0.5, -1.0, 2.0],
            "imu_errors": {"gyro_bias_deg_per_h": 0.25, "gyro_random_walk_deg_per_sqrt_h": 0.01},
        }
    },
}


class Bench:
    """A ground station, a peer and its telemetry sink."""

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        source = MavlinkSource(type="mavlink", url="udpout:127.0.0.1:14550", system_id=7, component_id=1)
        self.peer = MavlinkPeer(2, source, CONFIG if config is None else config)
        options = MavlinkTelemetryOptions(type="mavlink", navigator="main", source="gcs")
        self.sink = MavlinkTelemetry(options, SinkContext("telemetry", 2, self.peer))
        self.station = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.seq = 0

    def frame(self, message: Any) -> RawFrame:
        self.seq += 1
        data = bytes(message.pack(self.station))
        return RawFrame(self.seq, 1_000_000_000 + self.seq, 2, message.id, data)

    def ask(self, message: Any) -> tuple[list[Any], list[Command]]:
        """Messages and commands in answer to ``message``."""
        packets, commands = [], []
        for answer in self.peer.feed(self.frame(message)):
            if isinstance(answer, Transmit):
                packets.append(answer)
            else:
                commands.append(answer)
        return self.read(packets), commands

    def read(self, packets: list[Transmit]) -> list[Any]:
        parser = dialect.MAVLink(None)
        return [parser.parse_char(packet.data) for packet in packets]

    def command(self, command: int, *params: float, confirmation: int = 0) -> tuple[list[Any], list[Command]]:
        padded = (*params, *(0.0,) * 7)[:7]
        return self.ask(dialect.MAVLink_command_long_message(7, 1, command, confirmation, *padded))


def acknowledged(messages: list[Any], command: int) -> int:
    ack = messages[0]
    assert ack.get_type() == "COMMAND_ACK"
    assert (ack.command, ack.target_system, ack.target_component) == (command, 255, 190)
    return int(ack.result)


def test_version_is_told_on_request() -> None:
    bench = Bench()
    for command, param in (
        (dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)),
        (dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0),
    ):
        messages, _ = bench.command(command, param)
        assert acknowledged(messages, command) == dialect.MAV_RESULT_ACCEPTED
        assert messages[1].get_type() == "AUTOPILOT_VERSION"
        assert messages[1].capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        assert messages[1].flight_sw_version >> 24 == 0


def test_telemetry_on_request_once_there_is_some() -> None:
    bench = Bench()
    request = dialect.MAV_CMD_REQUEST_MESSAGE
    messages, _ = bench.command(request, dialect.MAVLINK_MSG_ID_ATTITUDE)
    assert acknowledged(messages, request) == dialect.MAV_RESULT_TEMPORARILY_REJECTED
    bench.sink.consume([out(solution())])
    messages, _ = bench.command(request, dialect.MAVLINK_MSG_ID_ATTITUDE)
    assert acknowledged(messages, request) == dialect.MAV_RESULT_ACCEPTED
    assert messages[1].get_type() == "ATTITUDE"
    messages, _ = bench.command(dialect.MAV_CMD_GET_HOME_POSITION)
    assert messages[1].get_type() == "HOME_POSITION"
    messages, _ = bench.command(request, dialect.MAVLINK_MSG_ID_WIND_COV)
    assert acknowledged(messages, request) == dialect.MAV_RESULT_UNSUPPORTED


def test_message_intervals_are_changed_asked_for_and_restored() -> None:
    bench = Bench()
    attitude, set_to = dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAV_CMD_SET_MESSAGE_INTERVAL

    def interval() -> int:
        messages, _ = bench.command(dialect.MAV_CMD_GET_MESSAGE_INTERVAL, attitude)
        assert messages[1].message_id == attitude
        return int(messages[1].interval_us)

    def sent_in_a_second(start_ns: int) -> int:
        packets = []
        for tick in range(100):
            packets += bench.sink.consume([out(solution(start_ns + tick * 10_000_000))])
        return sum(packet.key == attitude for packet in packets)

    assert interval() == 50_000
    assert acknowledged(bench.command(set_to, attitude, 200_000.0)[0], set_to) == dialect.MAV_RESULT_ACCEPTED
    assert interval() == 200_000
    assert sent_in_a_second(10_000_000_000) in (5, 6)
    bench.command(set_to, attitude, -1.0)
    assert interval() == -1
    assert sent_in_a_second(20_000_000_000) == 0
    bench.command(set_to, attitude, 0.0)
    assert interval() == 50_000
    messages, _ = bench.command(set_to, dialect.MAVLINK_MSG_ID_WIND_COV, 1e6)
    assert acknowledged(messages, set_to) == dialect.MAV_RESULT_UNSUPPORTED


def test_alignment_is_started_and_stopped_by_the_calibration_command() -> None:
    bench = Bench()
    calibrate = dialect.MAV_CMD_PREFLIGHT_CALIBRATION
    messages, commands = bench.command(calibrate, 1.0)
    assert acknowledged(messages, calibrate) == dialect.MAV_RESULT_ACCEPTED
    assert commands == [Command(CommandCode.START_ALIGNMENT)]
    # the same again with a confirmation count is a retransmission: answered, not obeyed twice
    messages, commands = bench.command(calibrate, 1.0, confirmation=1)
    assert acknowledged(messages, calibrate) == dialect.MAV_RESULT_ACCEPTED
    assert commands == []
    assert bench.command(calibrate)[1] == [Command(CommandCode.STOP)]


@pytest.mark.parametrize("code", list(CommandCode))
def test_user_command_carries_every_code(code: CommandCode) -> None:
    messages, commands = Bench().command(dialect.MAV_CMD_USER_1, float(code), 5.0)
    assert acknowledged(messages, dialect.MAV_CMD_USER_1) == dialect.MAV_RESULT_ACCEPTED
    assert commands == [Command(code, 5)]


def test_other_commands_are_refused_not_ignored() -> None:
    bench = Bench()
    arm = dialect.MAV_CMD_COMPONENT_ARM_DISARM
    messages, commands = bench.command(arm, 1.0)
    assert acknowledged(messages, arm) == dialect.MAV_RESULT_UNSUPPORTED
    assert commands == []
    assert acknowledged(bench.command(dialect.MAV_CMD_USER_1, 99.0)[0], dialect.MAV_CMD_USER_1) == (
        dialect.MAV_RESULT_DENIED
    )


def test_command_int_is_understood() -> None:
    user = dialect.MAV_CMD_USER_1
    message = dialect.MAVLink_command_int_message(7, 1, 0, user, 0, 0, 2.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    messages, commands = Bench().ask(message)
    assert acknowledged(messages, user) == dialect.MAV_RESULT_ACCEPTED
    assert commands == [Command(CommandCode.STOP)]


def test_messages_for_others_and_our_own_echo_are_left_alone() -> None:
    bench = Bench()
    other = dialect.MAVLink_command_long_message(8, 1, dialect.MAV_CMD_USER_1, 0, 1.0, *(0.0,) * 6)
    assert bench.ask(other) == ([], [])
    bench.station = dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    assert bench.command(dialect.MAV_CMD_USER_1, 1.0) == ([], [])


def test_parameters_are_the_numbers_of_the_configuration_and_read_only() -> None:
    bench = Bench()
    received = bench.ask(dialect.MAVLink_param_request_list_message(7, 1))[0]
    while more := bench.read(bench.sink.consume([])):
        received += more
    values = {message.param_id: message.param_value for message in received}
    assert len(values) == len(received) == received[0].param_count == 8
    assert [message.param_index for message in received] == list(range(8))
    assert values["DEV_IMU_RATE_HZ"] == 200.0
    assert sorted(values.values()) == pytest.approx([-1.0, 0.01, 0.25, 0.5, 1.0, 2.0, 7.0, 200.0])

    name = b"DEV_IMU_RATE_HZ"
    refused = dialect.MAVLink_param_set_message(7, 1, name, 100.0, dialect.MAV_PARAM_TYPE_REAL32)
    for question in (
        refused,
        dialect.MAVLink_param_request_read_message(7, 1, name, -1),
        dialect.MAVLink_param_request_read_message(7, 1, b"", 1),
    ):
        ((answer,), _) = bench.ask(question)
        assert (answer.param_id, answer.param_value, answer.param_index) == ("DEV_IMU_RATE_HZ", 200.0, 1)
    assert bench.ask(dialect.MAVLink_param_request_read_message(7, 1, b"NOT_THERE", -1)) == ([], [])


@given(
    st.recursive(
        st.floats(allow_nan=False) | st.integers(-10, 10) | st.text(max_size=3),
        lambda inner: st.dictionaries(st.text("abc_xyz", min_size=1, max_size=20), inner, max_size=6),
        max_leaves=30,
    ).map(lambda value: {"navigator": value})
)
def test_parameter_names_are_unique_and_fit(config: dict[str, Any]) -> None:
    def count(value: object) -> int:
        return sum(map(count, value.values())) if isinstance(value, dict) else isinstance(value, int | float)

    names = flatten(config)
    assert len(names) == count(config)
    assert all(1 <= len(name) <= 16 for name in names)
    assert flatten(config) == names


def test_mission_protocol_says_there_is_none() -> None:
    bench = Bench()
    ((answer,), _) = bench.ask(dialect.MAVLink_mission_request_list_message(7, 1, 1))
    assert (answer.get_type(), answer.count, answer.mission_type) == ("MISSION_COUNT", 0, 1)
    assert (answer.target_system, answer.target_component) == (255, 190)
    ((answer,), _) = bench.ask(dialect.MAVLink_mission_count_message(7, 1, 3))
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", dialect.MAV_MISSION_UNSUPPORTED)
    ((answer,), _) = bench.ask(dialect.MAVLink_mission_clear_all_message(7, 1))
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", dialect.MAV_MISSION_ACCEPTED)


def test_time_and_ping_are_answered_with_recorded_time() -> None:
    bench = Bench()
    ((answer,), _) = bench.ask(dialect.MAVLink_timesync_message(0, 123456789))
    assert (answer.tc1, answer.ts1) == (1_000_000_000 + bench.seq, 123456789)
    assert bench.ask(dialect.MAVLink_timesync_message(5, 6)) == ([], [])
    ((answer,), _) = bench.ask(dialect.MAVLink_ping_message(42, 9, 0, 0))
    assert (answer.get_type(), answer.time_usec, answer.seq) == ("PING", 42, 9)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert bench.ask(dialect.MAVLink_ping_message(42, 9, 7, 1)) == ([], [])


def test_file_transfer_is_refused_at_once() -> None:
    payload = bytearray(251)
    payload[0:2] = (17).to_bytes(2, "little")
    payload[2], payload[3] = 4, 3  # session, list directory
    ((answer,), _) = Bench().ask(dialect.MAVLink_file_transfer_protocol_message(0, 7, 1, payload))
    reply = bytes(answer.payload)
    assert int.from_bytes(reply[:2], "little") == 18
    assert (reply[2], reply[3], reply[4], reply[5], reply[12]) == (4, 129, 1, 3, 7)


def test_utc_comes_from_the_start_event() -> None:
    bench = Bench()
    body = json.dumps({"utc_ns": 1_700_000_000_000_000_000, "monotonic_ns": 4_000_000_000}).encode()
    assert bench.peer.feed(RawFrame(0, 4_000_000_000, BRIDGE, Event.START, body)) == []
    messages = bench.read(bench.sink.consume([out(solution(5_000_000_000), late_ns=0)]))
    (time,) = [message for message in messages if message.get_type() == "SYSTEM_TIME"]
    assert time.time_unix_usec == 1_700_000_001_000_000
    assert time.time_boot_ms == 5000


@pytest.mark.parametrize("body", [b"", b"{}", b"[1]", b'{"utc_ns": null, "monotonic_ns": 1}'])
def test_a_damaged_start_event_leaves_utc_unknown(body: bytes) -> None:
    bench = Bench()
    assert bench.peer.feed(RawFrame(0, 0, BRIDGE, Event.START, body)) == []
    assert bench.peer.utc_minus_engine_ns is None


@given(data=st.binary(max_size=60), key=st.sampled_from([20, 21, 23, 43, 44, 76, 75, 110, 111, 4, 30]))
def test_damaged_packets_are_counted(data: bytes, key: int) -> None:
    bench = Bench()
    assert bench.peer.feed(RawFrame(0, 0, 2, key, data)) == []
    assert bench.peer.unreadable == (key != 30)  # 30 is nobody's question


def test_a_flipped_bit_is_counted() -> None:
    bench = Bench()
    frame = bench.frame(dialect.MAVLink_param_request_list_message(7, 1))
    damaged = bytearray(frame.data)
    damaged[10] ^= 1
    assert bench.peer.feed(frame._replace(data=bytes(damaged))) == []
    assert bench.peer.unreadable == 1


def test_equal_input_gives_equal_bytes() -> None:
    def run() -> list[bytes]:
        bench = Bench()
        sent = list(bench.sink.consume([out(solution())]))
        for answer in bench.peer.feed(bench.frame(dialect.MAVLink_param_request_list_message(7, 1))):
            assert isinstance(answer, Transmit)
            sent.append(answer)
        return [packet.data for packet in sent]

    assert run() == run()
    # one sequence over telemetry and answers
    assert [data[4] for data in run()] == list(range(len(run())))
