"""A solution against the truth: errors, their size, and their size against what the solution claimed.

Truth is that of one point of the vehicle and so is a solution; `TruthTable.at_point` moves the truth
to the solution's point when they differ. Solutions are interpolated to the instants of the truth
(position by a cubic through both ends with their velocities, velocity linearly, attitude along the
shortest turn), which at 100 Hz costs less than a millimetre; instants with no solution within
`MAX_GAP_NS` on both sides are left out. Truth taken at the very instants of solutions costs nothing.

All of it goes through Earth-fixed axes, so no meridian is special: neither where they meet nor where
longitude starts again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bridge.outputs import SolutionOut
from nav import rotation
from nav.earth import convergence, earth_rate_g, ecef, geodetic, position_quat
from nav.types import Mode, S, SolutionFlag

Array = NDArray[np.float64]
Epochs = NDArray[np.int64]

MAX_GAP_NS: Final = 250_000_000
NAVIGATING: Final = (Mode.NAVIGATE, Mode.DEGRADED)


@dataclass(frozen=True)
class TruthTable:
    """Truth at n instants ``t_ns`` (n,).

    ``lat``, ``lon`` (n,) rad, ``height`` (n,) m, ``v_g`` (n, 3) m/s east, north, up, ``q_gv`` (n, 4)
    vehicle axes to east-north-up, ``w_iv_v`` (n, 3) rad/s in vehicle axes.
    """

    t_ns: Epochs
    lat: Array
    lon: Array
    height: Array
    v_g: Array
    q_gv: Array
    w_iv_v: Array

    @classmethod
    def from_documents(cls, documents: Iterable[Mapping[str, Any]]) -> TruthTable:
        """From the objects of a capture's truth channel, as `truth_document` makes them."""
        rows = list(documents)

        def column(key: str, width: int | None = None) -> Array:
            shape = (len(rows),) if width is None else (len(rows), width)
            return np.array([row[key] for row in rows], dtype=np.float64).reshape(shape)

        return cls(
            t_ns=np.array([row["t_ns"] for row in rows], dtype=np.int64),
            lat=np.radians(column("lat_deg")),
            lon=np.radians(column("lon_deg")),
            height=column("height_m"),
            v_g=column("velocity_enu_m_s", 3),
            q_gv=column("q_gv", 4),
            w_iv_v=np.radians(column("rate_deg_s", 3)),
        )

    def at_point(self, lever_v: Sequence[float]) -> TruthTable:
        """Truth of another point, ``lever_v`` (3,) m away in vehicle axes (right, forward, up)."""
        lever = np.asarray(lever_v, dtype=np.float64)
        offset = rotation.quat_rotate(self.q_gv, np.broadcast_to(lever, self.v_g.shape))
        w_ie_g = np.array([earth_rate_g(lat) for lat in self.lat]).reshape(-1, 3)
        w_ev_v = self.w_iv_v - rotation.quat_rotate(rotation.quat_conjugate(self.q_gv), w_ie_g)
        swing = rotation.quat_rotate(self.q_gv, np.cross(w_ev_v, lever))
        q_eg = position_quat(self.lat, self.lon)
        lat, lon, height = geodetic(
            ecef(self.lat, self.lon, self.height) + rotation.quat_rotate(q_eg, offset)
        )
        # a metre away the local axes are others, next to a pole by much
        q_pg = rotation.quat_multiply(rotation.quat_conjugate(position_quat(lat, lon)), q_eg)
        return TruthTable(
            self.t_ns,
            lat,
            lon,
            height,
            rotation.quat_rotate(q_pg, self.v_g + swing),
            rotation.quat_multiply(q_pg, self.q_gv),
            self.w_iv_v,
        )


def truth_document(
    lat: float, lon: float, height: float, v_g: Array, q_gv: Array, w_iv_v: Array
) -> dict[str, Any]:
    """One object of the truth channel; the recorder adds ``t_ns``. Arguments as in `TruthTable`."""
    w, x, y, z = (float(value) for value in q_gv)
    heading, pitch, roll = (math.degrees(float(a)) for a in rotation.euler_from_quat(q_gv))
    return {
        "lat_deg": math.degrees(lat),
        "lon_deg": math.degrees(lon),
        "height_m": float(height),
        "velocity_enu_m_s": [float(v) for v in v_g],
        "q_gv": [w, x, y, z],
        "rate_deg_s": [math.degrees(float(rate)) for rate in w_iv_v],
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": heading,
    }


