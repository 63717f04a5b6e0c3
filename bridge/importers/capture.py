"""Writing imported frames as a capture that replays like one recorded live."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from bridge.config import Config
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.recording import Recorder


@dataclass(frozen=True, slots=True)
class Imported:
    """What an import wrote: frames by device source, and the time they span."""

    path: Path
    frames: dict[str, int]
    seconds: float


def write_capture(
    path: str | Path, received: Iterable[RawFrame], config: Config, utc_offset_ns: int, origin: str
) -> Imported:
    """Record ``received`` between a START and a STOP event; ``origin`` says where they came from.

    The frames are numbered anew in the order given.

    Raises:
        CaptureError: the file cannot be written.
    """
    names = {0: "bridge", **dict(enumerate(config.sources, start=1))}
    counts = dict.fromkeys(config.sources, 0)
    recorder = Recorder(
        path,
        sources=names,
        utc_offset_ns=utc_offset_ns,
        attachments=config.attachments(),
        metadata={"origin": origin},
        lossless=True,
    )
    try:
        seq, first_ns, last_ns = 0, 0, 0
        for frame in received:
            if seq == 0:
                first_ns = frame.rx_ns
                start = {"utc_ns": first_ns + utc_offset_ns, "monotonic_ns": first_ns}
                recorder.record(_event(0, first_ns, Event.START, start))
                seq = 1
            last_ns = frame.rx_ns
            recorder.record(frame._replace(seq=seq))
            counts[names[frame.source]] += 1
            seq += 1
        if seq:
            recorder.record(_event(seq, last_ns, Event.STOP, {"reason": "end of the import"}))
    finally:
        recorder.close()
    return Imported(Path(path), counts, (last_ns - first_ns) / 1e9)


def _event(seq: int, rx_ns: int, event: Event, body: Mapping[str, int | str]) -> RawFrame:
    return RawFrame(seq, rx_ns, BRIDGE, int(event), msgspec.json.encode(body))
