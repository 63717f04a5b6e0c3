"""Coarse static alignment: heading from Earth rate, for gyros that can see it.

It averages and constructs the attitude from gravity and Earth rate, "Inertial navigation", eqs. (2-101) and
(2-113). Fine stages go on from there: `nav.align.open_loop`, `nav.align.kalman`.

What none of them can beat, "Inertial navigation", eq. (2-104), strapdown sign of the gyro error: phi_E =
-nabla_N/g, phi_N = nabla_E/g, phi_U = -eps_E/w_N + tan(L) nabla_E/g. The coarse stage's covariance
holds these with their cross terms, so that the fine stage knows that it cannot tell the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from nav.align import still as watch
from nav.align.drift import FEWEST
from nav.align.handover import Place, hand_over, imu_place, under_antenna
from nav.align.still import Block, Own, Standing, Still
from nav.align.types import AlignConfig, AlignStatus, NavInit, Stage
from nav.earth import EARTH_RATE, earth_rate_g, gravity_g, normal_gravity
from nav.rotation import cross, dcm_from_quat, quat_from_dcm, quat_from_rotvec
from nav.types import Sample, Vector

SIGMAS: Final = 6.0
BLIND: Final = 0.3  # of the horizontal Earth rate: gyros worse than this cannot find heading
SMALL: Final = math.radians(2.0)  # of azimuth, beside what the drifts explain
HEIGHTS: Final = 0.005  # m/s^2, what a height may be wrong by in gravity
PATIENCE_S: Final = 60.0  # seconds to wait for a position after the coarse stage
SOMEWHERE: Final = (0.8, 0.0)  # latitude rad and height m to say a limit for before they are known
UNKNOWN: Final = np.diag([1.0, 1.0, math.pi**2])  # rad^2, of an attitude that may be anything
_VEL, _PHI, _EPS, _NAB = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


def limits(config: AlignConfig, lat: float, height: float, seconds: float, settles: bool = True) -> Vector:
    """Standard deviations (3,), rad about east, north, up, that a static alignment cannot beat.

    Of sensors as in ``config`` at latitude ``lat`` (rad), in ``seconds``: constant biases, eq. (2-104), the
    angle random walk as a mean rate over the time, and the accelerometers' noise, which hides the level (as
    a mean) and, of a vehicle that ``settles``, its rate of change (as the slope of a straight line: variance
    12 q / T^3). What averages rates alone takes the vehicle not to.
    """
    g = normal_gravity(math.sin(lat), height)
    north = EARTH_RATE * math.cos(lat)
    vrw, arw = config.velocity_random_walk / g, config.angle_random_walk
    level2 = (config.accel_bias / g) ** 2 + vrw**2 / seconds
    rate2 = config.gyro_bias**2 + arw**2 / seconds
    if settles:
        rate2 += 12.0 * vrw**2 / seconds**3
    azimuth = math.sqrt(rate2 / north**2 + math.tan(lat) ** 2 * level2)
    return np.array([math.sqrt(level2), math.sqrt(level2), azimuth])


Coarse = Standing[None]
"""State of a stage that only averages."""


class Meaning(NamedTuple):
    """What means over a standstill are taken for.

    ``against`` what contradicts them at latitude and height, or None; ``solve`` the attitude C_gb (3, 3) and
    covariance (3, 3) of phi at latitude and height, or None; ``limit`` what cannot be beaten there.
    """

    against: Callable[[AlignConfig, Still, float, float], str | None]
    solve: Callable[[AlignConfig, Still, float, float], tuple[Vector, Vector] | None]
    limit: Callable[[AlignConfig, float, float], Vector]


def coarse_init(config: AlignConfig, given: NavInit | None) -> Coarse:
    """Begin with nothing known."""
    limit = limits(config, *SOMEWHERE, config.coarse_s)
    return Coarse(config, Still(), AlignStatus(None, UNKNOWN.copy(), limit, 0.0, False), None)


def average(meaning: Meaning) -> Callable[[Coarse, Sample], tuple[Coarse, AlignStatus]]:
    """The step of a stage that averages inertial samples while nothing moves, until ``coarse_s`` are over."""

    def work(state: Coarse, block: Block) -> tuple[Coarse, str | None]:
        config, still = state.config, state.still
        place = place_of(config, still)
        if place is None:
            return state, lost(config, still)
        lat, _, height = place
        ready = still.seconds >= config.coarse_s - 0.5 * watch.BLOCK_S
        reason = meaning.against(config, still, lat, height) if ready else None
        estimate, covariance = None, UNKNOWN.copy()
        if (ready or still.line.averages >= FEWEST) and reason is None:
            solved = meaning.solve(config, still, lat, height)
            if solved is not None:
                estimate, covariance = quat_from_dcm(solved[0]), solved[1]
        status = AlignStatus(
            estimate=estimate,
            covariance=covariance,
            limit=meaning.limit(config, lat, height),
            progress=min(1.0, still.seconds / config.coarse_s),
            done=ready,
        )
        return state._replace(status=status), reason

    return watch.standing(work)


def lost(config: AlignConfig, still: Still) -> str | None:
    """Why it cannot go on without a position, once it has waited long enough for one."""
    if still.seconds > config.coarse_s + PATIENCE_S:
        return "no position: no GNSS fix came and the configuration gives none"
    return None


def place_of(config: AlignConfig, still: Still) -> Place | None:
    """Where it stands (lat rad, lon rad, height m): as configured, or the antenna's mean; None: not known."""
    if config.position is not None:
        return config.position
    if still.fixes == 0:
        return None
    return float(still.place[0]), float(still.place[1]), float(still.place[2])


