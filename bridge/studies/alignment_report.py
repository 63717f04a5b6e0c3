"""What alignments on a capture came to, as a table for people and as JSON for programs."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any

from bridge.commands import LACKS
from bridge.studies.alignment_table import Found

_HEADS = ("alignment", "heading", "pitch", "roll", "sigma", "limit", "level")
_BESIDE = ("error", "e/sigma")


def lines_of(found: Sequence[Found], bound_deg: float) -> list[str]:
    """The table for people, and why what was refused was."""
    has_truth = any(one.error_deg is not None for one in found)
    heads = [*_HEADS, f"< {bound_deg:g} deg", "ended", *(_BESIDE if has_truth else ())]
    rows = [heads, *([one.method, *_cells(one, bound_deg, has_truth)] for one in found)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
    lines = [
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    lines.insert(1, "-" * max(map(len, lines)))
    lines.append(
        "angles and sigmas in deg; sigma, limit and error of heading, level the larger sigma of the other "
        "two; limit what these sensors can do on a base that goes nowhere (gnss: on its way); times in s: "
        "when the sigma of heading fell below the bound for good, and when it handed over"
    )
    mounting = max((one.mounting_sigma_deg for one in found if one.error_deg is not None), default=0.0)
    if mounting > 0.0:
        lines.append(
            f"the error is the vehicle's: in e/sigma there are {mounting:.3g} deg for the IMU's mounting, too"
        )
    return lines + _reasons(found)


def _cells(one: Found, bound_deg: float, has_truth: bool) -> list[str]:
    """A row but for its name; dashes where there is nothing to say."""
    ended = _seconds(one.ended_s)
    if one.ended_s is None:
        ended = "not run" if one.lacks else "refused" if one.refusals else "-"
    if one.attitude_deg is None:
        return ["-"] * len(_HEADS) + [ended] + ["-"] * (len(_BESIDE) if has_truth else 0)
    pitch, roll, heading = one.attitude_deg
    sigma, limit = one.sigma_deg or (math.nan,) * 3, one.limit_deg or (math.nan,) * 3
    cells = [
        "-" if math.isnan(heading) else f"{heading % 360.0:.3f}",
        f"{pitch:.4f}",
        f"{roll:.4f}",
        "-" if math.isnan(heading) else f"{sigma[2]:.3g}",
        f"{limit[2]:.3g}",
        f"{max(sigma[:2]):.2g}",
        _seconds(one.converged_s(bound_deg)),
        ended,
    ]
    if has_truth:
        error = one.error_deg[2] if one.error_deg is not None else math.nan
        whole = math.hypot(sigma[2], one.mounting_sigma_deg)
        cells += [f"{error:+.3f}", f"{error / whole:+.2f}"] if math.isfinite(error) else ["-", "-"]
    return cells


def refusals_of(one: Found) -> list[str]:
    """When and why it was refused; reasons that differ by their numbers alone once."""
    kinds: dict[str, list[tuple[float, str]]] = {}
    for t_s, why in one.refusals:
        kinds.setdefault(re.sub(r"[\d.]+", "", why), []).append((t_s, why))
    lines = []
    for again in kinds.values():
        t_s, why = again[0]
        times = "once" if len(again) == 2 else f"{len(again) - 1} times"
        more = f" (and {times} more, till {again[-1][0]:.1f} s)" if len(again) > 1 else ""
        lines.append(f"refused after {t_s:.1f} s: {why}{more}")
    return lines


def _reasons(found: Sequence[Found]) -> list[str]:
    """What was not run and what was refused, and why; of which the same is true in one line."""
    told: dict[str, list[str]] = {}
    for one in found:
        lacks = [f"not run, it needs {LACKS[one.lacks][1]}"] if one.lacks else []
        for line in [*lacks, *refusals_of(one)]:
            told.setdefault(line, []).append(one.method)
    return [f"{', '.join(methods)}: {line}" for line, methods in told.items()]


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def document_of(found: Sequence[Found], bound_deg: float) -> dict[str, Any]:
    """The same for programs."""
    axes, about = ("pitch", "roll", "heading"), ("east", "north", "up")

    def named(names: Sequence[str], values: tuple[float, ...] | None) -> dict[str, float | None] | None:
        if values is None:
            return None
        return {name: v if math.isfinite(v) else None for name, v in zip(names, values, strict=True)}

    return {
        "bound_deg": bound_deg,
        "alignments": [
            {
                "method": one.method,
                "lacks": one.lacks or None,
                "attitude_deg": named(axes, one.attitude_deg),
                "sigma_deg": named(about, one.sigma_deg),
                "limit_deg": named(about, one.limit_deg),
                "error_deg": named(axes, one.error_deg),
                "converged_s": one.converged_s(bound_deg),
                "right_s": one.right_s(bound_deg),
                "ended_s": one.ended_s,
                "seconds": one.seconds,
                "restarts": one.restarts,
                "refusals": [{"t_s": t_s, "why": why} for t_s, why in one.refusals],
            }
            for one in found
        ],
    }


def json_of(found: Sequence[Found], bound_deg: float) -> str:
    """`document_of` as text."""
    return json.dumps(document_of(found, bound_deg), indent=2, allow_nan=False)