@dataclass(frozen=True)
class SolutionTable:
    """Solutions at n instants: ``t_ns``, ``mode``, ``flags`` (n,) and ``state`` (n, `S.SIZE`)."""

    t_ns: Epochs
    mode: NDArray[np.int64]
    flags: NDArray[np.int64]
    state: Array

    @classmethod
    def from_outputs(cls, outputs: Iterable[SolutionOut]) -> SolutionTable:
        """From what an engine put out for one navigator, in order."""
        rows = [out.solution for out in outputs]
        return cls(
            np.array([row.t_ns for row in rows], dtype=np.int64),
            np.array([int(row.mode) for row in rows], dtype=np.int64),
            np.array([row.flags for row in rows], dtype=np.int64),
            np.array([row.state for row in rows], dtype=np.float64).reshape(-1, S.SIZE),
        )

    def navigating(self) -> SolutionTable:
        """Those of a navigator that was under way and had a position."""
        keep = np.isin(self.mode, [int(mode) for mode in NAVIGATING])
        return self.where(keep & ((self.flags & SolutionFlag.POSITION) != 0))

    def where(self, keep: NDArray[np.bool_]) -> SolutionTable:
        """The rows that ``keep`` (n,) marks."""
        return SolutionTable(self.t_ns[keep], self.mode[keep], self.flags[keep], self.state[keep])

    def at(self, t_ns: Epochs) -> tuple[SolutionTable, NDArray[np.bool_]]:
        """Interpolated to ``t_ns`` (m,), and which of these have solutions close enough on both sides."""
        if len(self.t_ns) == 0:
            return self, np.zeros(len(t_ns), dtype=np.bool_)
        right = np.clip(np.searchsorted(self.t_ns, t_ns), 0, len(self.t_ns) - 1)
        exact = self.t_ns[right] == t_ns
        left = np.where(exact, right, np.maximum(right - 1, 0))
        step_ns = self.t_ns[right] - self.t_ns[left]
        inside = (self.t_ns[left] <= t_ns) & (t_ns <= self.t_ns[right])
        usable = inside & (step_ns <= MAX_GAP_NS)
        dt = np.where(step_ns > 0, step_ns, 1) * 1e-9
        x = np.where(step_ns > 0, (t_ns - self.t_ns[left]) * 1e-9 / dt, 0.0)[:, None]
        a, b = self.state[left], self.state[right]
        state = a + x * (b - a)
        _interpolate(state, a, b, x, dt[:, None])
        table = SolutionTable(np.asarray(t_ns), self.mode[left], self.flags[left] & self.flags[right], state)
        return table.where(usable), usable


def _interpolate(state: Array, a: Array, b: Array, x: Array, dt: Array) -> None:
    """Position, velocity and attitude of ``state`` at the fraction ``x`` (n, 1) of ``dt`` s from a to b."""
    q_ea, q_eb = (position_quat(end[:, S.LAT], end[:, S.LON]) for end in (a, b))
    r_a, r_b = (ecef(end[:, S.LAT], end[:, S.LON], end[:, S.HEIGHT]) for end in (a, b))
    v_a, v_b = rotation.quat_rotate(q_ea, a[:, S.V]), rotation.quat_rotate(q_eb, b[:, S.V])
    rise = r_b - r_a
    bend = x * (1.0 - x) * ((1.0 - x) * (v_a * dt - rise) - x * (v_b * dt - rise))
    lat, lon, height = geodetic(r_a + x * rise + bend)
    q_ge = rotation.quat_conjugate(position_quat(lat, lon))
    q_a, q_b = rotation.quat_multiply(q_ea, a[:, S.Q]), rotation.quat_multiply(q_eb, b[:, S.Q])
    turn = rotation.rotvec_from_quat(rotation.quat_multiply(rotation.quat_conjugate(q_a), q_b))
    q = rotation.quat_multiply(q_a, rotation.quat_from_rotvec(x * turn))
    state[:, S.LAT], state[:, S.LON], state[:, S.HEIGHT] = lat, lon, height
    state[:, S.V] = rotation.quat_rotate(q_ge, v_a + x * (v_b - v_a))
    state[:, S.Q] = rotation.quat_multiply(q_ge, q)


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + math.pi) % (2.0 * math.pi) - math.pi)


@dataclass(frozen=True)
class Errors:
    """Solution minus truth at n instants, with the solution's own sigmas.

    ``position`` m, ``velocity`` m/s and ``attitude`` rad (rotation vector), all (n, 3) east, north, up of
    the solution's place, to which its sigmas belong too; ``heading`` (n,) rad, NaN where not valid.
    Directions are compared as they are, not by their bearings from the norths of two places.
    """

    t_ns: Epochs
    position: Array
    velocity: Array
    attitude: Array
    heading: Array
    sigma_position: Array
    sigma_velocity: Array
    sigma_attitude: Array


