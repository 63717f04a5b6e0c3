"""The CRC of Profile 1 as a table, for kernels that read or write frames."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

_GENERATOR: Final = 0x1D


def _table() -> NDArray[np.int64]:
    table = np.arange(256)
    for _ in range(8):
        table = np.where(table & 0x80, table << 1 ^ _GENERATOR, table << 1) & 0xFF
    return table


CRC8: Final = _table()
"""CRC-8 SAE J1850 of each byte, "Specification of CRC Routines" (AUTOSAR document 016)."""
