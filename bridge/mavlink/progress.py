"""How far an alignment is, as the named values that any ground station plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from bridge.mavlink.telemetry import boot_ms
from bridge.outputs import Progress, Transfer


def alignment(progress: Progress) -> list[Any]:
    """NAMED_VALUE_FLOAT: progress in %, sigmas of level and heading and the heading's limit in deg."""
    east, north, up = progress.sigma
    values = {
        "AlignPct": 100.0 * progress.fraction,
        "AlignSigL": math.degrees(max(east, north)),
        "AlignSigH": math.degrees(up),
        "AlignLimH": math.degrees(progress.limit[2]),
    }
    return _named(progress.t_ns, values)


def transfer(known: Transfer) -> list[Any]:
    """NAMED_VALUE_FLOAT: sigmas of phi about east, north, up in mrad, and the mounting found, in deg."""
    values = {f"XferSig{axis}": 1e3 * sigma for axis, sigma in zip("ENU", known.sigma, strict=True)}
    values |= {f"XferMnt{axis}": math.degrees(x) for axis, x in zip("XYZ", known.mounting, strict=True)}
    values["XferAgree"] = 100.0 * known.quality
    return _named(known.t_ns, values)


def _named(t_ns: int, values: Mapping[str, float]) -> list[Any]:
    t_ms = boot_ms(t_ns)
    return [
        dialect.MAVLink_named_value_float_message(t_ms, name.encode(), value)
        for name, value in values.items()
        if math.isfinite(value)
    ]
