"""The solution in the frames of somebody else's DBC file.

::

    [sink.cluster]
    type = "dbc_map"
    source = "can0"
    navigator = "main"
    dbc = "vehicle.dbc"
    rate_hz = 20

    [sink.cluster.messages.EGO_POSE]
    Latitude = "lat"                                   # unit from the DBC file
    Heading = { quantity = "heading", unit = "deg" }   # unit stated
    VelDown = "-vel_up"
    Valid = "position_valid"
    Counter = "counter"
    Sender = { value = 7 }                             # always this

As in our own frames, what is not known is not sent: a frame with a value that is unknown or outside its
signal's range is left out; a standard deviation that does not fit is sent as the largest that does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Final, NamedTuple

from cantools.database.can import Message
from msgspec import Meta

from bridge.drivers.dbc_map_signals import Book, Source, key_of
from bridge.options import SinkOptions
from bridge.outputs import FixOut, Output, SolutionOut, Transmit
from bridge.sinks.base import SinkContext
from bridge.sinks.epoch import level_sigmas
from bridge.strict import Table
from dbc.units import UNITS, si_factor
from nav.types import S, Solution, SolutionFlag

_TURN: Final = 2.0 * math.pi
_WEEK_S: Final = 604_800


class Out(Table):
    """A quantity with its unit stated, or a constant as the signal shows it."""

    quantity: str | None = None
    unit: str | None = None
    scale: float = 1.0
    value: float | None = None

    def __post_init__(self) -> None:
        """Raise ValueError unless there is one of quantity and value."""
        if (self.quantity is None) == (self.value is None):
            raise ValueError("found both or none of quantity and value, expected one of them")


class DbcMapSinkOptions(SinkOptions, kw_only=True):
    """``[sink.NAME]`` with ``type = "dbc_map"``: signals by message, each a quantity of `QUANTITIES`."""

    files: ClassVar[tuple[str, ...]] = ("dbc",)

    dbc: str
    rate_hz: Annotated[float, Meta(gt=0.0, le=1000.0)] = 50.0
    messages: dict[str, dict[str, str | Out]]


class Moment(NamedTuple):
    """What quantities are computed from; ``gps_ns`` is GPS time of the solution, None while unknown."""

    solution: Solution
    counter: int
    gps_ns: int | None


class Quantity(NamedTuple):
    """One thing that can be sent: a key of `dbc.units.UNITS`, its value in SI, and how it ends."""

    kind: str
    value: Callable[[Moment], float]
    end: str = ""  # "turn": angles a turn apart are equal; "wrap": counts on at 0; "most": saturates


def _state(place: int) -> Callable[[Moment], float]:
    return lambda m: float(m.solution.state[place])


def _flag(flag: SolutionFlag) -> Callable[[Moment], float]:
    return lambda m: float(bool(m.solution.flags & flag))


def _velocity(m: Moment) -> tuple[float, float, float]:
    east, north, up = (float(v) for v in m.solution.v_g)
    return east, north, up


def _speed(m: Moment) -> float:
    east, north, _ = _velocity(m)
    return math.hypot(east, north)


def _forward(m: Moment) -> float:
    east, north, up = _velocity(m)
    heading, pitch = m.solution.heading, m.solution.pitch
    level = east * math.sin(heading) + north * math.cos(heading)
    return level * math.cos(pitch) + up * math.sin(pitch)


def _course(m: Moment) -> float:
    east, north, _ = _velocity(m)
    return math.atan2(east, north) % _TURN


def _gps(m: Moment, part: int) -> float:
    return math.nan if m.gps_ns is None else divmod(m.gps_ns / 1e9, _WEEK_S)[part]


_V, _P, _F = S.V.start, S.SIGMA_P.start, S.F.start
_W, _SV = S.W.start, S.SIGMA_V.start

QUANTITIES: Final[dict[str, Quantity]] = {
    "lat": Quantity("angle", _state(S.LAT)),
    "lon": Quantity("angle", _state(S.LON), "turn"),
    "height": Quantity("length", _state(S.HEIGHT)),
    "vel_east": Quantity("speed", _state(_V)),
    "vel_north": Quantity("speed", _state(_V + 1)),
    "vel_up": Quantity("speed", _state(_V + 2)),
    "speed": Quantity("speed", _speed),
    "speed_forward": Quantity("speed", _forward),
    "course": Quantity("angle", _course, "turn"),
    "roll": Quantity("angle", lambda m: m.solution.roll),
    "pitch": Quantity("angle", lambda m: m.solution.pitch),
    "heading": Quantity("angle", lambda m: m.solution.heading, "turn"),
    "rate_right": Quantity("angular rate", _state(_W)),
    "rate_forward": Quantity("angular rate", _state(_W + 1)),
    "rate_up": Quantity("angular rate", _state(_W + 2)),
    "force_right": Quantity("acceleration", _state(_F)),
    "force_forward": Quantity("acceleration", _state(_F + 1)),
    "force_up": Quantity("acceleration", _state(_F + 2)),
    "sigma_east": Quantity("length", _state(_P), "most"),
    "sigma_north": Quantity("length", _state(_P + 1), "most"),
    "sigma_up": Quantity("length", _state(_P + 2), "most"),
    "sigma_vel_east": Quantity("speed", _state(_SV), "most"),
    "sigma_vel_north": Quantity("speed", _state(_SV + 1), "most"),
    "sigma_vel_up": Quantity("speed", _state(_SV + 2), "most"),
    "sigma_roll": Quantity("angle", lambda m: level_sigmas(m.solution)[0], "most"),
    "sigma_pitch": Quantity("angle", lambda m: level_sigmas(m.solution)[1], "most"),
    "sigma_heading": Quantity("angle", lambda m: level_sigmas(m.solution)[2], "most"),
    "mode": Quantity("ratio", lambda m: float(m.solution.mode)),
    "flags": Quantity("ratio", lambda m: float(m.solution.flags)),
    "position_valid": Quantity("ratio", _flag(SolutionFlag.POSITION)),
    "velocity_valid": Quantity("ratio", _flag(SolutionFlag.VELOCITY)),
    "level_valid": Quantity("ratio", _flag(SolutionFlag.LEVEL)),
    "heading_valid": Quantity("ratio", _flag(SolutionFlag.HEADING)),
    "counter": Quantity("ratio", lambda m: float(m.counter), "wrap"),
    "time": Quantity("time", lambda m: m.solution.t_ns / 1e9, "wrap"),
    "gps_time_of_week": Quantity("time", lambda m: _gps(m, 1), "wrap"),
    "gps_week": Quantity("ratio", lambda m: _gps(m, 0), "wrap"),
}
"""What can be sent, by the name in a mapping. ``time`` is the bridge's monotonic time."""


