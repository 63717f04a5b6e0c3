"""Coning: coefficients of the N-sample algorithms, and the drift that they leave.

Yan Gongmin, "On SINS In-movement Initial Alignment and Some Other Problems", 2008, chapter 7: Tables 7-1
and 7-2 beside the program's coefficients and rotation vectors, in double precision, and beside the drift
that the algorithms have without rounding (`bridge.studies.figures.coning_exact`).
"""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np

from bridge.plots.style import AXES, GREY, INK, RED, Picture, legend
from bridge.studies.figures.coning_exact import PI, Cone
from bridge.studies.figures.result import Result, Row
from bridge.studies.figures.sculling import ALPHA, FREQUENCY, SAMPLE, drift, sculling
from nav.strapdown.coning import coning_coefficients
from nav.strapdown.kernels import increments
from virtual_bus.ellipsoid import G0

TABLE_7_1: Final[dict[int, tuple[tuple[str, ...], str]]] = {
    1: ((), "1/12"),
    2: (("2/3",), "1/960"),
    3: (("27/20", "9/20"), "1/204120"),
    4: (("214/105", "92/105", "54/105"), "1/82575360"),
    5: (("1375/504", "650/504", "525/504", "250/504"), "1/54140625000"),
}
"""Samples to k_1 ... k_(N-1), and the factor of alpha^2 lambda_N^(2 N + 1) in the residual."""

ARCSEC: Final = PI / 648_000
ANGLES: Final = {'1"': ARCSEC, "1'": 60 * ARCSEC, "1 deg": 3600 * ARCSEC, "10 deg": 36_000 * ARCSEC}
TABLE_7_2: Final = {
    '1"': ("6.013e-7", "4.745e-10", "4.016e-13", "3.522e-16", "9.558e-19"),
    "1'": ("2.164e-3", "1.708e-6", "1.444e-9", "1.612e-12", "1.623e-12"),
    "1 deg": ("7.790", "6.148e-3", "4.596e-6", "4.480e-6", "2.103e-5"),
    "10 deg": ("771.242", "0.596", "-5.455e-3", "4.416e-2", "2.075e-2"),
}
"""Half angle to the drift of one to five samples in 60 s, arcsec, true minus computed."""
SAMPLE_S: Final = Decimal("0.01")
SECONDS: Final = 60
LAMBDA: Final = 2 * PI * SAMPLE_S  # at 1 Hz

_SWAPPED: Final = (
    "simulated and theoretical drift are interchanged in print: the printed number is the theory's"
)
_ROUNDING: Final = "the printed number carries the rounding of a simulation in double precision"
WHY: Final = {
    ('1"', 1): _SWAPPED,
    ('1"', 3): _SWAPPED,
    ('1"', 4): _ROUNDING,
    ('1"', 5): _ROUNDING + "; so does ours, which is therefore only shown",
    ("1'", 5): _ROUNDING,
    ("10 deg", 5): "misprint of the exponent: 2.075e-1",
}
"""Cells of Table 7-2 whose number is not that of the algorithm."""

ORDER_TOLERANCE: Final = 0.1
SHAKEN_TOLERANCE: Final = 0.05  # third orders of the tilt, against second ones that nearly cancel
COLOURS: Final = (*AXES, RED, GREY)


def kernel_drift(alpha: Decimal, lam: Decimal, samples: int, updates: int | None = None) -> Decimal:
    """Mean drift of an update, computed minus true, rad, of the program's rotation vectors.

    ``alpha`` half angle, ``lam`` turn of the cone in a sample, rad. Rounding differs with the phase: the mean
    is taken over ``updates``, by default as many as there are different ones at the step of Table 7-2.
    """
    cone = Cone(alpha, lam)
    updates = updates or math.lcm(samples, 100) // samples
    total = Decimal(0)
    inc = np.empty(6)
    for update in range(updates):
        first = update * samples
        d = np.zeros(6 * samples)
        d[: 3 * samples] = [float(x) for k in range(samples) for x in cone.increment(first + k)]
        increments(d, samples, inc)
        total += cone.drift([Decimal(float(x)) for x in inc[:3]], samples)
    return total / updates


def exact_drift(alpha: Decimal, lam: Decimal, samples: int) -> Decimal:
    """The same of the algorithm with the printed coefficients, without rounding."""
    return Cone(alpha, lam).algorithm_drift([Fraction(k) for k in TABLE_7_1[samples][0]])


