"""Logs of `candump -l` (can-utils) as a capture: the frames as they were on the buses.

A line is ``(1627305599.790450) can2 009#95A44F410202B07F``; ``##`` and a flag digit mark CAN FD,
``#R`` a remote frame, eight digits an extended identifier, and with 20000000 in it an error frame. A log
may be compressed with gzip. Lines that are none of this are counted, not fatal.
"""

from __future__ import annotations

import argparse
import gzip
import re
import sys
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from bridge.config import Config
from bridge.errors import CaptureError, ConfigError
from bridge.frame import CAN_EFF, CAN_ERR, CAN_RTR, RawFrame
from bridge.importers.capture import Imported, write_capture
from bridge.options import CanSource
from bridge.strict import unknown
from dbc.busload import FD_LENGTHS

HELP: Final = "logs of candump -l, also compressed with gzip"

_START_NS: Final = 1_000_000_000
"""Monotonic time of a capture's first frame."""
_STEP_NS: Final = 1_000_000_000
"""A stamp so much earlier than the one before is a clock that was set, not two sockets out of order."""
_ABSOLUTE_NS: Final = 10**17
"""Stamps beyond this (1973) are UTC; smaller ones count from some start that nobody knows."""
_SHOWN: Final = 3

_LINE: Final = re.compile(
    r"\((?P<s>\d+)\.(?P<frac>\d{1,9})\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-F]{3}|[0-9A-F]{8})"
    r"(?:#(?P<remote>R[0-9A-F]?(?:_[0-9A-F])?)|##[0-9A-F](?P<fd>[0-9A-F]*)|#(?P<data>[0-9A-F]{0,16})(?:_[0-9A-F])?)"
    r"(?:\s+[TR])?\s*",
    re.IGNORECASE,
)


class Line(NamedTuple):
    """One frame of a log: its stamp as written, ns, its channel, its key as in `RawFrame`, its payload."""

    stamp_ns: int
    channel: str
    key: int
    data: bytes


def parse_line(text: str) -> Line | None:
    """Read one line of a log; None when it is not a frame."""
    match = _LINE.fullmatch(text)
    if match is None:
        return None
    digits = match["id"]
    key = int(digits, 16)
    if len(digits) == 3:
        if key > 0x7FF:
            return None
    elif not key & CAN_ERR:
        if key > 0x1FFF_FFFF:
            return None
        key |= CAN_EFF
    payload = ""
    if match["remote"]:
        key |= CAN_RTR
    else:
        payload = match["data"] if match["data"] is not None else match["fd"]
    if len(payload) % 2:
        return None
    data = bytes.fromhex(payload)
    if match["fd"] is not None and len(data) not in FD_LENGTHS:
        return None
    stamp_ns = int(match["s"]) * 1_000_000_000 + int(match["frac"].ljust(9, "0"))
    return Line(stamp_ns, match["channel"], key, data)


