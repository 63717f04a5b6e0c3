"""Reading a capture: in file order, whatever is left of it."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Metadata
from mcap.stream_reader import get_chunk_data_stream

from bridge.errors import CaptureError
from bridge.frame import RawFrame
from bridge.outputs import Checkpoint
from bridge.recording_format import DIGEST, FORMAT_VERSION, FRAMES, META, RESULT, TRUTH, unpack_frames

_RECORD_LIMIT: Final = 1 << 30
_MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = struct.Struct("<BQ")  # of every record: kind and length
_CHANNEL_ID: Final = struct.Struct("<H")
_MESSAGE_HEAD: Final = 22  # bytes of a message before its content: channel, sequence, two times

Record = Header | Metadata | Attachment | Chunk | Footer
_KINDS: Final[dict[int, type[Record]]] = {
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHUNK: Chunk,
    Opcode.FOOTER: Footer,
}


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
        self._attachments: dict[str, bytes] = {}
        self._spoilt: list[str] = []
        self.damage: str | None = None
        header: Header | None = None
        for record in self._records():
            if isinstance(record, Header):
                header = record
            elif isinstance(record, Metadata) and record.name == META:
                self.metadata = record.metadata
            elif isinstance(record, Attachment):
                self._attachments[record.name] = record.data
                if isinstance(record, _Spoilt):
                    self._spoilt.append(record.name)
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
    def attachments(self) -> dict[str, bytes]:
        """Configuration, contract and the other files that were recorded with the frames.

        Raises CaptureError when one of them is damaged.
        """
        if self._spoilt:
            raise CaptureError(
                f"{self.path}: damaged: the checksum of {' and '.join(self._spoilt)} in it does not agree"
            )
        return self._attachments

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
        return chain.from_iterable(map(unpack_frames, self._messages(FRAMES)))

    def checkpoints(self) -> list[Checkpoint]:
        """Digest checkpoints recorded while running, in order."""
        return [checkpoint(item) for item in self.documents(DIGEST)]

    def truth(self) -> Iterator[dict[str, Any]]:
        """The simulator's truth, one dictionary per instant; empty for a real run."""
        return self.documents(TRUTH)

    def documents(self, topic: str) -> Iterator[dict[str, Any]]:
        """The JSON objects of one channel, in order."""
        return map(msgspec.json.decode, self._messages(topic))

    def result(self) -> dict[str, str] | None:
        """What was written at the orderly end (final digest, counts), or None: the run was cut off."""
        found: dict[str, str] | None = None
        for record in self._records():
            if isinstance(record, Metadata) and record.name == RESULT:
                found = record.metadata
        return found

    def _messages(self, topic: str) -> Iterator[bytes]:
        wanted: set[int] = set()
        for record in self._records():
            if not isinstance(record, Chunk):
                continue
            try:
                found = _inside(record, topic, wanted)
            except Exception as error:  # zstd, lz4 and struct each raise their own
                self.damage = f"a chunk cannot be read ({error})"
                return
            yield from found

    def _records(self) -> Iterator[Record]:
        """Top-level records up to the end or the first damage."""
        self.damage = None
        try:
            stream = self.path.open("rb")
        except OSError as error:
            raise CaptureError(f"{self.path}: cannot open the capture: {error.strerror}") from error
        with stream:
            records = _read(stream)
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
                    inside = stream.tell() >= self.path.stat().st_size
                    self.damage = (
                        "the file ends inside a record: it was cut off"
                        if inside
                        else f"a record cannot be read ({error})"
                    )
                    return
                started = True
                yield record


def checkpoint(document: dict[str, Any]) -> Checkpoint:
    """The checkpoint that a document of the digest channel holds."""
    return Checkpoint(document["t_ns"], document["navigator"], document["index"], document["sha256"])


def _read(stream: BinaryIO) -> Iterator[Record]:
    """The top-level records that a capture is read by; schemas, indices and statistics are passed over."""
    _require_magic(stream)
    while True:
        kind, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
        if length > _RECORD_LIMIT:
            raise RecordLengthLimitExceeded(kind, length, _RECORD_LIMIT)
        body = _exactly(stream, length)
        if kind not in _KINDS:
            continue
        record = _KINDS[kind].read(ReadDataStream(BytesIO(body)))
        if isinstance(record, Attachment) and not _crc_agrees(body):
            record = _Spoilt(**vars(record))
        yield record
        if kind == Opcode.FOOTER:
            _require_magic(stream)
            return


class _Spoilt(Attachment):
    """An attachment whose bytes are not those that were written."""


def _crc_agrees(body: bytes) -> bool:
    """Whether the last four bytes of an attachment's record are the CRC-32 of the others."""
    return zlib.crc32(body[:-4]) == int.from_bytes(body[-4:], "little")


def _require_magic(stream: BinaryIO) -> None:
    found = stream.read(len(_MAGIC))
    if not found:
        raise EndOfFile
    if found != _MAGIC:
        raise InvalidMagic(tuple(found))


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise EndOfFile
    return data


def _inside(chunk: Chunk, topic: str, wanted: set[int]) -> list[bytes]:
    """Contents of the messages of ``topic`` in a chunk; its channels are added to ``wanted``."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    found = []
    at = 0
    while at < size:
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        end = at + length
        if end > size:
            raise EndOfFile
        if kind == Opcode.MESSAGE:
            if _CHANNEL_ID.unpack_from(data, at)[0] in wanted:
                found.append(data[at + _MESSAGE_HEAD : end])
        elif kind == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(data[at:end])))
            if channel.topic == topic:
                wanted.add(channel.id)
        at = end
    return found