class _Field(NamedTuple):
    """One signal of a frame: a quantity times ``factor``, or a constant."""

    source: Source
    quantity: Quantity | None
    factor: float
    constant: float

    def physical(self, moment: Moment) -> float | None:
        """The value as the DBC file scales it; None when it is unknown or does not fit."""
        if self.quantity is None:
            return self.constant
        value = self.quantity.value(moment) * self.factor
        low, high = self.limits()
        step = self.source.resolution
        if self.quantity.end == "most":
            # asked this way round, what is not a number ends up as the largest as well
            return value if low <= value <= high else high
        if not math.isfinite(value):
            return None
        if self.quantity.end == "wrap":
            conversion = self.source.signal.conversion
            raw = math.floor((value - conversion.offset) / conversion.scale + 1e-6) % self.source.raw_steps
            return float(raw * conversion.scale + conversion.offset)
        turn = _TURN * abs(self.factor)
        turns = (0.0, -turn, turn) if self.quantity.end == "turn" else (0.0,)
        for shift in turns:
            if low - 0.5 * step <= value + shift < high + 0.5 * step:
                return min(max(value + shift, low), high)
        return None

    def limits(self) -> tuple[float, float]:
        """The values that fit the signal's bits and are allowed by the file."""
        low, high = self.source.limits
        if self.source.ends is not None:
            low, high = max(low, self.source.ends[0]), min(high, self.source.ends[1])
        return low, high


