"""What is counted about one device."""

from __future__ import annotations

from typing import Final

from bridge.outputs import DeviceHealth, Reject, UnitHealth

_REASONS: Final = tuple(Reject)


class Counters:
    """Mutable counters of one device since the start; `health` is their picture for the outside."""

    __slots__ = (
        "_rate_hz",
        "_samples_then",
        "_then_ns",
        "bridged",
        "duplicates",
        "frames",
        "last_ns",
        "missing",
        "notes",
        "rejects",
        "samples",
        "sensors",
    )

    def __init__(self) -> None:
        self.frames = 0
        self.samples = 0
        self.missing = 0
        self.bridged = 0
        self.duplicates = 0
        self.rejects = [0] * len(Reject)
        self.notes: list[str] = []
        """What an operator should read; the engine takes them away once a second."""
        self.last_ns: int | None = None
        """Engine time of the newest sample, None before the first."""
        self.sensors: UnitHealth | None = None
        """Of a redundant unit, from its first sample on."""
        self._then_ns: int | None = None
        self._samples_then = 0
        self._rate_hz = 0.0

    def reject(self, reason: Reject) -> tuple[()]:
        """Count a frame or sample turned away; returns no samples, so a driver can return it."""
        self.rejects[reason] += 1
        return ()

    def health(self, now_ns: int) -> DeviceHealth:
        """The counters at engine time ``now_ns``, with the sample rate since the call before."""
        if self._then_ns is not None and now_ns > self._then_ns:
            self._rate_hz = (self.samples - self._samples_then) * 1e9 / (now_ns - self._then_ns)
        self._then_ns = now_ns
        self._samples_then = self.samples
        return DeviceHealth(
            frames=self.frames,
            samples=self.samples,
            missing=self.missing,
            bridged=self.bridged,
            duplicates=self.duplicates,
            rejects={reason: count for reason, count in zip(_REASONS, self.rejects, strict=True) if count},
            rate_hz=self._rate_hz,
            age_ms=0.0 if self.last_ns is None else (now_ns - self.last_ns) / 1e6,
            sensors=self.sensors,
        )
