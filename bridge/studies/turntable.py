"""A calibration plan on the simulated bench: the scenario of a table that carries it out."""

from __future__ import annotations

from typing import Final

import numpy as np

from bridge.calibration_plan import Plan, Site
from nav.calibrate.plan import Position
from virtual_bus.turntable import Hold, Move, Spin, TableErrors, Turntable, turntable

RATE_HZ: Final = 200.0
_REST_S: Final = 6.0  # before and after a rotation


def scenario_of(plan: Plan, site: Site | None, grade: str, rate_hz: float = RATE_HZ) -> Turntable:
    """The table's scenario: every seed draws its errors, as large as the plan expects, and the unit's.

    Raises:
        ConfigError: nobody said where the table stands.
    """
    where, place = plan.at(site)
    moves: list[Move] = []
    for step in plan.steps:
        if isinstance(step, Position):
            moves.append(Hold(step.C_gb, step.seconds))
        else:
            rest = Hold(step.C_gb, _REST_S)
            angle = float(np.sign(step.rate)) * 2.0 * np.pi * step.turns
            moves += [rest, Spin(step.axis, abs(step.rate), angle), rest]
    errors = TableErrors(*plan.sigmas)
    return turntable(plan.title, grade, moves, where.lat_deg, where.height_m, place.gravity, errors, rate_hz)
