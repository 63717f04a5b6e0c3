"""A flight in closed form, what a slave on a flexing mounting feels, what its master says.

Course, roll and speed are functions of time; position is their quadrature over the ellipsoid. The slave's
increments are those that take its exact attitude and velocity from one sample's end to the next, so nothing
of the estimator is in them but the Earth model and rotations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.align.types import AlignConfig, TransferConfig, advance, begin, result
from nav.errors.model import error_dynamics
from nav.filter import states as house
from nav.transfer import alignment, model
from nav.transfer.instant import I_RATES, I_SIZE, I_TURNS, I_W, I_WAY
from nav.transfer.states import SIZE
from nav.types import ImuSample, MasterState

T0_NS = 10**12
MG = 9.80665e-3
DEG_H = np.radians(1.0) / 3600.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)


def smooth(t, start, end):
    """From 0 to 1 between two times, with three continuous derivatives."""
    x = np.clip((t - start) / (end - start), 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def straight(t):
    """Roll and course, rad."""
    return np.zeros_like(t), np.full_like(t, 0.0)


def wing_rock(start=2.0):
    """+30 degrees of roll and back within two seconds, straight on."""

    def profile(t):
        up = smooth(t, start, start + 1.0) - smooth(t, start + 1.0, start + 2.0)
        return np.radians(30.0) * up, np.zeros_like(t)

    return profile


def s_turns(period=120.0, amplitude=0.8, speed=200.0):
    """Course to and fro, banked for it."""

    def profile(t):
        w = 2.0 * np.pi / period
        turn = amplitude * w * np.sin(w * t)
        bank = np.arctan(speed * turn / 9.8)
        return bank, amplitude * (1.0 - np.cos(w * t))

    return profile


def wiggle(period=4.0, amplitude=0.09, speed=200.0, start=1.0):
    """Nose to and fro about the flight path's new course, flat."""

    def profile(t):
        w = 2.0 * np.pi / period
        return np.zeros_like(t), amplitude * smooth(t, start, start + 1.0) * np.sin(w * (t - start))

    return profile


@dataclass
class Set:
    """What the flight and the instruments are like."""

    profile: Callable = field(default_factory=wing_rock)
    seconds: float = 6.0
    imu_hz: float = 200.0
    master_hz: float = 50.0
    speed: float = 200.0
    lever: np.ndarray = field(default_factory=lambda: np.array([4.0, -1.0, -0.5]))
    C_ab: np.ndarray = field(default_factory=lambda: np.eye(3))
    mounting: float = np.radians(0.5)
    gyro_bias: float = DEG_H
    accel_bias: float = MG
    arw: float = np.radians(0.05) / 60.0
    vrw: float = 5e-4
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    flexure: np.ndarray | None = None
    flexure_time: float = 0.5
    sigma_v: float = 0.02
    sigma_att: float = 3e-4
    sigma_pos: float = 1.0
    sigma_rate: float = 5e-4
    latency: float = 0.0  # of its dating
    dated: float = 0.01  # to which that is told
    late: float = 0.02  # until a message is there
    heading: float = 0.3


class Flight(NamedTuple):
    """Samples in the order of arrival, and truth at the ends of inertial samples."""

    samples: list
    t_ns: np.ndarray
    q_gb: np.ndarray
    v_g: np.ndarray
    r_e: np.ndarray
    mounting: np.ndarray
    bias: np.ndarray


def _master(s, t):
    """Roll, heading, velocity, position (lat, lon, height) of the master at times ``t``."""

    def course(t):
        return s.profile(t)[1] + s.heading

    lat0, lon0, h = 0.6, 0.3, 3000.0
    dt = np.diff(t, prepend=t[0] - (t[1] - t[0]))
    lat, lon = np.full_like(t, lat0), np.full_like(t, lon0)
    for _ in range(4):
        r_m, r_n = np.array([earth.radii(np.sin(a)) for a in lat]).T
        north = np.zeros_like(t)
        east = np.zeros_like(t)
        for x, w in zip(NODES, WEIGHTS, strict=True):
            at = t - dt * 0.5 * (1.0 - x)
            c = course(at)
            north += 0.5 * w * dt * s.speed * np.cos(c)
            east += 0.5 * w * dt * s.speed * np.sin(c)
        lat = lat0 + np.cumsum(north / (r_m + h))
        lon = lon0 + np.cumsum(east / (r_n + h) / np.cos(lat))
    c = course(t)
    v = s.speed * np.stack([np.sin(c), np.cos(c), 0.0 * c], axis=-1)
    roll = s.profile(t)[0]
    return rot.quat_from_euler(c, np.full_like(t, 0.03), roll), v, lat, lon, np.full_like(t, h)


