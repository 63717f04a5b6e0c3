"""Truth for alignments: a base that stands or sways, a vehicle on a road, and what sensors make of either.

Nothing here comes from the navigator but rotations and the form of its samples: the Earth is the simulated
bench's, increments are integrals of closed forms or of the bench's trajectory. A run is its random generator.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from nav.align.types import AlignConfig
from nav.rotation import dcm_from_euler, dcm_from_quat, quat_from_dcm, rotvec_from_quat
from nav.types import FixType, GnssFix, ImuSample, OdoSample, Sample
from virtual_bus.ellipsoid import G0, OMEGA, gravity
from virtual_bus.grades import DEG_PER_H
from virtual_bus.manoeuvres import Accelerate, Brake, Cruise, Manoeuvre, Profile, Static, STurns, Turn
from virtual_bus.truth import Trajectory, Vehicle

Vector = NDArray[np.float64]
Times = NDArray[np.int64]

G: Final = G0
LAT, LON, HEIGHT = math.radians(34.18), math.radians(108.9), 400.0
TICK: Final = 0.08194  # m
WALK: Final = 0.003  # m per root of a metre that wheels roll
ONSET_S: Final = 2.0  # in which a sway that begins comes to its full strength
DELAY_NS: Final = 60_000_000  # of a fix
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)

__all__ = [
    "DEG_PER_H",
    "HEIGHT",
    "LAT",
    "LON",
    "TICK",
    "Base",
    "G",
    "drive",
    "fixes",
    "left_by_constants",
    "merged",
    "misalignment",
    "road",
    "rough",
    "sensed",
    "stops",
    "ticks",
    "times",
]


class Base:
    """Rotations about a point fixed to the Earth at ``LAT``, in closed form.

    Heading, pitch and roll swing by ``swing`` (3, k) rad at ``rates`` (k,) rad/s; the IMU is ``lever`` (3,) m
    from the point, in b. Phases are random, so the sway is under way when it is first looked at, but
    for ``rest_s``: where that is not zero the base stands so long first. ``attitude`` (3,) rad is the mean
    heading, pitch and roll; without it any heading and up to 0.1 rad of the others are drawn.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        swing: ArrayLike,
        rates: ArrayLike,
        lever: ArrayLike,
        attitude: ArrayLike | None = None,
        rest_s: float = 0.0,
    ) -> None:
        self.mean = np.append(rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.1, 0.1, 2))
        if attitude is not None:
            self.mean = np.asarray(attitude, dtype=np.float64)
        self.swing, self.rates = np.asarray(swing, dtype=np.float64), np.asarray(rates, dtype=np.float64)
        self.phase = rng.uniform(0.0, 2.0 * math.pi, self.swing.shape)
        self.lever = np.asarray(lever, dtype=np.float64)
        self.rest_s = rest_s

    def C_gb(self, t: ArrayLike) -> Vector:
        """Attitude (..., 3, 3) at ``t`` (...) s."""
        a = self._angles(np.asarray(t, dtype=np.float64))[0]
        return dcm_from_euler(a[..., 0], a[..., 1], a[..., 2])

    def velocity(self, t: ArrayLike) -> Vector:
        """Velocity (..., 3) of the IMU, m/s east, north, up."""
        t = np.asarray(t, dtype=np.float64)
        v = np.cross(self._rates(*self._angles(t))[0], self.lever)
        return np.asarray(np.einsum("...ij,...j", self.C_gb(t), v))

    def increments(self, n: int, dt: float) -> tuple[Vector, Vector]:
        """Exact dtheta and dv (n, 3) of ``n`` samples of ``dt`` s, rad and m/s in b."""
        t = dt * (np.arange(n)[:, None] + 0.5 * (_NODES + 1.0))
        north, up = (float(x) for x in gravity(np.array(LAT), np.array(HEIGHT)))
        w_ie = OMEGA * np.array([0.0, math.cos(LAT), math.sin(LAT)])
        angles = self._angles(t)
        a = angles[0]
        C = dcm_from_euler(a[..., 0], a[..., 1], a[..., 2])
        w, dw = self._rates(*angles)
        v = np.cross(w, self.lever)
        w_ie_b = np.einsum("...ji,j", C, w_ie)
        force = np.cross(dw, self.lever) + np.cross(w + 2.0 * w_ie_b, v)
        force -= np.einsum("...ji,j", C, np.array([0.0, north, up]))
        k = 0.5 * dt * _WEIGHTS
        return np.einsum("k,nkj->nj", k, w + w_ie_b), np.einsum("k,nkj->nj", k, force)

    def _angles(self, t: Vector) -> tuple[Vector, Vector, Vector]:
        """Heading, pitch and roll (..., 3) rad, and two derivatives."""
        wave = self.rates * t[..., None, None] + self.phase
        sine, cosine = self.swing * np.sin(wave), self.swing * self.rates * np.cos(wave)
        s, s1, s2 = sine.sum(-1), cosine.sum(-1), -(sine * self.rates**2).sum(-1)
        if self.rest_s > 0.0:
            x = np.clip((t[..., None] - self.rest_s) / ONSET_S, 0.0, 1.0)
            e = x**3 * (10.0 + x * (6.0 * x - 15.0))
            e1 = 30.0 * (x * (1.0 - x)) ** 2 / ONSET_S
            e2 = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ONSET_S**2
            s, s1, s2 = e * s, e1 * s + e * s1, e2 * s + 2.0 * e1 * s1 + e * s2
        return self.mean + s, s1, s2

    @staticmethod
    def _rates(angles: Vector, first: Vector, second: Vector) -> tuple[Vector, Vector]:
        """w_gb_b (..., 3) and its derivative: heading turns about down, then pitch, then roll."""
        zero = np.zeros(angles.shape[:-1])

        def axis(k: int, x: Vector) -> Vector:
            return np.stack([x if j == k else zero for j in range(3)], axis=-1)

        def back(C: Vector, v: Vector) -> Vector:
            return np.asarray(np.einsum("...ji,...j", C, v))

        C_pitch = dcm_from_euler(zero, angles[..., 1], zero)
        C_roll = dcm_from_euler(zero, zero, angles[..., 2])
        pitch, roll = axis(0, first[..., 1]), axis(1, first[..., 2])
        turning = back(C_pitch, axis(2, -first[..., 0]))
        both = back(C_roll, turning + pitch)
        speeding = back(C_pitch, axis(2, -second[..., 0])) - np.cross(pitch, turning)
        change = back(C_roll, speeding + axis(0, second[..., 1])) - np.cross(roll, both)
        return both + roll, change + axis(1, second[..., 2])


