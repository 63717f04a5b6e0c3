"""What a navigator reports besides its solutions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from nav.types import Mode, Solution


@dataclass(frozen=True, slots=True)
class ModeChange:
    """The navigator changed its mode at ``t_ns``, and why."""

    t_ns: int
    old: Mode
    new: Mode
    reason: str


class Innovation(NamedTuple):
    """One measurement against its prediction: residuals (computed minus measured) and sigmas, SI units.

    ``kind`` is a name of the table of measurements. ``nis`` is the normalised innovation squared.
    """

    t_ns: int
    kind: str
    residual: tuple[float, ...]
    sigma: tuple[float, ...]
    nis: float
    accepted: bool


@dataclass(frozen=True, slots=True)
class Refusal:
    """A sample of ``device`` was not used: ``reason`` is "stale", "invalid" or "standby"."""

    t_ns: int
    device: str
    reason: str


@dataclass(frozen=True, slots=True)
class AlignmentProgress:
    """How far the alignment is (0 to 1) and what its attitude is good for, rad (3,) east, north, up.

    ``limit`` (3,) rad is the sigma that it cannot beat, ``method`` its name, ``restarts`` how often it had to
    start again; ``behind``: it is going through stored samples.
    """

    t_ns: int
    progress: float
    sigma: tuple[float, float, float]
    method: str = ""
    limit: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    behind: bool = False
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class TransferProgress:
    """What a transfer alignment knows at ``t_ns``, relative to its master; rad.

    ``matching`` is the key of `nav.transfer.MATCHINGS`. ``sigma`` (3,) is that of phi about east, north, up;
    ``mounting`` (3,), about right, forward, up of a, what the slave is turned beyond its configured C_ab, to
    ``sigma_mounting`` (3,). ``observability``: of each estimated state, by name, what is left of its first
    sigma (1: nothing was learnt of it). ``hint``: the manoeuvre that would show what is least known
    against what is asked for, or nothing. ``quality``: 0 to 1, share of late messages that agreed.
    """

    t_ns: int
    matching: str
    sigma: tuple[float, float, float]
    mounting: tuple[float, float, float]
    sigma_mounting: tuple[float, float, float]
    observability: tuple[tuple[str, float], ...]
    hint: str
    quality: float


@dataclass(frozen=True, slots=True)
class Notice:
    """Something an operator should read once."""

    t_ns: int
    text: str


NavEvent = Solution | ModeChange | Innovation | Refusal | AlignmentProgress | TransferProgress | Notice
