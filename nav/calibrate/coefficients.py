"""The coefficients of a fit as a calibration file has them, each with its sigma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from nav.calibrate.model import LETTERS
from nav.calibrate.solve import Fit
from nav.types import Vector

KEYS: Final = (
    "scale",
    "scale_negative",
    "bias",
    "axes",
    "g_sensitivity",
    "square",
    "product",
    "scale_temperature",
    "bias_temperature",
)


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Values and sigmas, SI, of the gyros or the accelerometers of a unit, n of them, by `KEYS`.

    ``scale``, ``scale_negative``, ``bias`` (n,), ``axes``, ``g_sensitivity``, ``square``, ``product`` (n, 3);
    g sensitivity is of gyros, squares are of accelerometers. These and the coefficients of temperature,
    ``scale_temperature``, ``bias_temperature`` (n, order), are there if asked for.
    """

    value: dict[str, Vector]
    sigma: dict[str, Vector]


def coefficients(fit: Fit, gyros: bool) -> Coefficients:
    """Those of all gyros, or of all accelerometers, in the order of the model."""
    model = fit.model
    chosen = [k for k, one in enumerate(model.sensors) if one.gyro == gyros]
    value: dict[str, list[Vector]] = {key: [] for key in KEYS}
    sigma: dict[str, list[Vector]] = {key: [] for key in KEYS}

    def add(key: str, constant: Vector, rows: Vector) -> None:
        """A quantity that is ``constant`` (m,) plus ``rows`` (m, size) times the unknowns."""
        value[key].append(constant + rows @ fit.theta)
        sigma[key].append(np.sqrt(np.einsum("ij,jk,ik->i", rows, fit.covariance, rows)))

    for place in chosen:
        one = model.sensors[place]
        rows = {term: np.eye(model.size)[model.index(place, term)] for term in one.terms}
        uneven = 0.5 * rows.get("asymmetry", np.zeros(model.size))
        add("scale", np.array([one.scale]), one.scale * (rows["scale"] - uneven)[None])
        add("scale_negative", np.array([one.scale]), one.scale * (rows["scale"] + uneven)[None])
        add("bias", np.zeros(1), rows["bias"][None])
        add("axes", one.axis, one.across @ np.stack([rows[one.angle_of(k)] for k in (0, 1)]))
        if gyros:
            nothing = np.zeros(model.size)
            drift = [rows.get(f"g sensitivity {letter}", nothing) for letter in LETTERS]
            add("g_sensitivity", np.zeros(3), np.stack(drift))
        if len(one.forms):
            last = len(one.terms) - 2 * one.temperature_order
            own = np.stack([rows[term] for term in one.terms[last - len(one.forms) : last]])
            if not gyros:
                add("square", np.zeros(3), np.einsum("kii->ik", one.forms) @ own)
            pairs = np.stack([one.forms[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))])
            add("product", np.zeros(3), 2.0 * pairs @ own)
        if one.temperature_order:
            for what in ("scale", "bias"):
                powers = [rows[f"{what} temperature {j + 1}"] for j in range(one.temperature_order)]
                add(f"{what}_temperature", np.zeros(len(powers)), np.stack(powers))
    flat = ("scale", "scale_negative", "bias")

    def gathered(parts: dict[str, list[Vector]]) -> dict[str, Vector]:
        found = {key: np.array(rows) for key, rows in parts.items() if rows}
        return {key: rows[:, 0] if key in flat else rows for key, rows in found.items()}

    return Coefficients(gathered(value), gathered(sigma))