def residual(samples: int) -> Fraction:
    """Factor of alpha^2 lambda_N^(2 N + 1) in what the program's coefficients leave: eqs. (7-15), (7-18)."""
    p = 2 * samples + 1
    k = coning_coefficients(samples) if samples > 1 else []
    left = Fraction(samples**p, 2)
    for j, k_j in enumerate(k, 1):
        left -= ((j + 1) ** p + (j - 1) ** p - 2 * j**p) * k_j
    return Fraction((-1) ** (samples + 1), math.factorial(p) * samples**p) * left


def compute() -> Result:
    """Tables 7-1 and 7-2, and how the drift falls with the step."""
    rows = _coefficients()
    for angle, printed in TABLE_7_2.items():
        rows += [_drift(angle, samples, text) for samples, text in enumerate(printed, 1)]
    # where the half angle is small, and where it is not: then a term of alpha^4 lambda^5 stays
    rows += [_order('1"', samples, 2 * samples) for samples in TABLE_7_1]
    rows += [_order("10 deg", samples, 4) for samples in (4, 5)]
    for samples in TABLE_7_1:
        rows += _shaken(samples)
    notes = [
        "Drift of Table 7-2 in 60 s, true minus computed, of a cone of 1 Hz sampled at 100 Hz. The closed "
        "form is the drift of the N-sample algorithm without rounding. Printed numbers are cut, not rounded: "
        "they are right to one unit of their last digit.",
        "Order: power of the step that the drift goes with, from samples of 0.2 and 0.4 rad of the cone at "
        '1", of 1 and 2 ms at 10 deg, where a term of alpha^4 lambda^5 is left whatever the samples.',
        "Shaken: 1 deg of coning at 10 Hz with 1 g of sculling, 200 Hz samples, 60 s through the whole "
        "kernel; coning as the turn about the cone's axis, sculling as mean acceleration along it. From "
        "three samples on sculling is what the kernel's third-order term leaves of turning gravity, which at "
        "a constant rate in an update would be -alpha^2 g lambda_N^4 / 180.",
    ]
    return Result(
        "Coning: coefficients and drift", rows, notes, {"angles": _sweep_angles(), "steps": _sweep_steps()}
    )


def _coefficients() -> list[Row]:
    rows = []
    for samples, (printed, last) in TABLE_7_1.items():
        k = coning_coefficients(samples) if samples > 1 else []
        for j, (text, value) in enumerate(zip(printed, k, strict=True), 1):
            same = value == Fraction(text)
            rows.append(
                Row(f"N={samples} k{j} = {value}", float(Fraction(text)), float(value), "equal", same, "")
            )
        left = residual(samples)
        name = f"N={samples} residual {left}"
        rows.append(Row(name, float(Fraction(last)), float(left), "equal", left == Fraction(last), ""))
    return rows


def _drift(angle: str, samples: int, printed: str) -> Row:
    per_minute = -Decimal(SECONDS) / (samples * SAMPLE_S) / ARCSEC
    ours = float(kernel_drift(ANGLES[angle], LAMBDA, samples) * per_minute)
    exact = float(exact_drift(ANGLES[angle], LAMBDA, samples) * per_minute)
    why = WHY.get((angle, samples), "")
    name, unit = f"{angle} N={samples}", "arcsec"
    if (angle, samples) == ('1"', 5):
        return Row(name, float(printed), ours, "", None, unit, why, exact)
    share = 2e-6 if samples <= 3 or "deg" in angle else 2e-3
    last_digit = float(Decimal((0, (1,), int(Decimal(printed).as_tuple().exponent))))
    passed = abs(ours - exact) <= share * abs(exact)
    if not why:
        passed = passed and abs(float(printed) - ours) <= last_digit
    return Row(name, float(printed), ours, f"{share:g} of closed form", passed, unit, why, exact)


def _order(angle: str, samples: int, theory: int) -> Row:
    lam = LAMBDA / 10 if "deg" in angle else Decimal("0.2")
    ratio = kernel_drift(ANGLES[angle], 2 * lam, samples) / kernel_drift(ANGLES[angle], lam, samples)
    order = math.log2(ratio) - 1.0  # of the drift in a given time
    passed = abs(order - theory) <= ORDER_TOLERANCE
    return Row(
        f"order {angle} N={samples}",
        None,
        order,
        f"within {ORDER_TOLERANCE:g}",
        passed,
        "",
        "",
        float(theory),
    )


