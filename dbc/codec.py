"""The codec of the wire contract: frames to physical values and back, with their protection.

The DBC file is the definition; `cantools` reads it once and a compiled bit layout does the work per
frame. A contract is stricter than DBC in general: every message is little-endian, not multiplexed,
integer coded, and protected by one of the profiles of `dbc.e2e` (attributes ``E2EProfile`` and
``E2EDataId``; signals ``CRC`` and ``ALIVE``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final, NamedTuple

import bitstruct.c
import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from dbc import e2e

CRC: Final = "CRC"
ALIVE: Final = "ALIVE"

Value = int | float


class _Profile(NamedTuple):
    crc_bits: int
    alive_at: int
    alive_bits: int
    modulus: int
    protect: Callable[[bytearray, int], None]
    check: Callable[[bytes, int], bool]


_PROFILES: Final = {
    "P01": _Profile(8, 8, 4, e2e.P01_ALIVE_MODULUS, e2e.protect_p01, e2e.check_p01),
    "P05": _Profile(16, 16, 8, e2e.P05_ALIVE_MODULUS, e2e.protect_p05, e2e.check_p05),
}


class SignalInfo(NamedTuple):
    """One signal: physical = raw * factor + offset, allowed from ``minimum`` to ``maximum``."""

    name: str
    start: int
    bits: int
    signed: bool
    factor: Value
    offset: Value
    minimum: Value
    maximum: Value
    unit: str


class MessageCodec:
    """Encodes and decodes one message of a contract.

    ``name``, ``frame_id``, ``length`` (bytes), ``is_fd``, ``cycle_ms`` (None: on request),
    ``data_id``, ``alive_modulus``. ``signals`` are the names without CRC and ALIVE in the order of
    their place in the frame, and `info` describes each.
    """

    __slots__ = (
        "_alive_byte",
        "_alive_mask",
        "_check",
        "_encode_plan",
        "_limits",
        "_pack",
        "_protect",
        "_scale",
        "_unpack",
        "alive_modulus",
        "cycle_ms",
        "data_id",
        "frame_id",
        "info",
        "is_fd",
        "length",
        "name",
        "signals",
    )

    def __init__(self, message: Message) -> None:
        """Compile ``message``; raises ValueError when it breaks the rules of a contract."""
        self.name: str = message.name
        self.frame_id: int = message.frame_id
        self.length: int = message.length
        self.is_fd: bool = message.is_fd
        self.cycle_ms: int | None = message.cycle_time
        profile, self.data_id = _protection(message)
        self.alive_modulus: int = profile.modulus
        self._alive_byte = profile.alive_at // 8
        self._alive_mask = (1 << profile.alive_bits) - 1
        self._protect = profile.protect
        self._check = profile.check

        signals = sorted(message.signals, key=lambda s: s.start)
        _require_layout(message, signals, profile)
        self.info: tuple[SignalInfo, ...] = tuple(_info(s) for s in signals if s.name not in (CRC, ALIVE))
        self.signals: tuple[str, ...] = tuple(s.name for s in self.info)

        # The bit layout is compiled for the frame read backwards, where little-endian signals are
        # contiguous and the last signal comes first.
        unpack = bitstruct.c.compile(_layout(self.length, self.info)).unpack
        self._unpack: Callable[[bytes], tuple[int, ...]] = unpack
        alive = SignalInfo(ALIVE, profile.alive_at, profile.alive_bits, False, 1, 0, 0, 0, "")
        packed = (alive, *self.info)
        self._pack: Callable[..., bytes] = bitstruct.c.compile(_layout(self.length, packed)).pack

        # only those whose physical value is another number than the raw one
        self._scale: tuple[tuple[int, Value, Value], ...] = tuple(
            (place, s.factor, s.offset)
            for place, s in enumerate(self.info)
            if (s.factor, s.offset) != (1, 0) or float in (type(s.factor), type(s.offset))
        )
        # last signal first, as they are packed
        self._encode_plan: tuple[tuple[Value, Value, int, int], ...] = tuple(
            (s.factor, s.offset, _raw(s, s.minimum), _raw(s, s.maximum)) for s in reversed(self.info)
        )
        self._limits: tuple[tuple[Value, Value], ...] = tuple(
            (lo * factor + offset, hi * factor + offset)
            for factor, offset, lo, hi in reversed(self._encode_plan)
        )

    def encode(self, alive: int, *values: Value) -> bytes:
        """Return the protected frame for an alive counter and physical values in the order of `signals`.

        Raises ValueError, with the signal's name, when a value is not a number or outside its range,
        when the counter is outside the profile's, and when the number of values is wrong.
        """
        if len(values) != len(self.signals):
            raise ValueError(
                f"{self.name}: {len(values)} values for {len(self.signals)} signals {', '.join(self.signals)}"
            )
        if not 0 <= alive < self.alive_modulus:
            raise ValueError(f"{self.name}: alive counter {alive}, expected 0 to {self.alive_modulus - 1}")
        raws = []
        try:
            for value, (factor, offset, lo, hi) in zip(reversed(values), self._encode_plan, strict=True):
                raw = round((value - offset) / factor) if factor != 1 else round(value - offset)
                if not lo <= raw <= hi:
                    raise ValueError
                raws.append(raw)
        except (ValueError, OverflowError):
            raise self._refusal(values) from None
        frame = bytearray(self._pack(*raws, alive)[::-1])
        self._protect(frame, self.data_id)
        return bytes(frame)

    def _refusal(self, values: tuple[Value, ...]) -> ValueError:
        """What is wrong with the first value that cannot be encoded."""
        plan = reversed(self._encode_plan)
        for value, signal, (factor, offset, lo, hi) in zip(values, self.info, plan, strict=True):
            name = f"{self.name}.{signal.name}"
            if not math.isfinite(value):
                return ValueError(f"{name}: {value} is not a finite number")
            if not lo <= round((value - offset) / factor) <= hi:
                limits = f"{lo * factor + offset:.12g} to {hi * factor + offset:.12g}"
                return ValueError(f"{name}: {value} is outside {limits}")
        return ValueError(f"{self.name}: {values} do not fit")

    def decode(self, data: bytes) -> tuple[Value, ...]:
        """Return the physical values in the order of `signals`; CRC and ranges are not looked at.

        Values stay ``int`` where factor and offset are integers. Raises ValueError when the length of
        ``data`` is not the message's.
        """
        if len(data) != self.length:
            raise ValueError(f"{self.name}: {len(data)} bytes, expected {self.length}")
        raws = self._unpack(data[::-1])[::-1]
        if not self._scale:
            return raws
        values: list[Value] = [*raws]
        for place, factor, offset in self._scale:
            values[place] = values[place] * factor + offset
        return tuple(values)

    def in_range(self, values: tuple[Value, ...]) -> bool:
        """Whether every value of `decode` is inside the range that the DBC file declares for it."""
        return all(lo <= v <= hi for v, (lo, hi) in zip(values, self._limits, strict=True))

    def alive(self, data: bytes) -> int:
        """Return the alive counter of a frame that is at least as long as the message's header."""
        return data[self._alive_byte] & self._alive_mask

    def crc_ok(self, data: bytes) -> bool:
        """Whether ``data`` has the message's length and its CRC agrees with content and data id."""
        return len(data) == self.length and self._check(data, self.data_id)

    def __repr__(self) -> str:
        return f"MessageCodec({self.name}, id 0x{self.frame_id:X})"


