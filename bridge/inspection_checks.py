"""Does the data make sense? Units, signs, frames and sigmas, judged by physics that needs no alignment.

Each check takes columns in SI units as the drivers give them and returns findings: lines that say
what was seen, what is normal, and the mistake that would look like this. Nothing is a proof; a check
that has too little data to judge is silent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.outputs import UnitHealth
from nav.earth import convergence, ecef
from nav.types import BaroSample, GnssFix, ImuChange, ImuSample, OdoSample, Sample, SpeedSample, Vector

G: Final = 9.80665
_DEG: Final = math.pi / 180.0
_EARTH: Final = 6_371_000.0  # m, a sphere is enough to tell metres from kilometres
_NEAR: Final = 0.03  # how far the norm at rest may be from gravity: biases of cheap sensors, 20 to 30 mg
_SLOPE: Final = 0.25  # how far a ratio of two independent sensors may be from 1
_WINDOW_S: Final = 1.0
_REST_RATE: Final = 3.0 * _DEG  # rad/s, more than the bias of any gyro worth using
_MIN_SEGMENTS: Final = 8
_STRETCH_S: Final = 2.0
_CHANGES: Final = 12  # of the sensors in use, that are listed
_SAME_NORTH: Final = 0.1  # rad that true north may turn by within a stretch

UNIT_RATIOS: Final = (
    (G, "g where m/s^2 is meant"),
    (1.0 / G, "m/s^2 where g is meant"),
    (_DEG, "degrees where radians are meant"),
    (1.0 / _DEG, "radians where degrees are meant"),
    (1.0 / 3.6, "km/h where m/s is meant"),
    (3.6, "m/s where km/h is meant"),
    (0.01, "centimetres where metres are meant"),
    (100.0, "metres where centimetres are meant"),
    (1e-3, "thousandths where whole units are meant"),
    (1000.0, "whole units where thousandths are meant"),
    (2.0, "half of the value"),
    (0.5, "twice the value"),
)
"""What to multiply by to put each mistake right."""


class Finding(NamedTuple):
    """Something that looks wrong about a device ("" for the capture as a whole)."""

    device: str
    text: str


class ImuColumns(NamedTuple):
    """Increments as columns: t (n,) s, dt (n,) s, dtheta and dv (n, 3)."""

    t: Vector
    dt: Vector
    dtheta: Vector
    dv: Vector


class FixColumns(NamedTuple):
    """Fixes as columns; velocity is NaN where there is none."""

    t: Vector
    lat: Vector
    lon: Vector
    height: Vector
    sigma_position: Vector
    v_g: Vector
    sigma_velocity: Vector


class DistanceColumns(NamedTuple):
    """Distance rolled up to t, m."""

    t: Vector
    distance: Vector


def imu_columns(samples: Sequence[Sample]) -> ImuColumns:
    """Columns of the inertial samples among ``samples``."""
    rows = [sample for sample in samples if isinstance(sample, ImuSample)]
    return ImuColumns(
        np.array([row.t_ns for row in rows], dtype=np.float64) / 1e9,
        np.array([row.dt for row in rows]),
        np.array([row.dtheta for row in rows]).reshape(-1, 3),
        np.array([row.dv for row in rows]).reshape(-1, 3),
    )


def fix_columns(samples: Sequence[Sample]) -> FixColumns:
    """Columns of the GNSS fixes among ``samples``."""
    rows = [sample for sample in samples if isinstance(sample, GnssFix)]
    unknown = np.full(3, math.nan)
    return FixColumns(
        np.array([row.t_ns for row in rows], dtype=np.float64) / 1e9,
        np.array([row.lat for row in rows]),
        np.array([row.lon for row in rows]),
        np.array([row.height for row in rows]),
        np.array([row.sigma_position for row in rows]).reshape(-1, 3),
        np.array([unknown if row.v_g is None else row.v_g for row in rows]).reshape(-1, 3),
        np.array([unknown if row.sigma_velocity is None else row.sigma_velocity for row in rows]).reshape(
            -1, 3
        ),
    )


def distance_columns(samples: Sequence[Sample]) -> DistanceColumns:
    """Distance by the odometer or speed samples among ``samples``."""
    odo = [sample for sample in samples if isinstance(sample, OdoSample)]
    if odo:
        t = np.array([row.t_ns for row in odo], dtype=np.float64) / 1e9
        return DistanceColumns(t, np.cumsum([row.distance for row in odo]))
    speed = [sample for sample in samples if isinstance(sample, SpeedSample)]
    t = np.array([row.t_ns for row in speed], dtype=np.float64) / 1e9
    v = np.array([row.speed for row in speed])
    return DistanceColumns(t, np.concatenate([[0.0], np.cumsum(v[1:] * np.diff(t))]) if len(t) else v)


def _mistake(ratio: float) -> str:
    """Words for a ratio of read to expected that is near a known factor, else ""."""
    for factor, words in UNIT_RATIOS:
        if abs(ratio * factor - 1.0) < 2.0 * _NEAR:
            return f"; looks like {words}"
    return ""


def _windows(imu: ImuColumns) -> tuple[Vector, Vector] | None:
    """Mean rate and force of the quietest quarter of the one-second windows, (k, 3) each."""
    if len(imu.t) < 4:
        return None
    place = ((imu.t - imu.t[0]) / _WINDOW_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    time = np.add.reduceat(imu.dt, starts)
    full = time > 0.5 * _WINDOW_S
    if full.sum() < 4:
        return None
    force = np.add.reduceat(imu.dv, starts)[full] / time[full, None]
    rate = np.add.reduceat(imu.dtheta, starts)[full] / time[full, None]
    # quiet: the mean force changes little from one window to the next
    change = np.linalg.norm(np.diff(force, axis=0, prepend=force[:1]), axis=1)
    change[0] = change[1]
    quiet = change <= np.quantile(change, 0.25)
    return rate[quiet], force[quiet]


def check_imu(device: str, imu: ImuColumns, mounting_known: bool) -> Iterator[Finding]:
    """Gravity, its direction, the rate at rest, and axes that never change."""
    for sensor, unit, increments in (("gyro", "rate", imu.dtheta), ("accelerometer", "force", imu.dv)):
        if len(increments) > 100:
            for axis in range(3):
                if np.ptp(increments[:, axis]) == 0.0:
                    yield Finding(device, f"{sensor} {'xyz'[axis]} gives the same {unit} in every sample")
    means = _windows(imu)
    if means is None:
        return
    rate, force = means
    norm = float(np.median(np.linalg.norm(force, axis=1)))
    if abs(norm / G - 1.0) > _NEAR:
        yield Finding(
            device, f"specific force when quiet is {norm:.4g} m/s^2, expected 9.8{_mistake(norm / G)}"
        )
    elif mounting_known:
        up = np.median(force, axis=0) / norm
        if up[2] < math.cos(45.0 * _DEG):
            axis = int(np.argmax(np.abs(up)))
            sign = "-" if up[axis] < 0 else "+"
            yield Finding(
                device,
                f"gravity lies along {sign}{'xyz'[axis]}, expected +z (specific force at rest points up); "
                'axes or mounting are not as configured (mounting_deg = "find" finds it)',
            )
    spin = float(np.median(np.linalg.norm(rate, axis=1)))
    if spin > _REST_RATE:
        yield Finding(
            device,
            f"angular rate when quiet is {spin / _DEG:.3g} deg/s, expected less than 3; "
            "a gyro bias, or degrees where radians are meant",
        )


def check_fixes(device: str, fixes: FixColumns) -> Iterator[Finding]:
    """Zero sigmas, positions nowhere, and position against velocity: axes, units and signs."""
    for name, sigma in (("position", fixes.sigma_position), ("velocity", fixes.sigma_velocity)):
        zero = int(np.sum(np.any(sigma == 0.0, axis=1)))
        if zero:
            yield Finding(device, f"{zero} of {len(sigma)} fixes say a {name} sigma of zero")
    if len(fixes.t) == 0:
        return
    nowhere = int(np.sum((np.abs(fixes.lat) < 1e-7) & (np.abs(fixes.lon) < 1e-7)))
    if nowhere:
        yield Finding(device, f"{nowhere} of {len(fixes.t)} fixes lie at latitude 0, longitude 0")
    height = float(np.median(fixes.height))
    if not -500.0 < height < 50_000.0:
        yield Finding(device, f"height is {height:.4g} m, expected -500 to 50000; perhaps another unit")
    yield from _position_against_velocity(device, fixes)


def _stretches(fixes: FixColumns) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Fixes some seconds apart, so that the way between them is more than their noise; which pairs are whole.

    A pair is whole when no fix between is missing and none of the two ends is in doubt by more than a
    fifth of the way.
    """
    places = [0]
    for place in range(1, len(fixes.t)):
        if fixes.t[place] - fixes.t[places[-1]] >= _STRETCH_S:
            places.append(place)
    ends = np.array(places, dtype=np.int64)
    if len(ends) < 2:
        return ends, np.zeros(0, dtype=np.bool_)
    widest = np.maximum.reduceat(np.diff(fixes.t), ends[:-1])
    doubt = np.max(fixes.sigma_position[ends[1:], :2], axis=1)
    return ends, (widest < 0.75 * _STRETCH_S + 1.0) & (_way(fixes, ends) > np.maximum(1.0, 5.0 * doubt))


