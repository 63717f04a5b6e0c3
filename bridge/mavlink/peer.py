"""Our end of one MAVLink link: the protocol machines a ground station expects to be answered by.

Pure, as all behind the recorder: what is answered follows from the recorded packets alone, and the
time in an answer is engine time. Requests for telemetry are passed to the telemetry sink of the link,
which registers itself here.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any, Final, Protocol

from pymavlink.dialects.v20 import common as dialect

from bridge.commands import CONFIGURED, Command, CommandCode, Reason, Verdict, judge
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.mavlink.link import Link
from bridge.mavlink.parameters import Parameters, flatten
from bridge.options import MavlinkSource
from bridge.outputs import Transmit

Answer = Transmit | Command

_BURST: Final = 8  # packets of a long answer sent per step, so that a step stays short
_PENDING_LIMIT: Final = 2000
_NAK, _UNKNOWN_COMMAND = 129, 7  # of the file transfer protocol

_CAPABILITIES: Final = (
    dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)


class Telemetry(Protocol):
    """What the peer asks of the telemetry sink on its link."""

    def build(self, message_id: int) -> Any:
        """A message as it would be sent now; None where it cannot be built."""
        ...

    def offers(self, message_id: int) -> bool:
        """Whether the message is one of those it sends."""
        ...

    def interval_us(self, message_id: int) -> int:
        """Time between two of them; -1 when switched off."""
        ...

    def set_interval(self, message_id: int, interval_us: int) -> None:
        """Change it: -1 switches the message off, 0 restores the configured rate."""
        ...


def _obey(code: int, argument: int) -> Verdict:
    return judge(code, CONFIGURED, {})


class MavlinkPeer:
    """Feeds on recorded frames of its source and on the bridge's own events.

    ``judge`` says whether a command, its code and argument, can be obeyed; by default it knows the codes
    alone. ``unreadable`` counts packets whose checksum or length was wrong, ``utc_minus_engine_ns`` is
    known from the start event on.
    """

    def __init__(
        self,
        source: int,
        options: MavlinkSource,
        config: Mapping[str, Any] | None = None,
        judge: Callable[[int, int], Verdict] = _obey,
    ) -> None:
        self.source = source
        self._judge = judge
        self.link = Link(source, options.system_id, options.component_id)
        self.telemetry: Telemetry | None = None
        self.unreadable = 0
        self.utc_minus_engine_ns: int | None = None
        self._parameters = Parameters(flatten(config or {}))
        self._pending: deque[Any] = deque()
        self._last_command: tuple[int, int, int] | None = None
        self._machines: dict[int, Callable[[Any, int], list[Answer]]] = {
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._command_long,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._command_int,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._parameter,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._parameter,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._parameter,
            dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._mission_list,
            dialect.MAVLINK_MSG_ID_MISSION_COUNT: self._mission_refused,
            dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._mission_cleared,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            dialect.MAVLINK_MSG_ID_PING: self._ping,
            dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._file_transfer,
        }

    def feed(self, frame: RawFrame) -> list[Answer]:
        """What to send, and what is asked of the bridge, after a frame of our source or an event."""
        if frame.source == BRIDGE:
            if frame.key == Event.START:
                self._start(frame.data)
            return [*self.drain()]
        machine = self._machines.get(frame.key)
        if frame.source != self.source or machine is None:
            return [*self.drain()]
        try:
            message = self.link.decode(frame.data)
        except ValueError:
            self.unreadable += 1
            return []
        if not self._is_for_us(message):
            return [*self.drain()]
        return [*machine(message, frame.rx_ns), *self.drain()]

    def drain(self) -> list[Transmit]:
        """The next packets of a long answer."""
        count = min(_BURST, len(self._pending))
        return [self.link.send(self._pending.popleft()) for _ in range(count)]

    def _start(self, body: bytes) -> None:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            event = json.loads(body)
            self.utc_minus_engine_ns = int(event["utc_ns"]) - int(event["monotonic_ns"])

    def _is_for_us(self, message: Any) -> bool:
        us = (self.link.system_id, self.link.component_id)
        if (message.get_srcSystem(), message.get_srcComponent()) == us:
            return False
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, us[0]) and component in (0, us[1])

    def _reply(self, message: Any) -> list[Answer]:
        return [self.link.send(message)]

    # commands

    def _command_long(self, message: Any, rx_ns: int) -> list[Answer]:
        params = tuple(getattr(message, f"param{place}") for place in range(1, 8))
        repeated = (message.get_srcSystem(), message.get_srcComponent(), message.command)
        again = message.confirmation > 0 and repeated == self._last_command
        self._last_command = repeated
        return self._command(message, params, again)

    def _command_int(self, message: Any, rx_ns: int) -> list[Answer]:
        params = (
            *(getattr(message, f"param{place}") for place in range(1, 5)),
            message.x,
            message.y,
            message.z,
        )
        return self._command(message, params, False)

    def _command(self, message: Any, params: tuple[float, ...], again: bool) -> list[Answer]:
        """Act and acknowledge; a retransmission (``again``) is acknowledged without acting twice.

        MAV_CMD_USER_1 carries a `Command`: its code and the number of an alignment are the first two
        parameters. MAV_CMD_PREFLIGHT_CALIBRATION starts the configured alignment, or with all parameters 0
        stops it.
        """
        after: list[Answer] = []
        reason = 0
        numbers = [value if math.isfinite(value) else 0.0 for value in params]
        match message.command:
            case dialect.MAV_CMD_REQUEST_MESSAGE:
                result = self._request_message(int(numbers[0]), after)
            case dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                result = self._request_message(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, after)
            case dialect.MAV_CMD_GET_HOME_POSITION:
                result = self._request_message(dialect.MAVLINK_MSG_ID_HOME_POSITION, after)
            case dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
                result = self._set_interval(int(numbers[0]), numbers[1])
            case dialect.MAV_CMD_GET_MESSAGE_INTERVAL:
                result = self._get_interval(int(numbers[0]), after)
            case dialect.MAV_CMD_PREFLIGHT_CALIBRATION:
                # all zero means: stop calibrating
                code = CommandCode.START_ALIGNMENT if any(numbers) else CommandCode.STOP
                result, reason = self._order(code, CONFIGURED, again, after)
            case dialect.MAV_CMD_USER_1:
                result, reason = self._order(numbers[0], numbers[1], again, after)
            case _:
                result = dialect.MAV_RESULT_UNSUPPORTED
        ack = dialect.MAVLink_command_ack_message(
            message.command,
            result,
            result_param2=reason,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
        )
        return [*self._reply(ack), *after]

    def _order(self, code: float, argument: float, again: bool, after: list[Answer]) -> tuple[int, int]:
        """Result and reason; what is denied for want of something is passed on, so that it is said why."""
        if code not in list(CommandCode):
            # not UNSUPPORTED: that would be the MAVLink command itself
            return int(dialect.MAV_RESULT_DENIED), Reason.UNKNOWN_CODE
        command = Command(CommandCode(int(code)), int(argument))
        verdict = self._judge(*command)
        if not again:
            after.append(command)
        return verdict.result, verdict.reason

    def _request_message(self, message_id: int, after: list[Answer]) -> int:
        if message_id == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            after += self._reply(self._autopilot_version())
            return int(dialect.MAV_RESULT_ACCEPTED)
        if self.telemetry is None or not self.telemetry.offers(message_id):
            return int(dialect.MAV_RESULT_UNSUPPORTED)
        message = self.telemetry.build(message_id)
        if message is None:
            return int(dialect.MAV_RESULT_TEMPORARILY_REJECTED)
        after += self._reply(message)
        return int(dialect.MAV_RESULT_ACCEPTED)

    def _set_interval(self, message_id: int, interval_us: float) -> int:
        if self.telemetry is None or not self.telemetry.offers(message_id):
            return int(dialect.MAV_RESULT_UNSUPPORTED)
        if interval_us < -1.0 or interval_us > 1e9:
            return int(dialect.MAV_RESULT_DENIED)
        self.telemetry.set_interval(message_id, round(interval_us))
        return int(dialect.MAV_RESULT_ACCEPTED)

    def _get_interval(self, message_id: int, after: list[Answer]) -> int:
        # 0 says: not available
        interval_us = 0
        if self.telemetry is not None and self.telemetry.offers(message_id):
            interval_us = self.telemetry.interval_us(message_id)
        after += self._reply(dialect.MAVLink_message_interval_message(message_id & 0xFFFF, interval_us))
        return int(dialect.MAV_RESULT_ACCEPTED)

    def _autopilot_version(self) -> Any:
        none = (0,) * 8
        return dialect.MAVLink_autopilot_version_message(
            _CAPABILITIES, _VERSION, 0, 0, 0, none, none, none, 0, 0, self.link.system_id
        )

    # parameters, missions, the rest

    def _parameter(self, message: Any, rx_ns: int) -> list[Answer]:
        for answer in self._parameters.answer(message):
            if len(self._pending) < _PENDING_LIMIT:
                self._pending.append(answer)
        return []

    def _mission_list(self, message: Any, rx_ns: int) -> list[Answer]:
        asker = message.get_srcSystem(), message.get_srcComponent()
        return self._reply(dialect.MAVLink_mission_count_message(*asker, 0, message.mission_type))

    def _mission_ack(self, message: Any, result: int) -> list[Answer]:
        asker = message.get_srcSystem(), message.get_srcComponent()
        return self._reply(dialect.MAVLink_mission_ack_message(*asker, result, message.mission_type))

    def _mission_refused(self, message: Any, rx_ns: int) -> list[Answer]:
        return self._mission_ack(message, dialect.MAV_MISSION_UNSUPPORTED)

    def _mission_cleared(self, message: Any, rx_ns: int) -> list[Answer]:
        return self._mission_ack(message, dialect.MAV_MISSION_ACCEPTED)

    def _timesync(self, message: Any, rx_ns: int) -> list[Answer]:
        if message.tc1 != 0:
            return []  # an answer, not a question
        return self._reply(dialect.MAVLink_timesync_message(rx_ns, message.ts1))

    def _ping(self, message: Any, rx_ns: int) -> list[Answer]:
        if message.target_system or message.target_component:
            return []  # an answer, not a question
        asker = message.get_srcSystem(), message.get_srcComponent()
        return self._reply(dialect.MAVLink_ping_message(message.time_usec, message.seq, *asker))

    def _file_transfer(self, message: Any, rx_ns: int) -> list[Answer]:
        """Refuse at once, so that a client falls back without waiting for a time-out."""
        request = bytes(message.payload)
        sequence = (int.from_bytes(request[:2], "little") + 1) & 0xFFFF
        reply = bytearray(251)
        reply[0:2] = sequence.to_bytes(2, "little")
        reply[2] = request[2]
        reply[3], reply[4], reply[5], reply[12] = _NAK, 1, request[3], _UNKNOWN_COMMAND
        asker = message.get_srcSystem(), message.get_srcComponent()
        return self._reply(dialect.MAVLink_file_transfer_protocol_message(0, *asker, reply))


def _version() -> int:
    """The package's version as MAVLink packs it: major, minor, patch, type of release."""
    digits = [int("".join(filter(str.isdigit, part)) or 0) for part in version("navbridge").split(".")[:3]]
    major, minor, patch = (*digits, 0, 0, 0)[:3]
    return major << 24 | minor << 16 | patch << 8 | int(dialect.FIRMWARE_VERSION_TYPE_DEV)


_VERSION: Final = _version()