class DbcMapSink:
    """Encodes one navigator's solution through somebody else's DBC file.

    Raises ConfigError when the file is not DBC, or the mapping names a message, signal, quantity or unit that
    is not there.
    """

    def __init__(self, options: DbcMapSinkOptions, context: SinkContext) -> None:
        self._navigator = options.navigator
        self._source = context.source
        self._period_ns = round(1e9 / options.rate_hz)
        # the mapping and the file disagree where either may be wrong, so the file is named
        book = Book(context.files[options.dbc], options.dbc, options.dbc, f"sink.{context.name}")
        self._frames: list[tuple[Message, list[_Field], dict[str, float]]] = []
        if not options.messages:
            raise book.wrong("messages", {}, "at least one table messages.NAME")
        for name, signals in options.messages.items():
            message = _message(book, name)
            fields = [
                _field(book, f"messages.{name}.{signal}", f"{name}.{signal}", what)
                for signal, what in signals.items()
            ]
            # signals that are not mapped are sent as raw 0
            defaults = {s.name: float(s.conversion.offset) for s in message.signals}
            self._frames.append((message, fields, defaults))
        self._slot: int | None = None
        self._counter = 0
        self._gps_minus_engine_ns: int | None = None

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Frames due after ``outputs``: of several solutions the last one is sent."""
        latest: SolutionOut | None = None
        for output in outputs:
            match output:
                case SolutionOut() if output.navigator == self._navigator:
                    latest = output
                case FixOut() if output.fix.gps_ns is not None:
                    self._gps_minus_engine_ns = output.fix.gps_ns - output.fix.t_ns
        if latest is None:
            return []
        slot = latest.latest_rx_ns // self._period_ns
        if slot == self._slot:
            return []
        self._slot = slot
        return [Transmit(self._source, key, data) for key, data in self.encode_solution(latest.solution)]

    def encode_solution(self, solution: Solution) -> list[tuple[int, bytes]]:
        """Key and payload of every frame whose values are all known; the counter moves on by one."""
        offset = self._gps_minus_engine_ns
        moment = Moment(solution, self._counter, None if offset is None else solution.t_ns + offset)
        self._counter += 1
        frames = []
        for message, fields, defaults in self._frames:
            values: dict[str, float] = dict(defaults)
            for field in fields:
                value = field.physical(moment)
                if value is None:
                    break
                values[field.source.signal.name] = value
            else:
                frames.append((key_of(message), bytes(message.encode(values, strict=False))))
        return frames


def _message(book: Book, name: str) -> Message:
    if name not in book.messages:
        raise book.unknown(f"messages.{name}", name, list(book.messages))
    return book.messages[name]


def _field(book: Book, key: str, signal: str, what: str | Out) -> _Field:
    source = book.find(key, signal)
    out = Out(quantity=what) if isinstance(what, str) else what
    if out.value is not None:
        constant = _Field(source, None, 0.0, out.value)
        low, high = constant.limits()
        if not low <= out.value <= high:
            raise book.wrong(key, out.value, f"a value from {low:g} to {high:g}")
        return constant
    assert out.quantity is not None
    name = out.quantity.removeprefix("-")
    if name not in QUANTITIES:
        raise book.unknown(key, name, list(QUANTITIES))
    quantity = QUANTITIES[name]
    unit = source.signal.unit or "" if out.unit is None else out.unit
    try:
        factor = out.scale / si_factor(unit, quantity.kind)
    except ValueError:
        raise book.wrong(
            key,
            unit,
            f"a unit of {quantity.kind} in the DBC file or stated as unit = one of "
            f"{', '.join(UNITS[quantity.kind])}",
        ) from None
    return _Field(source, quantity, -factor if out.quantity.startswith("-") else factor, 0.0)
