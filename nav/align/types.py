"""What an alignment says while it runs, and what it hands over when it is done."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from nav.align.drift import Line
from nav.align.sensors import Sensors, against, sensors
from nav.types import ImuSample, Sample, Vector

if TYPE_CHECKING:
    from nav.transfer.report import Report


class AlignStatus(NamedTuple):
    """The one status of every alignment stage.

    ``estimate`` is q_gb (4,), or None while attitude is not known; ``covariance`` (3, 3) rad^2 is that of
    phi about east, north, up, with true C_gb = (I + [phi x]) estimated C_gb; ``limit`` (3,) rad is
    the standard deviation that these sensors cannot beat in the time given. ``progress`` runs from
    0 to 1. ``done`` says that the stage has nothing to add; ``refusal`` says why it cannot go on, and that
    it started again. ``behind`` says that it is going through stored samples and what it says holds for
    an earlier time than the last sample's; it is never ``done`` then. ``transfer`` is what a transfer
    alignment has to tell besides, ten times a second.
    """

    estimate: Vector | None
    covariance: Vector
    limit: Vector
    progress: float
    done: bool
    refusal: str | None = None
    behind: bool = False
    transfer: Report | None = None


@dataclass(frozen=True, slots=True)
class NavInit:
    """Where navigation starts: the state of the IMU point at ``t_ns`` and how far it is to be trusted.

    Position ``lat``, ``lon`` (rad), ``height`` (m above the ellipsoid); ``v_g`` (3,) m/s east, north,
    up; ``q_gb`` (4,) takes b to east-north-up. ``P_phi`` (3, 3) rad^2 is the covariance of phi about
    east, north, up, ``sigma_v`` (3,) m/s, ``sigma_p`` (3,) m east, north, up. ``gyro_bias`` (3,) rad/s and
    ``accel_bias`` (3,) m/s^2 in b are to be subtracted from the increments' rates, and are known to
    ``sigma_gyro_bias`` and ``sigma_accel_bias`` (3,). ``C_vb`` (3, 3) takes b to the vehicle axes, with
    ``sigma_mounting`` (3,) rad about right, forward, up of the vehicle; both are None where the alignment
    has not estimated the mounting. ``P`` (15, 15), where given, is the whole covariance with its
    cross terms (the tilt of a levelled IMU is its accelerometer bias): errors, true minus
    estimate, of position and velocity (east, north, up), phi, gyro bias, accelerometer bias.
    ``rest_rate`` (3,) rad/s and ``rest_force`` (3,) m/s^2 are the standard deviations of single samples
    while the vehicle stood (engine running or not): what a standstill looks like to this IMU. ``line`` is
    through the angles of a standstill that goes on.
    """

    t_ns: int
    lat: float
    lon: float
    height: float
    v_g: Vector
    q_gb: Vector
    P_phi: Vector
    sigma_v: Vector
    sigma_p: Vector
    gyro_bias: Vector
    accel_bias: Vector
    sigma_gyro_bias: Vector
    sigma_accel_bias: Vector
    C_vb: Vector | None = None
    sigma_mounting: Vector | None = None
    P: Vector | None = None
    rest_rate: Vector | None = None
    rest_force: Vector | None = None
    line: Line | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TransferConfig:
    """What a slave must know of its master, to be aligned from it (`nav.transfer`); SI units, one sigma.

    ``lever_arm`` (3,) m from the master's point to the slave's IMU in the master's body axes a, good to
    ``sigma_lever_arm`` m an axis. ``C_ab`` (3, 3) takes the slave's b to a as built, good to
    ``sigma_mounting`` (3,) rad about right, forward, up of a.

    Noise of one message, independent of the next: ``sigma_velocity`` m/s, ``sigma_attitude`` rad,
    ``sigma_position`` m, ``sigma_rate`` rad/s. ``vertical_walk`` m/s/sqrt(s): by which its vertical velocity
    wanders, as a barometer holds it, and no free inertial navigator's would. ``latency`` s: sigma of the
    constant error of its dating, by default that of a master without a clock in common, so that a tenth of a
    second, which straight on nothing shows, is within 99.9 % of what is handed over; ``latest_s``: a message
    that holds for a time longer ago is of no use.

    ``flexure`` (3,) rad about the axes of a, with correlation times ``flexure_time`` (3,) s: second-order
    Markov motion of the slave on its mounting, turning about the master's point. None: no states for it; what
    there is of it belongs into the noise of the attitude.

    ``duration`` s at least it takes, and ends when phi relative to the master is known to ``sigma`` (3,) rad
    about east, north, up, if not at once; after ``patience`` s without that it refuses. ``lockout`` s of
    messages refused or missing make it refuse, too.
    """

    lever_arm: Vector = field(default_factory=lambda: np.zeros(3))
    sigma_lever_arm: float = 0.02
    C_ab: Vector = field(default_factory=lambda: np.eye(3))
    sigma_mounting: Vector = field(default_factory=lambda: np.full(3, math.radians(0.5)))
    sigma_velocity: float = 0.02
    sigma_attitude: float = 3e-4
    sigma_position: float = 2.0
    sigma_rate: float = 1e-3
    vertical_walk: float = 0.0
    latency: float = 0.04
    latest_s: float = 0.5
    flexure: Vector | None = None
    flexure_time: Vector = field(default_factory=lambda: np.full(3, 0.5))
    duration: float = 5.0
    sigma: Vector = field(default_factory=lambda: np.full(3, 2e-3))
    patience: float = 3600.0
    lockout: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class AlignConfig:
    """What an alignment must know about sensors, place and time; SI units.

    ``gyro_bias`` rad/s, ``accel_bias`` m/s^2: standard deviation of the constant error of one sensor that
    is left after compensation; ``angle_random_walk`` rad/sqrt(s), ``velocity_random_walk`` m/s/sqrt(s).
    What motion shows: ``gyro_scale``, ``accel_scale`` (1), errors of scale, and ``gyro_axes``, ``accel_axes``
    (1), what input along one axis puts into each other one; ``gyro_walk`` rad/s/sqrt(s), ``accel_walk``
    m/s^2/sqrt(s), by which constant errors wander.
    ``coarse_s``, ``fine_s``: durations of a static alignment. ``position`` (lat rad, lon rad, height m)
    replaces a GNSS position where given, and is good to ``sigma_position`` m. ``sway`` m/s: rms velocity of
    a standing vehicle with its engine and the wind. ``gnss_lever_arm`` (3,) m from IMU to antenna in b;
    the velocity of a fix holds ``gnss_velocity_age`` s before its position (no more than a fix interval).
    ``C_vb`` (3, 3) is the mounting where known; None has it estimated. ``sigma_heading`` rad ends an
    alignment in motion, ``window_s`` bounds the motion it looks at, ``rest_s`` is the standstill it takes
    for levelling when the vehicle grants it. ``slope`` rad: standard deviation of the ground's inclination
    where the vehicle stands at first.

    ``store_s`` bounds the samples kept for going over them again, ``replay_samples`` how many of
    them one step may work off. ``heading`` (rad, and its sigma, rad) of the vehicle's forward axis and
    ``attitude`` (q_gb (4,), and sigma (3,) rad about east, north, up) are what is known from outside: a
    stored heading, another system's attitude.

    ``odometer_lever_arm`` (3,) m from IMU to the odometer's point in b; ``odometer_quantum`` m of a tick;
    ``odometer_scale`` (1) standard deviation of its scale factor, ``odometer_walk`` m per root of a metre: by
    how much it counts too much or too little; ``sigma_mounting`` rad: how far ``C_vb`` is to be trusted;
    ``slip`` m/s: standard deviation of the velocity across the vehicle on a straight road, to which
    `nav.align.rolled.road` adds what speed and level acceleration do.

    ``transfer``: of the master, where there is one; None: the defaults of `TransferConfig`.
    """

    gyro_bias: float
    accel_bias: float
    angle_random_walk: float
    velocity_random_walk: float
    coarse_s: float = 60.0
    fine_s: float = 240.0
    position: tuple[float, float, float] | None = None
    sigma_position: float = 10.0
    sway: float = 0.003
    gnss_lever_arm: Vector = field(default_factory=lambda: np.zeros(3))
    gnss_velocity_age: float = 0.0
    C_vb: Vector | None = None
    sigma_heading: float = math.radians(2.0)
    window_s: float = 40.0
    rest_s: float = 5.0
    slope: float = math.radians(2.0)
    store_s: float = 900.0
    replay_samples: int = 64
    heading: tuple[float, float] | None = None
    attitude: tuple[Vector, Vector] | None = None
    odometer_lever_arm: Vector = field(default_factory=lambda: np.zeros(3))
    odometer_quantum: float = 0.0
    odometer_scale: float = 0.01
    sigma_mounting: float = math.radians(0.1)
    odometer_walk: float = 0.003
    slip: float = 0.02
    gyro_scale: float = 0.0
    gyro_axes: float = 0.0
    accel_scale: float = 0.0
    accel_axes: float = 0.0
    gyro_walk: float = 0.0
    accel_walk: float = 0.0
    transfer: TransferConfig | None = None


State = TypeVar("State")


@dataclass(frozen=True, slots=True)
class Stage(Generic[State]):
    """One step of an alignment: three pure functions around a state of its own.

    ``init(config, given)`` starts from the previous stage's result (None for the first).
    ``step(state, sample)`` takes any sample in the order of arrival, ignores the kinds it has no use for,
    and returns the new state (the old one is used up) and its status. ``finish(state)`` hands over, at the
    time of the last inertial sample; it may be called once the status said ``done``.
    """

    init: Callable[[AlignConfig, NavInit | None], State]
    step: Callable[[State, Sample], tuple[State, AlignStatus]]
    finish: Callable[[State], NavInit]


@dataclass(frozen=True, slots=True)
class Alignment:
    """Stages in order, and what they cannot end without.

    ``needs``: names of sample kinds ("gnss", "odometer", "speed", "baro", "master"), and "heading" where the
    configuration must give a heading or an attitude. They all need a position: given, of GNSS, of the master.
    """

    needs: frozenset[str]
    stages: tuple[Stage[Any], ...]


class Run(NamedTuple):
    """An alignment under way: the watch over sensors, which stage, its state, how often it began again."""

    alignment: Alignment
    config: AlignConfig
    watched: Sensors
    stage: int
    state: Any
    restarts: int = 0


def lack(alignment: Alignment, kinds: Collection[str], config: AlignConfig) -> str:
    """What an alignment cannot end for want of, where samples of ``kinds`` come: a word of ``needs``.

    Or "position"; empty where nothing is missing.
    """
    for need in sorted(alignment.needs):
        if need == "heading":
            if config.heading is None and config.attitude is None:
                return need
        elif need not in kinds:
            return need
    placed = config.position is not None or "gnss" in kinds or "master" in alignment.needs
    return "" if placed else "position"


def begin(alignment: Alignment, config: AlignConfig) -> Run:
    """Start an alignment."""
    watched = sensors(config.gyro_bias, config.accel_bias)
    return Run(alignment, config, watched, 0, alignment.stages[0].init(config, None))


def advance(run: Run, sample: Sample) -> tuple[Run, AlignStatus]:
    """Give an alignment its next sample, in the order of arrival.

    A stage that refuses, or a sensor that is stuck or wild, sends the alignment back to its first stage; the
    status carries the reason once. ``done`` is the whole alignment's; after it call `result`.
    """
    stages = run.alignment.stages
    wrong = against(run.watched, sample) if isinstance(sample, ImuSample) else None
    state, status = stages[run.stage].step(run.state, sample)
    if wrong is not None:
        status = status._replace(done=False, refusal=wrong)
    progress = (run.stage + min(1.0, status.progress)) / len(stages)
    if status.refusal is not None:
        state = stages[0].init(run.config, None)
        return run._replace(stage=0, state=state, restarts=run.restarts + 1), status._replace(progress=0.0)
    if not status.done:
        # for nearly every sample: written out, which is faster than replacing by name
        if state is not run.state:
            run = Run(run.alignment, run.config, run.watched, run.stage, state, run.restarts)
        estimate, covariance, limit, _, _, _, behind, transfer = status
        return run, AlignStatus(estimate, covariance, limit, progress, False, None, behind, transfer)
    if run.stage + 1 == len(stages):
        return run._replace(state=state), status._replace(progress=1.0)
    given = stages[run.stage].finish(state)
    state = stages[run.stage + 1].init(run.config, given)
    return run._replace(stage=run.stage + 1, state=state), status._replace(progress=progress, done=False)


def result(run: Run) -> NavInit:
    """The hand-over of an alignment whose last status said ``done``."""
    return run.alignment.stages[-1].finish(run.state)