def _shaken(samples: int) -> list[Row]:
    """Coning and sculling through the whole kernel."""
    lam = 2 * PI * Decimal(FREQUENCY) * Decimal(SAMPLE)
    per_minute = SECONDS / (samples * SAMPLE)
    turn, velocity = drift(samples)
    exact_turn = -float(exact_drift(Decimal(ALPHA), lam, samples)) * per_minute
    exact_velocity = sculling(samples)
    rows = []
    for kind, ours, exact, unit, factor in (
        ("coning", turn, exact_turn, "arcsec", 648_000.0 / math.pi),
        ("sculling", velocity, exact_velocity, "ug", 1e6 / (SECONDS * G0)),
    ):
        passed = abs(ours - exact) <= SHAKEN_TOLERANCE * abs(exact)
        tolerance = f"{SHAKEN_TOLERANCE:g} of closed form"
        name = f"shaken N={samples} {kind}"
        rows.append(Row(name, None, ours * factor, tolerance, passed, unit, "", exact * factor))
    return rows


Sweep = dict[str, list[dict[str, float]]]


def _sweep_angles() -> Sweep:
    """Drift in 60 s (arcsec) by samples and half angle (arcsec), at the step of Table 7-2."""
    angles = [Decimal(10) ** (Decimal(k) / 4) for k in range(-1, 20)]
    return {
        str(samples): [_point(float(one), one * ARCSEC, LAMBDA, samples) for one in angles]
        for samples in TABLE_7_1
    }


def _sweep_steps() -> Sweep:
    """Drift in 60 s (arcsec) by samples and step (ms), at a half angle of 1'."""
    steps = [Decimal(10) ** (Decimal(k) / 8) for k in range(17)]
    return {
        str(samples): [_point(float(one), ANGLES["1'"], one * LAMBDA / 10, samples) for one in steps]
        for samples in TABLE_7_1
    }


def _point(x: float, alpha: Decimal, lam: Decimal, samples: int) -> dict[str, float]:
    per_minute = float(SECONDS * 2 * PI / (samples * lam) / ARCSEC)  # at 1 Hz
    classical = float(residual(samples)) * float(alpha) ** 2 * float(samples * lam) ** (2 * samples + 1)
    return {
        "x": x,
        "ours": abs(float(kernel_drift(alpha, lam, samples, updates=4))) * per_minute,
        "exact": abs(float(exact_drift(alpha, lam, samples))) * per_minute,
        "classical": classical * per_minute,
    }


def draw(result: Result, path: Path) -> None:
    """Drift of one to five samples against half angle, and against the step."""
    picture = Picture(
        "Coning drift of the N-sample algorithms in 60 s",
        "cone of 1 Hz; lines: no rounding, dots: the program in double precision, dashes: classical residual",
        columns=2,
        height=5.6,
    )
    left, right = picture.axes[0]
    for axes, sweep in ((left, result.numbers["angles"]), (right, result.numbers["steps"])):
        for colour, (samples, points) in zip(COLOURS, sweep.items(), strict=True):
            x = [point["x"] for point in points]
            axes.plot(x, [point["classical"] for point in points], "--", color=colour, lw=0.8, alpha=0.7)
            label = "1 sample" if samples == "1" else f"{samples} samples"
            axes.plot(x, [point["exact"] for point in points], color=colour, label=label)
            axes.plot(x, [point["ours"] for point in points], "o", ms=3.5, color=colour)
        axes.set_xscale("log")
        axes.set_yscale("log")
    for angle, printed in TABLE_7_2.items():
        x = [float(ANGLES[angle] / ARCSEC)] * len(printed)
        mark = "Table 7-2" if angle == "1'" else None
        left.plot(x, [abs(float(one)) for one in printed], "s", ms=8, mfc="none", color=INK, label=mark)
    left.set_ylabel("drift (arcsec)")
    left.set_xlabel("half angle (arcsec), samples of 10 ms")
    right.set_xlabel("sample (ms), half angle 1 arcmin")
    legend(right)
    left.legend(*([one[-1:] for one in left.get_legend_handles_labels()]), loc="upper left")
    picture.save(path)
