"""Reading a capture: in file order, whatever is left of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Final

import msgspec
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.records import Attachment, Channel, Chunk, Footer, Header, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from bridge.errors import CaptureError
from bridge.frame import RawFrame
from bridge.outputs import Checkpoint
from bridge.recording_format import DIGEST, FORMAT_VERSION, FRAMES, META, RESULT, TRUTH, unpack_frames

_RECORD_LIMIT: Final = 1 << 30


class Capture:
    """A capture file, read from front to back as often as asked.

    The order of frames is the order of the file; nothing is sorted. A file cut short by a kill or
    a full disk is read up to the cut, and ``damage`` then says what was met there (after a pass
    over the file: `frames`, `checkpoints`, `truth` or `result`).

    Raises CaptureError when the file is missing, is not MCAP or was not written by navbridge.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.damage: str | None = None
        header: Header | None = None
        for record in self._records():
            if isinstance(record, Header):
                header = record
            elif isinstance(record, Metadata) and record.name == META:
                self.metadata = record.metadata
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif isinstance(record, Chunk | Footer):
                break
        if not self.metadata:
            if header is None or self.damage:
                raise CaptureError(f"{self.path}: cut off before its header was complete, nothing to read")
            raise CaptureError(f"{self.path}: an MCAP file, but not a capture of navbridge")
        version = self.metadata.get("format")
        if version != FORMAT_VERSION:
            raise CaptureError(
                f"{self.path}: capture format {version}, this navbridge reads {FORMAT_VERSION}"
            )

    @property
    def sources(self) -> dict[int, str]:
        """Names of the sources by their number; 0 is the bridge."""
        return {int(number): name for number, name in json.loads(self.metadata["sources"]).items()}

    @property
    def utc_offset_ns(self) -> int:
        """UTC minus monotonic time when the capture began, ns."""
        return int(self.metadata["utc_offset_ns"])

    def frames(self) -> Iterator[RawFrame]:
        """Every frame that can be read, in file order."""
        return chain.from_iterable(unpack_frames(message.data) for message in self._messages(FRAMES))

    def checkpoints(self) -> list[Checkpoint]:
        """Digest checkpoints recorded while running, in order."""
        return [
            Checkpoint(item["t_ns"], item["navigator"], item["index"], item["sha256"])
            for item in self.documents(DIGEST)
        ]

    def truth(self) -> Iterator[dict[str, Any]]:
        """The simulator's truth, one dictionary per instant; empty for a real run."""
        return self.documents(TRUTH)

    def documents(self, topic: str) -> Iterator[dict[str, Any]]:
        """The JSON objects of one channel, in order."""
        return (msgspec.json.decode(message.data) for message in self._messages(topic))

    def result(self) -> dict[str, str] | None:
        """What was written at the orderly end (final digest, counts), or None: the run was cut off."""
        found: dict[str, str] | None = None
        for record in self._records():
            if isinstance(record, Metadata) and record.name == RESULT:
                found = record.metadata
        return found

    def _messages(self, topic: str) -> Iterator[Message]:
        wanted: set[int] = set()
        for record in self._records():
            if not isinstance(record, Chunk):
                continue
            try:
                inside = breakup_chunk(record, validate_crc=True)
            except Exception as error:  # zstd, lz4 and struct each raise their own
                self.damage = f"a chunk cannot be read ({error})"
                return
            for item in inside:
                if isinstance(item, Message):
                    if item.channel_id in wanted:
                        yield item
                elif isinstance(item, Channel) and item.topic == topic:
                    wanted.add(item.id)

    def _records(self) -> Iterator[McapRecord]:
        """Top-level records up to the end or the first damage."""
        self.damage = None
        try:
            stream = self.path.open("rb")
        except OSError as error:
            raise CaptureError(f"{self.path}: cannot open the capture: {error.strerror}") from error
        with stream:
            reader = StreamReader(stream, emit_chunks=True, record_size_limit=_RECORD_LIMIT)
            records = reader.records
            started = False
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except OSError as error:
                    raise CaptureError(f"{self.path}: {error.strerror}") from error
                except InvalidMagic as error:
                    if not started:
                        raise CaptureError(f"{self.path}: not a capture (not an MCAP file)") from error
                    self.damage = "the file ends in its last bytes"
                    return
                except EndOfFile:
                    if not started:
                        raise CaptureError(
                            f"{self.path}: empty or cut off at once, nothing to read"
                        ) from None
                    self.damage = "the file ends without a footer: the run was cut off"
                    return
                except Exception as error:
                    # a record cut in the middle: struct and the text codecs raise their own errors
                    if not started:
                        raise CaptureError(f"{self.path}: not a capture ({error})") from error
                    self.damage = f"a record cannot be read ({error})"
                    return
                started = True
                yield record
