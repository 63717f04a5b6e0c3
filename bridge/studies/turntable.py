"""A calibration plan on the simulated bench: the scenario of a table that carries it out."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from msgspec.structs import replace

from bridge.calibration_plan import Plan, Site
from bridge.strict import wrong
from nav.calibrate.plan import Position
from virtual_bus.tables import EncoderTable
from virtual_bus.turntable import Hold, Move, Spin, TableErrors, Turntable, turntable

RATE_HZ: Final = 200.0
_REST_S: Final = 6.0  # before and after a rotation


def scenario_of(
    plan: Plan,
    site: Site | None,
    grade: str,
    rate_hz: float = RATE_HZ,
    soak: float | None = None,
    axes: Literal["cone", "skew"] | None = None,
) -> Turntable:
    """The table's scenario: every seed draws its errors, as large as the plan expects, and the unit's.

    Of a plan with several temperatures the steps at ``soak`` degC, by default at the first of them. ``axes``
    are those of a redundant unit.

    Raises:
        ConfigError: nobody said where the table stands, or the plan has no such temperature.
    """
    where, place = plan.at(site)
    if soak is None and plan.soaks:
        soak = plan.soaks[0]
    if soak is not None and soak not in plan.soaks:
        raise wrong(plan.file, "temperature.soak_deg_c", list(plan.soaks), f"{soak:g} among them")
    moves: list[Move] = []
    for step in plan.steps if soak is None else [one for one in plan.steps if one.temperature == soak]:
        if isinstance(step, Position):
            moves.append(Hold(step.C_gb, step.seconds))
        else:
            rest = Hold(step.C_gb, _REST_S)
            angle = float(np.sign(step.rate)) * 2.0 * np.pi * step.turns
            moves += [rest, Spin(step.axis, abs(step.rate), angle), rest]
    errors = TableErrors(*plan.sigmas, plan.position)
    encoder = None
    if plan.encoded:
        encoder = EncoderTable(
            axes=plan.encoder.axes, sigma_arcsec=float(np.degrees(plan.encoder.sigma)) * 3600.0
        )
    made = turntable(
        plan.title, grade, moves, where.lat_deg, where.height_m, place.gravity, errors, rate_hz, encoder
    )
    imu = replace(made.imu, axes=axes)
    return replace(made, imu=imu if soak is None else replace(imu, temperature_deg_c=(soak, soak)))
