"""Epochs of somebody else's frames: what belongs together, and when it was measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from bridge.drivers.base import Context
from bridge.drivers.counters import Counters
from bridge.drivers.dbc_map_options import Channel, Condition, Quantity
from bridge.drivers.dbc_map_signals import Book, Reading, Source, Test, Values
from bridge.outputs import Reject

_GAIN: Final = (
    0.1  # of the loop that follows arrivals: jitter is a tenth, a wrong rate is learnt in ten samples
)
_LOST: Final = 1.5  # periods that a frame may be late before others are thought to be missing


class Needs:
    """Looks up what one channel maps, and remembers the signals."""

    def __init__(self, book: Book, prefix: str) -> None:
        self.book = book
        self.prefix = prefix
        self.sources: dict[str, Source] = {}

    def source(self, key: str, text: str) -> Source:
        """The signal named ``text``; raises ConfigError as `Book.find`."""
        source = self.book.find(f"{self.prefix}.{key}", text)
        self.sources[source.name] = source
        return source

    def reading(self, key: str, quantity: Quantity, kind: str, unit: str | None = None) -> Reading:
        """The quantity in SI; raises ConfigError as `Book.reading`."""
        reading = self.book.reading(f"{self.prefix}.{key}", quantity, kind, unit)
        if reading.source is not None:
            self.sources[reading.source.name] = reading.source
        return reading

    def maybe(self, key: str, quantity: Quantity | None, kind: str) -> Reading | None:
        """The quantity in SI where it is mapped."""
        return None if quantity is None else self.reading(key, quantity, kind)

    def condition(self, key: str, condition: Condition) -> Test:
        """The condition with its signals found; raises ConfigError as `Book.find`."""
        test = self.book.condition(f"{self.prefix}.{key}", condition)
        for name, _ in test.parts:
            self.sources[name] = self.book.source(name)
        return test


class Epoch(NamedTuple):
    """All values of one epoch, the arrival of its first frame, and how far its counter moved, if known."""

    values: Values
    rx_ns: int
    step: int | None


class Epochs:
    """Collects the frames of one channel until every mapped signal is there.

    With a counter frames of equal count belong together, without one those that arrive within the window
    and do not repeat a signal. An epoch that never becomes whole is counted INCOMPLETE, a value outside
    the range of its signal RANGE, a count that repeats is a duplicate.
    """

    def __init__(self, needs: Needs, options: Channel, counters: Counters) -> None:
        self._counters = counters
        self._window_ns = round(options.window_ms * 1e6)
        self._wanted: dict[int, list[tuple[str, str, float, float]]] = {}
        for source in needs.sources.values():
            place = (source.signal.name, source.name, *source.limits)
            self._wanted.setdefault(source.key, []).append(place)
        self._count_of: dict[int, Source] = {}
        if options.counter is not None:
            for key, wanted in self._wanted.items():
                message = wanted[0][1].partition(".")[0]
                name = options.counter.rpartition(".")[2]
                self._count_of[key] = needs.book.find(f"{needs.prefix}.counter", f"{message}.{name}")
        self._size = len(needs.sources)
        if not self._size:
            raise needs.book.wrong(needs.prefix, "only constants", "a signal")
        self._values: Values = {}
        self._done_values: Values = {}
        self._rx_ns = 0
        self._count: int | None = None
        self._done: int | None = None

    @property
    def keys(self) -> tuple[int, ...]:
        """Keys of the frames it takes."""
        return tuple(self._wanted)

    def take(self, key: int, rx_ns: int, decoded: Mapping[str, float]) -> Epoch | None:
        """The epoch that this frame completes, if it does."""
        parts: Values = {}
        for signal, name, low, high in self._wanted[key]:
            if signal in decoded:  # else a signal of another multiplexer value
                value = decoded[signal]
                if not low <= value <= high:  # true of what is not a number, too
                    self._counters.reject(Reject.RANGE)
                    return None
                parts[name] = value
        if not parts:
            return None
        if key in self._count_of:
            count = decoded.get(self._count_of[key].signal.name)
            if count is None or not self._same_count(int(count), parts):
                return None
        elif self._values and (rx_ns - self._rx_ns > self._window_ns or parts.keys() & self._values.keys()):
            self._counters.reject(Reject.INCOMPLETE)
            self._values = {}
        if not self._values:
            self._rx_ns = rx_ns
        self._values.update(parts)
        if len(self._values) < self._size:
            return None
        values, self._values = self._values, {}
        step = self._step(key)
        self._done_values = values
        return Epoch(values, self._rx_ns, step)

    def _same_count(self, count: int, parts: Values) -> bool:
        """Whether a frame is wanted by its count; it may end the epoch before it."""
        before = self._values
        if before and count != self._count:
            self._counters.reject(Reject.INCOMPLETE)
            self._values = before = {}
        if not before:
            if count != self._done:
                self._count = count
                return True
            before = self._done_values
        elif not parts.keys() & before.keys():
            return True
        if all(before[name] == value for name, value in parts.items()):
            self._counters.duplicates += 1
        else:
            self._counters.reject(Reject.COUNTER)
        return False

    def _step(self, key: int) -> int | None:
        if not self._count_of:
            return None
        assert self._count is not None
        last, self._done = self._done, self._count
        return None if last is None else (self._count - last) % self._count_of[key].raw_steps


class Stamps:
    """When an epoch was measured: by the device's own time where it tells, else by arrival.

    ``period_ns`` is that of a regular device: its arrivals are followed by a loop, so that jitter of the
    bus does not become jitter of intervals. Without one the arrival of the first frame is the time.
    """

    def __init__(self, needs: Needs, options: Channel, context: Context, latency_ms: float) -> None:
        self._latency_ns = round(latency_ms * 1e6)
        self._last_ns: int | None = None
        self._reading = needs.maybe("time", options.time, "time")
        if self._reading is None:
            return
        source = self._reading.source
        if source is None:
            raise needs.book.wrong(f"{needs.prefix}.time", options.time, "a signal")
        step_ns = source.resolution * self._reading.factor * 1e9
        # whole steps multiply exactly; a time of years in nanoseconds has no room for a fraction in a float
        self._step_ns: int | float = round(step_ns) if abs(step_ns - round(step_ns)) < 1e-6 else step_ns
        self._offset = float(source.signal.conversion.offset)
        self._scale = float(source.signal.conversion.scale)
        self._is_float = source.signal.is_float
        modulus = None if self._is_float else round(source.raw_steps * self._step_ns)
        self._port = context.port(modulus, latency_ms)

    def stamp(self, epoch: Epoch, period_ns: float | None = None) -> tuple[int, int | None]:
        """Engine time, ns, and the interval since the epoch before (None: the first, or a restart)."""
        reading = self._reading
        if reading is not None:
            assert reading.source is not None
            value = (epoch.values[reading.source.name] - self._offset) / self._scale
            counter_ns = round((value if self._is_float else round(value)) * self._step_ns)
            t_ns = self._port.stamp(counter_ns, epoch.rx_ns)
            return t_ns, self._port.elapsed_ns
        t_ns, last = epoch.rx_ns - self._latency_ns, self._last_ns
        if last is not None and period_ns is not None:
            late = t_ns - last - period_ns
            if late < _LOST * period_ns:
                t_ns = last + max(1, round(period_ns + max(_GAIN * late, -0.5 * period_ns)))
        self._last_ns = t_ns
        return t_ns, None if last is None else t_ns - last