def implausible(config: AlignConfig, still: Still, lat: float) -> str | None:
    """What contradicts a standing IMU on the turning Earth that is to find its heading, or None."""
    north = EARTH_RATE * math.cos(lat)
    sigma = math.hypot(config.gyro_bias, config.angle_random_walk / math.sqrt(still.seconds))
    if sigma > BLIND * north:
        return (
            f"gyros good to {math.degrees(sigma) * 3600:.1f} deg/h cannot find heading in an Earth rate of "
            f"{math.degrees(north) * 3600:.1f} deg/h; align in motion"
        )
    return turning(config, still, lat)


def turning(config: AlignConfig, still: Still, lat: float) -> str | None:
    """Whether the mean rates about the vertical and the level are Earth's; where not, the words to say so."""
    north, up = EARTH_RATE * math.cos(lat), EARTH_RATE * math.sin(lat)
    drift, covariance = watch.mean_rate(still, config)
    vertical = still.force / np.linalg.norm(still.force)
    seen = float(drift.rate @ vertical)
    sigma = math.sqrt(config.gyro_bias**2 + float(vertical @ covariance @ vertical))
    if abs(seen - up) > SIGMAS * sigma + 2.0 * north * config.accel_bias / 9.8:
        return (
            f"the vertical rate is {math.degrees(seen) * 3600:.2f} deg/h where Earth's is "
            f"{math.degrees(up) * 3600:.2f}: the vehicle turns, or calibration or latitude are wrong"
        )
    level = float(np.linalg.norm(drift.rate - seen * vertical))
    sigma = math.sqrt(config.gyro_bias**2 + float(np.max(np.linalg.eigvalsh(covariance))))
    if abs(level - north) > SIGMAS * sigma + 2.0 * EARTH_RATE * config.accel_bias / 9.8:
        return (
            f"the level rate is {math.degrees(level) * 3600:.2f} deg/h where Earth's is "
            f"{math.degrees(north) * 3600:.2f}: the vehicle turns, or calibration or latitude are wrong"
        )
    return None


def not_gravity(config: AlignConfig, push: Vector, seconds: float, lat: float, height: float) -> str | None:
    """Why a velocity increment (3,) m/s over ``seconds`` is not one of rest, or None."""
    gravity, force = normal_gravity(math.sin(lat), height), float(np.linalg.norm(push)) / seconds
    if abs(force - gravity) <= SIGMAS * math.hypot(config.accel_bias, 2.0 * config.sway / seconds) + HEIGHTS:
        return None
    return (
        f"the specific force is {force:.4f} m/s^2 where gravity is {gravity:.4f}: "
        "an accelerometer is stuck, or calibration or latitude are wrong"
    )


def triad(force: Vector, rate: Vector, lat: float, height: float) -> Vector:
    """C_gb (3, 3) of a standing IMU from its mean specific force (3,) and rate (3,), of any scale.

    The same three orthonormal vectors are built from gravity and Earth rate in g and from the sensors in b;
    gravity counts fully, Earth rate only by its direction about it. So gyro noise does not reach the level.
    That is eqs. (2-101), (2-102) or (2-113) with the rows made orthonormal, that of gravity first; the
    printed orthogonalisation, eqs. (2-115) to (2-120), begins with a column, which lets the gyros tilt it.
    """
    in_b = _orthonormal(force, rate)
    in_g = _orthonormal(-gravity_g(lat, height), earth_rate_g(lat))
    return in_g.T @ in_b


