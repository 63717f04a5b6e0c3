"""The recorder's second half: the writer thread and the file that keeps trying."""

from __future__ import annotations

import json
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Final, cast

import msgspec
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from bridge.errors import CaptureError
from bridge.recording_format import FRAME_ENCODING, FRAMES, META, PROFILE, RESULT
from bridge.recording_viewer import LOCATION, POSE, SCHEMAS, TRANSFORM, Encoder, Row

ITEM_BYTES: Final = 512
"""What a queued document counts for."""
VIEW: Final = "view"
"""Pseudo topic of rows for viewers, which become messages on several topics."""

_CHUNK_BYTES: Final = 64 * 1024  # closing a chunk compresses it: 0.3 ms at this size
_CHUNK_NS: Final = 1_000_000_000  # what a kill can cost at most
_RETRY_S: Final = 0.1
_IDLE_S: Final = 0.02
_VIEWER_TOPICS: Final = {POSE: "/pose", LOCATION: "/location", TRANSFORM: "/tf"}

Item = tuple[str, int, Any, int]
"""Topic, time, payload, and the number of frames in it."""


class OutputFile:
    """The output file: whole chunks are handed to it, and it keeps trying until it is told not to."""

    def __init__(self, path: Path, lossless: bool) -> None:
        try:
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise CaptureError(f"{path}: cannot create the capture: {error.strerror}") from error
        self._pending = bytearray()
        self._written = 0
        self._lossless = lossless
        self.error: str | None = None
        self.failed = False
        self.closed = False
        self.give_up = threading.Event()

    def write(self, data: bytes) -> int:
        """Take data for the next `commit`."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Place in the file, what is still pending included."""
        return self._written + len(self._pending)

    def flush(self) -> None:
        """Called by the MCAP writer at its own moments; ours is `commit`."""

    def commit(self) -> None:
        """Write what is pending, however long the disk takes; raise OSError when that is hopeless."""
        while self._pending:
            try:
                count = os.write(self._fd, self._pending)
            except OSError as error:
                self.error = error.strerror
                if self._lossless or self.give_up.is_set():
                    self.failed = True
                    raise
                self.give_up.wait(_RETRY_S)
                continue
            self._written += count
            del self._pending[:count]
        self.error = None

    def close(self) -> None:
        """Close the file as it is."""
        os.close(self._fd)
        self.closed = True


class WriterThread:
    """The writer thread: takes items from the queue, builds chunks, commits them to the file."""

    def __init__(self, file: OutputFile, items: deque[Item | None], utc_offset_ns: int) -> None:
        self.result: dict[str, str] = {}
        self.done_bytes = 0
        self._file = file
        self._items = items
        self._utc_offset_ns = utc_offset_ns
        self._encoder = Encoder(utc_offset_ns)
        self._shown: str | None = None
        # chunks are closed by hand, so that it is known which frames are in the file
        self._mcap = Writer(cast(IO[Any], file), chunk_size=1 << 30, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._chunk_bytes = 0
        self._chunk_ns = 0
        self._chunk_frames = 0

    def begin(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        """Write the header; raises OSError when the file does not take it."""
        self._mcap.start(profile=PROFILE, library=f"navbridge {metadata['navbridge']}")
        self._mcap.add_metadata(META, dict(metadata))
        for name, data in attachments.items():
            kind = "application/toml" if name.endswith(".toml") else "application/octet-stream"
            self._mcap.add_attachment(0, 0, name, kind, data)
        self._file.give_up.set()  # nothing to protect yet: a full disk is an error, not a wait
        self._file.commit()
        self._file.give_up.clear()
        self._channels[FRAMES] = self._mcap.register_channel(FRAMES, FRAME_ENCODING, 0)

    def run(self) -> None:
        """Write until the queue ends or the file is given up."""
        try:
            while True:
                # looked into now and then: being woken by every batch would take the processor from the loop
                if not self._items:
                    time.sleep(_IDLE_S)
                    continue
                if (item := self._items.popleft()) is None:
                    break
                self._take(item)
            self._flush()
            self._mcap.add_metadata(RESULT, self.result)
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._file.commit()
        except OSError:
            self._file.failed = True  # said in its error; abandoned() counts what did not get through
        except Exception as error:  # the loop must not be left filling a queue that nobody empties
            self._file.failed = True
            self._file.error = f"the recorder failed: {error!r}"
        finally:
            self._file.close()

    def abandoned(self) -> int:
        """Frames that were accepted but are not in the file; asked after the end."""
        count = self._chunk_frames
        while self._items:
            item = self._items.popleft()
            count += item[3] if item is not None else 0
        return count

    def _take(self, item: Item) -> None:
        topic, t_ns, payload, frames = item
        if topic == FRAMES:
            self._add(FRAMES, t_ns, payload)
            self.done_bytes += len(payload)
            self._chunk_frames += frames
        else:
            if topic == VIEW:
                self._view(payload)
            else:
                self._open(topic, None)
                self._add(topic, t_ns, msgspec.json.encode(payload))
            self.done_bytes += ITEM_BYTES
        if self._chunk_bytes >= _CHUNK_BYTES or t_ns - self._chunk_ns >= _CHUNK_NS:
            self._flush()

    def _view(self, row: Row) -> None:
        t_ns, _, navigator, _ = row
        if self._shown is None:
            self._shown = navigator
        for schema, message in self._encoder.encode(row):
            topic = _VIEWER_TOPICS[schema]
            if navigator != self._shown and schema != TRANSFORM:
                topic = f"/{navigator}{topic}"  # the first navigator has the short names
            self._open(topic, schema)
            self._add(topic, t_ns, message)

    def _open(self, topic: str, schema: str | None) -> None:
        if topic in self._channels:
            return
        number = 0
        if schema is not None:
            if schema not in self._schemas:
                text = json.dumps(SCHEMAS[schema]).encode()
                self._schemas[schema] = self._mcap.register_schema(schema, SchemaEncoding.JSONSchema, text)
            number = self._schemas[schema]
        self._channels[topic] = self._mcap.register_channel(topic, MessageEncoding.JSON, number)

    def _add(self, topic: str, t_ns: int, data: bytes) -> None:
        if not self._chunk_bytes:
            self._chunk_ns = t_ns
        sequence = self._sequences.get(topic, 0)
        self._sequences[topic] = sequence + 1
        utc_ns = max(0, t_ns + self._utc_offset_ns)
        self._mcap.add_message(self._channels[topic], utc_ns, data, utc_ns, sequence & 0xFFFF_FFFF)
        self._chunk_bytes += len(data)

    def _flush(self) -> None:
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._file.commit()
        self._chunk_bytes = self._chunk_frames = 0
