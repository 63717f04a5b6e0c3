"""Watching that a vehicle which should stand still does: blocks of inertial samples, odometer, GNSS."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np

from nav.align import drift
from nav.align.drift import Drift, Line
from nav.align.level import gnss_speed
from nav.align.preintegrate import DT, SIZE, R, V, empty, extend, sample_piece
from nav.align.types import AlignConfig, AlignStatus
from nav.jit import kernel
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
_TURN: Final = slice(SIZE, SIZE + 3)  # rad, sum of the angle increments of a block, behind its piece
_PUSH: Final = slice(SIZE + 3, SIZE + 6)  # m/s, likewise
_AREA: Final = slice(SIZE + 6, SIZE + 9)  # rad s, integral of the turn
_LATE: Final = slice(SIZE + 9, SIZE + 12)  # rad s^2, of it times the time in the block
_NOTHING: Final = np.concatenate([empty(), np.zeros(12)])
_NO_BIASES: Final = np.zeros(6)
_NOWHERE: Final = np.full(3, math.inf)


class Still(NamedTuple):
    """The open block, the means of the closed ones, and where GNSS says the antenna is."""

    block: Vector = _NOTHING  # the open one: its piece and the sums of its increments
    rate: Vector = _ZERO  # means over the closed blocks, b
    force: Vector = _ZERO
    seconds: float = 0.0
    t_ns: int = 0
    place: Vector = _ZERO  # mean: lat rad, lon rad, height m
    sigma_place: Vector = _NOWHERE
    fixes: int = 0
    anchor: GnssFix | None = None
    line: Line = Line()  # through the angles
    blocks: int = 0


def add(still: Still, sample: ImuSample, gyro_bias: Vector, accel_bias: Vector) -> Still:
    """Add an inertial sample to the open block."""
    t_ns, dt, dtheta, dv, _, _ = sample
    before, rate, force, seconds, _, place, sigma_place, fixes, anchor, line, blocks = still
    longer = np.empty(len(before))
    _lengthen(before, dtheta, dv, dt, gyro_bias, accel_bias, _ZERO, longer)
    return Still(longer, rate, force, seconds, t_ns, place, sigma_place, fixes, anchor, line, blocks)


@kernel
def _lengthen(
    before: Vector,
    dtheta: Vector,
    dv: Vector,
    dt: float,
    gyro_bias: Vector,
    accel_bias: Vector,
    zero: Vector,
    out: Vector,
) -> None:
    """The block ``before`` with one more sample, into ``out``."""
    piece = np.empty(SIZE)
    sample_piece(dtheta, dv, dt, gyro_bias, accel_bias, piece)
    out[:] = before
    extend(out, piece, zero, zero)
    for i in range(3):
        middle = (out[SIZE + i] + 0.5 * dtheta[i]) * dt
        out[SIZE + 6 + i] += middle
        out[SIZE + 9 + i] += middle * (before[DT] + 0.5 * dt) + dtheta[i] * dt * dt / 12.0
        out[SIZE + i] += dtheta[i]
        out[SIZE + 3 + i] += dv[i]


def full(still: Still) -> bool:
    """Whether the open block has its length."""
    return float(still.block[DT]) >= BLOCK_S - 1e-6


def close(still: Still, config: AlignConfig) -> tuple[Still, str | None]:
    """Close the block: the new state, and what moved, if it moved.

    A block is compared with the mean of those before it: a net turn or push of the vehicle shows, engine
    and wind average out.
    """
    dt = float(still.block[DT])
    turned, pushed = still.block[_TURN], still.block[_PUSH]
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
    turn_of = drift.Turn(dt, turned, still.block[_AREA], still.block[_LATE] / dt)
    still = still._replace(
        block=_NOTHING,
        rate=still.rate + (turned - still.rate * dt) / seconds,
        force=still.force + (pushed - still.force * dt) / seconds,
        seconds=seconds,
        line=drift.follow(still.line, turn_of, drift.average(config.coarse_s, BLOCK_S)),
        blocks=still.blocks + 1,
    )
    return still, reason


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


class Block(NamedTuple):
    """A closed block: what its samples come to, in b at its start, and their plain sums."""

    rotation: Vector  # (3, 3)
    dv: Vector  # (3,) m/s
    turned: Vector  # (3,) rad
    pushed: Vector  # (3,) m/s
    dt: float


def standing(
    work: Callable[[Standing[Own], Block], tuple[Standing[Own], str | None]],
) -> Callable[[Standing[Own], Sample], tuple[Standing[Own], AlignStatus]]:
    """The step of a stage at rest that does ``work`` with every closed block, and refuses as it says."""

    def step(state: Standing[Own], sample: Sample) -> tuple[Standing[Own], AlignStatus]:
        """Work in inertial samples; wheels and GNSS may contradict the rest."""
        config, still, status, own, biases = state
        if isinstance(sample, ImuSample):
            reason = fault(sample)
            still = add(still, sample, biases[:3], biases[3:])
            state = Standing(config, still, status, own, biases)
            if reason is None and full(still):
                p = still.block
                block = Block(p[R].reshape(3, 3), p[V], p[_TURN], p[_PUSH], float(p[DT]))
                still, reason = close(still, config)
                state = Standing(config, still, status, own, biases)
                if reason is None:
                    state, reason = work(state, block)
        else:
            still, reason = aid(still, sample)
            state = Standing(config, still, status, own, biases)
        if reason is not None:
            return state, state.status._replace(done=False, refusal=reason)
        return state, state.status

    return step
