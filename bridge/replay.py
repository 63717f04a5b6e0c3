"""Play a capture through an engine and compare the digest with the one recorded.

A capture that was cut off by a kill has no final digest, but its checkpoints still verify everything
up to the last of them. Where they do not, the largest deviation from the solutions that were kept with
the checkpoints says how far apart the two runs are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from bridge.digest import combine
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.outputs import Checkpoint, Output, SolutionOut
from bridge.recording import Capture
from bridge.recording_capture import checkpoint
from bridge.recording_format import DIGEST
from bridge.recording_host import differences
from nav.earth import geodetic_to_xyz
from nav.types import S, Solution

_OURS: Final = frozenset({"navbridge", "sources_sha256"})


class Engine(Protocol):
    """What a replay needs of an engine."""

    def feed(self, frame: RawFrame) -> Sequence[Output]:
        """What follows from one more frame."""
        ...

    def digests(self) -> Mapping[str, str]:
        """Final digest of each navigator so far."""
        ...


@dataclass(slots=True)
class Deviation:
    """Largest differences between recorded and replayed solutions of equal times.

    ``compared`` counts the pairs, ``missing`` those recorded that the replay does not have.
    """

    compared: int = 0
    missing: int = 0
    horizontal_m: float = 0.0
    height_m: float = 0.0
    velocity_m_s: float = 0.0
    attitude_deg: float = 0.0

    def take(self, recorded: Sequence[float | None], replayed: Solution) -> None:
        """Compare one pair; parts that either does not have yet are left out."""
        old = [math.nan if value is None else value for value in recorded]
        new = replayed.state.tolist()
        self.compared += 1
        # at one height, in space: longitude starts again on the date line and means nothing at a pole
        places = (geodetic_to_xyz(row[S.LAT], row[S.LON], 0.0) for row in (new, old))
        self.horizontal_m = _larger(self.horizontal_m, math.dist(*places))
        self.height_m = _larger(self.height_m, abs(new[S.HEIGHT] - old[S.HEIGHT]))
        self.velocity_m_s = _larger(self.velocity_m_s, math.dist(new[S.V], old[S.V]))
        self.attitude_deg = _larger(self.attitude_deg, math.degrees(_angle(new[S.Q], old[S.Q])))

    def __str__(self) -> str:
        if not self.compared:
            return "no solution of both at the same instant: nothing to compare"
        return (
            f"largest deviation in {self.compared} solutions: {self.horizontal_m:.3g} m horizontal, "
            f"{self.height_m:.3g} m height, {self.velocity_m_s:.3g} m/s, {self.attitude_deg:.3g} deg"
        )


@dataclass(slots=True)
class Report:
    """What a replay found.

    ``recorded`` is the final digest of the recording (None: it was cut off), ``verified`` counts the
    checkpoints that agree. ``breaks_ns`` is the time at which frames are first marked as not recorded; what
    closes behind that mark cannot agree. ``failed`` is the first checkpoint before it that does not.
    ``lost_frames`` counts those that the recording says it has and that could not be read.
    ``machine`` names what differs between the recording machine and this one.
    """

    digest: str
    digests: dict[str, str]
    frames: int
    seconds: float
    replay_seconds: float
    recorded: str | None
    checkpoints: int
    verified: int
    failed: Checkpoint | None
    breaks_ns: int | None
    unrecorded: int
    damage: str | None
    lost_frames: int
    deviation: Deviation
    machine: list[str] = field(default_factory=list)

    @property
    def agrees(self) -> bool:
        """Whether everything that can be compared is equal."""
        broken = self.breaks_ns is not None or self.unrecorded > 0
        return self.failed is None and (broken or self.recorded in (None, self.digest))

    @property
    def other_machine(self) -> bool:
        """Whether hardware or libraries differ from those of the recording."""
        return bool(set(self.machine) - _OURS)


def replay(
    capture: Capture, engine: Engine, watch: Callable[[Sequence[Output]], object] | None = None
) -> Report:
    """Feed every frame to ``engine`` and compare; ``watch`` is shown the outputs of every frame."""
    result = capture.result() or {}
    links = list(capture.documents(DIGEST))
    expected = {(link["navigator"], link["index"]): checkpoint(link) for link in links}
    kept = {
        (link["navigator"], link["solution"]["t_ns"]): link["solution"]["state"]
        for link in links
        if link.get("solution")
    }
    deviation = Deviation()
    frames = verified = 0
    first_ns = last_ns = None
    breaks_ns: int | None = None
    failed: Checkpoint | None = None
    seen: set[tuple[str, int]] = set()
    started = time.perf_counter()
    feed = engine.feed
    for frame in capture.frames():
        frames += 1
        if frame.source == BRIDGE and frame.key == Event.UNRECORDED and breaks_ns is None:
            breaks_ns = frame.rx_ns
        last_ns = frame.rx_ns
        if first_ns is None:
            first_ns = last_ns
        outputs = feed(frame)
        if not outputs:
            continue
        for output in outputs:
            if isinstance(output, Checkpoint):
                key = (output.navigator, output.index)
                seen.add(key)
                if key in expected and expected[key].sha256 == output.sha256:
                    verified += 1
                elif key in expected and failed is None and breaks_ns is None:
                    failed = output
            elif isinstance(output, SolutionOut) and kept:
                state = kept.pop((output.navigator, output.solution.t_ns), None)
                if state is not None:
                    deviation.take(state, output.solution)
        if watch is not None:
            watch(outputs)
    elapsed = time.perf_counter() - started
    damage = capture.damage
    unrecorded = int(result.get("unrecorded", "0"))
    if failed is None and breaks_ns is None and not unrecorded:
        failed = next((item for key, item in expected.items() if key not in seen), None)
    deviation.missing = len(kept)
    digests = dict(engine.digests())
    return Report(
        digest=combine(digests),
        digests=digests,
        frames=frames,
        seconds=((last_ns or 0) - (first_ns or 0)) / 1e9,
        replay_seconds=elapsed,
        recorded=result.get("solution_sha256"),
        checkpoints=len(expected),
        verified=verified,
        failed=failed,
        breaks_ns=breaks_ns,
        unrecorded=unrecorded,
        damage=damage,
        lost_frames=max(0, int(result.get("frames", "0")) - unrecorded - frames),
        deviation=deviation,
        machine=differences(capture.metadata),
    )


def _larger(old: float, new: float) -> float:
    return new if new > old else old  # a NaN is never larger


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle between two attitudes, rad, exact for small ones."""
    difference = [
        a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2],
        a[0] * b[2] - a[2] * b[0] - a[3] * b[1] + a[1] * b[3],
        a[0] * b[3] - a[3] * b[0] - a[1] * b[2] + a[2] * b[1],
    ]
    return (
        2.0 * math.asin(min(1.0, math.hypot(*difference)))
        if all(map(math.isfinite, difference))
        else math.nan
    )
