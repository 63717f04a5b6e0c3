"""Sensors of the simulated bench: from true motion to what an instrument of a grade gives out.

Every error is drawn from its own random stream, named after the device, so that adding a device changes
no other.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from virtual_bus.arrangement import Arrangement
from virtual_bus.ellipsoid import G0, axes_eg, axes_eh, to_geodetic
from virtual_bus.faults import (
    Faults,
    GnssJump,
    GnssOutage,
    GnssOutlier,
    SensorBias,
    SensorDead,
    SensorStuck,
    WheelSlip,
)
from virtual_bus.grades import DEG_PER_H, DEG_PER_SQRT_H, REFERENCE_DEG_C, UG, Grade, ImuErrors
from virtual_bus.redundancy import NO_COUNT
from virtual_bus.truth import Trajectory

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Counts = NDArray[np.int64]

COUNT_MAX: Final = 32767


def generator(seed: int, name: str) -> np.random.Generator:
    """The random stream of ``name`` under ``seed``: the same whatever other streams there are."""
    words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:16], "<u4")
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(map(int, words))))
    )


class GaussMarkov:
    """First-order Gauss-Markov process of standard deviation ``sigma`` and correlation time ``tau`` s.

    Exact at the ends of the steps taken, a straight line within; it starts in its steady state.
    """

    def __init__(self, sigma: float | Array, tau: float, size: int, rng: np.random.Generator) -> None:
        self._sigma = sigma
        self._tau = tau
        self._rng = rng
        self.value: Array = np.asarray(sigma * rng.standard_normal(size))

    def step(self, dt: float) -> tuple[Array, Array]:
        """Values before and after ``dt`` seconds."""
        before = self.value
        a = math.exp(-dt / self._tau)
        self.value = a * before + self._sigma * math.sqrt(1.0 - a * a) * self._rng.standard_normal(
            before.size
        )
        return before, self.value


class Quantiser:
    """Turns a flow into whole pulses; what is left of a pulse waits for the next sample."""

    def __init__(self, size: int) -> None:
        self.residual = np.zeros(size)

    def pulses(self, amount: Array) -> Counts:
        """Pulses (n, k) out of ``amount`` (n, k), in pulses: their sums differ by half a pulse at most."""
        total = np.cumsum(amount, axis=0) + self.residual
        whole = np.rint(total)
        self.residual = total[-1] - whole[-1]
        return np.asarray(np.diff(whole, axis=0, prepend=0.0).astype(np.int64))


@dataclass(frozen=True, slots=True)
class Warming:
    """Warming up from the first instant on, ``cold`` to ``warm`` degC with a time constant of ``seconds``."""

    cold: float = 25.0
    warm: float = 37.0
    seconds: float = 600.0

    def at(self, t_ns: Times) -> Array:
        """Temperature (n,) degC at ``t_ns`` (n,)."""
        return np.asarray(self.cold + (self.warm - self.cold) * (1.0 - np.exp(t_ns * (-1e-9 / self.seconds))))


def forces_squared(trajectory: Trajectory, t_ns: Times) -> Array:
    """Integral of f f^T (n-1, 3, 3), (m/s^2)^2 s, between the times ``t_ns`` (n,).

    Sums of squares over the whole and the half intervals, extrapolated: exact of a force on a line.
    """
    fine = np.sort(np.concatenate((t_ns, (t_ns[:-1] + t_ns[1:]) // 2)))
    dv = trajectory.increments(fine)[1]
    spans = np.diff(fine)[:, None, None] * 1e-9
    parts = dv[:, :, None] * dv[:, None, :] / spans
    halves = parts[::2] + parts[1::2]
    whole = dv[::2] + dv[1::2]
    return np.asarray(
        (4.0 * halves - whole[:, :, None] * whole[:, None, :] / (spans[::2] + spans[1::2])) / 3.0
    )


def _polynomial(rows: Array, away: Array, n: int) -> Array:
    """Polynomials (t, n) without constant, with coefficients (n, k) or (1, k), at ``away`` (t,) degC."""
    powers = away[:, None] ** np.arange(1.0, rows.shape[1] + 1.0)
    return np.broadcast_to(powers @ rows.T, (len(away), n))


class Imu:
    """As many gyros as accelerometers giving pulse counts, arranged in some way."""

    def __init__(
        self,
        trajectory: Trajectory,
        grade: Grade,
        errors: ImuErrors,
        rng: np.random.Generator,
        faults: Faults,
        noise: bool = True,
        arrangement: Arrangement | None = None,
        warming: Warming = Warming(),
    ) -> None:
        self._trajectory = trajectory
        self.warming = warming
        self.arrangement = arrangement or Arrangement()
        self._errors = errors
        self._rng = rng
        self._faults = faults
        size = 1.0 if noise else 0.0
        n = len(errors.gyro.scale)
        instability = np.repeat(
            [grade.gyro_instability_deg_per_h * DEG_PER_H, grade.accel_instability_ug * UG], n
        )
        self._instability = GaussMarkov(size * instability, grade.correlation_s, 2 * n, rng)
        self._random_walk = size * np.repeat(
            [
                grade.gyro_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H,
                grade.accel_random_walk_ug_per_sqrt_hz * UG,
            ],
            n,
        )
        self._sensors = 2 * n
        self._quantiser = Quantiser(2 * n)
        self._last = np.zeros(2 * n, np.int64)

    def restart(self) -> None:
        """Power on: no fraction of a pulse is left."""
        self._quantiser = Quantiser(self._sensors)

    def block(self, t_ns: Times) -> tuple[Counts, NDArray[np.bool_]]:
        """Counts (n-1, 6 or more), gyros first, and saturation flags, between times ``t_ns`` (n,).

        A count beyond 16 bits is cut off and flagged, and the excess is lost, as in a real counter.
        """
        out, dt = self.arrangement.outputs(self._trajectory, self._errors, t_ns)
        gyro, accel = self._errors.gyro, self._errors.accel
        n = len(gyro.scale)
        if gyro.second.any() or accel.second.any():
            second = np.concatenate([np.broadcast_to(one.second, (n, 3, 3)) for one in (gyro, accel)])
            out += np.einsum("tab,iab->ti", forces_squared(self._trajectory, t_ns), second)
        away = self.warming.at((t_ns[:-1] + t_ns[1:]) // 2) - REFERENCE_DEG_C
        drift = [_polynomial(one.bias_temperature, away, n) for one in (gyro, accel)]
        growth = [_polynomial(one.scale_temperature, away, n) for one in (gyro, accel)]
        before, after = self._instability.step(float(dt[:, -1].sum()))
        place = ((np.arange(len(dt)) + 0.5) / len(dt))[:, None]
        bias = np.concatenate((gyro.bias, accel.bias)) + before + (after - before) * place
        bias += np.concatenate(drift, axis=1)
        for more in self._faults.of(SensorBias):
            size = (more.bias_deg_per_h or 0.0) * DEG_PER_H + (more.bias_ug or 0.0) * UG
            bias[:, more.column(n)] += size * more.share((t_ns[:-1] + t_ns[1:]) // 2)
        out += bias * dt + self._random_walk * np.sqrt(dt) * self._rng.standard_normal(out.shape)
        # the size of a positive pulse and of a negative one differ by the asymmetry
        asymmetry = np.concatenate((gyro.asymmetry, accel.asymmetry))
        out /= np.concatenate((gyro.scale, accel.scale)) * (1.0 + np.concatenate(growth, axis=1))
        out *= 1.0 + 0.5 * asymmetry * np.sign(out)
        counts = self._quantiser.pulses(out)
        saturated = np.abs(counts) > COUNT_MAX
        counts = np.clip(counts, -COUNT_MAX, COUNT_MAX)
        for stuck in self._faults.of(SensorStuck):
            during = stuck.during(t_ns[1:])
            if during.any():
                first, column = int(np.argmax(during)), stuck.column(n)
                counts[during, column] = counts[first - 1, column] if first else self._last[column]
        for dead in self._faults.of(SensorDead):
            counts[dead.during(t_ns[1:]), dead.column(n)] = NO_COUNT if dead.told else 0
        self._last = counts[-1]
        return counts, saturated


class Odometer:
    """A wheel encoder on the rear axle: ticks counted up in either direction, direction, standstill.

    Where there is an ``rng`` the distance it rolls walks off by ``walk`` m per root of a metre, and the wheel
    stands anywhere between two ticks at first; without one, at a tick.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        m_per_tick: float,
        scale_error: float,
        faults: Faults,
        walk: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> None:
        self._profile = trajectory.profile
        self._ticks_per_m = (1.0 + scale_error) / m_per_tick
        self._faults = faults
        self._turned = 0.0 if rng is None else m_per_tick * float(rng.random())
        self._walk = walk
        self._rng = rng

    def block(self, t_ns: Times) -> tuple[Counts, Counts, NDArray[np.bool_]]:
        """Ticks since power-on, direction (0 none, 1 forward, 2 reverse), standstill at ``t_ns[1:]``."""
        rolled = np.diff(self._profile.distance(t_ns))
        if self._rng is not None:
            error = self._walk * np.sqrt(rolled) * self._rng.standard_normal(len(rolled))
            rolled = np.maximum(0.0, rolled + error)
        for slip in self._faults.of(WheelSlip):
            rolled[slip.during(t_ns[1:])] *= slip.factor
        turned = self._turned + np.cumsum(rolled)
        self._turned = float(turned[-1])
        speed = self._profile.speed(t_ns)
        standstill = np.maximum(np.abs(speed[:-1]), np.abs(speed[1:])) < 0.005
        direction = np.where(standstill, 0, np.where(speed[1:] < 0.0, 2, 1))
        return np.floor(turned * self._ticks_per_m).astype(np.int64), direction, standstill