def _flexed(s, n, dt, rng):
    """Flexure angles (n, 3): second-order Markov, exact at the samples."""
    out = np.zeros((n, 3))
    if s.flexure is None:
        return out
    b = 2.146 / s.flexure_time
    e = np.exp(-b * dt)
    A = e * np.array([[1.0 + b * dt, dt], [-b * b * dt, 1.0 - b * dt]])
    steady = np.diag([1.0, b * b])
    L = np.linalg.cholesky(steady - A @ steady @ A.T)
    state = np.diag([1.0, b]) @ rng.standard_normal((2, 3))
    for k in range(n):
        out[k] = state[0]
        state = A @ state + L @ rng.standard_normal((2, 3))
    return out * s.flexure


def _moving(q, r_e, dt):
    """Rate of b (n, 3) with respect to e, in b, by central differences of exact attitudes."""
    step = rot.rotvec_from_quat(rot.quat_multiply(rot.quat_conjugate(q[:-2]), q[2:])) / (2.0 * dt)
    return np.concatenate([step[:1], step, step[-1:]])


def fly(s, seed=0):
    """One flight."""
    rng = np.random.default_rng(seed)
    dt = 1.0 / s.imu_hz
    n = round(s.seconds * s.imu_hz) + 1
    t = dt * np.arange(-2, n + 2)  # beyond the ends for differences
    q_ga, v, lat, lon, h = _master(s, t)
    mounting = rng.normal(0.0, s.mounting, 3)
    bias = np.concatenate([rng.normal(0.0, s.gyro_bias, 3), rng.normal(0.0, s.accel_bias, 3)])
    q_ab = rot.quat_multiply(rot.quat_from_rotvec(mounting), rot.quat_from_dcm(s.C_ab))
    theta = _flexed(s, len(t), dt, rng)
    q_gb = rot.quat_multiply(rot.quat_multiply(q_ga, rot.quat_from_rotvec(theta)), q_ab)
    q_eg = earth.position_quat(lat, lon)
    q_eb = rot.quat_multiply(q_eg, q_gb)
    l_b = rot.quat_rotate(rot.quat_conjugate(q_ab), s.lever)
    arm = rot.quat_rotate(q_eb, np.broadcast_to(l_b, (len(t), 3)))
    r_e = earth.ecef(lat, lon, h) + arm
    # velocities of the arm's end by fourth-order differences of its exact places
    swing = np.zeros_like(arm)
    swing[2:-2] = (8.0 * (arm[3:-1] - arm[1:-3]) - (arm[4:] - arm[:-4])) / (12.0 * dt)
    v_e = rot.quat_rotate(q_eg, v) + swing
    w_ie = np.array([0.0, 0.0, earth.EARTH_RATE])
    k = slice(2, n + 2)
    g_e = np.array([rot.quat_rotate(q_eg[i], earth.gravity_g(lat[i], h[i])) for i in range(len(t))])
    other = g_e - 2.0 * np.cross(w_ie, v_e)

    # rotation of b in i, and specific force: both constant within a sample
    turn = np.stack([np.cos(0.5 * w_ie[2] * t), 0 * t, 0 * t, np.sin(0.5 * w_ie[2] * t)], axis=-1)
    q_ib = rot.quat_multiply(turn, q_eb)
    q_ib, q_ebk, v_e, other = q_ib[k], q_eb[k], v_e[k], other[k]
    dtheta = rot.rotvec_from_quat(rot.quat_multiply(rot.quat_conjugate(q_ib[:-1]), q_ib[1:]))
    gained = v_e[1:] - v_e[:-1] - 0.5 * (other[1:] + other[:-1]) * dt
    # in the axes of b at the sample's beginning, e turning meanwhile
    half = rot.quat_from_rotvec(np.broadcast_to(0.5 * w_ie * dt, gained.shape))
    begin = rot.quat_rotate(rot.quat_conjugate(q_ebk[:-1]), rot.quat_rotate(half, gained))
    dv = np.array([np.linalg.solve(_mean_turn(p), b) for p, b in zip(dtheta, begin, strict=True)])
    Sg = np.diag(rng.normal(0.0, s.gyro_scale, 3))
    Sa = np.diag(rng.normal(0.0, s.accel_scale, 3))
    dtheta = dtheta + dtheta @ Sg + bias[:3] * dt + rng.normal(0.0, s.arw * np.sqrt(dt), dtheta.shape)
    dv = dv + dv @ Sa + bias[3:] * dt + rng.normal(0.0, s.vrw * np.sqrt(dt), dv.shape)

    every = round(s.imu_hz / s.master_hz)
    t_ns = T0_NS + np.round(t[k] * 1e9).astype(np.int64)
    rates = _moving(rot.quat_multiply(turn, rot.quat_multiply(q_eg, q_ga)), None, dt)[k]
    arrivals = [
        (int(t_ns[i + 1]), ImuSample(int(t_ns[i + 1]), dt, dtheta[i], dv[i], "imu")) for i in range(n - 1)
    ]
    lag = round(s.latency * s.imu_hz)
    small = np.full(3, 1e-3)
    for i in range(every, n - 1, every):
        j = 2 + max(0, i - lag)
        q = rot.quat_multiply(rot.quat_from_rotvec(rng.normal(0.0, s.sigma_att, 3)), q_ga[j])
        noise = rng.normal(0.0, s.sigma_pos, 3)
        m = MasterState(
            int(t_ns[i]),
            float(lat[j] + noise[1] / 6.36e6),
            float(lon[j] + noise[0] / 6.38e6 / np.cos(lat[j])),
            float(h[j] + noise[2]),
            v[j] + rng.normal(0.0, s.sigma_v, 3),
            q,
            rates[max(0, i - lag)] + rng.normal(0.0, s.sigma_rate, 3),
            None,
            small,
            small,
            small * 1e-3,
            True,
            "master",
        )
        arrivals.append((int(t_ns[i]) + round(s.late * 1e9), m))
    arrivals.sort(key=lambda one: one[0])
    v_g = rot.quat_rotate(rot.quat_conjugate(q_eg[k]), v_e)
    return Flight([m for _, m in arrivals], t_ns, q_gb[k], v_g, r_e[k], mounting, bias)


