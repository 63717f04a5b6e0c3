"""Watching that a vehicle which should stand still does: blocks of inertial samples, odometer, GNSS."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np

from nav.align import drift
from nav.align.drift import Drift, Line
from nav.align.level import gnss_speed
from nav.align.preintegrate import turn_matrix
from nav.align.types import AlignConfig, AlignStatus
from nav.jit import in_place
from nav.types import GnssFix, ImuFlag, ImuSample, OdoSample, Sample, SpeedSample, Vector

BLOCK_S: Final = 1.0
TURNED: Final = math.radians(0.05)  # rad within a block
PUSHED: Final = 0.05  # m/s within a block
DROVE: Final = 0.5  # m/s by GNSS
JUMPED: Final = 5.0  # m by GNSS, beyond what it claims
ROLLED: Final = 0.02  # m by the odometer within one sample, or m/s of speed
SIGMAS: Final = 6.0
LEAN: Final = 30.0
_GAP: Final = int(ImuFlag.GAP)
_SATURATED: Final = int(ImuFlag.SATURATED)
_RADIUS: Final = 6.37e6  # m, of the Earth
_ZERO: Final = np.zeros(3)
# places in the sums over a block
_R: Final = slice(0, 9)  # rotation from b at its end to b at its start
_V: Final = slice(9, 12)  # m/s, integral of f in b at its start
_TURN: Final = slice(12, 15)  # rad, sum of the angle increments
_PUSH: Final = slice(15, 18)  # m/s, likewise
_AREA: Final = slice(18, 21)  # rad s, integral of the turn
_LATE: Final = slice(21, 24)  # rad s^2, of it times the time in the block
_DT: Final = 24  # s
_STEP: Final = slice(25, 34)  # rotation over the last sample
_SIZE: Final = 34
_NO_BIASES: Final = np.zeros(6)
_NOWHERE: Final = np.full(3, math.inf)


class Still(NamedTuple):
    """The open block, the means of the closed ones, and where GNSS says the antenna is."""

    block: Vector | None = None  # sums over the open one; used up
    rate: Vector = _ZERO  # means over the closed blocks, b
    force: Vector = _ZERO
    seconds: float = 0.0
    t_ns: int = 0  # end of the last of them
    place: Vector = _ZERO  # mean: lat rad, lon rad, height m
    sigma_place: Vector = _NOWHERE
    fixes: int = 0
    anchor: GnssFix | None = None
    line: Line = Line()  # through the angles
    blocks: int = 0


class Block(NamedTuple):
    """A closed block: what its samples come to, in b at its start, and their plain sums."""

    rotation: Vector  # (3, 3)
    dv: Vector  # (3,) m/s
    turned: Vector  # (3,) rad
    pushed: Vector  # (3,) m/s
    dt: float


def add(still: Still, sample: ImuSample, biases: Vector = _NO_BIASES) -> tuple[Still, bool]:
    """Add an inertial sample to the open block; also, whether that has its length now.

    ``biases`` (6,) rad/s and m/s^2 are taken off what turns and pushes b, not off the plain sums.
    """
    block = still.block
    if block is None:
        block = np.zeros(_SIZE)
        block[0:9:4] = 1.0
        still = still._replace(block=block)
    _, dt, dtheta, dv, _, _ = sample
    return still, _lengthen(block, dtheta, dv, dt, biases) >= BLOCK_S - 1e-6


@in_place
def _lengthen(block: Vector, dtheta: Vector, dv: Vector, dt: float, biases: Vector) -> float:
    """Take one more sample into a block; its seconds.

    Half the rotation of the interval is applied to its velocity increment, as in
    `nav.align.preintegrate.sample_piece`.
    """
    tx, ty, tz = dtheta[0] - biases[0] * dt, dtheta[1] - biases[1] * dt, dtheta[2] - biases[2] * dt
    ux, uy, uz = dv[0] - biases[3] * dt, dv[1] - biases[4] * dt, dv[2] - biases[5] * dt
    step = block[_STEP]
    turn_matrix(tx, ty, tz, step)
    vx, vy, vz = (
        ux + 0.5 * (ty * uz - tz * uy),
        uy + 0.5 * (tz * ux - tx * uz),
        uz + 0.5 * (tx * uy - ty * ux),
    )
    before = block[_DT]
    for i in range(3):
        a, b, c = block[3 * i], block[3 * i + 1], block[3 * i + 2]
        block[9 + i] += a * vx + b * vy + c * vz
        for j in range(3):
            block[3 * i + j] = a * step[j] + b * step[3 + j] + c * step[6 + j]
        middle = (block[12 + i] + 0.5 * dtheta[i]) * dt
        block[18 + i] += middle
        block[21 + i] += middle * (before + 0.5 * dt) + dtheta[i] * dt * dt / 12.0
        block[12 + i] += dtheta[i]
        block[15 + i] += dv[i]
    block[_DT] = before + dt
    return float(block[_DT])


def close(still: Still, config: AlignConfig, t_ns: int) -> tuple[Still, Block, str | None]:
    """Close the block at ``t_ns``: the new state, the block, and what moved, if it moved.

    A block is compared with the mean of those before it: a net turn or push of the vehicle shows, engine
    and wind average out.
    """
    sums = still.block
    assert sums is not None
    dt = float(sums[_DT])
    turned, pushed = sums[_TURN], sums[_PUSH]
    reason = None
    if still.seconds > 0.0:
        turn = float(np.linalg.norm(turned - still.rate * dt))
        push = float(np.linalg.norm(pushed - still.force * dt))
        spread = math.sqrt(dt * (1.0 + dt / still.seconds))
        if turn > max(TURNED, SIGMAS * config.angle_random_walk * spread):
            reason = f"the vehicle turned by {math.degrees(turn):.2f} deg in {dt:.1f} s"
        elif push > max(PUSHED, SIGMAS * config.velocity_random_walk * spread):
            reason = f"the vehicle was pushed: its velocity changed by {push:.2f} m/s in {dt:.1f} s"
    seconds = still.seconds + dt
    turn_of = drift.Turn(dt, turned, sums[_AREA], sums[_LATE] / dt)
    still = still._replace(
        block=None,
        rate=still.rate + (turned - still.rate * dt) / seconds,
        force=still.force + (pushed - still.force * dt) / seconds,
        seconds=seconds,
        t_ns=t_ns,
        line=drift.follow(still.line, turn_of, drift.average(config.coarse_s, BLOCK_S)),
        blocks=still.blocks + 1,
    )
    return still, Block(sums[_R].reshape(3, 3), sums[_V], turned, pushed, dt), reason


def mean_rate(still: Still, config: AlignConfig) -> tuple[Drift, Vector]:
    """The mean rate and what turned it beside that, and the covariance (3, 3) of the rate as an Earth's.

    Without the gyros' constant errors: of what random walk gives, or what the angles show where that is more
    than chance. A vehicle that somebody tilts a little has turned once, and its mean rate is not Earth's.
    """
    found = drift.fitted(still.line, config.angle_random_walk)
    return found, found.walk * (1.2 / still.seconds)


def rate_covariance(still: Still, config: AlignConfig) -> Vector:
    """The covariance of `mean_rate` alone."""
    return mean_rate(still, config)[1]


def angle_walk(still: Still, config: AlignConfig) -> float:
    """Density (rad^2/s) of the random walk by which angles scatter: the gyros', or what they show if more.

    An angle that only a gyro saw, or an unseen turn, is none of the gyros' walk: a filter that does not know
    takes it for heading.
    """
    return float(np.max(np.linalg.eigvalsh(drift.fitted(still.line, config.angle_random_walk).walk)))


class Lean(NamedTuple):
    """What innovations have in common that should have nothing, fading over `LEAN` of them."""

    sums: Vector | None = None
    squares: float = 0.0  # mean of a component's, at first one
    weight: float = 0.0


def contradiction(leaning: Lean, y: Vector, S: Vector, floor: float, unit: str) -> tuple[Lean, str | None]:
    """Whether an innovation (n,) of covariance (n, n), or what the last have in common, is no standstill's.

    One is let pass up to ``floor``: a sway may be larger than configured. An unseen turn, or an angle that
    only a gyro saw, is far below the sway of a block, but it stays; what sways leans to no side, and is
    measured by its own scatter where that is larger than it should be.
    """
    white = np.linalg.solve(np.linalg.cholesky(S), y)
    keep = 1.0 - 1.0 / LEAN
    sums = white if leaning.sums is None else keep * leaning.sums + white
    weight = keep * leaning.weight + 1.0
    squares = leaning.squares + (float(white @ white) / len(white) - leaning.squares) / weight
    leaning = Lean(sums, squares, weight)
    size = float(np.linalg.norm(y))
    if float(white @ white) > SIGMAS**2 and size > floor:
        return leaning, f"the vehicle moves: {size:.3f} {unit} against a standstill"
    scatter = max(1.0, squares - float(sums @ sums) / (len(sums) * weight**2))
    # of white noise the sum has the variance of keep^2k summed up
    variance = (1.0 - (1.0 - weight / LEAN) ** 2) / (1.0 - keep**2)
    sigmas = float(np.linalg.norm(sums)) / math.sqrt(scatter * variance)
    if sigmas > SIGMAS:
        return leaning, (
            f"force and rate contradict a standstill by {sigmas:.0f} sigma: the vehicle moves, "
            "or a gyro or an accelerometer is wrong"
        )
    return leaning, None


def fault(sample: ImuSample) -> str | None:
    """Why an inertial sample ends a static alignment, or None."""
    if sample.flags & _GAP:
        return "inertial samples are missing"
    if sample.flags & _SATURATED:
        return "an inertial sensor is saturated"
    return None


def aid(still: Still, sample: object) -> tuple[Still, str | None]:
    """Take an odometer, speed or GNSS sample: mean position, and what moved, if it moved."""
    if isinstance(sample, OdoSample) and abs(sample.distance) > ROLLED:
        return still, f"the odometer rolls: {sample.distance:.2f} m in {sample.dt:.2f} s"
    if isinstance(sample, SpeedSample) and abs(sample.speed) > ROLLED + SIGMAS * sample.sigma:
        return still, f"the vehicle drives: {sample.speed:.2f} m/s"
    if not isinstance(sample, GnssFix):
        return still, None
    speed, anchor = gnss_speed(sample, still.anchor)
    sigma_p = np.asarray(sample.sigma_position, dtype=np.float64)
    claimed = sample.sigma_velocity
    sigma = float(np.max(sigma_p)) if claimed is None else float(np.max(claimed))
    if speed is not None and speed > DROVE + SIGMAS * sigma:
        return still._replace(anchor=anchor), f"the vehicle drives: {speed:.1f} m/s by GNSS"
    step = np.array([sample.lat, sample.lon, sample.height]) - still.place
    step[1] = math.remainder(step[1], 2.0 * math.pi)  # on the date line
    far = float(np.linalg.norm(step * [_RADIUS, _RADIUS * math.cos(sample.lat), 1.0]))
    if still.fixes and far > JUMPED + SIGMAS * float(np.linalg.norm(sigma_p)):
        reason = f"by GNSS it is {far:.0f} m from where it stood: the vehicle moved, or the fix is wrong"
        return still._replace(anchor=anchor), reason
    n = still.fixes + 1
    # each fix errs in its own way here; what they have in common is added where it is configured
    return still._replace(
        anchor=anchor,
        place=still.place + step / n,
        sigma_place=sigma_p / math.sqrt(n),
        fixes=n,
    ), None


Own = TypeVar("Own")


class Standing(NamedTuple, Generic[Own]):
    """State of a stage at rest: the watch over it, what it says, and what is its ``own``."""

    config: AlignConfig
    still: Still
    status: AlignStatus
    own: Own
    biases: Vector = _NO_BIASES  # (6,) rad/s, m/s^2 in b, taken off the samples


def standing(
    work: Callable[[Standing[Own], Block], tuple[Standing[Own], str | None]],
) -> Callable[[Standing[Own], Sample], tuple[Standing[Own], AlignStatus]]:
    """The step of a stage at rest that does ``work`` with every closed block, and refuses as it says."""

    def step(state: Standing[Own], sample: Sample) -> tuple[Standing[Own], AlignStatus]:
        """Work in inertial samples; wheels and GNSS may contradict the rest."""
        config, before, status, own, biases = state
        if isinstance(sample, ImuSample):
            reason = fault(sample)
            still, full = add(before, sample, biases)
        else:
            still, reason = aid(before, sample)
            full = False
        block = None
        if full and reason is None:
            still, block, reason = close(still, config, sample.t_ns)
        if still is not before:
            state = Standing(config, still, status, own, biases)
        if block is not None and reason is None:
            state, reason = work(state, block)
        if reason is not None:
            return state, state.status._replace(done=False, refusal=reason)
        return state, state.status

    return step