def _orthonormal(first: Vector, second: Vector) -> Vector:
    """Rows: across both, in their plane, along ``first``."""
    up = first / np.linalg.norm(first)
    east = cross(second, up)
    east /= np.linalg.norm(east)
    return np.stack([east, cross(up, east), up])


def coarse_covariance(config: AlignConfig, C_gb: Vector, lat: float, height: float, still: Still) -> Vector:
    """Covariance (12, 12) of velocity, phi, gyro bias, accelerometer bias after the coarse stage.

    Errors are true minus estimate. Eq. (2-104) with the strapdown sign, the biases in b.
    """
    by_rate, by_force = sensitivities(lat, height)
    # a mean force is off by the velocity that it begins and ends with
    force = config.velocity_random_walk**2 / still.seconds + 2.0 * (config.sway / still.seconds) ** 2
    # what is no mean rate has turned the vehicle since the middle, too
    turned = by_rate + 0.5 * still.seconds * np.eye(3)
    noise = turned @ C_gb @ watch.rate_covariance(still, config) @ C_gb.T @ turned.T
    return with_constants(config, C_gb, lat, height, noise + by_force @ by_force.T * force)


def sensitivities(lat: float, height: float) -> tuple[Vector, Vector]:
    """d phi / d rate error and d phi / d force error, (3, 3) each, in g: eq. (2-104), strapdown."""
    g, north = normal_gravity(math.sin(lat), height), EARTH_RATE * math.cos(lat)
    by_rate, by_force = np.zeros((3, 3)), np.zeros((3, 3))
    by_rate[2, 0] = -1.0 / north
    by_force[0, 1], by_force[1, 0], by_force[2, 0] = -1.0 / g, 1.0 / g, math.tan(lat) / g
    return by_rate, by_force


def with_constants(config: AlignConfig, C_gb: Vector, lat: float, height: float, noise: Vector) -> Vector:
    """Covariance (12, 12) as of `coarse_covariance`: ``noise`` (3, 3) of phi and the constant errors."""
    by_rate, by_force = sensitivities(lat, height)
    eps2, nab2 = config.gyro_bias**2, config.accel_bias**2
    P = np.zeros((12, 12))
    P[_VEL, _VEL] = np.eye(3) * config.sway**2
    P[_PHI, _PHI] = 0.5 * (noise + noise.T) + by_rate @ by_rate.T * eps2 + by_force @ by_force.T * nab2
    P[_PHI, _PHI] += np.eye(3) * 1e-14
    P[_PHI, _EPS] = by_rate @ C_gb * eps2
    P[_PHI, _NAB] = by_force @ C_gb * nab2
    P[_EPS, _PHI], P[_NAB, _PHI] = P[_PHI, _EPS].T, P[_PHI, _NAB].T
    P[_EPS, _EPS], P[_NAB, _NAB] = np.eye(3) * eps2, np.eye(3) * nab2
    return P


def attitude(config: AlignConfig, still: Still, lat: float, height: float) -> tuple[Vector, Vector]:
    """C_gb (3, 3) of a standing IMU at the last block's end, and the covariance (12, 12)."""
    drift, _ = watch.mean_rate(still, config)
    C = triad(still.force, drift.rate, lat, height) @ dcm_from_quat(quat_from_rotvec(drift.now))
    return C, coarse_covariance(config, C, lat, height, still)


def _by_triad(config: AlignConfig, still: Still, lat: float, height: float) -> tuple[Vector, Vector]:
    C, P = attitude(config, still, lat, height)
    return C, P[_PHI, _PHI]


def _against(config: AlignConfig, still: Still, lat: float, height: float) -> str | None:
    reason = not_gravity(config, still.force * still.seconds, still.seconds, lat, height)
    reason = reason or implausible(config, still, lat)
    if reason is not None:
        return reason
    sigma = math.sqrt(attitude(config, still, lat, height)[1][5, 5])
    if sigma < math.hypot(SMALL, 1.5 * limit_of_means(config, lat, height)[2]):
        return None
    return (
        f"azimuth is known to {math.degrees(sigma):.1f} deg only after {still.seconds:.0f} s: "
        "the vehicle turned a little, or sways"
    )


def coarse_finish(state: Coarse) -> NavInit:
    """Attitude at the last sample; the place is the antenna's still."""
    config, still = state.config, state.still
    place = place_of(config, still)
    assert place is not None
    C, P = attitude(config, still, place[0], place[2])
    return nav_init(config, still.t_ns, place, sigma_of_place(config, still), C, np.zeros(12), P, True)