def _mean_turn(p):
    """Mean rotation (3, 3) over a sample that turns evenly by ``p`` rad."""
    a2 = float(p @ p)
    S = rot.skew(p)
    return np.eye(3) + (0.5 - a2 / 24.0) * S + (1.0 / 6.0 - a2 / 120.0) * S @ S


def errors(flight, init):
    """Errors (9,) of a hand-over: position m, velocity m/s (true minus estimate), phi rad, as `NavInit.P`."""
    i = int(np.searchsorted(flight.t_ns, init.t_ns))
    assert flight.t_ns[i] == init.t_ns
    C_ge = earth.position_matrix(init.lat, init.lon).T
    dp = C_ge @ (flight.r_e[i] - earth.ecef(init.lat, init.lon, init.height))
    phi = rot.rotvec_from_quat(rot.quat_multiply(flight.q_gb[i], rot.quat_conjugate(init.q_gb)))
    return np.concatenate([dp, flight.v_g[i] - init.v_g, phi])


def dynamics(C_nb, f_b, w_b, v_n, frame, k, rest):
    """F (SIZE, SIZE) of all states but flexure by the readable error model; ``k`` is the curvature."""
    F, kept = np.zeros((SIZE, SIZE)), [k for k in range(house.FULL) if not 15 <= k < house.BASIC]
    gradient = -2.0 * frame.gravity_n[2] * np.sqrt(k[0] * k[2] - k[1] ** 2)
    whole = error_dynamics(C_nb, f_b, w_b, v_n, frame.w_ie_n, frame.w_en_n, k, gradient, rest)
    F[: len(kept), : len(kept)] = whole[np.ix_(kept, kept)]
    return F


def shown(kind, x, w_b, m, transfer):
    """Residual (3,) and H (3, SIZE) of a kind of rows, where the slave turns evenly by ``w_b``."""
    now = np.zeros(I_SIZE)
    now[I_W : I_W + 3] = w_b
    now[I_WAY] = 0.01
    now[I_TURNS:I_RATES] = 0.01 * np.tile(w_b, 2)
    r, H, R = np.empty(3), np.empty((3, SIZE)), np.empty((3, 3))
    seen, told = model.master(m), model.told(transfer)
    kind(x, now, seen, told, model.scene(x, now, seen, told), r, H, R)
    return r, H


def config(s, **changes):
    """What a slave is told of that flight; ``changes`` to `TransferConfig`."""
    told = {
        "lever_arm": s.lever,
        "C_ab": s.C_ab,
        "sigma_mounting": np.full(3, s.mounting),
        "sigma_velocity": s.sigma_v,
        "sigma_attitude": s.sigma_att,
        "sigma_position": s.sigma_pos,
        "sigma_rate": s.sigma_rate,
        "latency": s.dated,
        "flexure": s.flexure,
        "flexure_time": np.full(3, s.flexure_time),
    }
    return AlignConfig(
        gyro_bias=s.gyro_bias,
        accel_bias=s.accel_bias,
        angle_random_walk=s.arw,
        velocity_random_walk=s.vrw,
        gyro_scale=s.gyro_scale,
        accel_scale=s.accel_scale,
        transfer=TransferConfig(**(told | changes)),
    )


def align(matching, flight, told, faulty=None):
    """Hand-over of an alignment (or None), the reasons why it began again, and its last state.

    ``faulty`` makes of the samples those that arrive.
    """
    run = begin(alignment("transfer_" + matching), told)
    reasons = []
    for sample in flight.samples if faulty is None else faulty(flight.samples):
        run, status = advance(run, sample)
        if status.refusal is not None:
            reasons.append(status.refusal)
        if status.done:
            return result(run), reasons, run.state
    return None, reasons, run.state


def surprise(flight, init):
    """Normalised square (9 degrees of freedom) of a hand-over's errors of position, velocity and phi."""
    e = errors(flight, init)
    return float(e @ np.linalg.solve(init.P[:9, :9], e))