# ---- what the sensors make of it ----------------------------------------------------------------


def sensed(
    rng: np.random.Generator,
    config: AlignConfig,
    dtheta: Vector,
    dv: Vector,
    dt: float,
    eps: Vector | None = None,
    nabla: Vector | None = None,
    start_ns: int = 0,
) -> tuple[list[ImuSample], Vector, Vector]:
    """Inertial samples with the errors of ``config``, and the constant errors (3,) of gyros, accelerometers.

    ``dtheta``, ``dv`` (n, 3) are exact; errors that are not given are drawn. The constant errors of
    accelerometers hold at the mean specific force: what scale and axes make of gravity is in them.
    """
    eps = config.gyro_bias * rng.standard_normal(3) if eps is None else eps
    nabla = config.accel_bias * rng.standard_normal(3) if nabla is None else nabla
    root, step = math.sqrt(dt), round(dt * 1e9)
    own = rng.spawn(1)[0].standard_normal((2, 3, 3))
    one = np.eye(3, dtype=bool)
    turns = dtheta @ (np.where(one, config.gyro_scale, config.gyro_axes) * own[0]).T
    pushes = (dv - dv.mean(axis=0)) @ (np.where(one, config.accel_scale, config.accel_axes) * own[1]).T
    dtheta = dtheta + eps * dt + config.angle_random_walk * root * rng.standard_normal(dtheta.shape)
    dv = dv + nabla * dt + config.velocity_random_walk * root * rng.standard_normal(dv.shape)
    dtheta, dv = dtheta + turns, dv + pushes
    samples = [ImuSample(start_ns + (k + 1) * step, dt, dtheta[k], dv[k], "imu") for k in range(len(dtheta))]
    return samples, eps, nabla


def misalignment(C_gb: ArrayLike, q_gb: ArrayLike) -> Vector:
    """phi (3,) with true C_gb (3, 3) = (I + [phi x]) the one of ``q_gb`` (4,)."""
    return rotvec_from_quat(quat_from_dcm(np.asarray(C_gb) @ dcm_from_quat(q_gb).T))


