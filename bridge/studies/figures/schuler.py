"""Errors at rest over a day: closed forms, matrix exponential and the navigation kernel side by side.

The textbook chapter "Inertial navigation", section 2.4.5, tables 2-9 and 2-10 with eqs. (2-90) to (2-98), and
section 2.5.2, eq. (2-104); the excerpt on psi-angle and phi-angle error models, eqs. (2.2.7) and (2.2.9).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.integrate import solve_ivp

from bridge.studies.figures.result import Result, Row
from bridge.studies.figures.schuler_plot import draw
from bridge.studies.figures.schuler_printed import MISPRINTS
from bridge.studies.figures.schuler_runs import (
    AMOUNT,
    ARCMIN,
    BIAS,
    CURVES,
    DAY,
    DEG_PER_H,
    DRIFT,
    EIGHTH,
    EVERY,
    LAT,
    MIDDLE,
    NAMES,
    NOISE,
    ORDER,
    RUNS,
    SHOWN,
    UG,
    Matrix,
    Rest,
    Vector,
    exponential,
    noisy_velocities,
)
from nav.earth import EARTH_RATE
from nav.errors.psi import alignment_dynamics, alignment_limit, observability_rank
from nav.errors.response import (
    SOURCES,
    STATES,
    Sphere,
    frequencies,
    responses,
    static_dynamics,
    velocity_variance,
)
from nav.filter.covariance import predict_readable
from nav.filter.kalman import update
from nav.filter.states import PHI

__all__ = ["compute", "draw"]

CLOSED: Final = 1e-9
KERNEL: Final = 1e-5
"""An update of half a second shifts the phase of a day's Schuler oscillation (107 rad) by its
(w_s dt)^2 / 12, 3e-8 of it or 3e-6 rad; third-order terms of 3e-3 rad of error add as much."""
SIGMAS: Final = 3.3  # one in a thousand

SYMBOLS: Final = dict(zip(STATES, ("v_E", "v_N", "lat", "lon", "phi_E", "phi_N", "phi_U"), strict=True))


def integral(F: Matrix, b: Vector, t: Vector, sphere: Sphere) -> Matrix:
    """States (7, len(t)) of ``dx/dt = F x + b`` from zero, by an eighth-order Runge-Kutta method.

    In units of like size: Earth radii, Schuler's speed and Schuler's time.
    """
    ws = sphere.schuler
    units = np.array([sphere.radius * ws] * 2 + [1.0] * 5)
    A, forced = F * units / units[:, None] / ws, b / units / ws
    solved = solve_ivp(
        lambda _, x: A @ x + forced,
        (0.0, t[-1] * ws),
        np.zeros(len(b)),
        method="DOP853",
        t_eval=t * ws,
        rtol=1e-13,
        atol=1e-14 * float(np.max(np.abs(forced))),
    )
    return np.asarray(solved.y * units[:, None])


def compute() -> Result:
    """All comparisons, of 0.01 deg/h and 100 micro-g."""
    t = np.arange(EVERY, DAY + 1, EVERY, dtype=np.float64)
    rest = Rest(LAT)
    rows = _cells(t, rest.sphere)
    coriolis, neglect = _coriolis(t, rest.sphere)
    kernel, dots = _kernel(rest, t)
    noise, spread = _noise()
    middle = Rest(MIDDLE)
    curves, mixed = _curves(middle, t)
    rows += [*coriolis, *kernel, *curves, *_roots(middle.sphere), *noise, *_equilibrium(middle)]
    rows += _alignment(middle)
    notes = [
        f"Cells: error after {SHOWN // 3600} h of 0.01 deg/h (drift of a platform) or 100 ug at 40 deg, on a "
        "sphere of the local Gaussian radius. Ours is the numerical integral of (2-90) without Coriolis "
        "terms, the closed form the table's, corrected where it says so; judged over 24 h. In table 2-10 the "
        "cell of v_N for accel E holds the formula of gyro E; without Coriolis terms it is zero.",
        "Neglect of Coriolis: largest difference that dropping +-2 w_ie sin L makes in 24 h, as part of the "
        "largest value; the matrix exponential of the whole matrix is the truth. Shown: the worse velocity.",
        "Kernel: half the difference of navigations with plus and minus the sensor error, against the matrix "
        "exponential of the ellipsoid with the height channel: the largest of seven states in 24 h. Second "
        "order: what one navigation has beyond that, mostly the square of its position error.",
        "Figure 2-26: the errors named there, gyros, accelerometers and misalignments at once; judged with a "
        "tenth of them.",
        f"Noise: {RUNS} navigations by the kernel at the equator, seed 1, 10 ug/sqrt(Hz) on accel E.",
        "Alignment at rest, psi form: sigma of a filter that is told 100 ug and 0.02 deg/h and sees rest to "
        "0.1 m/s every second, with noise of 10 ug/sqrt(Hz) and 0.002 deg/sqrt(h); limits by (2-104).",
    ]
    numbers = {"neglect": neglect, "kernel": dots, "curves": mixed, "noise": spread}
    return Result("Errors at rest: Schuler, Foucault and Earth oscillations", rows, notes, numbers)


def _in(state: str) -> tuple[float, str]:
    return (1.0, "m/s") if state.startswith("v_") else (ARCMIN, "arcmin")


def _cells(t: Vector, sphere: Sphere) -> list[Row]:
    """The 28 cells that are not zero, against integration without Coriolis terms."""
    F, G = static_dynamics(LAT, sphere, coriolis=False)
    closed = responses(t, LAT, sphere) * AMOUNT[:, None, None]
    at = int(np.flatnonzero(t == SHOWN)[0])
    rows = []
    for i, source in enumerate(SOURCES):
        ours = integral(F, G[:, i] * AMOUNT[i], t, sphere)
        for j, state in enumerate(STATES):
            size = float(np.max(np.abs(closed[i, j])))
            if size == 0.0:
                continue
            scale, unit = _in(state)
            printed, why = closed[i, j, at], ""
            if (source, state) in MISPRINTS:
                form, why = MISPRINTS[source, state]
                printed = math.nan if form is None else float(form(t, LAT, sphere)[at]) * AMOUNT[i]
            passed = bool(np.max(np.abs(ours[j] - closed[i, j])) <= CLOSED * size)
            rows.append(
                Row(
                    f"{SYMBOLS[state]} of {NAMES[source]}",
                    None if math.isnan(printed) else float(printed) / scale,
                    float(ours[j, at]) / scale,
                    f"{CLOSED:g} of its largest",
                    passed,
                    unit,
                    why,
                    float(closed[i, j, at]) / scale,
                )
            )
    return rows


def _coriolis(t: Vector, sphere: Sphere) -> tuple[list[Row], dict[str, dict[str, float]]]:
    """The matrix exponential with Coriolis terms, checked by integration, and what their neglect does."""
    F, G = static_dynamics(LAT, sphere, coriolis=True)
    closed = responses(t, LAT, sphere)
    worst, rows, neglect = 0.0, [], {}
    for i, source in enumerate(SOURCES):
        truth = exponential(F, G[:, i], EVERY, len(t)).T
        size = np.max(np.abs(truth), axis=1)
        worst = max(worst, float(np.max(np.abs(integral(F, G[:, i], t, sphere) - truth) / size[:, None])))
        missed = np.max(np.abs(closed[i] - truth), axis=1) / size
        neglect[source] = {state: float(part) for state, part in zip(STATES, missed, strict=True)}
        j = int(np.argmax(missed[:2]))
        name = f"neglect of Coriolis, {SYMBOLS[STATES[j]]} of {NAMES[source]}"
        rows.append(Row(name, None, 100.0 * float(missed[j]), "", None, "%"))
    check = Row(
        "exponential, integral", None, worst, f"{CLOSED:g} of the largest", worst <= CLOSED, "of the largest"
    )
    return [check, *rows], neglect


def _kernel(rest: Rest, t: Vector) -> tuple[list[Row], dict[str, list[list[float]]]]:
    """The navigation kernel against the matrix exponential; some of the errors, to be drawn."""
    F, G = rest.model()
    exact = rest.navigate(np.zeros(6), DAY, EVERY)
    drift = float(np.hypot(exact[-1, 0], exact[-1, 1] * math.cos(LAT))) * rest.sphere.radius
    rows = [Row("kernel, exact sensors, 24 h", None, drift, "1 m", drift < 1.0, "m")]
    dots = {}
    for i, source in enumerate(SOURCES):
        # what a platform's drift is, a strapdown gyro reads too little
        e = np.zeros(6)
        e[i] = -AMOUNT[i] if i < 3 else AMOUNT[i]
        plus, minus = rest.navigate(e, DAY, EVERY), rest.navigate(-e, DAY, EVERY)
        linear = exponential(F, G @ e, EVERY, len(t))
        size = np.max(np.abs(linear[:, ORDER]), axis=0)
        off = float(np.max(np.abs(0.5 * (plus - minus) - linear)[:, ORDER] / size))
        beyond = float(np.max(np.abs(0.5 * (plus + minus) - exact)[:, ORDER] / size))
        asked, unit = f"{KERNEL:g} of the largest", "of the largest"
        rows.append(Row(f"kernel, exponential, {NAMES[source]}", None, off, asked, off <= KERNEL, unit))
        rows.append(Row(f"second order, {NAMES[source]}", None, beyond, "", None, unit))
        dots[source] = _short(plus - exact)
    return rows, dots


def _short(errors: Matrix) -> list[list[float]]:
    """The seven states at every third moment, six digits each."""
    return [[float(f"{one:.6g}") for one in state] for state in errors[2::3, ORDER].T]


def _curves(rest: Rest, t: Vector) -> tuple[list[Row], dict[str, list[list[float]]]]:
    """Figure 2-26: several errors and initial misalignments at once, kernel against matrix exponential."""
    F, G = rest.model()
    rows, dots = [], {}
    for name, mixture in CURVES.items():
        e, start = mixture.inputs()
        linear = exponential(F, G @ e, EVERY, len(t), start)
        size = np.max(np.abs(linear[:, ORDER]), axis=0)
        # 70 km of error are not small: third-order terms of a tenth of it are
        ends = [rest.navigate(part * e, DAY, EVERY, part * start[PHI]) for part in (0.1, -0.1)]
        off = float(np.max(np.abs(5.0 * (ends[0] - ends[1]) - linear)[:, ORDER] / size))
        title = f"kernel, exponential, figure 2-26 ({name})"
        rows.append(Row(title, None, off, f"{KERNEL:g} of the largest", off <= KERNEL, "of the largest"))
        dots[name] = _short(rest.navigate(e, DAY, EVERY, start[PHI]))
    return rows, dots


def _roots(sphere: Sphere) -> list[Row]:
    """Frequencies of the matrix of (2-90), and the periods named in the text."""
    F, _ = static_dynamics(MIDDLE, sphere, coriolis=True)
    units = np.array([sphere.radius * sphere.schuler] * 2 + [1.0] * 5)
    roots = np.linalg.eigvals(np.delete(np.delete(F * units / units[:, None], 3, 0), 3, 1)).imag
    found = [float(root) for root in np.sort(roots[roots > 0.0])]
    w, fast, slow = frequencies(MIDDLE, sphere)
    f = sphere.rate * math.sin(MIDDLE)
    why = "(2-95) takes w_s for the root of w_s^2 + w_f^2"
    rows = []
    for name, printed, ours, exact, reason in (
        ("w_e", w, found[0], w, ""),
        ("w_s - w_f", sphere.schuler - f, found[1], slow, why),
        ("w_s + w_f", sphere.schuler + f, found[2], fast, why),
    ):
        passed = abs(ours - exact) <= CLOSED * exact
        asked = f"{CLOSED:g} of it"
        rows.append(
            Row(f"root {name}", 1e3 * printed, 1e3 * ours, asked, passed, "mrad/s", reason, 1e3 * exact)
        )
    turn = 2.0 * math.pi
    periods = (
        ("Schuler's period", 84.4, turn / sphere.schuler / 60.0, 0.1, "min"),
        ("Foucault's period", 34.0, turn / f / 3600.0, 1.0, "h"),
        ("Earth's period", 24.0, turn / w / 3600.0, 1.0, "h"),
    )
    rows += [
        Row(name, text, ours, "its last digit", abs(ours - text) <= last, unit)
        for name, text, ours, last, unit in periods
    ]
    return rows


def _noise() -> tuple[list[Row], dict[str, list[float]]]:
    """(2-98): the spread of kernels with a noisy accelerometer, where no Coriolis term mixes the channels."""
    rest = Rest(0.0, rate=1)
    seconds = 5 * EIGHTH
    # level frequency of the east channel: the radius of the equator
    w_s = math.sqrt(rest.gravity / 6_378_137.0)
    every = EIGHTH // 3
    t = np.arange(every, seconds + 1, every, dtype=np.float64)
    velocities = noisy_velocities(rest, NOISE**2, RUNS, seconds, every, seed=1)
    ours = np.sqrt(np.mean(velocities**2, axis=0))
    exact = np.sqrt(velocity_variance(t, NOISE**2, w_s))
    printed = NOISE * np.sqrt(0.5 * t + np.sin(2.0 * w_s * t) / (2.0 * w_s))
    band = SIGMAS / math.sqrt(2.0 * RUNS)
    rows = []
    for k, moment in ((2, "630 s"), (len(t) - 1, "3150 s")):
        passed = abs(float(ours[k] / exact[k]) - 1.0) <= band
        asked = f"{100.0 * band:.0f} %, {RUNS} runs"
        why = "(2-98) prints the sine over 2 w_s, it is 4 w_s"
        rows.append(
            Row(
                f"sigma of v_E, noise, {moment}",
                1e3 * float(printed[k]),
                1e3 * float(ours[k]),
                asked,
                passed,
                "mm/s",
                why,
                1e3 * float(exact[k]),
            )
        )
    return rows, {
        "t": t.tolist(),
        "ours": ours.tolist(),
        "closed": exact.tolist(),
        "printed": printed.tolist(),
    }


def _equilibrium(rest: Rest) -> list[Row]:
    """(2-104): the numbers of the text, and the kernel started at the limit: it must stay at rest."""
    north = EARTH_RATE * math.cos(MIDDLE)
    rows = []
    for name, text, ours in (
        ("azimuth for 0.01 deg/h", 1.0, DRIFT / north),
        ("azimuth, 0.005 deg/sqrt(h), 15 min", 1.0, math.radians(0.005) / 60.0 / (north * 30.0)),
        ("azimuth for 1 ug/s", 20.0, UG / (rest.gravity * north)),
    ):
        passed = abs(1e3 * ours - text) <= 0.1 * text
        rows.append(Row(name, text, 1e3 * ours, "0.1 of it", passed, "mrad"))
    e = np.zeros(6)
    e[0], e[3] = -DRIFT, BIAS
    phi = np.array(alignment_limit(MIDDLE, rest.gravity, (BIAS, 0.0), DRIFT))
    speeds = []
    for sign in (-1.0, 1.0):
        errors = rest.navigate(e, 3600, 60, phi * np.array([1.0, sign, 1.0]))
        speeds.append(float(np.max(np.hypot(errors[:, 3], errors[:, 4]))))
    why = "(2-104) prints phi_x and phi_y for accelerometers that read gravity, against (2-89)"
    # products of 1 mrad of azimuth with 0.1 mrad of tilt, times g / w_s
    asked = "1e-3 m/s"
    rows.append(
        Row("speed in 1 h from (2-104)", speeds[0], speeds[1], asked, speeds[1] < 1e-3, "m/s", why, 0.0)
    )
    return rows


def _alignment(rest: Rest) -> list[Row]:
    """What alignment at rest can see in the psi form, and how far a filter comes in 15 min."""
    rows = []
    # velocity in g / w_e, accelerometers in g, drifts in w_e: all of order one
    for vertical, seen in ((False, 7), (True, 9)):
        F = alignment_dynamics(rest.lat, rest.gravity, vertical)
        k = 3 if vertical else 2
        g, w = rest.gravity, EARTH_RATE
        size = np.array([g / w] * k + [1.0] * 3 + [g] * k + [w] * 3)
        rank = observability_rank(F * size / size[:, None], k, 1.0 / w)
        rows.append(Row(f"observable of {len(F)} states", None, rank, "equal", rank == seen, "", "", seen))
    u, drift = 100.0 * UG, 0.02 * DEG_PER_H
    walk = 0.002 * math.radians(1.0) / 60.0
    F = alignment_dynamics(rest.lat, rest.gravity)
    P = np.diag(np.square([0.1] * 2 + [math.radians(1.0)] * 3 + [u] * 2 + [drift] * 3))
    q = np.square([NOISE] * 2 + [walk] * 3 + [0.0] * 5)
    H, R, X = np.eye(10)[:2], 0.01 * np.eye(2), np.zeros((10, 2))
    dx, S = np.empty(10), np.empty((2, 2))
    for _ in range(900):
        P = predict_readable(P, F, q, 1.0)
        update(P, H, np.zeros(2), R, X, np.inf, dx, S)
    sigma = np.sqrt(np.diag(P))[2:5] / ARCMIN
    azimuth = math.hypot(
        alignment_limit(rest.lat, rest.gravity, (u, 0.0), 0.0)[2],
        alignment_limit(rest.lat, rest.gravity, (0.0, 0.0), drift)[2],
    )
    for name, ours, limit, part in (
        ("psi_E", sigma[0], u / rest.gravity, 0.01),
        ("psi_N", sigma[1], u / rest.gravity, 0.01),
        ("psi_U", sigma[2], azimuth, 0.05),
    ):
        exact = limit / ARCMIN
        passed = bool(abs(ours - exact) <= part * exact)
        asked = f"{100 * part:g} % of the limit"
        rows.append(Row(f"sigma of {name}, 15 min", None, float(ours), asked, passed, "arcmin", "", exact))
    return rows
