"""What is in a capture, and what looks wrong in it, without running a navigator.

The frames are counted by message, the devices' drivers are fed once more, and their samples are
judged by `bridge.inspection_checks`. A capture that was cut off is inspected up to the cut.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bridge import inspection_checks as checks
from bridge.config import Config
from bridge.decoding import FrameDecoder
from bridge.drivers.base import Driver
from bridge.drivers.gnss_can import GnssCanOptions
from bridge.engine import BACKWARDS_NS, build_drivers
from bridge.errors import CaptureError, ConfigError
from bridge.frame import BRIDGE, CAN_EFF, Event, RawFrame
from bridge.inspection_checks import Finding
from bridge.options import CanSource
from bridge.outputs import Reject
from bridge.recording import Capture
from bridge.recording_format import LATENCY
from dbc.busload import FD_LENGTHS, classic_bits, fd_bits
from dbc.codec import MessageCodec
from nav.types import ImuChange, Sample, Vector

_GAP: Final = 1.5
"""An interval longer than this many typical ones is a gap."""
_RATE: Final = 0.05
"""How far a rate may be from the configured one."""
_DEFAULT_BITRATE: Final = 1_000_000
_SILENCE_NS: Final = 1_000_000_000
_SILENCE: Final = 10
"""No sample for so many typical intervals, and `_SILENCE_NS` at least, is a device that fell silent."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """One message of one source: how often, how regular."""

    source: str
    key: str
    name: str
    frames: int
    rate_hz: float
    gaps: int
    longest_gap_ms: float


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """What a device's driver made of its frames."""

    device: str
    driver: str
    frames: int
    samples: int
    rate_hz: float
    expected_hz: float | None
    gaps: int
    longest_gap_ms: float
    missing: int
    bridged: int
    duplicates: int
    rejects: dict[str, int]
    notes: list[str]


@dataclass(frozen=True, slots=True)
class BusReport:
    """Load of one CAN source: share of the bus without stuff bits and with as many as can be."""

    source: str
    bitrate: int
    frames: int
    load: float
    load_worst: float


