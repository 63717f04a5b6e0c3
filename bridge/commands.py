"""What an operator can ask of the bridge, whichever way it arrives: console, CAN or MAVLink."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple


class CommandCode(IntEnum):
    """Values are those of CODE in the CAN frame COMMAND."""

    START_ALIGNMENT = 1
    STOP = 2  # back to STANDBY: an alignment is aborted
    RESTART = 3  # stop, forget what was estimated, align again


METHODS: Final = {
    "static": 1,
    "motion": 2,
    "analytic": 3,
    "open_loop": 4,
    "kalman_closed": 5,
    "kalman_open": 6,
    "kalman_psi": 7,
    "gyrocompass": 8,
    "rapid_gyrocompass": 9,
    "moving_gyrocompass": 10,
    "inertial": 11,
    "inertial_single": 12,
    "inertial_wahba": 13,
    "odometer": 14,
    "gnss": 15,
    "large_angle": 16,
    "stored": 17,
    "transfer_one_shot": 33,
    "transfer_velocity": 34,
    "transfer_position": 35,
    "transfer_velocity_heading": 36,
    "transfer_velocity_heading_13": 37,
    "transfer_velocity_heading_7": 38,
    "transfer_velocity_attitude": 39,
    "transfer_velocity_rate": 40,
    "transfer_velocity_11": 41,
}
"""Numbers of alignments in a command's argument and in SOL_ALIGN; a number is never given to another one."""

HINTS: Final = {"": 0, "coordinated turn": 1, "S-turn": 2, "wing rock": 3, "heading wiggle": 4}
"""Numbers of the manoeuvres that a transfer alignment asks for, in SOL_TRANSFER."""

CONFIGURED: Final = 0
"""The argument that means the alignment of the configuration."""


class Command(NamedTuple):
    """One request; ``argument`` is the number of an alignment in `METHODS`, or `CONFIGURED`."""

    code: CommandCode
    argument: int = CONFIGURED


class Result(IntEnum):
    """Outcome of a command, numbered as MAVLink's MAV_RESULT."""

    ACCEPTED = 0
    DENIED = 2
    UNSUPPORTED = 3


class Reason(IntEnum):
    """Why a command was refused: REASON in the CAN frame COMMAND_ACK, result_param2 in MAVLink's."""

    NONE = 0
    UNKNOWN_CODE = 1
    UNKNOWN_METHOD = 2
    NO_POSITION = 3
    NO_HEADING = 4
    NO_GNSS = 5
    NO_ODOMETER = 6
    NO_SPEED = 7
    NO_BAROMETER = 8
    NO_MASTER = 9


LACKS: Final = {
    "position": (Reason.NO_POSITION, "a GNSS receiver or a configured position"),
    "heading": (Reason.NO_HEADING, "a stored heading or an attitude in the configuration"),
    "gnss": (Reason.NO_GNSS, "a GNSS receiver"),
    "odometer": (Reason.NO_ODOMETER, "an odometer"),
    "speed": (Reason.NO_SPEED, "a speed"),
    "baro": (Reason.NO_BAROMETER, "a barometer"),
    "master": (Reason.NO_MASTER, "a master navigator"),
}
"""What an alignment may need, by the word for it: why it is refused without, and how that is said."""


class Verdict(NamedTuple):
    """What a command comes to.

    ``methods`` names the alignment that each navigator is to start (None: the configured one); those that
    lack what it needs are not in it, and ``texts`` says so.
    """

    result: Result
    reason: Reason
    methods: dict[str, str | None]
    texts: tuple[str, ...] = ()


def judge(code: int, argument: int, lacking: Mapping[str, Mapping[str, str]]) -> Verdict:
    """Whether a command can be obeyed: what is needed must be there for one navigator at least.

    ``lacking`` says by navigator what each alignment that there is lacks there, a word or nothing.
    """
    if code not in list(CommandCode):
        return Verdict(Result.UNSUPPORTED, Reason.UNKNOWN_CODE, {})
    if code == CommandCode.STOP or argument == CONFIGURED:
        return Verdict(Result.ACCEPTED, Reason.NONE, dict.fromkeys(lacking))
    method = next((name for name, number in METHODS.items() if number == argument), None)
    methods: dict[str, str | None] = {}
    reason, texts = Reason.UNKNOWN_METHOD, []
    for navigator, by_method in lacking.items():
        if method is None or method not in by_method:
            continue
        lack = by_method[method]
        if not lack:
            methods[navigator] = method
            continue
        reason, needs = LACKS[lack]
        texts.append(f"{navigator}: alignment {method} refused: it needs {needs}")
    if reason is Reason.UNKNOWN_METHOD and not methods:
        texts.append(f"command refused: there is no alignment number {argument}")
    if methods:
        return Verdict(Result.ACCEPTED, Reason.NONE, methods, tuple(texts))
    return Verdict(Result.DENIED, reason, methods, tuple(texts))
