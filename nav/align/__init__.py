"""Alignment: finding the attitude at which navigation starts.

`ALIGNMENTS` names them for the configuration; `begin`, `advance` and `result` run one.
"""

from __future__ import annotations

from typing import Final

from nav.align.compass import ONCE, RAPID
from nav.align.gnss_moving import GNSS
from nav.align.inertial import ALL, DOUBLE, SINGLE
from nav.align.kalman import CLOSED, OPEN, PSI
from nav.align.large import LARGE
from nav.align.level import LEVEL
from nav.align.match import MATCH
from nav.align.moving_compass import MOVING
from nav.align.odometer import ODOMETER
from nav.align.open_loop import OPEN_LOOP
from nav.align.static import ANALYTIC, COARSE
from nav.align.stored import STORED
from nav.align.types import (
    AlignConfig,
    Alignment,
    AlignStatus,
    NavInit,
    Run,
    advance,
    begin,
    lack,
    result,
)

ALIGNMENTS: Final[dict[str, Alignment]] = {
    "static": Alignment(needs=frozenset(), stages=(COARSE, PSI)),
    "motion": Alignment(needs=frozenset({"gnss"}), stages=(LEVEL, MATCH)),
    "analytic": Alignment(needs=frozenset(), stages=(ANALYTIC,)),
    "open_loop": Alignment(needs=frozenset(), stages=(COARSE, OPEN_LOOP)),
    "stored": Alignment(needs=frozenset({"heading"}), stages=(STORED,)),
    "kalman_closed": Alignment(needs=frozenset(), stages=(COARSE, CLOSED)),
    "kalman_open": Alignment(needs=frozenset(), stages=(COARSE, OPEN)),
    "kalman_psi": Alignment(needs=frozenset(), stages=(COARSE, PSI)),
    "gyrocompass": Alignment(needs=frozenset(), stages=(ONCE,)),
    "rapid_gyrocompass": Alignment(needs=frozenset(), stages=(RAPID,)),
    "moving_gyrocompass": Alignment(needs=frozenset({"odometer"}), stages=(MOVING,)),
    "inertial_single": Alignment(needs=frozenset(), stages=(SINGLE,)),
    "inertial": Alignment(needs=frozenset(), stages=(DOUBLE,)),
    "inertial_wahba": Alignment(needs=frozenset(), stages=(ALL,)),
    "odometer": Alignment(needs=frozenset({"odometer"}), stages=(ODOMETER,)),
    "gnss": Alignment(needs=frozenset({"gnss"}), stages=(GNSS,)),
    "large_angle": Alignment(needs=frozenset(), stages=(LARGE, PSI)),
}

__all__ = [
    "ALIGNMENTS",
    "AlignConfig",
    "AlignStatus",
    "Alignment",
    "NavInit",
    "Run",
    "advance",
    "begin",
    "lack",
    "result",
]
