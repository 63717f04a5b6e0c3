"""The driver protocol: what a driver is, what it is built from, and a line of the table of drivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from bridge.drivers.counters import Counters
from bridge.drivers.device_clock import ClockPort, DeviceClock
from bridge.errors import ConfigError
from bridge.frame import RawFrame
from bridge.options import DeviceOptions
from bridge.strict import unknown, wrong
from bridge.wire import message
from dbc.codec import Contract, MessageCodec, contract
from nav.types import Sample

Samples = Sequence[Sample]


class Driver(Protocol):
    """What the engine asks of a device."""

    @property
    def keys(self) -> Sequence[tuple[int, int]]:
        """The (source, key) pairs it subscribes to."""
        ...

    @property
    def counters(self) -> Counters:
        """What it counts."""
        ...

    def feed(self, frame: RawFrame) -> Samples:
        """The samples that ``frame`` completes; often none."""
        ...


@dataclass(frozen=True)
class Context:
    """What a driver is built from besides its own options."""

    name: str  # of the device
    source: int  # number of its source
    file: str  # the configuration's, for error messages
    files: Mapping[str, bytes]  # by the name that the options give
    clock: DeviceClock
    contract: Contract = field(default_factory=contract)

    def message(self, name: str) -> MessageCodec:
        """The codec of a message; raises ConfigError where the contract in force has it not."""
        return message(self.contract, name)

    def port(self, modulus_ns: int | None, latency_ms: float) -> ClockPort:
        """A counter of this device on its (possibly shared) clock; ``modulus_ns`` None: it never wraps."""
        return self.clock.port(modulus_ns, round(latency_ms * 1e6))

    def wrong(self, key: str, found: object, expected: str) -> ConfigError:
        """The error for a value of this device's table."""
        return wrong(self.file, f"device.{self.name}.{key}", found, expected)

    def unknown(self, key: str, found: str, names: Sequence[str]) -> ConfigError:
        """The error for a name of this device's table that is not among ``names``."""
        return unknown(self.file, f"device.{self.name}.{key}", found, names)


class Entry(NamedTuple):
    """One line of `DRIVERS`: options, factory ``(options, context) -> driver``, kind of its source, and
    more."""

    options: type[DeviceOptions]
    factory: Callable[[Any, Context], Driver]
    source_type: str
    provides: Callable[[Any], frozenset[str]]
    """From the options to the kinds of samples: "imu", "odometer", "speed", "gnss", "baro", "master"."""