class Contract(Mapping[str, MessageCodec]):
    """The messages of one DBC file by name; `by_id` has them by identifier."""

    def __init__(self, database: Database, text: bytes) -> None:
        """Compile every message of ``database``; ``text`` is the file it was read from."""
        self._by_name = {m.name: MessageCodec(m) for m in database.messages}
        self.by_id: Mapping[int, MessageCodec] = {c.frame_id: c for c in self._by_name.values()}
        self.text = text

    def __getitem__(self, name: str) -> MessageCodec:
        """Return the codec of a message; raises KeyError naming the messages that are there."""
        try:
            return self._by_name[name]
        except KeyError:
            raise KeyError(f"no message {name!r}; the contract has {', '.join(self._by_name)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)


def parse(text: bytes, name: str) -> Contract:
    """Read a contract from the bytes of a DBC file; ``name`` is what errors call it.

    Raises ValueError, with name and message, when it is not DBC or breaks the rules of a contract.
    """
    try:
        database = cantools.database.load_string(text.decode("cp1252"), database_format="dbc")
        if not isinstance(database, Database) or not database.messages:
            raise ValueError("it holds no CAN messages")
        return Contract(database, text)
    except (CantoolsError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from error


def load(path: str | Path) -> Contract:
    """Read a contract from a DBC file; raises as `parse`."""
    return parse(Path(path).read_bytes(), str(path))


@cache
def contract() -> Contract:
    """Return the packaged contract, ``navbridge.dbc``."""
    with as_file(files("dbc") / "navbridge.dbc") as path:
        return load(path)


def _protection(message: Message) -> tuple[_Profile, int]:
    attributes = message.dbc.attributes if message.dbc else {}
    profile, data_id = attributes.get("E2EProfile"), attributes.get("E2EDataId")
    if profile is None or data_id is None:
        raise ValueError(f"message {message.name} has no attributes E2EProfile and E2EDataId")
    name = profile.definition.choices[profile.value] if isinstance(profile.value, int) else profile.value
    if name not in _PROFILES:
        raise ValueError(f"message {message.name}: E2EProfile {name}, expected one of {', '.join(_PROFILES)}")
    return _PROFILES[name], int(data_id.value)


def _require_layout(message: Message, signals: list[Signal], profile: _Profile) -> None:
    for s in signals:
        if s.byte_order != "little_endian" or s.is_float or s.is_multiplexer or s.multiplexer_ids:
            raise ValueError(f"{message.name}.{s.name} is not a plain little-endian integer signal")
    places = {s.name: (s.start, s.length) for s in signals}
    header = {CRC: (0, profile.crc_bits), ALIVE: (profile.alive_at, profile.alive_bits)}
    for name, place in header.items():
        if places.get(name) != place:
            raise ValueError(
                f"{message.name}: signal {name} is at {places.get(name)}, its profile has it at {place}"
            )


def _info(s: Signal) -> SignalInfo:
    factor, offset = s.conversion.scale, s.conversion.offset
    if factor == 0:
        raise ValueError(f"signal {s.name} has a factor of 0")
    lo, hi = (-(1 << s.length - 1), (1 << s.length - 1) - 1) if s.is_signed else (0, (1 << s.length) - 1)
    minimum = lo * factor + offset if s.minimum is None else s.minimum
    maximum = hi * factor + offset if s.maximum is None else s.maximum
    return SignalInfo(s.name, s.start, s.length, s.is_signed, factor, offset, minimum, maximum, s.unit or "")


def _raw(s: SignalInfo, value: Value) -> int:
    return round((value - s.offset) / s.factor)


def _layout(length: int, signals: tuple[SignalInfo, ...]) -> str:
    """Return the bitstruct format of the reversed frame: signals by falling start bit, gaps as padding."""
    items, top = [], 8 * length
    for s in sorted(signals, key=lambda s: -s.start):
        if gap := top - s.start - s.bits:
            items.append(f"p{gap}")
        items.append(f"{'s' if s.signed else 'u'}{s.bits}")
        top = s.start
    if top:
        items.append(f"p{top}")
    return "".join(items)
