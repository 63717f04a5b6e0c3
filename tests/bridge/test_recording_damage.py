"""Captures that were cut, are foreign, or whose disk was full or slow."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.writer import Writer

from bridge import recording
from bridge.errors import CaptureError
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.recording import Capture, Recorder

SOURCES = {0: "bridge", 1: "can0"}


def frame(seq: int, size: int = 8) -> RawFrame:
    # incompressible, so that sizes on disk are what they seem
    return RawFrame(seq, seq * 1_000_000, 1, 0x100, os.urandom(size))


def write_capture(path: Path, count: int) -> list[RawFrame]:
    frames = [frame(i) for i in range(count)]
    rec = Recorder(path, sources=SOURCES, utc_offset_ns=0, attachments={"config.toml": b"x" * 500})
    for item in frames:
        rec.record(item)
    rec.close()
    return frames


def test_a_file_cut_anywhere_reads_to_the_cut_or_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    frames = write_capture(path, 8000)
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    longest = 0
    lengths = [*range(0, len(whole), 1000), *range(len(whole) - 20, len(whole))]
    for length in lengths:
        cut.write_bytes(whole[:length])
        try:
            capture = Capture(cut)
        except CaptureError:
            assert length < 10_000, "only a cut inside the header leaves nothing to read"
            continue
        got = list(capture.frames())
        assert got == frames[: len(got)]
        assert capture.damage is not None
        assert len(got) >= longest, "a longer file holds at least as much"
        longest = len(got)
        if length >= len(whole) - 20:
            assert "cut off" in capture.damage or "last bytes" in capture.damage
    assert longest == len(frames), "all frames are there before the summary is"


def test_a_damaged_chunk_ends_the_capture_there(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    frames = write_capture(path, 8000)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    capture = Capture(path)
    got = list(capture.frames())
    assert got == frames[: len(got)]
    assert len(got) < len(frames)
    assert capture.damage is not None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"\x89", "not a capture"),
        (b"hello, this is a text file\n", "not a capture"),
        (bytes(5000), "not a capture"),
    ],
)
def test_foreign_files_are_refused_in_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(CaptureError, match=words) as caught:
        Capture(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_another_programs_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(CaptureError, match="not a capture of navbridge"):
        Capture(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="No such file"):
        Capture(tmp_path / "a.mcap")
    with pytest.raises(CaptureError, match="directory"):
        Capture(tmp_path)


def test_a_killed_process_leaves_a_capture_that_opens(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    child = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time\n"
            "from bridge.recording import Recorder\n"
            "from bridge.frame import RawFrame\n"
            "r = Recorder(sys.argv[1], sources={0: 'bridge', 1: 'x'}, utc_offset_ns=0)\n"
            "for i in range(10**9):\n"
            "    r.record(RawFrame(i, i * 1_000_000, 1, 1, i.to_bytes(8, 'little')))\n"
            "    if i % 100 == 0:\n"
            "        time.sleep(0.001)\n"
            "    if i == 20_000:\n"
            "        print('far enough', flush=True)\n",
            str(path),
        ],
        stdout=subprocess.PIPE,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == b"far enough\n"
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    capture = Capture(path)
    count = 0
    for count, got in enumerate(capture.frames(), 1):
        assert got == RawFrame(count - 1, (count - 1) * 1_000_000, 1, 1, (count - 1).to_bytes(8, "little"))
    assert capture.damage is not None
    assert capture.result() is None
    # 20 s of frames were handed over; at most the chunk in progress and the queue's head are lost
    assert count > 15_000


@contextmanager
def file_size_limit(limit: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def feed(rec: Recorder, seq: int, count: int) -> tuple[int, list[RawFrame]]:
    """Frames as the loop hands them over, with the breaks marked; what was taken."""
    taken: list[RawFrame] = []
    for _ in range(count):
        if lost := rec.resume():
            mark = RawFrame(seq, seq * 1_000_000, BRIDGE, Event.UNRECORDED, str(lost).encode())
            assert rec.record(mark)
            taken.append(mark)
            seq += 1
        item = frame(seq, 1000)
        if rec.record(item):
            taken.append(item)
        seq += 1
    return seq, taken


def test_a_full_disk_breaks_the_recording_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "_QUEUE_BYTES", 500_000)
    path = tmp_path / "a.mcap"
    rec = Recorder(path, sources=SOURCES, utc_offset_ns=0)
    with file_size_limit(300_000):
        seq, worst = 0, 0.0
        deadline = time.monotonic() + 5.0
        while (rec.error is None or rec.unrecorded < 1000) and time.monotonic() < deadline:
            started = time.monotonic()
            seq, _ = feed(rec, seq, 100)
            worst = max(worst, time.monotonic() - started)
            time.sleep(0.001)
        assert rec.error is not None
        assert rec.unrecorded >= 1000
        # a hundred frames take well under a millisecond; waiting for the disk would take for ever
        assert worst < 1.0, "the loop was held up"
        seen = rec.unrecorded
    deadline = time.monotonic() + 5.0
    while rec.error and time.monotonic() < deadline:
        time.sleep(0.02)  # the disk takes data again
    time.sleep(0.1)
    seq, _ = feed(rec, seq, 200)
    rec.close()
    assert rec.unrecorded == seen
    capture = Capture(path)
    frames = list(capture.frames())
    assert capture.damage is None
    marks = [item for item in frames if item.source == BRIDGE]
    assert sum(int(item.data) for item in marks) == seen > 0
    for before, after in pairwise(frames):
        skipped = after.seq - before.seq - 1
        assert skipped == (int(after.data) if after.source == BRIDGE else 0)
    assert frames[-1].seq == seq - 1
    assert capture.result() == {"unrecorded": str(seen)}


def test_a_disk_full_to_the_end_is_counted_and_leaves_a_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "_QUEUE_BYTES", 200_000)
    monkeypatch.setattr(recording, "_CLOSE_S", 0.3)
    path = tmp_path / "a.mcap"
    with file_size_limit(150_000):
        rec = Recorder(path, sources=SOURCES, utc_offset_ns=0)
        seq, _ = feed(rec, 0, 2000)
        rec.close()
    assert rec.error is not None
    frames = list(Capture(path).frames())
    assert [item.seq for item in frames] == list(range(len(frames)))
    assert 100 < len(frames) == seq - rec.unrecorded


def test_lossless_recording_stops_at_a_full_disk(tmp_path: Path) -> None:
    def write() -> None:
        rec = Recorder(tmp_path / "a.mcap", sources=SOURCES, utc_offset_ns=0, lossless=True)
        feed(rec, 0, 3000)
        rec.close()

    with file_size_limit(300_000), pytest.raises(CaptureError, match="File too large"):
        write()


def test_lossless_recording_waits_for_a_slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "_QUEUE_BYTES", 200_000)
    disk = SlowDisk(tmp_path, delay=0.01)
    rec = Recorder(disk.path, sources=SOURCES, utc_offset_ns=0, lossless=True)
    _, taken = feed(rec, 0, 3000)
    rec.close()
    assert rec.unrecorded == 0
    assert disk.frames() == taken


def test_a_slow_disk_never_holds_up_the_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "_QUEUE_BYTES", 200_000)
    disk = SlowDisk(tmp_path, delay=0.2)
    rec = Recorder(disk.path, sources=SOURCES, utc_offset_ns=0)
    taken: list[RawFrame] = []
    seq, worst = 0, 0.0
    for _ in range(300):
        started = time.perf_counter()
        seq, some = feed(rec, seq, 10)
        worst = max(worst, time.perf_counter() - started)
        taken += some
        time.sleep(0.001)
    rec.close()
    # a blocking write takes at least the reader's 200 ms; ten frames take some 20 us
    assert worst < 0.15
    assert rec.unrecorded > 0
    frames = disk.frames()
    assert {item.seq for item in frames} <= {item.seq for item in taken}
    assert len(frames) == seq - rec.unrecorded


class SlowDisk:
    """A pipe that is emptied slowly, in the place of a slow disk."""

    def __init__(self, folder: Path, delay: float) -> None:
        self.path = folder / "pipe"
        self._copy = folder / "received.mcap"
        self._delay = delay
        os.mkfifo(self.path)
        self._thread = threading.Thread(target=self._empty, name="disk")
        self._thread.start()

    def _empty(self) -> None:
        with self.path.open("rb", buffering=0) as stream, self._copy.open("wb") as copy:
            while part := stream.read(65536):
                copy.write(part)
                time.sleep(self._delay)

    def frames(self) -> list[RawFrame]:
        self._thread.join()
        return list(Capture(self._copy).frames())