class SpeedLog:
    """Forward speed from a Doppler log: scale error and white noise."""

    def __init__(
        self, trajectory: Trajectory, sigma: float, scale_error: float, rng: np.random.Generator
    ) -> None:
        self._profile = trajectory.profile
        self._sigma = sigma
        self._scale = 1.0 + scale_error
        self._rng = rng

    def block(self, t_ns: Times) -> Array:
        """Speed (n,) m/s at ``t_ns`` (n,)."""
        return self._scale * self._profile.speed(t_ns) + self._sigma * self._rng.standard_normal(len(t_ns))


_T0_K: Final = 288.15
_LAPSE: Final = 0.0065  # K/m
_GAS: Final = 287.05287  # J/(kg K)
_TROPOPAUSE: Final = 11_000.0  # m


def isa_temperature(height: Array) -> Array:
    """Temperature (K) at a geopotential altitude (m) up to 20 km (ICAO Doc 7488/3)."""
    return np.asarray(_T0_K - _LAPSE * np.minimum(height, _TROPOPAUSE))


def isa_pressure(height: Array) -> Array:
    """Pressure (Pa) at a geopotential altitude (m) up to 20 km (ICAO Doc 7488/3)."""
    temperature = isa_temperature(height)
    below = 101325.0 * (temperature / _T0_K) ** (G0 / (_GAS * _LAPSE))
    return np.asarray(below * np.exp(-G0 / (_GAS * temperature) * np.maximum(height - _TROPOPAUSE, 0.0)))


