"""The engine: a pure fold over recorded frames.

A frame goes to the drivers that subscribed to its key, their samples to the navigators that listen to the
device, and what comes out is put into the words of bridge.outputs. No clock is read, no socket touched, no
random number drawn; what a frame can cost is bounded.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from bridge.commands import METHODS, Command, CommandCode, Verdict, judge
from bridge.config import Config
from bridge.digest import DigestChain
from bridge.drivers import DRIVERS
from bridge.drivers.base import Context, Driver
from bridge.drivers.counters import Counters
from bridge.drivers.device_clock import DeviceClock
from bridge.followers import Follower, as_master, in_order
from bridge.frame import BRIDGE, Event, RawFrame
from bridge.mavlink.peer import MavlinkPeer
from bridge.navigators import build_navigator, lacking, provided
from bridge.options import MavlinkSource
from bridge.outputs import (
    Checkpoint,
    FixOut,
    Health,
    Output,
    Reject,
    Severity,
    SolutionOut,
    Text,
    Transmit,
    sensors_changed,
)
from bridge.said import said
from bridge.silence import Silence
from bridge.warm import warm_up
from bridge.wire import message
from nav import events
from nav.navigator import Navigator
from nav.types import GnssFix, ImuChange, Sample, Solution

SECOND_NS: Final = 1_000_000_000
QUIET_NS: Final = 10 * SECOND_NS
"""A navigator does not say the same again within this."""
BACKWARDS_NS: Final = SECOND_NS
"""Stamps of different sockets cross by less; a frame further back than this is turned away."""

_NOTHING: Final[tuple[Output, ...]] = ()
_NUMBERS: Final = re.compile(r"-?\d+(\.\d+)?")
_REFUSALS: Final = {"stale": Reject.STALE, "invalid": Reject.INVALID}
_MEASURES: Final = {
    "gnss_position": "gnss",
    "gnss_velocity": "gnss",
    "barometer": "baro",
    "odometer": "odometer",
    "speed": "speed",
}
"""Kind of sample behind each kind of innovation; the others come from no device."""


class _Line(NamedTuple):
    """One navigator with its digest; ``sensors`` are the counters behind each kind of innovation."""

    name: str
    navigator: Navigator
    chain: DigestChain
    sensors: dict[str, Counters]


class _Route(NamedTuple):
    """A driver and the navigators that listen to it."""

    feed: Callable[[RawFrame], Sequence[Sample]]
    driver: Driver
    lines: tuple[_Line, ...]


class Engine:
    """Everything downstream of the recorder.

    ``peers`` are our ends of the MAVLink links by source number; a telemetry sink on a link is made with
    its peer. ``accept`` says, by source number, which keys anybody wants; a MAVLink source is not there:
    its peer listens to more than is worth listing.

    It has every kernel compiled when it is made, unless told not to ``warm`` them. Raises ConfigError when
    the configuration asks for what a driver or navigator cannot do.
    """

    def __init__(self, config: Config, *, warm: bool = True) -> None:
        self._now = 0
        self._next_health = 0  # engine time, so at the first frame
        self._unchained: list[tuple[DigestChain, Solution]] = []
        self._closed: list[Checkpoint] = []
        self._silence: Silence | None = None
        self._quiet_until: dict[str, int] = {}
        self._unknown = 0
        self._dropped = 0
        self._unrecorded = 0
        self._refused: Counter[str] = Counter()
        self._names = dict(enumerate(config.sources, start=1))
        self._drivers = build_drivers(config)
        self._lines = [
            _Line(name, build_navigator(name, config), DigestChain(name), self._sensors(name, config))
            for name in in_order(config.navigators)
        ]
        self._followers: dict[str, list[tuple[_Line, Follower]]] = {}
        for line in self._lines:
            master = config.navigators[line.name].master_navigator
            if master is not None:
                follower = line, Follower(config.navigators[line.name].transfer.rate_hz)
                self._followers.setdefault(master, []).append(follower)
        self._lacking = {name: lacking(name, config) for name in config.navigators}
        self._waiting = [line for line in self._lines if config.navigators[line.name].autostart]
        self._routes: dict[tuple[int, int], tuple[_Route, ...]] = {}
        for name, driver in self._drivers.items():
            lines = tuple(line for line in self._lines if name in config.navigators[line.name].devices)
            route = _Route(driver.feed, driver, lines)
            for key in driver.keys:
                self._routes[key] = (*self._routes.get(key, ()), route)

        self.peers: dict[int, MavlinkPeer] = {}
        self.accept: dict[int, frozenset[int]] = {}
        self._command_codec = message(config.contract, "COMMAND")
        self._ack_codec = message(config.contract, "COMMAND_ACK")
        self._ack_alive = 0
        table = tomllib.loads(config.resolved_toml())
        for number, options in enumerate(config.sources.values(), start=1):
            if isinstance(options, MavlinkSource):
                self.peers[number] = MavlinkPeer(number, options, table, self._judge)
            else:
                keys = {key for source, key in self._routes if source == number}
                self.accept[number] = frozenset(keys | {self._command_codec.frame_id})
        self._heard = frozenset((BRIDGE, *self.peers) if self.peers else ())  # sources that peers listen to
        if warm:
            # those that a command can start, and the one of a navigator that was cut off
            needs = [need for by_method in self._lacking.values() for need in by_method.items()]
            warm_up(frozenset(("motion", *(method for method, lacks in needs if not lacks))))

    def _sensors(self, name: str, config: Config) -> dict[str, Counters]:
        kinds = provided(name, config)
        # where two devices measure the same, the innovation does not say which of them it was
        return {
            measure: self._drivers[kinds[kind][0]].counters
            for measure, kind in _MEASURES.items()
            if kind in kinds
        }

    @property
    def navigators(self) -> dict[str, Navigator]:
        """The navigators by name, for who studies them; what they say comes out of `feed`."""
        return {line.name: line.navigator for line in self._lines}

    def digests(self) -> dict[str, str]:
        """Digest of each navigator's solutions up to now."""
        self._chain()
        return {line.name: line.chain.final() for line in self._lines}

    def feed(self, frame: RawFrame) -> Sequence[Output]:
        """What follows from one more frame."""
        seq, rx_ns, source, key, data = frame
        if rx_ns > self._now:
            self._now = rx_ns
        elif rx_ns < self._now:
            if rx_ns < self._now - BACKWARDS_NS:
                for route in self._routes.get((source, key), ()):
                    route.driver.counters.reject(Reject.STALE)
                return _NOTHING
            frame = RawFrame(seq, self._now, source, key, data)
        out: list[Output] = []
        if self._unchained:
            self._chain()
            out += self._closed
            self._closed.clear()
        if self._now >= self._next_health:
            self._second(out)
        routes = self._routes.get((source, key))
        if routes is not None:
            for feed, _, lines in routes:
                samples = feed(frame)
                if not samples:
                    continue
                for sample in samples:
                    if type(sample) is GnssFix:
                        out.append(FixOut(self._now, sample.device, sample))
                    elif type(sample) is ImuChange:
                        out += sensors_changed(self._now, sample)
                    for line in lines:
                        if heard := line.navigator.step(sample):
                            self._take_all(line, heard, out)
        elif source == BRIDGE:
            self._event(frame, out)
        elif source not in self.peers:
            if key == self._command_codec.frame_id:
                self._can_command(frame, out)
            else:
                self._unknown += 1
        if source in self._heard:
            self._ask_peers(frame, out)
        return out

    def _chain(self) -> None:
        """Take solutions into their digests: with the next frame, while nobody waits for a solution."""
        for chain, solution in self._unchained:
            checkpoint = chain.add(solution)
            if checkpoint is not None:
                self._closed.append(checkpoint)
        self._unchained.clear()

    def _take_all(self, line: _Line, heard: Sequence[events.NavEvent], out: list[Output]) -> None:
        """Put what a navigator said into the outputs' words."""
        for event in heard:
            if type(event) is Solution:
                out.append(SolutionOut(line.name, event, self._now))
                self._unchained.append((line.chain, event))
                for slave, follower in self._followers.get(line.name, ()):
                    if follower.wants(event.t_ns):
                        self._take_all(slave, slave.navigator.step(as_master(event, line.name)), out)
            else:
                self._take(line, event, out)

    def _take(self, line: _Line, event: events.NavEvent, out: list[Output]) -> None:
        output = said(line.name, event)
        if output is not None:
            out.append(output)
        match event:
            case events.Innovation():
                if not event.accepted and event.kind in line.sensors:
                    line.sensors[event.kind].reject(Reject.GATE)
            case events.Refusal():
                reason = _REFUSALS.get(event.reason)
                if reason is not None and event.device in self._drivers:
                    self._drivers[event.device].counters.reject(reason)
            case events.Notice():
                # an alignment that is refused at every sample says so at every sample, each time with
                # other numbers; another cause is told at once
                text = f"{line.name}: {event.text}"
                stem = _NUMBERS.sub("", text)
                if self._now >= self._quiet_until.get(stem, 0):
                    self._quiet_until[stem] = self._now + QUIET_NS
                    out.append(Text(self._now, Severity.NOTICE, text))

    def _second(self, out: list[Output]) -> None:
        """What happens at the first frame, and then at the first of every second."""
        now = self._now
        self._next_health = (now // SECOND_NS + 1) * SECOND_NS
        devices = {name: driver.counters.health(now) for name, driver in self._drivers.items()}
        if self._silence is None:
            counters = {name: driver.counters for name, driver in self._drivers.items()}
            self._silence = Silence(counters, now)
            for line in self._waiting:
                self._take_all(line, line.navigator.start(now), out)
            return
        out.append(Health(now, devices, self._unknown, self._dropped, self._unrecorded, dict(self._refused)))
        for name, driver in self._drivers.items():
            notes = driver.counters.notes
            if notes:
                out.extend(Text(now, Severity.WARNING, f"{name}: {note}") for note in notes)
                notes.clear()
        out.extend(Text(now, *text) for text in self._silence.second(now))

    # commands

    def _judge(self, code: int, argument: int) -> Verdict:
        return judge(code, argument, self._lacking)

    def _order(self, code: int, argument: int, out: list[Output]) -> Verdict:
        verdict = self._judge(code, argument)
        out.extend(Text(self._now, Severity.WARNING, text) for text in verdict.texts)
        for line in self._lines:
            if line.name not in verdict.methods:
                continue
            if code in (CommandCode.STOP, CommandCode.RESTART):
                self._take_all(line, line.navigator.stop(self._now), out)
            if code in (CommandCode.START_ALIGNMENT, CommandCode.RESTART):
                self._take_all(line, line.navigator.start(self._now, verdict.methods[line.name]), out)
        return verdict

    def _can_command(self, frame: RawFrame, out: list[Output]) -> None:
        codec = self._command_codec
        if not codec.crc_ok(frame.data):
            self._unknown += 1
            return
        number, argument = codec.decode(frame.data)
        verdict = self._order(int(number), int(argument), out)
        ack = self._ack_codec
        data = ack.encode(self._ack_alive, number, verdict.result, verdict.reason)
        self._ack_alive = (self._ack_alive + 1) % ack.alive_modulus
        out.append(Transmit(frame.source, ack.frame_id, data))

    def _ask_peers(self, frame: RawFrame, out: list[Output]) -> None:
        for number, peer in self.peers.items():
            if frame.source in (number, BRIDGE):
                for answer in peer.feed(frame):
                    if isinstance(answer, Command):
                        self._order(answer.code, answer.argument, out)
                    else:
                        out.append(answer)

    # the bridge's own events

    def _event(self, frame: RawFrame, out: list[Output]) -> None:
        if frame.key == Event.TICK:
            return
        try:
            body = json.loads(frame.data)
            text = self._border(frame.key, body, out)
        except (ValueError, KeyError, TypeError, AttributeError):
            self._unknown += 1
            return
        if text is not None:
            out.append(Text(self._now, *text))

    def _border(self, key: int, body: dict[str, Any], out: list[Output]) -> tuple[Severity, str] | None:
        """What the border has to say, for the counters and for the operator."""
        match key:
            case Event.DROPPED:
                self._dropped += int(body["frames"])
                return Severity.WARNING, f"{body['frames']} frames lost before they were read"
            case Event.UNRECORDED:
                self._unrecorded += int(body["frames"])
                return Severity.ERROR, f"{body['frames']} frames not recorded: the disk is too slow or full"
            case Event.CLOCK_STEP:
                return Severity.NOTICE, f"the wall clock stepped by {int(body['step_ns']) / 1e9:+.3f} s"
            case Event.BUS_STATE:
                return Severity.WARNING, f"bus {body['source']}: {body['text']}"
            case Event.PEER:
                return Severity.INFO, str(body["text"])
            case Event.REFUSED:
                return self._refuse(body)
            case Event.COMMAND:
                self._order(*_command(body), out)
        return None

    def _refuse(self, body: dict[str, Any]) -> tuple[Severity, str] | None:
        reason, name = str(body["reason"]), self._names[body["source"]]
        unit = "packets" if "packets" in body else "bytes"
        count = int(body[unit])
        self._refused[reason] += count
        stem = f"{name}: refused, {reason}"
        if self._now < self._quiet_until.get(stem, 0):
            return None
        self._quiet_until[stem] = self._now + QUIET_NS
        return Severity.WARNING, f"{stem}: {count} {unit if count > 1 else unit[:-1]}"


def _command(body: Mapping[str, Any]) -> Command:
    """A console's request; ValueError or KeyError where there is no such command."""
    method = body.get("method")
    return Command(CommandCode[str(body["command"]).upper()], 0 if method is None else METHODS[str(method)])


def build_drivers(config: Config) -> dict[str, Driver]:
    """A driver for every device of ``config``, those that share a clock on one clock."""
    shared: dict[str, DeviceClock] = {}
    drivers: dict[str, Driver] = {}
    for name, options in config.devices.items():
        clock = DeviceClock() if options.clock is None else shared.setdefault(options.clock, DeviceClock())
        number = config.source_number(options.source)
        context = Context(name, number, config.file, config.files, clock, config.contract)
        drivers[name] = DRIVERS[options.driver].factory(options, context)
    return drivers
