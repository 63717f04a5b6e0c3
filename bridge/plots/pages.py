"""The pictures, a function each: from a run's data to a `Picture`, or None where there is nothing to show."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Final

import numpy as np

from bridge.evaluate import Errors, SolutionTable, coverage, errors
from bridge.outputs import Innovation
from bridge.plots.data import Array, PlotData
from bridge.plots.style import (
    AXES,
    BLUE,
    GREY,
    INK,
    ORANGE,
    RED,
    Picture,
    band,
    broken,
    fit,
    legend,
    line,
    modes,
    thin,
    time_axis,
)
from nav.earth import ecef, position_quat
from nav.rotation import quat_conjugate, quat_rotate
from nav.types import S, SolutionFlag

_DEG: Final = 180.0 / np.pi
_DEG_H: Final = _DEG * 3600.0
_MG: Final = 1e3 / 9.80665
_ENU: Final = ("east", "north", "up")
_RESIDUALS: Final[dict[str, tuple[tuple[str, ...], str, float]]] = {
    "gnss_position": (("x of n", "y of n", "up"), "m", 1.0),
    "gnss_velocity": (("x of n", "y of n", "up"), "m/s", 1.0),
    "zero_velocity": (("x of n", "y of n", "up"), "m/s", 1.0),
    "zero_rate": (("x of b", "y of b", "z of b"), "deg/s", _DEG),
    "non_holonomic": (("right", "up"), "m/s", 1.0),
    "odometer": (("forward",), "m/s", 1.0),
    "speed": (("forward",), "m/s", 1.0),
    "barometer": (("up",), "m", 1.0),
}
"""Names of a measurement's residuals, the unit they are shown in, and its factor."""
_BODY: Final = ("right (x)", "forward (y)", "up (z)")


def _plane(lat: Array, lon: Array, lat0: float, lon0: float) -> tuple[Array, Array]:
    """East and north, m, in the plane that touches the ellipsoid at a reference; no meridian is special."""
    apart_e = ecef(lat, lon, 0.0) - ecef(lat0, lon0, 0.0)
    apart = quat_rotate(quat_conjugate(position_quat(lat0, lon0)), apart_e)
    return apart[..., 0], apart[..., 1]