def left_by_constants(C_gb: Vector, eps: Vector, nabla: Vector) -> float:
    """phi_U (rad) of a long static alignment at this attitude with constant errors in b.

    "Inertial navigation", eq. (2-104), strapdown sign.
    """
    g = -float(gravity(np.array(LAT), np.array(HEIGHT))[1])
    east, force = float((C_gb @ eps)[0]), float((C_gb @ nabla)[0])
    return -east / (OMEGA * math.cos(LAT)) + math.tan(LAT) * force / g


# ---- a vehicle on a road ------------------------------------------------------------------------


def drive(
    manoeuvres: Sequence[Manoeuvre],
    heading: float,
    lat: float,
    lon: float,
    height: float,
    imu: ArrayLike = (0.0, 0.0, 0.0),
    C_vb: Vector | None = None,
) -> Trajectory:
    """A trajectory; ``imu`` m from the rear axle, in vehicle axes."""
    blends, speed = [], 0.0
    for m in manoeuvres:
        new = m.blends(speed)
        speed += sum(b.speed for b in new)
        blends += new
    vehicle = Vehicle(np.asarray(imu), np.eye(3) if C_vb is None else C_vb)
    return Trajectory(Profile(blends, heading), vehicle, lat, lon, height)


def road(kind: str, seconds: float, speed: float = 5.0, steady: bool = True) -> list[Manoeuvre]:
    """Twenty seconds to get going, then ``seconds`` of a nearly straight or of a winding road.

    ``speed`` m/s is kept on the straight one where ``steady``; else either has stretches of 1.6 times that.
    """
    begin: list[Manoeuvre] = [
        Static(duration_s=5.0),
        Accelerate(duration_s=10.0, speed_m_s=speed),
        Cruise(duration_s=5.0),
    ]
    part: list[Manoeuvre]
    if kind == "straight":
        part = [STurns(duration_s=60.0, angle_deg=5.0, count=1)]
        part += [Cruise(duration_s=60.0)] if steady else _faster(speed, 48.0)
    else:
        part = [
            Turn(duration_s=12.0, angle_deg=90.0),
            Cruise(duration_s=30.0),
            STurns(duration_s=60.0, angle_deg=40.0, count=2),
            Turn(duration_s=12.0, angle_deg=-70.0),
            Cruise(duration_s=20.0),
            Accelerate(duration_s=6.0, speed_m_s=1.6 * speed),
            Turn(duration_s=15.0, angle_deg=120.0),
            Accelerate(duration_s=5.0, speed_m_s=speed),
        ]
    one = sum(m.duration_s for m in part)
    return [*begin, *part * math.ceil((seconds + 5.0) / one)]


def _faster(speed: float, seconds: float) -> list[Manoeuvre]:
    faster, back = (Accelerate(duration_s=6.0, speed_m_s=k * speed) for k in (1.6, 1.0))
    return [faster, Cruise(duration_s=seconds), back]


def stops(speed: float = 14.0, drive_s: float = 150.0, stop_s: float = 10.0) -> list[Manoeuvre]:
    """Stop, drive, stop, drive, stop."""
    leg: list[Manoeuvre] = [
        Accelerate(duration_s=15.0, speed_m_s=speed),
        Turn(duration_s=15.0, angle_deg=60.0),
        Cruise(duration_s=drive_s - 85.0),
        Turn(duration_s=15.0, angle_deg=-100.0),
        Cruise(duration_s=25.0),
        Brake(duration_s=15.0),
        Static(duration_s=stop_s),
    ]
    return [Static(duration_s=stop_s), *leg, *leg]


def times(start_s: float, seconds: float, step_s: float) -> Times:
    """Nanoseconds (n + 1,) from ``start_s`` on."""
    step = round(step_s * 1e9)
    return round(start_s * 1e9) + step * np.arange(round(seconds / step_s) + 1)


