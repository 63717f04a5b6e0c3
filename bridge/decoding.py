"""Raw frames as named values for people: CAN by the DBC files of a capture, MAVLink by its dialect.

Nothing here is on the path to a solution. What cannot be decoded is left out, never guessed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import cantools.database
from cantools.database.can import Database, Message
from cantools.database.errors import Error as CantoolsError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.config import Config
from bridge.frame import CAN_EFF, CAN_ERR, CAN_RTR, RawFrame
from bridge.options import MavlinkSource
from bridge.wire import DBC_ATTACHMENT
from dbc.codec import MessageCodec, contract

_CAN_ID: Final = 0x1FFF_FFFF


class FrameDecoder:
    """Names and values of the frames of one capture.

    The wire contract of ``config`` (without one: the packaged) comes first, with the identifiers shifted
    as its devices and sinks have it; then every other DBC file among ``attachments``.
    """

    def __init__(self, attachments: Mapping[str, bytes], config: Config | None) -> None:
        self._messages = config.contract if config else contract()
        self._contract: dict[tuple[int, int], MessageCodec] = {}
        self._foreign: dict[int, Message] = {}
        self._mavlink: set[int] = set()
        self._numbers: dict[str, int] = {}
        for name, data in attachments.items():
            if name.endswith(".dbc") and name != DBC_ATTACHMENT:
                self._add_dbc(data)
        for number, (name, options) in enumerate(config.sources.items() if config else (), start=1):
            self._numbers[name] = number
            if isinstance(options, MavlinkSource):
                self._mavlink.add(number)
        for users in (config.devices, config.sinks) if config else ():
            for user in users.values():
                self._shift(self._numbers[user.source], getattr(user, "id_offset", None))

    def label(self, source: int, key: int) -> str:
        """Name of the message, or "" where nobody knows it."""
        if source in self._mavlink:
            kind = dialect.mavlink_map.get(key)
            return str(kind.msgname) if kind else ""
        if key & CAN_ERR:
            return "error frame"
        codec = self._codec(source, key)
        if codec is not None:
            return codec.name
        message = self._foreign.get(key)
        return str(message.name) if message else ""

    def key_text(self, source: int, key: int) -> str:
        """The key as people write it: hexadecimal for CAN, decimal for MAVLink."""
        if source in self._mavlink:
            return str(key)
        digits = 8 if key & CAN_EFF else 3
        remote = " remote" if key & CAN_RTR else ""
        return f"{key & _CAN_ID:0{digits}X}{remote}"

    def decode(self, frame: RawFrame) -> tuple[str, dict[str, Any]] | None:
        """Message name and values by signal; None where it is not known or does not fit."""
        if frame.source in self._mavlink:
            return _mavlink_values(frame.data)
        codec = self._codec(frame.source, frame.key)
        if codec is not None:
            if not codec.crc_ok(frame.data):
                return None
            return codec.name, dict(zip(codec.signals, codec.decode(frame.data), strict=True))
        message = self._foreign.get(frame.key)
        if message is None:
            return None
        try:
            values = message.decode(frame.data, decode_choices=True, allow_truncated=False)
        except (CantoolsError, ValueError):
            return None
        if not isinstance(values, dict):
            return None
        return str(message.name), {name: _plain(value) for name, value in values.items()}

    def units(self, name: str) -> dict[str, str]:
        """Units of a message's signals, by signal."""
        if name in self._messages:
            return {signal.name: signal.unit for signal in self._messages[name].info}
        for message in self._foreign.values():
            if message.name == name:
                return {signal.name: signal.unit or "" for signal in message.signals}
        return {}

    def _codec(self, source: int, key: int) -> MessageCodec | None:
        return self._contract.get((source, key)) or (
            None if key in self._foreign else self._messages.by_id.get(key)
        )

    def _shift(self, number: int, id_offset: int | None) -> None:
        if id_offset:
            for codec in self._messages.values():
                self._contract[number, codec.frame_id + id_offset] = codec

    def _add_dbc(self, data: bytes) -> None:
        try:
            database = cantools.database.load_string(data.decode("cp1252"), "dbc", strict=False)
        except (CantoolsError, ValueError):
            return
        if isinstance(database, Database):
            for message in database.messages:
                self._foreign[message.frame_id | (CAN_EFF if message.is_extended_frame else 0)] = message


def _mavlink_values(data: bytes) -> tuple[str, dict[str, Any]] | None:
    try:
        message = dialect.MAVLink(None).decode(bytearray(data))
    except (dialect.MAVError, ValueError, KeyError):
        return None
    return str(message.get_type()), {
        name: _plain(getattr(message, name)) for name in message.get_fieldnames()
    }


def _plain(value: Any) -> Any:
    """A value that JSON can hold; what is not a number becomes null."""
    if isinstance(value, bool | int | str) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value)