class CandumpImport:
    """The frames of one log for the sources of one configuration.

    A channel of the log belongs to the CAN source that ``channels`` says (channel to source name), else to
    the one whose ``channel`` or name is the same, else, when log and configuration have one each, to
    that. After `frames` is exhausted the counts say what came of every line: ``malformed`` (and the first
    ``examples``), ``unmapped`` frames by channel, ``clock_steps``, and whether a compressed log is
    ``truncated``.

    Raises CaptureError when the log cannot be read or holds no frame; ConfigError when the configuration is
    wrong or no channel belongs to a source.
    """

    def __init__(
        self, log: str | Path, config: str | Path, channels: Mapping[str, str] | None = None
    ) -> None:
        self._log = Path(log)
        self.config = Config.load(config)
        self.lines = 0
        self.malformed = 0
        self.examples: list[str] = []
        self.unmapped: Counter[str] = Counter()
        self.clock_steps = 0
        self.truncated = False
        self._first_ns, found = self._survey()
        self._sources = self._assign(found, channels or {})

    @property
    def utc_offset_ns(self) -> int:
        """UTC minus the capture's monotonic time; 0 where the log's stamps are not UTC."""
        return self._first_ns - _START_NS if self._first_ns >= _ABSOLUTE_NS else 0

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames in the order of the log, with stamps that never go back."""
        self.lines = self.malformed = self.clock_steps = 0
        self.examples.clear()
        self.unmapped.clear()
        seq, last_ns, zero_ns = 0, _START_NS, self._first_ns - _START_NS
        for number, text in self._text():
            self.lines += 1
            line = parse_line(text)
            if line is None:
                self.malformed += 1
                if len(self.examples) < _SHOWN:
                    self.examples.append(f"line {number}: {text[:60]}")
                continue
            rx_ns = line.stamp_ns - zero_ns
            if rx_ns < last_ns - _STEP_NS:
                self.clock_steps += 1
                zero_ns -= last_ns - rx_ns
            last_ns = max(last_ns, line.stamp_ns - zero_ns)
            source = self._sources.get(line.channel)
            if source is None:
                self.unmapped[line.channel] += 1
                continue
            yield RawFrame(seq, last_ns, source, line.key, line.data)
            seq += 1

    def report(self) -> list[str]:
        """Return what a user should know about lines and frames that are not in the capture."""
        notes = []
        if self.malformed:
            shown = "; ".join(self.examples)
            notes.append(f"{self._log}: {self.malformed} of {self.lines} lines are not frames ({shown})")
        for channel, count in sorted(self.unmapped.items()):
            notes.append(f"{self._log}: {count} frames on {channel} left out: no source has that channel")
        if self.truncated:
            notes.append(f"{self._log}: the compressed file is damaged after line {self.lines}")
        if self.clock_steps:
            notes.append(
                f"{self._log}: the clock of the log was set back {self.clock_steps} times; time goes on"
            )
        return notes

    def _text(self) -> Iterator[tuple[int, str]]:
        """Lines that are not empty, with their numbers."""
        try:
            with self._log.open("rb") as raw:
                packed = raw.read(2) == b"\x1f\x8b"
                raw.seek(0)
                stream: Iterable[bytes] = gzip.GzipFile(fileobj=raw) if packed else raw
                for number, line in enumerate(stream, start=1):
                    if text := line.decode("ascii", "replace").strip():
                        yield number, text
        except (EOFError, zlib.error, gzip.BadGzipFile):
            self.truncated = True
        except OSError as error:
            raise CaptureError(f"{self._log}: cannot be read: {error.strerror or error}") from error

    def _survey(self) -> tuple[int, list[str]]:
        """Return the first stamp and the channels of the log."""
        first_ns: int | None = None
        lines = 0
        channels: dict[str, None] = {}
        for _, text in self._text():
            lines += 1
            line = parse_line(text)
            if line is not None:
                first_ns = line.stamp_ns if first_ns is None else first_ns
                channels[line.channel] = None
        if first_ns is None:
            raise CaptureError(
                f"{self._log}: no frame in {lines} lines; "
                "expected lines like (1627305599.790450) can0 1A0#00FF"
            )
        return first_ns, list(channels)

    def _assign(self, found: list[str], wished: Mapping[str, str]) -> dict[str, int]:
        sources = {name: s for name, s in self.config.sources.items() if isinstance(s, CanSource)}
        for channel, name in wished.items():
            if channel not in found:
                raise unknown(str(self._log), "channel", channel, found)
            if name not in sources:
                raise unknown(self.config.file, f"source of channel {channel}", name, sources)
        names: dict[str, str] = {}
        for channel in found:
            same = [name for name, source in sources.items() if str(source.channel) == channel]
            if channel in wished:
                names[channel] = wished[channel]
            elif len(same) == 1:
                names[channel] = same[0]
            elif channel in sources:
                names[channel] = channel
        if not names and len(found) == len(sources) == 1:
            names[found[0]] = next(iter(sources))
        if not names:
            known = ", ".join(f"{name} ({source.channel})" for name, source in sources.items()) or "none"
            raise ConfigError(
                f"{self.config.file}: source: found CAN sources {known}, expected one for a channel of "
                f"{self._log}: {', '.join(found)}; name it with --channel CHANNEL=SOURCE"
            )
        return {channel: self.config.source_number(name) for channel, name in names.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what ``navbridge import candump`` takes."""
    parser.add_argument("log", metavar="LOG", help="log file, plain or compressed with gzip")
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        required=True,
        help="configuration to replay the capture with, path or packaged",
    )
    parser.add_argument(
        "--channel",
        metavar="CHANNEL=SOURCE",
        type=_pair,
        action="append",
        default=[],
        help="which source of the configuration a channel of the log is (default: the one with that channel)",
    )


def run(args: argparse.Namespace) -> Imported:
    """Do what the arguments say; what is not in the capture is said on standard error."""
    job = CandumpImport(args.log, args.config, dict(args.channel))
    origin = f"import candump {Path(args.log).name}"
    done = write_capture(args.out, job.frames(), job.config, job.utc_offset_ns, origin)
    for note in job.report():
        print(note, file=sys.stderr)
    return done


def _pair(text: str) -> tuple[str, str]:
    channel, sign, source = text.partition("=")
    if not (channel and sign and source):
        raise argparse.ArgumentTypeError(f'"{text}": expected CHANNEL=SOURCE, as can2=imu_bus')
    return channel, source