def rough(
    rng: np.random.Generator, trajectory: Trajectory, t_ns: Times, slip: float
) -> tuple[Vector, Vector]:
    """dtheta and dv (n - 1, 3) of an IMU on wheels that a road takes off their way.

    They are those of `Trajectory.increments`, and of velocities to the right and upwards that ticks do not
    show: of ``slip`` m/s on a straight road, half of that more for each m/s^2 of level acceleration, for
    about a second; and of a quarter of it for each m/s of speed, for 12.5 m of way. They come to decimetres:
    what these do to gravity and Earth's rate is left out.
    """
    dtheta, dv = trajectory.increments(t_ns)
    value, first, _, _ = trajectory.profile.channels(t_ns)
    speed = np.abs(value[:, 0])
    level = np.hypot(first[:, 0], speed * first[:, 1])
    v_v = np.zeros((len(t_ns), 3))
    for sigma, over, lasts in (
        (slip * np.hypot(1.0, 0.5 * level), 1e-9 * t_ns.astype(np.float64), 1.0),
        (0.25 * slip * speed, trajectory.profile.distance(t_ns), 12.5),
    ):
        v_v[:, [0, 2]] += sigma[:, None] * _lasting(rng, over, lasts)
    v_b = v_v @ trajectory.vehicle.C_vb
    return dtheta, dv + np.diff(v_b, axis=0) + np.cross(dtheta, 0.5 * (v_b[1:] + v_b[:-1]))


def _lasting(rng: np.random.Generator, over: Vector, lasts: float) -> Vector:
    """Two processes (n, 2) of unit variance and first order, over time or way (n,).

    What they do in ``lasts`` is on the average the same: twice that in which they decay.
    """
    step = 0.01 * lasts
    keep = math.exp(-2.0 * step / lasts)
    white = rng.standard_normal((math.ceil((over[-1] - over[0]) / step) + 2, 2))
    white[1:] *= math.sqrt(1.0 - keep**2)
    values = lfilter([1.0], [1.0, -keep], white, axis=0)
    place = over[0] + step * np.arange(len(white))
    return np.stack([np.interp(over, place, column) for column in values.T], axis=1)


def ticks(
    trajectory: Trajectory,
    t_ns: Times,
    scale: float = 1.0,
    tick: float = TICK,
    rng: np.random.Generator | None = None,
) -> list[OdoSample]:
    """Odometer samples between the times, in whole ticks.

    With an ``rng`` the wheels begin anywhere between two, and count `WALK` too much or too little on the way.
    """
    rolled = trajectory.profile.distance(t_ns) * scale
    if rng is not None:
        error = WALK * np.sqrt(np.diff(rolled)) * rng.standard_normal(len(rolled) - 1)
        rolled[1:] += np.cumsum(error)
        rolled = np.maximum.accumulate(rolled + rng.uniform(0.0, tick))
    whole = np.floor(rolled / tick)
    dt = float(t_ns[1] - t_ns[0]) * 1e-9
    distance = np.diff(whole) * tick
    return [OdoSample(int(t), dt, float(d), False, "odo") for t, d in zip(t_ns[1:], distance, strict=True)]


def fixes(
    trajectory: Trajectory,
    t_ns: Times,
    rng: np.random.Generator,
    white: float,
    correlated: float,
    tau: float,
    velocity: float | None = None,
    antenna: Vector | None = None,
) -> list[GnssFix]:
    """Fixes of the IMU's place, or of ``antenna`` (m, vehicle axes).

    White and lasting errors in m, of velocity in m/s, are level ones; height has twice as much.
    """
    motion = trajectory.motion(t_ns, antenna)
    n, dt = len(t_ns), float(t_ns[1] - t_ns[0]) * 1e-9
    size = np.array([1.0, 1.0, 2.0])
    keep = math.exp(-dt / tau)
    slow = np.empty((n, 3))
    slow[0] = correlated * size * rng.standard_normal(3)
    for k in range(1, n):
        slow[k] = keep * slow[k - 1] + math.sqrt(1.0 - keep**2) * correlated * size * rng.standard_normal(3)
    error = slow + white * size * rng.standard_normal((n, 3))
    r = 6.37e6
    out = []
    for k in range(n):
        v = None if velocity is None else motion.v_g[k] + velocity * size * rng.standard_normal(3)
        out.append(
            GnssFix(
                int(t_ns[k]),
                float(motion.lat[k] + error[k, 1] / r),
                float(motion.lon[k] + error[k, 0] / (r * math.cos(motion.lat[k]))),
                float(motion.height[k] + error[k, 2]),
                math.hypot(white, correlated) * size,
                v,
                None if velocity is None else velocity * size,
                FixType.FIX_3D,
                "gnss",
            )
        )
    return out


def merged(*streams: Iterable[Sample]) -> list[Sample]:
    """Samples in the order of arrival: a fix takes 60 ms; of equal times the first stream's is first."""
    every = (s for stream in streams for s in stream)
    return sorted(every, key=lambda s: s.t_ns + (DELAY_NS if isinstance(s, GnssFix) else 0))
