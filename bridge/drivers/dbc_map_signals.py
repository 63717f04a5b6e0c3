"""Signals of somebody else's DBC file: found by name, taken from frames, turned into SI."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from bridge.drivers.dbc_map_options import Condition, Quantity, Term
from bridge.errors import ConfigError
from bridge.frame import CAN_EFF
from bridge.strict import unknown, wrong
from dbc.units import UNITS, si_factor

Values = dict[str, float]
"""Physical values of one epoch as the DBC file scales them, by ``Message.Signal``."""


_LISTED: Final = 40
"""Of thousands of signals, as a vehicle's DBC file has, an error lists those of the nearest names."""


class Source(NamedTuple):
    """One signal of one message: ``key`` as in `RawFrame`, ``name`` as in `Values`."""

    key: int
    name: str
    message: Message
    signal: Signal

    @property
    def resolution(self) -> float:
        """Physical size of one raw step."""
        return abs(float(self.signal.conversion.scale))

    @property
    def raw_steps(self) -> int:
        """Number of raw values before the signal wraps: up to its declared maximum, else by its bits."""
        if self.signal.maximum and not self.signal.is_float:
            top = (self.signal.maximum - self.signal.conversion.offset) / self.signal.conversion.scale
            if 0.0 < top < 2.0**self.signal.length:
                return round(top) + 1
        return 1 << self.signal.length

    @property
    def ends(self) -> tuple[float, float] | None:
        """Physical values at the ends of the raw range; None for floating-point signals."""
        s = self.signal
        if s.is_float:
            return None
        low, high = (
            (-(1 << s.length - 1), (1 << s.length - 1) - 1) if s.is_signed else (0, (1 << s.length) - 1)
        )
        ends = [raw * s.conversion.scale + s.conversion.offset for raw in (low, high)]
        return min(ends), max(ends)

    @property
    def limits(self) -> tuple[float, float]:
        """Physical values that the DBC file allows; every finite one where it does not say."""
        low, high = self.signal.minimum, self.signal.maximum
        if low is None or high is None or low >= high:  # [0|0] is DBC for "not stated"
            return -sys.float_info.max, sys.float_info.max
        slack = self.resolution * 1e-3  # limits in a DBC file are decimal, values are not
        return float(low) - slack, float(high) + slack


class Reading(NamedTuple):
    """A quantity in SI: ``factor`` times a signal's physical value, or a constant."""

    source: Source | None
    factor: float
    constant: float

    def of(self, values: Values) -> float:
        """The value in an epoch."""
        return self.constant if self.source is None else values[self.source.name] * self.factor

    def sigma(self, values: Values) -> float:
        """The value as a standard deviation: at least half a raw step, which it cannot tell from 0."""
        half_step = 0.0 if self.source is None else abs(self.source.resolution * self.factor) / 2.0
        return max(abs(self.of(values)), half_step)


class Test(NamedTuple):
    """A condition: each signal has one of the values that it may have."""

    parts: tuple[tuple[str, frozenset[float]], ...]

    def holds(self, values: Values) -> bool:
        """Whether the condition is fulfilled in an epoch; an empty one always is."""
        return all(values[name] in allowed for name, allowed in self.parts)

    def __bool__(self) -> bool:
        return bool(self.parts)


class Book:
    """The signals of one DBC file, with errors that name the mapping's file and key.

    Raises ConfigError when the file is not DBC.
    """

    def __init__(self, data: bytes, name: str, file: str, key: str) -> None:
        self._dbc, self._file, self._key = name, file, key
        try:
            database = cantools.database.load_string(data.decode("cp1252"), database_format="dbc")
        except (CantoolsError, UnicodeDecodeError, ValueError) as error:
            raise self.wrong("dbc", name, f"a DBC file ({' '.join(str(error).split())})") from error
        assert isinstance(database, Database)
        self.messages: Mapping[str, Message] = {m.name: m for m in database.messages}
        self._places: dict[str, list[Source]] = {}
        for message in database.messages:
            for signal in message.signals:
                source = Source(key_of(message), f"{message.name}.{signal.name}", message, signal)
                self._places.setdefault(signal.name, []).append(source)
                self._places.setdefault(source.name, []).append(source)

    def wrong(self, key: str, found: object, expected: str) -> ConfigError:
        """The error for a value of the mapping."""
        return wrong(self._file, f"{self._key}.{key}", found, expected)

    def unknown(self, key: str, found: str, names: Sequence[str]) -> ConfigError:
        """The error for a name of the mapping that is not among ``names``."""
        return unknown(self._file, f"{self._key}.{key}", found, names)

    def find(self, key: str, text: str) -> Source:
        """The signal that ``text`` names.

        Raises ConfigError when there is none, or several.
        """
        places = self._places.get(text)
        if places is None:
            message, dot, _ = text.partition(".")
            if dot and message in self.messages:
                names = [f"{message}.{s.name}" for s in self.messages[message].signals]
            else:
                names = [name for name in self._places if "." not in name]
            raise self.unknown(key, text, difflib.get_close_matches(text, names, n=_LISTED, cutoff=0.0))
        if len(places) > 1:
            choices = " or ".join(source.name for source in places)
            raise self.wrong(key, text, f"its message too, for there are several: {choices}")
        return places[0]

    def reading(self, key: str, quantity: Quantity, kind: str, unit: str | None = None) -> Reading:
        """A quantity of ``kind`` (a key of `dbc.units.UNITS`); ``unit`` where it states none itself.

        Raises ConfigError when signal or unit are unknown or measure something else.
        """
        term = Term(signal=quantity) if isinstance(quantity, str) else quantity
        if term.value is not None:
            assert term.unit is not None
            return Reading(None, 0.0, term.value * term.scale * self._factor(f"{key}.unit", term.unit, kind))
        assert term.signal is not None
        negative = term.signal.startswith("-")
        source = self.find(key, term.signal.removeprefix("-"))
        stated = term.unit or unit
        if stated is not None:
            factor = self._factor(f"{key}.unit", stated, kind)
        else:
            try:
                factor = si_factor(source.signal.unit or "", kind)
            except ValueError:
                raise self.wrong(
                    key,
                    term.signal,
                    f'a unit of {kind} to be stated (the DBC file says "{source.signal.unit or ""}"), '
                    f"as unit = one of {', '.join(UNITS[kind])}",
                ) from None
        return Reading(source, factor * term.scale * (-1.0 if negative else 1.0), 0.0)

    def condition(self, key: str, condition: Condition) -> Test:
        """A condition with its signals found."""
        parts = []
        for name, allowed in condition.items():
            source = self.find(f"{key}.{name}", name)
            values = allowed if isinstance(allowed, list) else [allowed]
            parts.append((source, frozenset(float(v) for v in values)))
        return Test(tuple((source.name, values) for source, values in parts))

    def source(self, name: str) -> Source:
        """The signal of a full name that `find` has given out."""
        return self._places[name][0]

    def _factor(self, key: str, unit: str, kind: str) -> float:
        try:
            return si_factor(unit, kind)
        except ValueError as error:
            raise self.wrong(key, unit, f"a unit of {kind}: one of {', '.join(UNITS[kind])}") from error


def key_of(message: Message) -> int:
    """The key that frames of ``message`` have."""
    return message.frame_id | (CAN_EFF if message.is_extended_frame else 0)