def analytic_finish(state: Coarse) -> NavInit:
    """Attitude at the last sample, and the place of the IMU."""
    return at_its_place(state.config, state.still, coarse_finish(state))


def sigma_of_place(config: AlignConfig, still: Still) -> Vector:
    """Standard deviations (3,) m of `place_of`."""
    return np.full(3, config.sigma_position) if config.position is not None else still.sigma_place


def at_its_place(config: AlignConfig, still: Still, given: NavInit) -> NavInit:
    """``given`` with the place of the IMU instead of the antenna's."""
    assert given.P is not None
    C = dcm_from_quat(given.q_gb)
    (lat, lon, height), _ = standing_at(config, given, still, C)
    P = _beside_antenna(config, given.P, C)
    return replace(given, lat=lat, lon=lon, height=height, sigma_p=np.sqrt(np.diag(P)[0:3]), P=P)


def nav_init(
    config: AlignConfig,
    t_ns: int,
    place: Place,
    sigma_p: Vector,
    C: Vector,
    x: Vector,
    P12: Vector,
    antenna: bool = False,
) -> NavInit:
    """Hand over a standing IMU: ``C`` (3, 3) is C_gb, ``x`` (12,) and ``P12`` as in `coarse_covariance`.

    ``sigma_p`` (3,) m is the antenna's; ``antenna``: so is the ``place`` still, for `at_its_place`.
    """
    P = np.zeros((15, 15))
    P[0:3, 0:3] = np.diag(sigma_p**2)
    P[3:15, 3:15] = P12
    if not antenna:
        P = _beside_antenna(config, P, C)
    mounting = None if config.C_vb is None else np.full(3, config.sigma_mounting)
    return hand_over(t_ns, place, np.zeros(3), quat_from_dcm(C), x[6:12], P, config.C_vb, mounting)


def _beside_antenna(config: AlignConfig, P: Vector, C: Vector) -> Vector:
    """``P`` (15, 15) of the IMU where it is the antenna's; a place from the configuration is the IMU's."""
    return P if config.position is not None else under_antenna(P, C @ config.gnss_lever_arm)


def standing_at(config: AlignConfig, given: NavInit, still: Still, C: Vector) -> tuple[Place, Vector]:
    """Place of a standing IMU (lat rad, lon rad, height m) and its sigma (3,), with ``C`` (3, 3) its C_gb.

    What GNSS said in ``still``, or in ``given`` where it said nothing, less the lever arm.
    """
    if config.position is not None:
        return (given.lat, given.lon, given.height), given.sigma_p
    place, sigma_p = (given.lat, given.lon, given.height), given.sigma_p
    if still.fixes:
        lat, lon, height = (float(value) for value in still.place)
        place, sigma_p = (lat, lon, height), still.sigma_place
    return imu_place(place, C @ config.gnss_lever_arm), sigma_p


def go_on(config: AlignConfig, given: NavInit, own: Own, biases: Vector | None = None) -> Standing[Own]:
    """Begin a fine stage where a coarse one ended, and go on with its line where it hands that on."""
    limit = limits(config, given.lat, given.height, config.coarse_s + config.fine_s)
    status = AlignStatus(given.q_gb, given.P_phi, limit, 0.0, False)
    still = Still() if given.line is None else Still(line=given.line)
    return Standing(config, still, status, own, np.zeros(6) if biases is None else biases)


def fine_status(state: Standing[Own], seconds: float, C: Vector, P12: Vector) -> Standing[Own]:
    """What a fine stage says after ``seconds``: C_gb (3, 3) and the covariance (12, 12)."""
    fine_s = state.config.fine_s
    status = state.status._replace(
        estimate=quat_from_dcm(C),
        covariance=P12[_PHI, _PHI],
        progress=min(1.0, seconds / fine_s),
        done=seconds >= fine_s - 0.5 * watch.BLOCK_S,
    )
    return state._replace(status=status)


def _of_both(config: AlignConfig, lat: float, height: float) -> Vector:
    return limits(config, lat, height, config.coarse_s + config.fine_s)


def limit_of_means(config: AlignConfig, lat: float, height: float) -> Vector:
    """`limits` of what averaging alone is given."""
    return limits(config, lat, height, config.coarse_s, settles=False)


COARSE: Final = Stage(
    init=coarse_init, step=average(Meaning(_against, _by_triad, _of_both)), finish=coarse_finish
)
ANALYTIC: Final = Stage(
    init=coarse_init, step=average(Meaning(_against, _by_triad, limit_of_means)), finish=analytic_finish
)
