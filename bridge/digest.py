"""The digest of a solution: what "the same bits" means.

Every solution of a navigator is one canonical row: ``t_ns``, ``mode``, ``flags`` and the state as
little-endian float64, every NaN with one bit pattern. The rows of one second of engine time form a
block, and blocks are chained, ``H_k = SHA256(H_{k-1} || block_k)``, so the checkpoints that survive
a killed process still verify the part before them.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from typing import Final

import numpy as np

from bridge.outputs import Checkpoint
from nav.jit import in_place
from nav.types import Solution, Vector

_SECOND_NS: Final = 1_000_000_000
_ROW: Final = struct.Struct("<qHI")
_GENESIS: Final = bytes(32)


def canonical_row(solution: Solution) -> bytes:
    """Bytes that enter the digest for one solution: t_ns int64, mode uint16, flags uint32, state float64."""
    state = solution.state
    if _holds_nan(state):
        # its sign and payload depend on how it came about
        state = np.where(np.isnan(state), np.nan, state)
    return _ROW.pack(solution.t_ns, solution.mode, solution.flags) + state.tobytes()


@in_place
def _holds_nan(state: Vector) -> bool:
    found = False
    for i in range(state.shape[0]):
        found = found or np.isnan(state[i])
    return bool(found)


class DigestChain:
    """Chained SHA-256 over the solutions of one navigator.

    A solution that begins a later second than any before closes the block in progress; one that
    is stamped earlier joins it.
    """

    def __init__(self, navigator: str) -> None:
        self.navigator = navigator
        self._head = _GENESIS
        self._index = 0
        self._second: int | None = None
        self._block = hashlib.sha256(_GENESIS)
        self._t_ns = 0
        self._rows = 0

    def add(self, solution: Solution) -> Checkpoint | None:
        """Take one solution; return the checkpoint of the block that it closes, if it closes one."""
        second = solution.t_ns // _SECOND_NS
        closed: Checkpoint | None = None
        if self._second is None:
            self._second = second
        elif second > self._second:
            self._second = second
            self._head = self._block.digest()
            self._index += 1
            closed = Checkpoint(self._t_ns, self.navigator, self._index, self._head.hex())
            self._block = hashlib.sha256(self._head)
            self._rows = 0
        self._block.update(canonical_row(solution))
        self._t_ns = solution.t_ns
        self._rows += 1
        return closed

    def final(self) -> str:
        """Digest of everything so far, the open block included, as hexadecimal."""
        return (self._block.digest() if self._rows else self._head).hex()


def combine(digests: Mapping[str, str]) -> str:
    """One digest for a whole run: SHA-256 over navigator names and their digests, sorted by name."""
    lines = "".join(f"{name} {digests[name]}\n" for name in sorted(digests))
    return hashlib.sha256(lines.encode()).hexdigest()