class Barometer:
    """Static pressure: the standard atmosphere over a datum that differs from the ellipsoid and drifts.

    Height counts as geopotential altitude, which it exceeds by 0.16 m at one kilometre and 16 m at ten.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        offset: float,
        drift: float,
        tau: float,
        noise: float,
        rng: np.random.Generator,
    ) -> None:
        self._trajectory = trajectory
        self._offset = offset * float(rng.standard_normal())
        self._drift = GaussMarkov(drift, tau, 1, rng)
        self._noise = noise
        self._rng = rng

    def block(self, t_ns: Times) -> tuple[Array, Array]:
        """Pressure (Pa) and air temperature (degC) at ``t_ns[1:]``."""
        height = self._trajectory.motion(t_ns[1:]).height
        before, after = self._drift.step(float(t_ns[-1] - t_ns[0]) * 1e-9)
        place = (np.arange(len(height)) + 1.0) / len(height)
        apparent = height + self._offset + before + (after - before) * place
        pressure = isa_pressure(apparent + self._noise * self._rng.standard_normal(len(height)))
        return pressure, isa_temperature(height) - 273.15


@dataclass(frozen=True, slots=True)
class GnssErrors:
    """One-sigma errors of a receiver, m and m/s: horizontal (per axis) and vertical."""

    white: tuple[float, float]
    correlated: tuple[float, float]
    correlation_s: float
    velocity: tuple[float, float]

    def sigma_position(self) -> Array:
        """What the receiver reports, (3,) east, north, up."""
        h, v = (math.hypot(self.white[k], self.correlated[k]) for k in (0, 1))
        return np.array([h, h, v])

    def sigma_velocity(self) -> Array:
        """What the receiver reports, (3,) east, north, up."""
        return np.array([self.velocity[0], self.velocity[0], self.velocity[1]])


@dataclass(frozen=True, slots=True)
class GnssBlock:
    """Fixes of n epochs; ``fix`` is false in an outage, ``silent`` where not even that is said."""

    lat: Array
    lon: Array
    height: Array
    v_g: Array
    fix: NDArray[np.bool_]
    silent: NDArray[np.bool_]


@dataclass(slots=True)
class Gnss:
    """A receiver with its antenna at ``antenna`` (3,) m, vehicle axes from the rear axle."""

    trajectory: Trajectory
    antenna: Array
    errors: GnssErrors
    rng: np.random.Generator
    faults: Faults
    _correlated: GaussMarkov = field(init=False)

    def __post_init__(self) -> None:
        h, v = self.errors.correlated
        self._correlated = GaussMarkov(np.array([h, h, v]), self.errors.correlation_s, 3, self.rng)

    def block(self, t_ns: Times) -> GnssBlock:
        """Fixes at ``t_ns`` (n,), epochs of equal spacing."""
        motion = self.trajectory.motion(t_ns, self.antenna)
        n, rng = len(t_ns), self.rng
        dt = float(t_ns[1] - t_ns[0]) * 1e-9 if n > 1 else 1.0
        h, v = self.errors.white
        slow = rng.standard_normal((n, 3)) * np.array([h, h, v])
        for k in range(n):
            slow[k] += self._correlated.step(dt)[1]
        # errors that last are along axes that keep their direction over the ground, at a pole too
        error_e = np.einsum("nij,nj->ni", axes_eh(motion.lat, motion.lon, self.trajectory.pole), slow)
        error = np.zeros((n, 3))
        noise = rng.standard_normal((n, 3)) * self.errors.sigma_velocity()
        for outlier in self.faults.of(GnssOutlier):
            hit = outlier.during(t_ns) & (rng.random(n) < outlier.probability)
            direction = rng.uniform(0.0, 2.0 * math.pi, n)
            error[:, 0] += hit * outlier.size_m * np.cos(direction)
            error[:, 1] += hit * outlier.size_m * np.sin(direction)
        for jump in self.faults.of(GnssJump):
            error += jump.during(t_ns)[:, None] * np.array([jump.east_m, jump.north_m, jump.up_m])
        fix, silent = np.ones(n, np.bool_), np.zeros(n, np.bool_)
        for outage in self.faults.of(GnssOutage):
            during = outage.during(t_ns)
            fix &= ~during
            silent |= during & outage.silent
        C_eg = axes_eg(motion.lat, motion.lon)
        lat, lon, height = to_geodetic(motion.r_e + error_e + np.einsum("nij,nj->ni", C_eg, error))
        # a receiver says its velocity along east and north of where it thinks it is
        v_g = np.einsum("nji,nj->ni", axes_eg(lat, lon), motion.v_e) + noise
        return GnssBlock(lat=lat, lon=lon, height=height, v_g=v_g, fix=fix, silent=silent)