def _way(fixes: FixColumns, ends: NDArray[np.int64]) -> Vector:
    """Horizontal distance between the fixes ``ends`` of one place and the next, m."""
    return np.asarray(np.linalg.norm(np.diff(ecef(fixes.lat[ends], fixes.lon[ends], 0.0), axis=0), axis=1))


def _converged(fixes: FixColumns, ends: NDArray[np.int64]) -> Vector:
    """By how much a bearing grows that is carried from each of ``ends`` to the next, rad."""
    lat, lon = fixes.lat[ends], fixes.lon[ends]
    return convergence(lat[:-1], lon[:-1], lat[1:], lon[1:])


def _position_against_velocity(device: str, fixes: FixColumns) -> Iterator[Finding]:
    dt = np.diff(fixes.t)
    steps = 0.5 * (fixes.v_g[1:] + fixes.v_g[:-1]) * dt[:, None]
    ends, use = _stretches(fixes)
    if use.sum() < _MIN_SEGMENTS:
        return
    mean = np.add.reduceat(steps[: ends[-1]], ends[:-1])
    # next to a pole east and north are others at either end
    use &= np.abs(_converged(fixes, ends)) < _SAME_NORTH
    dlat, dlon = np.diff(fixes.lat[ends]), np.diff(fixes.lon[ends])
    dlon = (dlon + math.pi) % (2.0 * math.pi) - math.pi
    step = _EARTH * np.column_stack([dlon * np.cos(fixes.lat[ends[1:]]), dlat])
    swapped = _EARTH * np.column_stack([dlat * np.cos(fixes.lon[ends[1:]]), dlon])
    use &= np.isfinite(mean).all(axis=1)
    if use.sum() < _MIN_SEGMENTS:
        return
    level = mean[use, :2]

    def fit(way: Vector, velocity: Vector) -> tuple[float, float]:
        """Least-squares ratio of velocity to displacement, and how much of it is left unexplained."""
        ratio = float(np.sum(way * velocity) / np.sum(way * way))
        rest = float(np.sqrt(np.sum((velocity - ratio * way) ** 2) / np.sum(velocity**2)))
        return ratio, rest

    ratio, rest = fit(step[use], level)
    if rest > 0.5:
        for words, way, velocity in (
            ("latitude and longitude look swapped", swapped[use], level),
            ("velocity east and north look swapped", step[use], level[:, ::-1]),
            ("velocity east has the wrong sign", step[use], level * [-1.0, 1.0]),
            ("velocity north has the wrong sign", step[use], level * [1.0, -1.0]),
        ):
            other, left = fit(way, velocity)
            if left < 0.2 and other > 0.0:
                yield Finding(device, f"velocity and change of position disagree; {words}")
                return
        yield Finding(device, "velocity and change of position disagree")
    elif abs(ratio - 1.0) > _SLOPE:
        yield Finding(
            device, f"velocity is {ratio:.3g} times the change of position, expected 1{_mistake(ratio)}"
        )
    climb = np.diff(fixes.height[ends])[use]
    up = mean[use, 2]
    scale = float(np.sqrt(np.sum(climb**2) * np.sum(up**2)))
    # noise does not correlate: a value near -1 needs real climbing
    if scale > 0.0 and float(np.sum(climb * up)) / scale < -0.7:
        yield Finding(device, "vertical velocity falls where height rises; positive is up here")


