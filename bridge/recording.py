"""The recorder: every frame on disk before the engine sees it, without ever holding the loop up.

The loop packs frames into batches and leaves them in a bounded queue; one writer thread compresses
and writes. When the disk is slow or full the queue fills, whole batches are given up and counted,
and when there is room again the loop records the break as an ``UNRECORDED`` event before it goes
on. Nothing is ever sorted: the file is in the order of sequence numbers.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from bridge.errors import CaptureError
from bridge.frame import RawFrame
from bridge.outputs import Checkpoint, SolutionOut
from bridge.recording_capture import Capture
from bridge.recording_format import BATCH_BYTES, BATCH_NS, DIGEST, FORMAT_VERSION, FRAMES, HEADER, TRUTH
from bridge.recording_host import environment
from bridge.recording_viewer import Decimator
from bridge.recording_writer import ITEM_BYTES, VIEW, Item, OutputFile, WriterThread
from nav.types import Solution

__all__ = ["Capture", "Recorder", "require_place"]

_QUEUE_BYTES: Final = 16 * 1024 * 1024
_CLOSE_S: Final = 5.0


def require_place(path: str | Path) -> None:
    """Find out that no capture can be written at ``path`` before kernels are compiled and buses opened.

    Raises CaptureError with the reason.
    """
    where = Path(path)
    reason = ""
    if where.is_dir():
        reason = "it is a folder"
    elif not where.parent.is_dir():
        reason = f"there is no folder {where.parent}"
    elif not os.access(where if where.exists() else where.parent, os.W_OK):
        reason = "permission denied"
    if reason:
        raise CaptureError(f"{path}: cannot write the capture: {reason}")


class Recorder:
    """Writes one capture.

    ``sources`` names the sources by number, ``utc_offset_ns`` is UTC minus monotonic time,
    ``attachments`` are the configuration, calibration and DBC files, ``metadata`` whatever else a
    replay needs to know; keys and passwords belong in neither. ``lossless`` is for simulated time
    and imports, where the loop may wait for the disk: then a full queue blocks and a disk error
    raises; otherwise frames are counted as unrecorded and the loop goes on.

    Raises CaptureError when the file cannot be created or its header cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        sources: Mapping[int, str],
        utc_offset_ns: int,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        lossless: bool = False,
    ) -> None:
        self.path = Path(path)
        self.unrecorded = 0
        self._lossless = lossless
        self._batch = bytearray()
        self._batch_frames = 0
        self._batch_ns = 0
        self._last_seq = -1
        self._lost = 0  # since the last break that was marked
        self._put_bytes = 0  # counted by the loop alone, _done_bytes by the writer alone: no lock
        self._result: dict[str, str] = {}
        self._decimator = Decimator()
        self._shown: dict[str, Solution] = {}
        self._queue: deque[Item | None] = deque()
        self._file = OutputFile(self.path, lossless)
        self._worker = WriterThread(self._file, self._queue, utc_offset_ns)
        try:
            self._worker.begin(
                {
                    **environment(),
                    **(metadata or {}),
                    "format": FORMAT_VERSION,
                    "sources": json.dumps({str(number): name for number, name in sources.items()}),
                    "utc_offset_ns": str(utc_offset_ns),
                },
                attachments or {},
            )
        except OSError as error:
            self._file.close()
            raise CaptureError(f"{self.path}: cannot write the capture: {error.strerror}") from error
        self._thread = threading.Thread(target=self._worker.run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Why the disk does not take data at the moment, or None."""
        return self._file.error

    def record(self, frame: RawFrame) -> bool:
        """Take one frame; False when it had to be given up (it is counted in ``unrecorded``)."""
        seq, rx_ns, source, key, data = frame
        if self._lost:
            self._lost += 1
            self.unrecorded += 1
            return False
        batch = self._batch
        if not batch:
            self._batch_ns = rx_ns
        batch += HEADER.pack(seq, rx_ns, source, key, len(data))
        batch += data
        self._batch_frames += 1
        self._last_seq = seq
        if len(batch) >= BATCH_BYTES or rx_ns - self._batch_ns >= BATCH_NS:
            return self._push_batch()
        return True

    def resume(self) -> int:
        """Frames lost since the last break, if the recorder has room again; otherwise 0.

        The caller records an UNRECORDED event with this number before any further frame.
        """
        if not self._lost or self._pending() > _QUEUE_BYTES // 2:
            return 0
        lost, self._lost = self._lost, 0
        return lost

    def solution(self, out: SolutionOut) -> None:
        """Show a solution to viewers, at most ten a second."""
        self._shown[out.navigator] = out.solution
        row = self._decimator.row(out.navigator, out.solution)
        if row is not None:
            self._put(VIEW, row[0], row)

    def checkpoint(self, checkpoint: Checkpoint) -> None:
        """Write a link of a digest chain behind the frames that led to it, with the latest solution.

        The solution lets a replay say how far it is off where the digests differ.
        """
        self._push_batch()
        document: dict[str, Any] = {
            "navigator": checkpoint.navigator,
            "index": checkpoint.index,
            "t_ns": checkpoint.t_ns,
            "sha256": checkpoint.sha256,
            "seq": self._last_seq,
        }
        if (solution := self._shown.get(checkpoint.navigator)) is not None:
            document["solution"] = {"t_ns": solution.t_ns, "state": solution.state.tolist()}
        self._put(DIGEST, checkpoint.t_ns, document)

    def truth(self, t_ns: int, document: dict[str, Any]) -> None:
        """Write the simulator's truth of one instant."""
        self._put(TRUTH, t_ns, {"t_ns": t_ns, **document})

    def document(self, topic: str, t_ns: int, document: object) -> None:
        """Write one JSON object on a channel of its own, encoded by the writer."""
        self._put(topic, t_ns, document)

    def finish(self, result: Mapping[str, str]) -> None:
        """Set what the orderly end of the capture shall say: final digest, counts."""
        self._result.update(result)

    def close(self) -> None:
        """Write everything that is still queued and end the file.

        Waits a few seconds for a disk that does not answer, then counts the rest as unrecorded.
        """
        if not self._thread.is_alive() and self._file.closed:
            return
        self._push_batch()
        self._worker.result = {**self._result, "unrecorded": str(self.unrecorded)}
        self._queue.append(None)
        self._thread.join(None if self._lossless else _CLOSE_S)
        if self._thread.is_alive():
            self._file.give_up.set()
            self._thread.join(1.0)
        self.unrecorded += self._worker.abandoned()
        if self._lossless and self.error:
            raise CaptureError(f"{self.path}: cannot write the capture: {self.error}")

    def _push_batch(self) -> bool:
        if not self._batch_frames:
            return True
        if self._lossless:
            while self._pending() > _QUEUE_BYTES and not self._file.failed:
                time.sleep(0.001)
            if self._file.failed:
                raise CaptureError(f"{self.path}: cannot write the capture: {self.error}")
        count = self._batch_frames
        taken = self._pending() <= _QUEUE_BYTES
        if taken:
            self._put_bytes += len(self._batch)
            self._queue.append((FRAMES, self._batch_ns, bytes(self._batch), count))
        else:
            self._lost += count
            self.unrecorded += count
        self._batch.clear()
        self._batch_frames = 0
        return taken

    def _put(self, topic: str, t_ns: int, payload: object) -> None:
        if self._lossless or self._pending() <= _QUEUE_BYTES:
            self._put_bytes += ITEM_BYTES
            self._queue.append((topic, t_ns, payload, 0))

    def _pending(self) -> int:
        return self._put_bytes - self._worker.done_bytes
