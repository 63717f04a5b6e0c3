"""Which devices have fallen silent: an operator must not have to guess from a navigator that stands still."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from bridge.drivers.counters import Counters
from bridge.outputs import Reject, Severity

FIRST_NS: Final = 5_000_000_000
"""A device that was never heard is reported after this."""
QUIET_NS: Final = 2_000_000_000
INTERVALS: Final = 5
"""One that was heard is silent after so many of its own intervals, and `QUIET_NS` at least."""


@dataclass(slots=True)
class _Watched:
    counters: Counters
    since_ns: int
    first: tuple[int, int] | None = None  # time and number of samples when it was first heard
    samples: int = 0
    frames: int = 0  # and rejects, when the newest sample came
    rejects: tuple[int, ...] = ()
    told: bool = False


class Silence:
    """Watches the counters of the devices, by engine time; `second` is called once a second."""

    def __init__(self, counters: Mapping[str, Counters], now_ns: int) -> None:
        self._watched = {
            name: _Watched(each, now_ns, rejects=(0,) * len(Reject)) for name, each in counters.items()
        }

    def second(self, now_ns: int) -> Iterator[tuple[Severity, str]]:
        """What there is to say: each silence once, and its end."""
        for name, watched in self._watched.items():
            counters = watched.counters
            if counters.samples > watched.samples and counters.last_ns is not None:
                if watched.told:
                    gone_s = (counters.last_ns - watched.since_ns) / 1e9
                    yield Severity.NOTICE, f"{name}: samples again, after about {gone_s:.0f} s"
                watched.told = False
                watched.since_ns = counters.last_ns
                watched.samples, watched.frames = counters.samples, counters.frames
                watched.rejects = tuple(counters.rejects)
                watched.first = watched.first or (counters.last_ns, counters.samples)
            elif not watched.told and now_ns - watched.since_ns >= self._patience_ns(watched):
                watched.told = True
                yield Severity.WARNING, f"{name}: {_reason(watched, now_ns)}"

    @staticmethod
    def _patience_ns(watched: _Watched) -> int:
        if watched.first is None:
            return FIRST_NS
        then_ns, samples = watched.first
        count = max(1, watched.samples - samples)
        return max(QUIET_NS, INTERVALS * (watched.since_ns - then_ns) // count)


def _reason(watched: _Watched, now_ns: int) -> str:
    seconds = f"{(now_ns - watched.since_ns) / 1e9:.0f} s"
    if watched.counters.frames == watched.frames:
        if watched.first is None:
            return f"nothing heard in {seconds}: is it connected, are source and identifiers right?"
        return f"silent for {seconds}"
    rejects = _named(new - old for new, old in zip(watched.counters.rejects, watched.rejects, strict=True))
    return f"frames come but no sample for {seconds}" + (f": {rejects}" if rejects else "")


def _named(counts: Iterable[int]) -> str:
    return ", ".join(
        f"{reason.name.lower()} {count}" for reason, count in zip(Reject, counts, strict=True) if count
    )