def check_turns(device: str, imu: ImuColumns, fixes: FixColumns) -> Iterator[Finding]:
    """The gyros against the change of course that the GNSS saw: unit and sign of the vertical rate."""
    means = _windows(imu)
    if means is None or len(fixes.t) < 2:
        return
    up = np.median(means[1], axis=0)
    norm = float(np.linalg.norm(up))
    if norm == 0.0:
        return
    bias = np.median(means[0], axis=0) @ up / norm
    angle = np.cumsum(imu.dtheta @ up / norm - bias * imu.dt)
    ends, _ = _stretches(fixes)
    v_g, t = fixes.v_g[ends], fixes.t[ends]
    speed = np.hypot(v_g[:, 0], v_g[:, 1])
    course = np.arctan2(v_g[:, 0], v_g[:, 1])
    turn = np.angle(np.exp(1j * (np.diff(course) - _converged(fixes, ends))))
    turned = np.diff(np.interp(t, imu.t, angle))
    # above a right angle the turn of the course is no longer known from its ends
    use = (
        (np.minimum(speed[1:], speed[:-1]) > 3.0) & (np.abs(turn) > 5.0 * _DEG) & (np.abs(turn) < 90.0 * _DEG)
    )
    use &= (t[:-1] >= imu.t[0]) & (t[1:] <= imu.t[-1]) & (np.diff(t) < 2.0 * _STRETCH_S)
    if use.sum() < _MIN_SEGMENTS:
        return
    # course counts clockwise, the rate about the upward axis counts the other way
    ratio = float(-np.sum(turned[use] * turn[use]) / np.sum(turn[use] ** 2))
    if abs(ratio + 1.0) < _SLOPE:
        yield Finding(
            device, "the vertical gyro turns against the course over ground; sign or axes are wrong"
        )
    elif abs(ratio - 1.0) > _SLOPE:
        yield Finding(
            device,
            f"the vertical gyro turns {ratio:.3g} times as far as the course, expected 1{_mistake(ratio)}",
        )


