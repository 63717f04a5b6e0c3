"""The clock as an object: the host's, and a simulated one that jumps."""

from __future__ import annotations

import math
import select
import time
from collections.abc import Sequence
from typing import Final, Protocol

_STEP_NS: Final = 1_000_000  # adjustment of a disciplined clock stays below: 500 ppm for 100 ms is 50 us
_READING_NS: Final = 20_000
_SECOND: Final = 1e9
_LAG_S: Final = 0.5  # further behind the host, a paced clock gives up catching up


class Clock(Protocol):
    """What the loop knows of time. ``host`` says that kernel stamps are on this clock."""

    host: bool

    def monotonic_ns(self) -> int:
        """Nanoseconds that never go back; the time of everything recorded."""
        ...

    def utc_ns(self) -> int:
        """Nanoseconds since the Unix epoch."""
        ...

    def wait_until(self, ns: int, descriptors: Sequence[int] = ()) -> None:
        """Wait for the monotonic instant ``ns``, or until one of the file descriptors can be read."""
        ...


class HostClock:
    """The clock of this machine."""

    host = True

    def monotonic_ns(self) -> int:
        """Nanoseconds of the system's monotonic clock."""
        return time.monotonic_ns()

    def utc_ns(self) -> int:
        """Nanoseconds of the system's wall clock."""
        return time.time_ns()

    def wait_until(self, ns: int, descriptors: Sequence[int] = ()) -> None:
        """Sleep until ``ns`` or input."""
        _wait((ns - time.monotonic_ns()) / _SECOND, descriptors)


class SimulatedClock:
    """Stands still while the program works; waiting moves it, so two runs see the same instants.

    It jumps, or keeps pace with ``speed`` times the host's clock. When the machine is too slow for
    that it falls behind instead of stamping late.
    """

    host = False

    def __init__(self, utc_ns: int, monotonic_ns: int = 0, speed: float = math.inf) -> None:
        self._speed = speed
        self._utc_offset_ns = utc_ns - monotonic_ns
        self._now_ns = self._origin_ns = monotonic_ns
        self._began_s = time.monotonic()

    def monotonic_ns(self) -> int:
        """The simulated instant."""
        return self._now_ns

    def utc_ns(self) -> int:
        """The simulated instant as UTC."""
        return self._now_ns + self._utc_offset_ns

    def wait_until(self, ns: int, descriptors: Sequence[int] = ()) -> None:
        """Move to ``ns`` when the host has come as far, or to where it is when there is input."""
        if math.isfinite(self._speed):
            ahead_s = (ns - self._origin_ns) / (_SECOND * self._speed) - (time.monotonic() - self._began_s)
            if ahead_s < -_LAG_S:
                self._began_s -= ahead_s  # what was lost is lost: no rush to make up for it
            elif ahead_s > 0.0 and select.select(descriptors, (), (), ahead_s)[0]:
                host_s = time.monotonic() - self._began_s
                ns = min(ns, self._origin_ns + round(host_s * self._speed * _SECOND))
        self._now_ns = max(self._now_ns, ns)


class WallClock:
    """Where the wall clock stands against the monotonic one, and kernel stamps made monotonic.

    Sockets stamp in wall-clock time, which an operator or a time service may step.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.offset_ns = self._read()[0]
        self._previous_ns = self.offset_ns

    def update(self) -> int:
        """Follow the wall clock; the size of its step in ns when it jumped by over a millisecond, else 0."""
        if not self._clock.host:
            return 0
        offset, doubt = self._read()
        change = offset - self.offset_ns
        if abs(change) < _STEP_NS + doubt:
            if doubt <= _READING_NS:
                self.offset_ns = offset
            return 0
        self._previous_ns, self.offset_ns = self.offset_ns, offset
        return change

    def to_monotonic(self, utc_ns: int, earliest_ns: int, now_ns: int) -> int:
        """A kernel stamp on the monotonic clock, known to lie between ``earliest_ns`` and ``now_ns``.

        A stamp from just before a step fits with the offset from before it. One that fits with neither
        is worth nothing: the frame then counts as received now. A clock that is not the host's has no
        kernel stamps: the answer is ``now_ns``.
        """
        if self._clock.host:
            for offset in (self.offset_ns, self._previous_ns):
                if earliest_ns <= utc_ns - offset <= now_ns:
                    return utc_ns - offset
        return now_ns

    def _read(self) -> tuple[int, int]:
        """UTC minus monotonic and how far apart the two readings may be, the best of three."""
        best = (0, 1 << 62)
        for _ in range(3):
            before = self._clock.monotonic_ns()
            utc = self._clock.utc_ns()
            after = self._clock.monotonic_ns()
            if after - before < best[1]:
                best = (utc - (before + after) // 2, after - before)
            if best[1] <= _READING_NS:
                break
        return best


def _wait(seconds: float, descriptors: Sequence[int]) -> None:
    if descriptors:
        select.select(descriptors, (), (), max(0.0, seconds))
    elif seconds > 0.0:
        time.sleep(seconds)