def _angles(q_gv: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and heading (0 to 360) of the vehicle, deg; by the naming law of `nav.types.Solution`."""
    w, x, y, z = q_gv.T
    roll = np.arctan2(-2.0 * (x * z - w * y), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2.0 * (y * z + w * x), -1.0, 1.0))
    heading = np.arctan2(2.0 * (x * y - w * z), w * w - x * x + y * y - z * z)
    return roll * _DEG, pitch * _DEG, heading * _DEG % 360.0


def _known(table: SolutionTable, flag: SolutionFlag) -> SolutionTable:
    return table.where((table.flags & flag) != 0)


def track(data: PlotData) -> Picture | None:
    """The way over ground, and the height."""
    found = _known(data.solutions, SolutionFlag.POSITION)
    if len(found.t_ns) == 0 and not data.fixes:
        return None
    lat0, lon0 = (
        (found.state[0, S.LAT], found.state[0, S.LON])
        if len(found.t_ns)
        else (data.fixes[0].lat, data.fixes[0].lon)
    )
    picture = Picture("Track", data.title, 2, 1, height=9.6, height_ratios=[3.2, 1.0])
    plan, level = picture.column()
    fix_lat, fix_lon, fix_height = (
        np.array([getattr(fix, name) for fix in data.fixes]) for name in ("lat", "lon", "height")
    )
    fix_t = data.seconds_of(np.array([fix.t_ns for fix in data.fixes], dtype=np.int64))
    plan.plot(
        *_plane(fix_lat, fix_lon, lat0, lon0), ".", color=GREY, markersize=3, label="GNSS fixes (antenna)"
    )
    level.plot(fix_t, fix_height, ".", color=GREY, markersize=3)
    if data.truth is not None:
        east, north = thin(*_plane(data.truth.lat, data.truth.lon, lat0, lon0))
        plan.plot(east, north, color=INK, linewidth=2.6, alpha=0.25, label="truth")
        line(level, data.seconds_of(data.truth.t_ns), data.truth.height, INK, linewidth=2.6, alpha=0.25)
    if len(found.t_ns):
        t = data.seconds_of(found.t_ns)
        east, north = _plane(found.state[:, S.LAT], found.state[:, S.LON], lat0, lon0)
        plan.plot(*thin(east, north), color=BLUE, label="solution")
        plan.plot(east[0], north[0], "o", color="white", markeredgecolor=INK, markersize=8, label="start")
        plan.plot(east[-1], north[-1], "s", color=INK, markersize=7, label="end")
        blind = (found.flags & SolutionFlag.DEAD_RECKONING) != 0
        if blind.any():
            plan.plot(
                *thin(np.where(blind, east, np.nan), np.where(blind, north, np.nan)),
                color=ORANGE,
                linewidth=2.2,
                label="without position aid",
            )
        height, sigma = found.state[:, S.HEIGHT], found.state[:, S.SIGMA_P.stop - 1]
        band(level, t, height, sigma, BLUE, "3 sigma")
        line(level, t, height, BLUE, "solution")
        fit(level, height, fix_height, floor=1.0, cover=1.0)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("east (m)")
    plan.set_ylabel("north (m)")
    level.set_ylabel("height (m)")
    modes([level], data)
    time_axis([level], data)
    legend(plan)
    legend(level)
    return picture


def attitude(data: PlotData) -> Picture | None:
    """Roll, pitch and heading with their 3-sigma bands."""
    found = _known(data.solutions, SolutionFlag.LEVEL)
    if len(found.t_ns) == 0:
        return None
    roll, pitch, heading = _angles(found.state[:, S.Q])
    heading[(found.flags & SolutionFlag.HEADING) == 0] = np.nan
    t = data.seconds_of(found.t_ns)
    sigma = found.state[:, S.SIGMA_PHI] * _DEG
    level = np.max(sigma[:, :2], axis=1)
    picture = Picture("Attitude of the vehicle", data.title, 3)
    panels = picture.column()
    for place, (axes, name, angle, own) in enumerate(
        zip(
            panels,
            ("roll", "pitch", "heading"),
            (roll, pitch, heading),
            (level, level, sigma[:, 2]),
            strict=True,
        )
    ):
        band(axes, t, angle, own, AXES[place], "3 sigma")
        line(axes, t, broken(angle, 180.0), AXES[place], name)
        axes.set_ylabel(f"{name} (deg)")
        fit(axes, angle, floor=0.5, cover=1.0)
    if data.truth is not None:
        t_true = data.seconds_of(data.truth.t_ns)
        for axes, angle in zip(panels, _angles(data.truth.q_gv), strict=True):
            line(axes, t_true, broken(angle, 180.0), INK, "truth", linewidth=2.6, alpha=0.25)
    modes(panels, data)
    time_axis(panels, data)
    for axes in panels:
        legend(axes)
    return picture


def velocity(data: PlotData) -> Picture | None:
    """East, north and up velocity with their 3-sigma bands, beside what the receiver says."""
    found = _known(data.solutions, SolutionFlag.VELOCITY)
    if len(found.t_ns) == 0:
        return None
    t, v, sigma = data.seconds_of(found.t_ns), found.state[:, S.V], found.state[:, S.SIGMA_V]
    fixes = [fix for fix in data.fixes if fix.v_g is not None]
    fix_t = data.seconds_of(np.array([fix.t_ns for fix in fixes], dtype=np.int64))
    fix_v = np.array([fix.v_g for fix in fixes]).reshape(-1, 3)
    picture = Picture("Velocity", data.title, 3)
    panels = picture.column()
    for axis, axes in enumerate(panels):
        axes.plot(fix_t, fix_v[:, axis], ".", color=GREY, markersize=3, label="GNSS" if len(fix_t) else None)
        band(axes, t, v[:, axis], sigma[:, axis], AXES[axis], "3 sigma")
        line(axes, t, v[:, axis], AXES[axis], _ENU[axis])
        if data.truth is not None:
            t_true = data.seconds_of(data.truth.t_ns)
            line(axes, t_true, data.truth.v_g[:, axis], INK, "truth", linewidth=2.6, alpha=0.25)
        axes.set_ylabel(f"{_ENU[axis]} (m/s)")
        fit(axes, v[:, axis], floor=0.2, cover=1.0)
    modes(panels, data)
    time_axis(panels, data)
    for axes in panels:
        legend(axes)
    return picture


def biases(data: PlotData) -> Picture | None:
    """Estimated gyro and accelerometer biases with their 3-sigma bands."""
    found = data.solutions.navigating()
    if len(found.t_ns) == 0 or not np.isfinite(found.state[:, S.GYRO_BIAS]).any():
        return None
    t = data.seconds_of(found.t_ns)
    picture = Picture("Biases of the inertial sensors, as estimated", data.title, 3, 2)
    groups = (
        ("gyro", "deg/h", _DEG_H, S.GYRO_BIAS, S.SIGMA_GYRO_BIAS),
        ("accelerometer", "mg", _MG, S.ACCEL_BIAS, S.SIGMA_ACCEL_BIAS),
    )
    for column, (name, unit, factor, value, deviation) in enumerate(groups):
        panels = picture.column(column)
        for axis, axes in enumerate(panels):
            bias, sigma = found.state[:, value][:, axis] * factor, found.state[:, deviation][:, axis] * factor
            band(axes, t, bias, sigma, AXES[axis], "3 sigma")
            line(axes, t, bias, AXES[axis], "estimate")
            axes.axhline(0.0, color=INK, linewidth=0.6)
            axes.set_ylabel(f"{_BODY[axis]} ({unit})")
            fit(axes, bias - 3.0 * sigma, bias + 3.0 * sigma, cover=0.97)
        panels[0].set_title(name, loc="left", fontsize=10)
        modes(panels, data, float(t[0]))
        time_axis(panels, data, float(t[0]))
    for axes in picture.column(1):
        legend(axes)
    return picture


def parameters(data: PlotData) -> Picture | None:
    """The other estimated states: odometer scale, residual mounting, barometer bias."""
    found = data.solutions.navigating()
    rows: list[tuple[str, str, Array, Array]] = []
    for name, unit, factor, value, deviation in (
        ("odometer scale", "%", 100.0, S.ODO_SCALE, S.SIGMA_ODO_SCALE),
        ("mounting, pitch", "deg", _DEG, S.MOUNTING.start, S.SIGMA_MOUNTING.start),
        ("mounting, heading", "deg", _DEG, S.MOUNTING.start + 1, S.SIGMA_MOUNTING.start + 1),
        ("barometer bias", "m", 1.0, S.BARO_BIAS, S.SIGMA_BARO_BIAS),
    ):
        state, sigma = found.state[:, value] * factor, found.state[:, deviation] * factor
        if len(state) and np.isfinite(state).any() and np.nanmax(sigma) > 0.0:
            rows.append((name, unit, state, sigma))
    if not rows:
        return None
    t = data.seconds_of(found.t_ns)
    picture = Picture("Odometer, mounting and barometer, as estimated", data.title, len(rows))
    panels = picture.column()
    for axes, (name, unit, state, sigma) in zip(panels, rows, strict=True):
        band(axes, t, state, sigma, BLUE, "3 sigma")
        line(axes, t, state, BLUE, "estimate")
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_ylabel(f"{name}\n({unit})")
        fit(axes, state - 3.0 * sigma, state + 3.0 * sigma, cover=0.97)
    modes(panels, data, float(t[0]))
    time_axis(panels, data, float(t[0]))
    for axes in panels:
        legend(axes)
    return picture


def innovations(data: PlotData) -> list[tuple[str, Picture]]:
    """A picture for each kind of measurement: residuals in their 3-sigma bounds, refused ones in red."""
    kinds: defaultdict[str, list[Innovation]] = defaultdict(list)
    for item in data.innovations:
        kinds[item.kind].append(item)
    return [(kind, _innovation(data, kind, items)) for kind, items in sorted(kinds.items())]


def _innovation(data: PlotData, kind: str, items: list[Innovation]) -> Picture:
    width = max(len(item.residual) for item in items)
    items = [item for item in items if len(item.residual) == width]
    t = data.seconds_of(np.array([item.t_ns for item in items], dtype=np.int64))
    residual = np.array([item.residual for item in items]).reshape(-1, width)
    sigma = np.array([item.sigma for item in items]).reshape(-1, width)
    accepted = np.array([item.accepted for item in items], dtype=np.bool_)
    inside = (
        float(np.mean(np.abs(residual[accepted]) <= 3.0 * sigma[accepted]))
        if accepted.any()
        else float("nan")
    )
    words = f"{len(items)} measurements, {int((~accepted).sum())} refused, {inside:.1%} inside 3 sigma"
    names, unit, factor = _RESIDUALS.get(kind, (tuple(str(place + 1) for place in range(width)), "SI", 1.0))
    residual, sigma = residual * factor, sigma * factor
    name = kind.replace("_", " ").replace("gnss", "GNSS")
    picture = Picture(f"Innovations: {name}", f"{data.title} · {words}", width)
    panels = picture.column()
    for axis, axes in enumerate(panels):
        band(axes, t, 0.0, sigma[:, axis], GREY, "3 sigma of the innovation")
        axes.plot(
            t[accepted], residual[accepted, axis], ".", color=AXES[axis % 3], markersize=3, label="used"
        )
        if not accepted.all():
            axes.plot(t[~accepted], residual[~accepted, axis], "x", color=RED, markersize=5, label="refused")
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_ylabel(f"{names[axis]} ({unit})")
        fit(axes, 3.0 * sigma[:, axis], -3.0 * sigma[:, axis], residual[:, axis])
    modes(panels, data, float(t[0]))
    time_axis(panels, data, float(t[0]))
    for axes in panels:
        legend(axes)
    return picture


def rates(data: PlotData) -> Picture | None:
    """Intervals between the samples of each device; gaps in red."""
    devices = {name: t_ns for name, t_ns in data.samples_ns.items() if len(t_ns) > 1}
    if not devices:
        return None
    picture = Picture("Rates and gaps", data.title, len(devices))
    panels = picture.column()
    for axes, (name, t_ns) in zip(panels, devices.items(), strict=True):
        step = np.diff(t_ns) / 1e6
        t = data.seconds_of(t_ns[1:])
        typical = float(np.median(step))
        gap = step > 1.5 * typical
        line(
            axes,
            t,
            step,
            BLUE,
            f"{1e3 / typical:.4g} Hz" if typical > 0 else None,
            linestyle="none",
            marker=".",
            ms=2,
        )
        if gap.any():
            axes.plot(t[gap], step[gap], "x", color=RED, markersize=6, label=f"gaps: {int(gap.sum())}")
            axes.set_yscale("log")
        else:
            axes.plot([], [], " ", label="no gaps")
            axes.set_ylim(0.0, 2.0 * typical)
        axes.set_ylabel(f"{name}\ninterval (ms)")
        legend(axes)
    modes(panels, data)
    time_axis(panels, data)
    return picture


def _error_page(
    title: str, names: tuple[str, ...], unit: str, pick: Callable[[Errors], tuple[Array, Array]]
) -> Callable[[PlotData], Picture | None]:
    def page(data: PlotData) -> Picture | None:
        if data.truth is None:
            return None
        found = errors(data.solutions, data.truth)
        if len(found.t_ns) == 0:
            return None
        error, sigma = pick(found)
        inside = float(np.mean(np.abs(error) <= 3.0 * sigma))
        t = data.seconds_of(found.t_ns)
        of = coverage(data.solutions, data.begin_ns, data.end_ns)
        words = f"{data.title}, {of.share:.0%} of it navigated · {inside:.1%} inside 3 sigma"
        picture = Picture(title, words, 3)
        panels = picture.column()
        for axis, axes in enumerate(panels):
            band(axes, t, 0.0, sigma[:, axis], GREY, "3 sigma of the solution")
            rms = float(np.sqrt(np.nanmean(error[:, axis] ** 2)))
            line(axes, t, error[:, axis], AXES[axis], f"error, RMS {rms:.3g} {unit}")
            axes.axhline(0.0, color=INK, linewidth=0.6)
            axes.set_ylabel(f"{names[axis]} ({unit})")
            fit(axes, 3.0 * sigma[:, axis], -3.0 * sigma[:, axis], error[:, axis], cover=0.99)
        modes(panels, data, float(t[0]))
        time_axis(panels, data, float(t[0]))
        for axes in panels:
            legend(axes)
        return picture

    return page


position_error = _error_page(
    "Position error against truth", _ENU, "m", lambda found: (found.position, found.sigma_position)
)
velocity_error = _error_page(
    "Velocity error against truth", _ENU, "m/s", lambda found: (found.velocity, found.sigma_velocity)
)
attitude_error = _error_page(
    "Attitude error against truth",
    ("about east", "about north", "about up"),
    "deg",
    lambda found: (found.attitude * _DEG, found.sigma_attitude * _DEG),
)

PAGES: dict[str, Callable[[PlotData], Picture | None]] = {
    "track": track,
    "attitude": attitude,
    "velocity": velocity,
    "biases": biases,
    "parameters": parameters,
    "rates": rates,
    "error_position": position_error,
    "error_velocity": velocity_error,
    "error_attitude": attitude_error,
}
"""File name to picture; innovations, a picture for each kind, are beside them."""
