"""What drivers make of the frames of a capture, in the order in which the engine would give them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from bridge.drivers.base import Driver
from bridge.engine import BACKWARDS_NS
from bridge.frame import RawFrame
from bridge.recording import Capture
from nav.types import Sample


def heard(capture: Capture, drivers: Iterable[Driver]) -> Iterator[tuple[RawFrame, Sequence[Sample]]]:
    """Every frame that some of ``drivers`` subscribe to, with engine time as its stamp, and their samples."""
    routes: dict[tuple[int, int], list[Driver]] = {}
    for driver in drivers:
        for key in driver.keys:
            routes.setdefault(key, []).append(driver)
    now_ns: int | None = None
    for frame in capture.frames():
        if now_ns is None or frame.rx_ns > now_ns:
            now_ns = frame.rx_ns
        elif frame.rx_ns < now_ns - BACKWARDS_NS:
            continue
        takers = routes.get((frame.source, frame.key))
        if takers is not None:
            frame = frame._replace(rx_ns=now_ns)
            yield frame, [sample for driver in takers for sample in driver.feed(frame)]