def check_distance(device: str, rolled: DistanceColumns, fixes: FixColumns) -> Iterator[Finding]:
    """Distance by odometer or speed log against the way over ground."""
    if len(rolled.t) < 2 or len(fixes.t) < 2:
        return
    ends, use = _stretches(fixes)
    if len(ends) < 2:
        return
    way, t = _way(fixes, ends), fixes.t[ends]
    by_wheel = np.abs(np.diff(np.interp(t, rolled.t, rolled.distance)))
    use &= (t[:-1] >= rolled.t[0]) & (t[1:] <= rolled.t[-1])
    if use.sum() < _MIN_SEGMENTS:
        return
    ratio = float(np.sum(by_wheel[use] * way[use]) / np.sum(way[use] ** 2))
    if abs(ratio - 1.0) > _SLOPE:
        yield Finding(
            device, f"distance is {ratio:.3g} times the way over ground, expected 1{_mistake(ratio)}"
        )


def check_baro(device: str, samples: Sequence[Sample]) -> Iterator[Finding]:
    """Pressure altitude that no vehicle reaches."""
    heights = [sample.height for sample in samples if isinstance(sample, BaroSample)]
    if heights and not -1000.0 < float(np.median(heights)) < 30_000.0:
        yield Finding(
            device,
            f"pressure altitude is {np.median(heights):.4g} m, expected -1000 to 30000; perhaps hPa for Pa",
        )


def check_sensors(device: str, changes: Sequence[ImuChange], begin_ns: int) -> Iterator[Finding]:
    """Sensors of a redundant unit that its driver does not trust, in the order in which that changed."""
    for change in changes[:_CHANGES]:
        words = ", ".join(UnitHealth(change.t_ns, *change[2:6]).words()) or "all sensors in use again"
        yield Finding(device, f"{words}, {(change.t_ns - begin_ns) / 1e9:.1f} s after the start")
    if len(changes) > _CHANGES:
        yield Finding(device, f"and {len(changes) - _CHANGES} more changes of the sensors in use")
