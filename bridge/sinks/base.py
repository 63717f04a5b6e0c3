"""What a sink is, and what it is given when it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from bridge.mavlink.peer import MavlinkPeer
from bridge.options import SinkOptions
from bridge.outputs import Output, SolutionOut, Transmit
from dbc.codec import Contract, contract


class Sink(Protocol):
    """Turns what the engine put out into frames to send.

    A sink is as pure as the engine: what it sends and when follows from the outputs alone, time
    being theirs. It never raises on an output.
    """

    def consume(self, outputs: Sequence[Output]) -> list[Transmit]:
        """Frames to send after ``outputs`` of one engine step, in order."""
        ...


@dataclass(frozen=True, slots=True)
class SinkContext:
    """What a sink is built from besides its own options.

    ``name`` is the sink's, ``source`` the number of the source it sends on; ``peer`` our end of that
    link where it speaks MAVLink; ``files`` the bytes of the files by the name that the options give;
    ``contract`` what our own frames look like.
    """

    name: str
    source: int
    peer: MavlinkPeer | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    contract: Contract = field(default_factory=contract)


class Entry(NamedTuple):
    """One line of `SINKS`: options, factory ``(options, context) -> sink``, and the kind of its source."""

    options: type[SinkOptions]
    factory: Callable[[Any, SinkContext], Sink]
    source_type: str


def output_time_ns(output: Output) -> int | None:
    """Engine time of an output; None where it has none."""
    match output:
        case SolutionOut():
            return output.latest_rx_ns
        case Transmit():
            return None
        case _:
            return output.t_ns
