"""What a simulated master sends: what it navigates, as the faults of a scenario let it say that."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_bus.faults import Faults, MasterFrozen, MasterLatency, MasterOutage, MasterTimeJump
from virtual_bus.master import Master, MasterBlock
from virtual_bus.truth import Times


class Said(NamedTuple):
    """Messages of n times; ``ahead_ns`` is added to the time that each tells.

    ``valid`` is false in an outage, ``silent`` where not even that is said.
    """

    block: MasterBlock
    valid: NDArray[np.bool_]
    silent: NDArray[np.bool_]
    ahead_ns: Times


class Sayings:
    """A master whose messages are ``age_ms`` older than they tell, and its faults."""

    def __init__(self, master: Master, age_ms: float, faults: Faults) -> None:
        self._master = master
        self._age_ns = round(1e6 * age_ms)
        self._faults = faults
        self._last: MasterBlock | None = None

    def at(self, t_ns: Times) -> Said:
        """What it says at ``t_ns`` (n,), later than any before."""
        n = len(t_ns)
        age_ns = np.full(n, self._age_ns)
        ahead_ns = np.zeros(n, np.int64)
        valid, silent, frozen = np.ones(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        for late in self._faults.of(MasterLatency):
            age_ns += late.during(t_ns) * round(1e6 * late.late_ms)
        for jump in self._faults.of(MasterTimeJump):
            ahead_ns += jump.during(t_ns) * round(1e6 * jump.ahead_ms)
        for outage in self._faults.of(MasterOutage):
            during = outage.during(t_ns)
            valid &= ~during
            silent |= during & outage.silent
        for freeze in self._faults.of(MasterFrozen):
            frozen |= freeze.during(t_ns)
        return Said(self._held(self._master.block(t_ns - age_ns), frozen), valid, silent, ahead_ns)

    def _held(self, block: MasterBlock, frozen: NDArray[np.bool_]) -> MasterBlock:
        """The last message before those that are ``frozen`` (n,) in their place, or the first of all."""
        rows = {field.name: getattr(block, field.name) for field in fields(MasterBlock)}
        before = self._last or MasterBlock(**{name: row[:1] for name, row in rows.items()})
        which = np.maximum.accumulate(np.where(frozen, 0, np.arange(1, len(frozen) + 1)))
        held = {name: np.concatenate((getattr(before, name), row))[which] for name, row in rows.items()}
        self._last = MasterBlock(**{name: row[-1:] for name, row in held.items()})
        return MasterBlock(**held)