@dataclass(slots=True)
class Report:
    """Everything `inspect` found."""

    file: str
    seconds: float = 0.0
    frames: int = 0
    damage: str | None = None
    complete: bool = False
    written_by: str = ""
    origin: str = ""
    events: dict[str, int] = field(default_factory=dict)
    dropped_frames: int = 0
    unrecorded_frames: int = 0
    unknown_frames: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    streams: list[StreamReport] = field(default_factory=list)
    devices: list[DeviceReport] = field(default_factory=list)
    buses: list[BusReport] = field(default_factory=list)
    latency_us: dict[str, dict[str, float]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def as_document(self) -> dict[str, Any]:
        """The report as plain tables for JSON."""
        document = asdict(self)
        document["findings"] = [finding._asdict() for finding in self.findings]
        return document


def inspect(capture: Capture) -> Report:
    """Read ``capture`` once and report; never raises for what is inside it."""
    report = Report(str(capture.path))
    report.written_by = f"navbridge {capture.metadata.get('navbridge', '?')}"
    report.origin = capture.metadata.get("origin", "")
    config: Config | None = None
    drivers: dict[str, Driver] = {}
    attachments: dict[str, bytes] = {}
    try:
        attachments = capture.attachments
        config = Config.from_attachments(attachments)
        drivers = build_drivers(config)
    except (CaptureError, ConfigError) as error:
        report.findings.append(Finding("", f"the configuration in it cannot be used: {error}"))
    names = FrameDecoder(attachments, config)
    reading = _Reading(drivers, config)
    for frame in capture.frames():
        reading.take(frame)
    report.damage = capture.damage
    result = capture.result()
    report.complete = reading.events[Event.STOP] > 0
    reading.summarise(report, capture.sources, names, config)
    report.latency_us = _latency(capture, result)
    if report.damage:
        report.findings.append(Finding("", f"nothing can be said about what is behind this: {report.damage}"))
    # a device that two navigators use is judged once
    report.findings += dict.fromkeys(_judge(reading, config))
    return report


class _Reading:
    """One pass over the frames: times and lengths by message, samples by device."""

    def __init__(self, drivers: dict[str, Driver], config: Config | None) -> None:
        self.drivers = drivers
        self.samples: dict[str, list[Sample]] = {name: [] for name in drivers}
        self.changes: dict[str, list[ImuChange]] = {name: [] for name in drivers}
        self.times: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        self.lengths: defaultdict[tuple[int, int], Counter[int]] = defaultdict(Counter)
        self.events: Counter[int] = Counter()
        self.zero_sigmas: Counter[tuple[str, str]] = Counter()
        self.dropped = self.unrecorded = self.unknown = self.frames = 0
        self.refused: Counter[str] = Counter()
        self._now_ns = 0
        self.begin_ns = self.end_ns = 0
        self.takers: defaultdict[tuple[int, int], list[str]] = defaultdict(list)
        for name, driver in drivers.items():
            for key in driver.keys:
                self.takers[key].append(name)
        # a driver puts a floor under what the receiver says, so the frames themselves are asked
        self._sigmas: dict[tuple[int, int], tuple[str, MessageCodec]] = {}
        for name, options in config.devices.items() if config else ():
            if config and isinstance(options, GnssCanOptions):
                for place in drivers[name].keys:
                    codec = config.contract.by_id[place[1] - options.id_offset]
                    if any(signal.startswith("SIGMA_") for signal in codec.signals):
                        self._sigmas[place] = (name, codec)

    def take(self, frame: RawFrame) -> None:
        self.frames += 1
        if self.frames == 1:
            self.begin_ns = self.end_ns = frame.rx_ns
        self.end_ns = max(self.end_ns, frame.rx_ns)
        place = (frame.source, frame.key)
        self.times[place].append(frame.rx_ns)
        if frame.source == BRIDGE:
            self._event(frame)
            return
        self.lengths[place][len(frame.data)] += 1
        takers = self.takers.get(place)
        if not takers:
            self.unknown += 1
            return
        # as the engine does: its time never goes back, and a frame from far back is turned away
        if frame.rx_ns < self._now_ns - BACKWARDS_NS:
            for name in takers:
                self.drivers[name].counters.reject(Reject.STALE)
            return
        self._now_ns = max(self._now_ns, frame.rx_ns)
        frame = frame._replace(rx_ns=self._now_ns)
        for name in takers:
            for sample in self.drivers[name].feed(frame):
                if isinstance(sample, ImuChange):
                    self.changes[name].append(sample)
                else:
                    self.samples[name].append(sample)
        if place in self._sigmas:
            self._look_at_sigmas(*self._sigmas[place], frame.data)

    def _look_at_sigmas(self, device: str, codec: MessageCodec, data: bytes) -> None:
        if not codec.crc_ok(data):
            return
        values = dict(zip(codec.signals, codec.decode(data), strict=True))
        if values.get("VEL_VALID", 1):
            for signal, value in values.items():
                if signal.startswith("SIGMA_") and value == 0:
                    self.zero_sigmas[device, signal] += 1

    def _event(self, frame: RawFrame) -> None:
        self.events[frame.key] += 1
        try:
            body = json.loads(frame.data) if frame.data else {}
            match frame.key:
                case Event.DROPPED:
                    self.dropped += int(body["frames"])
                case Event.UNRECORDED:
                    self.unrecorded += int(body["frames"])
                case Event.REFUSED:
                    unit = "packets" if "packets" in body else "bytes"
                    self.refused[f"{body['reason']} ({unit})"] += int(body[unit])
        except (ValueError, KeyError, TypeError):
            return

    def summarise(
        self, report: Report, sources: Mapping[int, str], names: FrameDecoder, config: Config | None
    ) -> None:
        """Fill in the counts, rates, devices and buses."""
        received = [times for (source, _), times in self.times.items() if source != BRIDGE]
        if received:
            report.seconds = (max(times[-1] for times in received) - min(t[0] for t in received)) / 1e9
        report.frames = self.frames
        report.events = {_event_name(key): count for key, count in sorted(self.events.items())}
        report.dropped_frames, report.unrecorded_frames = self.dropped, self.unrecorded
        report.unknown_frames = self.unknown
        report.refused = dict(self.refused)
        for (source, key), times in sorted(self.times.items()):
            if source != BRIDGE:
                rate, gaps, longest = _regularity(times)
                label = names.label(source, key)
                report.streams.append(
                    StreamReport(
                        sources.get(source, str(source)),
                        names.key_text(source, key),
                        label,
                        len(times),
                        rate,
                        gaps,
                        longest,
                    )
                )
        for name, driver in self.drivers.items():
            report.devices.append(self._device(name, driver, config))
        for source, bus in sources.items():
            options = config.sources.get(bus) if config else None
            if isinstance(options, CanSource) and report.seconds > 0.0:
                report.buses.append(self._bus(source, bus, options, report.seconds))

    def _device(self, name: str, driver: Driver, config: Config | None) -> DeviceReport:
        samples = self.samples[name]
        rate, gaps, longest = _regularity([sample.t_ns for sample in samples])
        options = config.devices[name] if config else None
        counters = driver.counters
        return DeviceReport(
            device=name,
            driver=options.driver if options else "",
            frames=counters.frames,
            samples=counters.samples,
            rate_hz=rate,
            expected_hz=getattr(options, "rate_hz", None),
            gaps=gaps,
            longest_gap_ms=longest,
            missing=counters.missing,
            bridged=counters.bridged,
            duplicates=counters.duplicates,
            rejects={reason.name: count for reason, count in counters.health(0).rejects.items()},
            notes=list(counters.notes),
        )

    def _bus(self, source: int, name: str, options: CanSource, seconds: float) -> BusReport:
        bitrate = options.bitrate or _DEFAULT_BITRATE
        fast = options.data_bitrate or bitrate
        frames = 0
        busy = {False: 0.0, True: 0.0}
        for (number, key), lengths in self.lengths.items():
            if number != source:
                continue
            extended = bool(key & CAN_EFF)
            for length, count in lengths.items():
                frames += count
                for stuffed in busy:
                    if length <= 8:
                        bits = classic_bits(length, extended=extended, stuffed=stuffed)
                    elif length in FD_LENGTHS:
                        bits = fd_bits(length, extended=extended, stuffed=stuffed)
                    else:
                        continue
                    busy[stuffed] += count * bits.seconds(bitrate, fast)
        return BusReport(name, bitrate, frames, busy[False] / seconds, busy[True] / seconds)


def _event_name(key: int) -> str:
    return Event(key).name if key in Event._value2member_map_ else str(key)


def _regularity(times_ns: Sequence[int]) -> tuple[float, int, float]:
    """Typical rate (1 / median interval, Hz), number of gaps, longest interval (ms)."""
    if len(times_ns) < 2:
        return 0.0, 0, 0.0
    steps: Vector = np.diff(np.array(times_ns, dtype=np.int64)).astype(np.float64)
    span = times_ns[-1] - times_ns[0]
    middle = float(np.median(steps))
    if middle <= 0.0:  # frames in bursts: their mean rate is what can be said
        return (len(times_ns) - 1) * 1e9 / span if span > 0 else 0.0, 0, float(steps.max()) / 1e6
    return 1e9 / middle, int(np.sum(steps > _GAP * middle)), float(steps.max()) / 1e6


def _judge(reading: _Reading, config: Config | None) -> Iterator[Finding]:
    """Findings about devices and about the stream."""
    if reading.dropped:
        yield Finding("", f"{reading.dropped} frames were lost by the kernel or a driver")
    if reading.unrecorded:
        yield Finding(
            "", f"{reading.unrecorded} frames were lost to the recorder: it replays differently there"
        )
    if config is None:
        return
    for (source, key), names in reading.takers.items():
        for name in names[1:]:
            where = list(config.sources)[source - 1]
            yield Finding(name, f"takes identifier {key:03X} on {where}, as {names[0]} does")
    for (device, signal), count in sorted(reading.zero_sigmas.items()):
        yield Finding(device, f"{signal} is zero in {count} frames; a receiver is never that sure")
    for name, driver in reading.drivers.items():
        samples, options = reading.samples[name], config.devices[name]
        if driver.counters.frames == 0:
            yield Finding(name, "no frame of it: identifiers, id_offset or source may be wrong")
        elif not samples:
            yield Finding(name, f"{driver.counters.frames} frames, but no sample")
        if missing := driver.counters.missing:
            yield Finding(name, f"{missing} samples missing, {driver.counters.bridged} of them made up")
        expected = getattr(options, "rate_hz", None)
        rate, _, _ = _regularity([sample.t_ns for sample in samples])
        if expected and len(samples) > 10 and abs(rate / expected - 1.0) > _RATE:
            yield Finding(name, f"samples come at {rate:.4g} Hz, rate_hz says {expected:g}")
        yield from _silences(name, [sample.t_ns for sample in samples], reading.begin_ns, reading.end_ns)
        yield from checks.check_baro(name, samples)
        yield from checks.check_sensors(name, reading.changes[name], reading.begin_ns)
    for navigator in config.navigators.values():
        imus = {name: checks.imu_columns(reading.samples[name]) for name in navigator.devices}
        fixes = {name: checks.fix_columns(reading.samples[name]) for name in navigator.devices}
        rolled = {name: checks.distance_columns(reading.samples[name]) for name in navigator.devices}
        receiver = max(fixes, key=lambda name: len(fixes[name].t))
        for name in navigator.devices:
            if len(imus[name].t):
                yield from checks.check_imu(name, imus[name], navigator.mounting_deg != "find")
                yield from checks.check_turns(name, imus[name], fixes[receiver])
            yield from checks.check_fixes(name, fixes[name])
            yield from checks.check_distance(name, rolled[name], fixes[receiver])


def _silences(name: str, times_ns: Sequence[int], begin_ns: int, end_ns: int) -> Iterator[Finding]:
    """Where a device gave nothing, the end of the capture included."""
    if len(times_ns) < 2:
        return
    times: NDArray[np.int64] = np.append(np.array(times_ns, dtype=np.int64), end_ns)
    steps = np.diff(times)
    long = np.flatnonzero(steps > max(_SILENCE_NS, _SILENCE * float(np.median(steps))))
    if len(long) == 0:
        return
    if long[-1] == len(steps) - 1:
        yield Finding(name, f"silent for the last {steps[-1] / 1e9:.1f} s of the capture")
        long = long[:-1]
    if len(long):
        worst = long[np.argmax(steps[long])]
        times_more = f", the longest of {len(long)} silences" if len(long) > 1 else ""
        yield Finding(
            name,
            f"silent for {steps[worst] / 1e9:.1f} s, {(times[worst] - begin_ns) / 1e9:.1f} s after the start"
            + times_more,
        )


def _latency(capture: Capture, result: Mapping[str, str] | None) -> dict[str, dict[str, float]]:
    """Percentiles by stage: those of the orderly end, or the last that were recorded on the way."""
    last: dict[str, dict[str, float]] = {}
    if result is not None:
        last = json.loads(result.get("latency", "{}"))
    else:
        for document in capture.documents(LATENCY):
            last = document
    return {stage: values for stage, values in last.items() if values.get("count")}
