"""One alignment of a simulated IMU after another, seed by seed: what was true, what came of it.

`SCENES` are the situations in which alignments are compared, each a function of a seed alone; `align` runs a
method on one, through the same `begin`, `advance` and `result` as the bridge.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from bridge.studies.alignment_truth import (
    DEG_PER_H,
    HEIGHT,
    LAT,
    LON,
    TICK,
    WALK,
    Base,
    G,
    Vector,
    drive,
    fixes,
    left_by_constants,
    merged,
    misalignment,
    road,
    rough,
    sensed,
    stops,
    ticks,
    times,
)
from nav.align import ALIGNMENTS, advance, begin, result
from nav.align.types import AlignConfig, NavInit
from nav.rotation import dcm_from_quat, quat_from_rotvec
from nav.types import Sample
from virtual_bus.ellipsoid import OMEGA, axes_eg, gravity, to_ecef
from virtual_bus.sensors import generator
from virtual_bus.truth import Trajectory

DT: Final = 0.01  # s: 100 Hz
ODO_DT, ODO_PHASE = 0.1, 0.03
ODO_SCALE: Final = 0.003
MOUNTING: Final = math.radians(0.05)
PLACE: Final = (0.3, 1.2, 0.8)  # m, of the IMU from the rear axle
REST_S, UNDER_WAY_S = 2.0, 20.0  # of a drive: it begins to move at 5
SPARE_S: Final = 3.0  # of samples after an alignment's time
STOPS_S: Final = 330.0

GRADE: Final = AlignConfig(
    gyro_bias=0.007 * DEG_PER_H,
    accel_bias=5e-5 * G,
    angle_random_walk=math.radians(0.0005) / 60.0,
    velocity_random_walk=1e-5 * G,
    coarse_s=60.0,
    fine_s=240.0,
    position=(LAT, LON, HEIGHT),
    store_s=1000.0,
    replay_samples=100_000,  # what is stored is worked off at once: the result is that of the time given
)
"""The sensors of Yan Gongmin 2008, sections 2.4.4 and 3.2.3; 100 Hz; standard deviations of what is drawn."""


class Left(NamedTuple):
    """What calibration has left of scale and axes, as `AlignConfig` has it."""

    gyro_scale: float = 0.0
    gyro_axes: float = 0.0
    accel_scale: float = 0.0
    accel_axes: float = 0.0


NOTHING: Final = Left()
"""What the printed conditions have of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What one seed makes of a situation.

    ``C_gb(t_ns)`` is the true attitude (3, 3), ``eps`` and ``nabla`` (3,) the constant errors in b;
    ``trajectory`` is there where the vehicle drives, from ``start_ns`` on. A ``rigid`` base does not turn.
    """

    config: AlignConfig
    samples: list[Sample]
    C_gb: Callable[[int], Vector]
    eps: Vector
    nabla: Vector
    trajectory: Trajectory | None = None
    start_ns: int = 0
    rigid: bool = False


class Outcome(NamedTuple):
    """What came of a run; rad.

    ``phi`` (3,) about east, north, up, true C_gb = (I + [phi x]) the one handed over, with its
    covariance ``P`` (3, 3); NaN where the method refused, for the reason in ``refusal``. ``constants`` is
    phi_U that a long static alignment of this IMU would leave, ``limit`` (3,) what `limit` says, ``way``
    the error of the level position over the distance rolled (NaN at rest), ``cpu_s`` what the method took.
    """

    seed: int
    phi: Vector
    P: Vector
    constants: float
    limit: Vector
    way: float
    refusal: str
    cpu_s: float


def limit(config: AlignConfig, seconds: float, rigid: bool) -> Vector:
    """phi (3,), rad: what constant and random errors leave of an alignment of ``seconds``.

    sqrt(bias^2 + n^2/t)/w_N, "Inertial navigation", eq. (2-104), with the accelerometers' part: their mean
    tilts the level, of which tan L goes into heading. On a base that is not ``rigid`` north is in how fast
    gravity turns as seen by the gyros, and accelerometer noise hides that: a line's slope varies by 12 q/t^3.
    """
    g = -float(gravity(np.array(LAT), np.array(HEIGHT))[1])
    level = math.hypot(config.accel_bias, config.velocity_random_walk / math.sqrt(seconds)) / g
    slope = 0.0 if rigid else math.sqrt(12.0 / seconds**3) * config.velocity_random_walk / g
    rate = math.hypot(config.gyro_bias, config.angle_random_walk / math.sqrt(seconds), slope)
    heading = math.hypot(rate / (OMEGA * math.cos(LAT)), math.tan(LAT) * level)
    return np.array([level, level, heading])


# ---- scenes -------------------------------------------------------------------------------------


class Imu(NamedTuple):
    """What is the same in all scenes of a seed: heading at first (rad), errors (3,) of gyros, accelerometers.

    So scenes and methods are compared on the same IMUs, and differ by what they are.
    """

    heading: float
    eps: Vector
    nabla: Vector


def _imu(seed: int, config: AlignConfig) -> Imu:
    rng = generator(seed, "imu")
    heading = rng.uniform(0.0, 2.0 * math.pi)
    return Imu(heading, config.gyro_bias * rng.standard_normal(3), config.accel_bias * rng.standard_normal(3))


def _fixed(
    seed: int,
    dt: float = DT,
    *,
    name: str,
    config: AlignConfig,
    swing: Vector | None = None,
    attitude: Vector | None = None,
    rest_s: float = 0.0,
    left: Left = NOTHING,
) -> Scene:
    """On a base that does not drive: at rest, or swaying."""
    config = replace(config, **left._asdict())
    rng, imu = generator(seed, name), _imu(seed, config)
    if attitude is None:
        attitude = np.append(imu.heading, rng.uniform(-0.1, 0.1, 2))
    rates = 2.0 * math.pi * rng.uniform(0.3, 1.2, 0 if swing is None else swing.shape[1])
    base = Base(rng, np.zeros((3, 0)) if swing is None else swing, rates, [0.3, 0.5, 1.0], attitude, rest_s)
    n = round((config.coarse_s + config.fine_s + SPARE_S) / dt)
    samples, eps, nabla = sensed(rng, config, *base.increments(n, dt), dt, imu.eps, imu.nabla)
    return Scene(config, list(samples), lambda t_ns: base.C_gb(t_ns * 1e-9), eps, nabla, rigid=swing is None)


def _misaligned(
    seed: int,
    dt: float = DT,
    *,
    name: str,
    angles_deg: tuple[float, float, float | None],
    left: Left = NOTHING,
) -> Scene:
    """At rest, with IMU axes that are off east-north-up by Euler platform angles; azimuth None: any.

    Yan Gongmin 2008, eq. (4-4): C_nb = C_np of the angles where the first guess is C_pb = I.
    """
    x, y, z = angles_deg
    # C_n^n' turns about z, x, y, as heading, pitch and roll turn, heading the other way
    heading = _imu(seed, GRADE).heading if z is None else -math.radians(z)
    attitude = np.append(heading, np.radians([x, y]))
    return _fixed(seed, dt, name=name, config=GRADE, attitude=attitude, left=left)


def _driving(
    seed: int, dt: float = DT, *, name: str, kind: str, from_rest: bool, left: Left = NOTHING
) -> Scene:
    """Ten minutes with an odometer: at 5 to 8 m/s from a rest on, or under way at 5 m/s."""
    config = replace(
        GRADE,
        fine_s=540.0,
        sigma_position=0.1,
        C_vb=np.eye(3),
        odometer_scale=ODO_SCALE,
        odometer_quantum=TICK,
        odometer_walk=WALK,
        sigma_mounting=MOUNTING,
        odometer_lever_arm=-np.array(PLACE),
        slip=0.002,
        **left._asdict(),
    )
    rng, imu = generator(seed, name), _imu(seed, config)
    seconds = config.coarse_s + config.fine_s + SPARE_S
    C_vb = dcm_from_quat(quat_from_rotvec(MOUNTING * rng.standard_normal(3)))
    way = road(kind, seconds, steady=not from_rest)
    trajectory = drive(way, imu.heading, LAT, LON, HEIGHT, PLACE, C_vb)
    begin_s = REST_S if from_rest else UNDER_WAY_S
    t_ns = times(begin_s, seconds, dt)
    start = trajectory.state(int(t_ns[0]))
    config = replace(config, position=(start.lat, start.lon, start.height))
    exact = rough(rng, trajectory, t_ns, config.slip)
    samples, eps, nabla = sensed(rng, config, *exact, dt, imu.eps, imu.nabla, int(t_ns[0]))
    scale = 1.0 + ODO_SCALE * rng.standard_normal()
    wheel = ticks(trajectory, times(begin_s - ODO_PHASE, seconds, ODO_DT), scale, rng=rng)
    return Scene(
        config, merged(samples, wheel), partial(_true, trajectory), eps, nabla, trajectory, int(t_ns[0])
    )


def _stopping(seed: int, dt: float = DT, *, name: str, left: Left = NOTHING) -> Scene:
    """Stop, drive, stop, drive, stop; GNSS positions of 2 m once a second and no velocities."""
    config = replace(
        GRADE,
        gyro_bias=0.005 * DEG_PER_H,
        accel_bias=3e-5 * G,
        fine_s=STOPS_S - GRADE.coarse_s - 1.0,
        position=None,
        **left._asdict(),
    )
    rng, imu = generator(seed, name), _imu(seed, config)
    trajectory = drive(stops(), imu.heading, LAT, LON, HEIGHT)
    exact = trajectory.increments(times(0.0, STOPS_S, dt))
    samples, eps, nabla = sensed(rng, config, *exact, dt, imu.eps, imu.nabla)
    fix = fixes(trajectory, times(0.0, STOPS_S, 1.0), rng, 0.3, 2.0, 150.0)
    return Scene(config, merged(samples, fix), partial(_true, trajectory), eps, nabla, trajectory)


def _true(trajectory: Trajectory, t_ns: int) -> Vector:
    return dcm_from_quat(trajectory.state(t_ns).q_gb)


_PEOPLE: Final = np.radians([[0.02] * 4, [0.15] * 4, [0.15] * 4])  # walking about: peaks of 0.5 deg
_RAPID: Final = replace(GRADE, gyro_bias=0.01 * DEG_PER_H)  # section 2.3.5
SHORT: Final = replace(GRADE, coarse_s=20.0, fine_s=50.0, sway=0.01)

SCENES: Final[dict[str, Callable[..., Scene]]] = {
    "standing": partial(_fixed, name="standing", config=GRADE),
    "standing, 0.01 deg/h": partial(_fixed, name="standing, 0.01 deg/h", config=_RAPID),
    "swaying after rest": partial(_fixed, name="swaying", config=SHORT, swing=_PEOPLE, rest_s=2.0),
    "swaying": partial(_fixed, name="swaying", config=SHORT, swing=_PEOPLE),
    "misaligned 30, 10, any": partial(_misaligned, name="30 10", angles_deg=(30.0, 10.0, None)),
    "misaligned 0.3, 0.1, any": partial(_misaligned, name="0.3 0.1", angles_deg=(0.3, 0.1, None)),
    "misaligned 0.3, 0.1, 1.7": partial(_misaligned, name="0.3 0.1 1.7", angles_deg=(0.3, 0.1, 1.7)),
    "straight road": partial(_driving, name="straight", kind="straight", from_rest=True),
    "winding road": partial(_driving, name="winding", kind="winding", from_rest=True),
    "straight road at 5 m/s": partial(_driving, name="straight 5", kind="straight", from_rest=False),
    "winding road under way": partial(_driving, name="winding 5", kind="winding", from_rest=False),
    "stops": partial(_stopping, name="stops"),
}
"""Name to scene of a seed, of the seconds between two samples (100 Hz where not given), and of what is
``left`` of scale and axes (nothing where not given)."""


# ---- runs ---------------------------------------------------------------------------------------


def align(method: str, scene: Scene, seed: int) -> Outcome:
    """Run a method of `ALIGNMENTS` on a scene, until it hands over or refuses."""
    config = scene.config
    before = time.process_time()
    run, refusal, init = begin(ALIGNMENTS[method], config), "", None
    for sample in scene.samples:
        run, status = advance(run, sample)
        if status.refusal is not None:
            refusal = status.refusal
            break
        if status.done:
            init = result(run)
            break
    spent = time.process_time() - before
    if init is None:
        refusal = refusal or "it did not end"
    seconds = config.coarse_s + (0.0 if method == "analytic" else config.fine_s)
    nothing = np.full(3, math.nan), np.full((3, 3), math.nan), math.nan, math.nan
    phi, P, constants, way = nothing if init is None else _compared(scene, init)
    return Outcome(seed, phi, P, constants, limit(config, seconds, scene.rigid), way, refusal, spent)


def _compared(scene: Scene, init: NavInit) -> tuple[Vector, Vector, float, float]:
    C_gb = scene.C_gb(init.t_ns)
    phi = misalignment(C_gb, init.q_gb)
    constants = left_by_constants(C_gb, scene.eps, scene.nabla)
    if scene.trajectory is None:
        return phi, init.P_phi, constants, math.nan
    there = scene.trajectory.motion(np.array([init.t_ns]))
    lat, lon = np.array(init.lat), np.array(init.lon)
    apart = to_ecef(lat, lon, np.array(init.height)) - there.r_e[0]
    level = (axes_eg(lat, lon).T @ apart)[0:2]
    profile = scene.trajectory.profile
    rolled = profile.distance(np.array([scene.start_ns, init.t_ns]))
    return phi, init.P_phi, constants, float(np.linalg.norm(level)) / float(rolled[1] - rolled[0])
