"""Across the poles, the date line and the equator: 24 h of pure inertial navigation with exact sensors.

Samples are integrals of rates that are known in closed form (`bridge.studies.figures.exact_increments`); the
program's strapdown kernel navigates by them (`bridge.studies.figures.flights`).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bridge.plots.style import AXES, BLUE, GREEN, GREY, INK, ORANGE, RED, Picture, broken
from bridge.studies.figures.exact_increments import GreatCircle, direction, integrals
from bridge.studies.figures.flights import PIECE_S, SAMPLES, Flight, Run, compare, fly, small_turn
from bridge.studies.figures.result import Result, Row
from nav import rotation as rot
from nav.strapdown.azimuth import NorthLawRefusal, refuse_latitude
from nav.strapdown.kernels import X_C

Array = NDArray[np.float64]

HOURS: Final = 24
FLIGHT_HZ: Final = 50.0
STATIC_HZ: Final = 10.0
SPEED: Final = 250.0  # m/s, 900 km/h
HEIGHT: Final = 10_000.0
RADIUS: Final = 6_377_000.0  # mean curvature of a meridian at that height, which makes that the mean speed
TURN: Final = math.radians(60.0) / 3600.0  # of the rotating law, rad/s
ATTITUDE: Final = (math.radians(30.0), math.radians(2.0), math.radians(-3.0))
"""Heading, pitch and roll of the instruments against the path."""

STATIC_LIMIT_M: Final = 1.0
FLIGHT_LIMIT_M: Final = 10.0
ANGLE_LIMIT_ARCSEC: Final = 0.3  # 10 m seen from the Earth's centre
AGREE: Final = 1e-9
REFUSED_DEG: Final = 85.0
_MINUTE_DEG: Final = 0.15  # what a flight gains in a minute, rounded up
_ARCSEC: Final = 648_000.0 / math.pi

PLACES: Final = {
    "at 45 deg": (45.0, 20.0),
    "on equator and date line": (0.0, 180.0),
    "11 m from the pole": (89.9999, -70.0),
    "at the north pole": (90.0, 0.0),
    "at the south pole": (-90.0, 0.0),
}


def at_rest(lat_deg: float, lon_deg: float) -> GreatCircle:
    """A body that does not move."""
    _, north, up = direction(lat_deg, lon_deg)
    return GreatCircle(up, north, 0.0, 0.0, rot.dcm_from_euler(*ATTITUDE))


def cruise(lat_deg: float, lon_deg: float, course_deg: float) -> GreatCircle:
    """A great circle at 900 km/h from a place and a course."""
    east, north, up = direction(lat_deg, lon_deg)
    course = math.radians(course_deg)
    forward = math.cos(course) * north + math.sin(course) * east
    return GreatCircle(up, forward, SPEED / RADIUS, HEIGHT, rot.dcm_from_euler(*ATTITUDE))


OVER: Final = cruise(-10.0, 180.0, 0.0)
"""From the tropics up the date line, over the pole after 12 h, down the meridian of Greenwich."""
BESIDE: Final = cruise(-10.0, 180.0, math.degrees(1000.0 / 6.4e6 / math.cos(math.radians(10.0))))
"""The same, about a kilometre beside the pole."""
UP_TO_60: Final = cruise(0.0, 170.0, 30.0)
EQUATOR: Final = cruise(0.0, 170.0, 90.0)


def runs(path: GreatCircle, *laws: str, rate_hz: float = FLIGHT_HZ) -> dict[str, Run]:
    """Navigate ``path`` for a day under each of ``laws``."""
    flights = {law: Flight(path, law, TURN if law == "rotating" else 0.0) for law in laws}
    return fly(flights, rate_hz, HOURS)


def compute() -> Result:
    """All rows; about ten seconds of processor time."""
    rows: list[Row] = []
    for name, where in PLACES.items():
        still = runs(at_rest(*where), "wander", "free", "rotating", rate_hz=STATIC_HZ)
        worst = max(float(run.horizontal.max()) for run in still.values())
        rows.append(_below(f"rest {name}, three laws", worst, STATIC_LIMIT_M, "m"))
    over, beside = runs(OVER, "wander", "free", "rotating"), runs(BESIDE, "wander", "north")
    middle, equator = runs(UP_TO_60, "wander", "free", "rotating", "north"), runs(EQUATOR, "wander")
    for name, run in over.items():
        rows += _errors(f"over the pole, {name}", run)
    rows += _errors("1 km beside the pole, wander", beside["wander"])
    rows += _errors("along the equator, wander", equator["wander"])
    for name, run in middle.items():
        rows += _errors(f"up to 60 deg, {name}", run)
    rows += _agreement(middle)
    rows += refusal()
    worst = float(beside["north"].horizontal.max())
    why = "beyond its limit and so refused by the bridge; shown for what the refusal is there for"
    rows.append(Row("1 km beside the pole, north", None, worst, "", None, "m", why))
    notes = [
        f"24 h each, exact sensors, {SAMPLES} samples an update at {FLIGHT_HZ:g} Hz ({STATIC_HZ:g} Hz at "
        f"rest). Great circles at {HEIGHT / 1e3:g} km, 900 km/h (within 1 %: the vertical turns steadily); "
        "height is slaved to truth through the kernel's height channel, critically damped with 30 s.",
        "Azimuth errors are turns about the true vertical: errors of true heading where there is a north. "
        "Laws: wander, free (azimuth gyro not torqued), rotating (60 deg/h), north.",
    ]
    numbers = _numbers(over, beside["north"])
    return Result("Pure inertial across pole, date line and equator", rows, notes, numbers)


def refusal() -> list[Row]:
    """Fly towards the pole under the north law until it refuses, asked once a minute."""
    flight = Flight(OVER, "north")
    samples = integrals(OVER.rates, 1.0 / FLIGHT_HZ, HOURS * 60, round(PIECE_S * FLIGHT_HZ))
    for minute, piece in enumerate(samples, 1):
        state = flight.navigate(piece, 1.0 / FLIGHT_HZ)
        lat = math.asin(state[X_C + 8])
        try:
            refuse_latitude("north", lat)
        except NorthLawRefusal:
            found = math.degrees(lat)
            inside = REFUSED_DEG < found < REFUSED_DEG + _MINUTE_DEG
            error = compare(OVER, np.array([minute * PIECE_S]), state[None])
            tolerance = f"{REFUSED_DEG:g} to {REFUSED_DEG + _MINUTE_DEG:g}"
            return [
                Row("north law refuses at", None, found, tolerance, inside, "deg"),
                _below("north law when it refuses", float(error.horizontal[0]), FLIGHT_LIMIT_M, "m"),
            ]
    return [Row("north law refuses at", None, 90.0, "before the pole", False, "deg")]


def _below(name: str, found: float, limit: float, unit: str) -> Row:
    # a comparison that is not true of NaN either
    return Row(name, None, found, f"below {limit:g}", found < limit, unit)


def _errors(name: str, run: Run) -> list[Row]:
    azimuth, level = (float(np.abs(angle).max()) * _ARCSEC for angle in (run.azimuth, run.level))
    return [
        _below(f"{name}: horizontal", float(run.horizontal.max()), FLIGHT_LIMIT_M, "m"),
        _below(f"{name}: azimuth", azimuth, ANGLE_LIMIT_ARCSEC, "arcsec"),
        _below(f"{name}: level", level, ANGLE_LIMIT_ARCSEC, "arcsec"),
    ]


def _agreement(found: dict[str, Run]) -> list[Row]:
    """Largest differences of any law from wander."""
    base = found["wander"]
    up = UP_TO_60.vertical(base.t)[0]
    others = [run for law, run in found.items() if law != "wander"]
    position = max(_relative(run.position, base.position) for run in others)
    velocity = max(_relative(run.velocity, base.velocity) for run in others)
    turns = [np.sum(small_turn(run.C_eb, base.C_eb) * up, axis=-1) for run in others]
    heading = max(float(np.abs(turn).max()) for turn in turns)
    return [
        _below("four laws agree: position", position, AGREE, "relative"),
        _below("four laws agree: velocity", velocity, AGREE, "relative"),
        _below("four laws agree: heading", heading, AGREE, "rad"),
    ]


def _relative(a: Array, b: Array) -> float:
    return float((np.linalg.norm(a - b, axis=-1) / np.linalg.norm(b, axis=-1)).max())


def _numbers(over: dict[str, Run], north: Run) -> dict[str, Any]:
    """What the picture shows, every ten minutes."""
    every = slice(9, None, 10)
    t = over["wander"].t[every]
    up, forward = OVER.vertical(t)[0], OVER.attitude(t)[:, :, 1]
    east = np.cross((0.0, 0.0, 1.0), up)
    heading = np.arctan2(np.sum(forward * east, -1), np.sum(forward * np.cross(up, east), -1))
    tracks = {"over the pole": OVER, "up to 60 deg": UP_TO_60, "along the equator": EQUATOR}
    return {
        "hours": (t / 3600.0).tolist(),
        "pole_hours": math.radians(100.0) / OVER.rate / 3600.0,
        "horizontal_m": {law: run.horizontal[every].tolist() for law, run in over.items()},
        "azimuth_arcsec": {law: (run.azimuth[every] * _ARCSEC).tolist() for law, run in over.items()},
        "north_m": north.horizontal[every].tolist(),
        "heading_deg": (np.degrees(heading) % 360.0).tolist(),
        "bearing_deg": {law: (np.degrees(run.bearing[every]) % 360.0).tolist() for law, run in over.items()},
        "tracks_deg": {name: _track(path, t) for name, path in tracks.items()},
    }


def _track(path: GreatCircle, t: Array) -> dict[str, list[float]]:
    x, y, z = path.vertical(t)[0].T
    return {"lat": np.degrees(np.arcsin(z)).tolist(), "lon": np.degrees(np.arctan2(y, x)).tolist()}


def draw(result: Result, path: Path) -> None:
    """Where the flights lead, their errors, and headings across the pole."""
    picture = Picture(
        result.title, "24 h at 900 km/h, exact sensors, height slaved to truth; dotted: the pole", 2, 2, 7.6
    )
    (chart, error), (heading, azimuth) = picture.axes
    numbers = result.numbers
    hours = numbers["hours"]
    _chart(chart, numbers["tracks_deg"])
    for law, colour in zip(numbers["horizontal_m"], AXES, strict=True):
        error.plot(hours, numbers["horizontal_m"][law], color=colour, label=f"{law}, over the pole")
        azimuth.plot(hours, 1e6 * np.array(numbers["azimuth_arcsec"][law]), color=colour, label=law)
        bearing = broken(np.array(numbers["bearing_deg"][law]), 180.0)
        heading.plot(hours, bearing, color=colour, label=f"{law}, in n")
    error.plot(hours, numbers["north_m"], color=RED, label="north, 1 km beside it")
    error.axhline(FLIGHT_LIMIT_M, color=INK, linestyle="--", linewidth=0.9, label="limit")
    error.set_yscale("log")
    error.set_ylim(1e-7, 1e4)
    heading.set_ylim(-15.0, 450.0)
    heading.plot(
        hours, broken(np.array(numbers["heading_deg"]), 90.0), color=INK, linewidth=2.0, label="true"
    )
    heading.set_yticks(range(0, 361, 90))
    for axes, label in (
        (error, "horizontal error (m)"),
        (heading, "heading (deg)"),
        (azimuth, "azimuth error (µarcsec)"),
    ):
        axes.set_ylabel(label)
        axes.set_xlim(0.0, HOURS)
        axes.set_xticks(range(0, HOURS + 1, 4))
        axes.set_xlabel("time (h)")
        axes.axvline(numbers["pole_hours"], color=GREY, linestyle=":", linewidth=1.2, ymax=0.82)
        axes.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)
    picture.save(path)


def _chart(axes: Axes, tracks: dict[str, dict[str, list[float]]]) -> None:
    """The Earth from above the north pole; the distance from the middle is that from the pole."""
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    for distance in (30.0, 60.0, 90.0):
        axes.plot(distance * np.sin(turn), distance * np.cos(turn), color="#D5D9DE", linewidth=0.8)
        axes.text(2.0, -distance, f"{90.0 - distance:g}°", ha="left", va="bottom", color=GREY, fontsize=8)
    for lon in range(0, 180, 30):
        x, y = 105.0 * math.sin(math.radians(lon)), 105.0 * math.cos(math.radians(lon))
        axes.plot([-x, x], [-y, y], color="#D5D9DE", linewidth=0.8)
    axes.text(0.0, -108.0, "Greenwich", ha="center", va="top", color=GREY, fontsize=8)
    axes.text(0.0, 108.0, "date line", ha="center", va="bottom", color=GREY, fontsize=8)
    for (name, track), colour in zip(tracks.items(), (BLUE, ORANGE, GREEN), strict=True):
        angle, away = np.radians(track["lon"]), 90.0 - np.array(track["lat"])
        right, up = away * np.sin(angle), -away * np.cos(angle)
        axes.plot(right, up, color=colour, linewidth=2.0, label=name)
        axes.plot(right[0], up[0], "o", color=colour, ms=6)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