def errors(solutions: SolutionTable, truth: TruthTable) -> Errors:
    """Errors of ``solutions`` while navigating, at the instants of ``truth``."""
    found, usable = solutions.navigating().at(truth.t_ns)
    state = found.state
    lat, lon, height = truth.lat[usable], truth.lon[usable], truth.height[usable]
    q_ge = rotation.quat_conjugate(position_quat(state[:, S.LAT], state[:, S.LON]))
    apart_e = ecef(state[:, S.LAT], state[:, S.LON], state[:, S.HEIGHT]) - ecef(lat, lon, height)
    position = rotation.quat_rotate(q_ge, apart_e)
    position[:, 2] = state[:, S.HEIGHT] - height
    # of the turn between the local axes of the two places only that about the vertical: level stays level
    about_up = -convergence(lat, lon, state[:, S.LAT], state[:, S.LON])[:, None] * np.array([0.0, 0.0, 1.0])
    twist = rotation.quat_from_rotvec(about_up)
    q_true = rotation.quat_multiply(twist, truth.q_gv[usable])
    q_error = rotation.quat_multiply(state[:, S.Q], rotation.quat_conjugate(q_true))
    heading = _heading(state[:, S.Q]) - _heading(q_true)
    valid = (found.flags & SolutionFlag.HEADING) != 0
    return Errors(
        t_ns=found.t_ns,
        position=position,
        velocity=state[:, S.V] - rotation.quat_rotate(twist, truth.v_g[usable]),
        attitude=rotation.rotvec_from_quat(q_error),
        heading=np.where(valid, _wrapped(heading), np.nan),
        sigma_position=state[:, S.SIGMA_P],
        sigma_velocity=state[:, S.SIGMA_V],
        sigma_attitude=state[:, S.SIGMA_PHI],
    )


def _heading(q: Array) -> Array:
    w, x, y, z = q.T
    return np.asarray(np.arctan2(2.0 * (x * y - w * z), w * w - x * x + y * y - z * z))


@dataclass(frozen=True)
class Row:
    """One line of the table: RMS, largest and final error in ``unit``.

    ``normalised`` is the RMS of error over sigma per axis, 1 where the solution knows how good it is.
    """

    name: str
    unit: str
    rms: float
    largest: float
    final: float
    normalised: float


def summary(found: Errors) -> list[Row]:
    """Horizontal, height, velocity, heading and level errors; empty when there is nothing to compare."""
    if len(found.t_ns) == 0:
        return []
    degrees = 180.0 / math.pi
    level, heading = found.attitude[:, :2], found.heading[:, None]
    return [
        _row("horizontal", "m", found.position[:, :2], found.sigma_position[:, :2]),
        _row("height", "m", found.position[:, 2:], found.sigma_position[:, 2:]),
        _row("velocity", "m/s", found.velocity, found.sigma_velocity),
        _row("heading", "deg", heading * degrees, found.sigma_attitude[:, 2:] * degrees),
        _row("level", "deg", level * degrees, found.sigma_attitude[:, :2] * degrees),
    ]


def _row(name: str, unit: str, error: Array, sigma: Array) -> Row:
    size = np.sqrt(np.sum(error * error, axis=1))
    ratio = np.divide(error, sigma, out=np.full_like(error, np.nan), where=sigma > 0.0)
    known = size[np.isfinite(size)]
    if len(known) == 0:
        return Row(name, unit, math.nan, math.nan, math.nan, math.nan)
    ratio = ratio[np.isfinite(ratio)]
    normalised = float(np.sqrt(np.mean(ratio * ratio))) if len(ratio) else math.nan
    rms = float(np.sqrt(np.mean(known * known)))
    return Row(name, unit, rms, float(known.max()), float(known[-1]), normalised)


@dataclass(frozen=True)
class Coverage:
    """How much of a run errors are about: ``navigated_s`` of ``seconds``.

    ``aligned_s`` is when the navigator was first under way, s after the beginning; None: never.
    """

    seconds: float
    navigated_s: float
    aligned_s: float | None

    @property
    def share(self) -> float:
        """Navigated part of the run, 0 to 1."""
        return self.navigated_s / self.seconds if self.seconds > 0.0 else 0.0

    def __str__(self) -> str:
        aligned = "never aligned" if self.aligned_s is None else f"aligned after {self.aligned_s:.1f} s"
        return f"navigated {self.navigated_s:.1f} of {self.seconds:.1f} s ({self.share:.1%}), {aligned}"


def coverage(solutions: SolutionTable, begin_ns: int, end_ns: int) -> Coverage:
    """How much of the time from ``begin_ns`` to ``end_ns`` there were solutions of a navigator under way."""
    t_ns = solutions.navigating().t_ns
    steps = np.diff(t_ns)
    aligned_s = float(t_ns[0] - begin_ns) * 1e-9 if len(t_ns) else None
    return Coverage((end_ns - begin_ns) * 1e-9, float(steps[steps <= MAX_GAP_NS].sum()) * 1e-9, aligned_s)


def table(rows: Sequence[Row], of: Coverage) -> list[str]:
    """The lines a person reads: first how much of the run they are about."""
    if not rows:
        return [str(of), "error against truth: the navigator was not under way at any instant with truth"]
    lines = [str(of)]
    lines += [f"{'error against truth':<22}{'RMS':>10}{'largest':>10}{'final':>10}{'error/sigma':>13}"]
    for row in rows:
        name = f"{row.name} ({row.unit})"
        lines.append(
            f"{name:<22}{row.rms:>10.4f}{row.largest:>10.4f}{row.final:>10.4f}{row.normalised:>13.2f}"
        )
    return lines
