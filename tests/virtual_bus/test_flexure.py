"""A wing that bends: the statistics of a second-order Markov process, and what the unit on it feels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nav.rotation import dcm_from_quat
from tests.virtual_bus.conftest import HEADING, HEIGHT, LAT, LON
from virtual_bus import ellipsoid
from virtual_bus.axes import cross
from virtual_bus.ellipsoid import OMEGA
from virtual_bus.flexure import STEP_NS, Flexed, Markov, Wandering, turned
from virtual_bus.manoeuvres import Cruise, Profile, WingRock
from virtual_bus.truth import Vehicle, mounting_matrix

WING = Markov.correlated(3e-3, 0.6)
SHAKE = Markov(5e-5, 2.0 * math.pi * 12.0, 0.05)


@pytest.mark.parametrize("process", [WING, SHAKE], ids=["flexure", "vibration"])
def test_variances_and_correlations_are_those_of_the_process(process):
    """Against the closed form, over 600 of them.

    The autocorrelation of x'' + 2 z w x' + w^2 x = white noise is that of its free decay from rest: for
    z = 1, exp(-w t) (1 + w t); for z < 1 exp(-z w t) (cos u t + z w / u sin u t) with u = w sqrt(1 - z^2).
    """
    n, w, z = 600, process.rate, process.damping
    lags = np.array([0.0, 0.3, 1.0, 2.0]) / w
    x, v = Wandering([[process]] * n, np.random.default_rng(3)).at(
        np.rint((1.0 + lags) * 1e9).astype(np.int64)
    )
    if z == 1.0:
        expected = np.exp(-w * lags) * (1.0 + w * lags)
    else:
        u = w * math.sqrt(1.0 - z * z)
        expected = np.exp(-z * w * lags) * (np.cos(u * lags) + z * w / u * np.sin(u * lags))
    found = x @ x[0] / (n * process.sigma**2)
    # 600 independent pairs: the mean of a product has a sigma of at most sqrt(2 / 600); four of them
    assert np.abs(found - expected).max() < 4.0 * math.sqrt(2.0 / n)
    assert np.mean(v[0] ** 2) == pytest.approx((process.sigma * w) ** 2, rel=4.0 * math.sqrt(2.0 / n))
    # in the steady state value and rate are independent
    assert abs(np.mean(x[0] * v[0])) < 4.0 * process.sigma**2 * w / math.sqrt(n)


@pytest.fixture(scope="module")
def wing():
    """A flight over a wing rock; the IMU mounted askew 4 m out, bending and shaking about the reference."""
    profile = Profile(
        [
            b
            for m in (Cruise(duration_s=1.0), WingRock(duration_s=2.0, angle_deg=30.0))
            for b in m.blends(0.0)
        ],
        HEADING,
        200.0,
    )
    arm = np.array([4.0, -0.8, -0.6])
    vehicle = Vehicle(arm, mounting_matrix(1.0, -2.0, 3.0))
    flexure = Wandering([[WING, SHAKE]] * 3, np.random.default_rng(5))
    return Flexed(profile, vehicle, LAT, LON, HEIGHT, flexure, arm)


def test_rates_are_the_slopes_of_the_angles(wing):
    t = STEP_NS * np.arange(1500) + 700_000  # within a step
    h = 10_000
    slope = (wing.flexure.at(t + h)[0] - wing.flexure.at(t - h)[0]) / (2e-9 * h)
    # the cubic's third derivative, of noise in the acceleration over 2 ms: up to 1e4 rad/s^3, (10 us)^2 / 6
    assert np.abs(slope - wing.flexure.at(t)[1]).max() < 2e-7
    edges = STEP_NS * np.arange(1, 1000)
    for before, after in zip(wing.flexure.at(edges - 1), wing.flexure.at(edges + 1), strict=True):
        # 2 ns at 20 mrad/s and at a few rad/s^2: no jump of the angle or of its rate
        assert np.abs(after - before).max() < 1e-7


def test_functions_do_not_depend_on_what_is_asked_for_first():
    late = np.array([9_000_000_000])
    a, b = (Wandering([[WING]] * 3, np.random.default_rng(1)) for _ in range(2))
    a.at(np.array([0]))
    assert a.at(late)[0].tolist() == b.at(late)[0].tolist()
    other = Wandering([[WING]] * 3, np.random.default_rng(2))
    assert other.at(late)[0].tolist() != b.at(late)[0].tolist()


def body_axes(wing, t_ns):
    """C_ib (n, 3, 3) of the bent IMU, and its place and velocity (n, 3) in Earth-fixed axes."""
    C, r, v = [], [], []
    for t in t_ns.tolist():
        s = wing.state(t)
        C_eg = ellipsoid.axes_eg(np.array([s.lat]), np.array([s.lon]))[0]
        angle = OMEGA * t * 1e-9
        turn = np.array(
            [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
        )
        C.append(turn @ C_eg @ dcm_from_quat(s.q_gb))
        r.append(ellipsoid.to_ecef(*(np.array([x]) for x in (s.lat, s.lon, s.height)))[0])
        v.append(C_eg @ s.v_g)
    return np.array(C), np.array(r), np.array(v)


def test_increments_turn_the_bent_unit_as_it_turns(wing):
    t = np.arange(1_000_000_000, 2_600_000_001, 1_000_000)
    dtheta, _ = wing.increments(t)
    A = body_axes(wing, t[:1])[0][0]
    for p in dtheta:
        angle = math.sqrt(p @ p)
        K = np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
        A = A @ (np.eye(3) + math.sin(angle) / angle * K + (1 - math.cos(angle)) / angle**2 * K @ K)
    C = body_axes(wing, t[-1:])[0][0]
    # third order in 9 mrad of bending, 1e-7, is what `turned` leaves out; coning within 1 ms is far less
    assert np.abs(A.T @ C - np.eye(3)).max() < 3e-7
    # and it has bent meanwhile
    bent = np.abs(np.diff(wing.flexure.at(t[[0, -1]])[0], axis=0)).max()
    assert bent > 1e-3


def test_increments_push_the_bent_unit_as_it_moves(wing):
    """Specific force turned into Earth-fixed axes, with gravity and Coriolis, is the change of velocity."""
    t = np.arange(1_300_000_000, 1_700_000_001, 1_000_000)
    _, dv = wing.increments(t)
    middle = (t[:-1] + t[1:]) // 2
    C, r, v = body_axes(wing, middle)
    angle = OMEGA * middle * 1e-9
    back = np.zeros_like(C)
    back[:, 0, 0] = back[:, 1, 1] = np.cos(angle)
    back[:, 0, 1], back[:, 1, 0], back[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
    lat, lon, height = ellipsoid.to_geodetic(r)
    C_eg = ellipsoid.axes_eg(lat, lon)
    north, up = ellipsoid.gravity(lat, height)
    g_e = north[:, None] * C_eg[:, :, 1] + up[:, None] * C_eg[:, :, 2]
    pushed = np.einsum("nij,njk,nk->ni", back, C, dv)
    pushed += 1e-3 * (g_e - 2.0 * cross(np.broadcast_to([0.0, 0.0, OMEGA], v.shape), v))
    _, _, ends = body_axes(wing, t[[0, -1]])
    # 0.4 s of what the middle of a millisecond leaves out while it shakes at 75 rad/s with 0.3 g
    assert np.abs(ends[1] - ends[0] - pushed.sum(axis=0)).max() < 1e-5
    # the shaking is there: the rigid wing feels another force
    rigid = np.diff(super(Flexed, wing).increments(t)[1], axis=0)
    assert np.abs(np.diff(dv, axis=0)).max() > 2.0 * np.abs(rigid).max()


def test_what_the_unit_feels_is_told_with_the_truth(wing):
    t_ns = 1_700_000_000
    state = wing.state(t_ns)
    dtheta, dv = wing.increments(np.array([t_ns - 500_000, t_ns + 500_000]))
    assert state.w_ib_b == pytest.approx(dtheta[0] / 1e-3)
    assert state.f_b == pytest.approx(dv[0] / 1e-3)
    at_the_master = wing.state(t_ns, np.zeros(3))
    assert at_the_master.v_g == pytest.approx(super(Flexed, wing).state(t_ns, np.zeros(3)).v_g)
    assert at_the_master.q_gb == pytest.approx(state.q_gb)


def test_turning_by_small_angles_keeps_lengths():
    rng = np.random.default_rng(4)
    v, angles = rng.standard_normal((2, 50, 3))
    once = turned(1e-3 * angles, v)
    # to fourth order in the angle
    assert np.abs(np.linalg.norm(once, axis=1) / np.linalg.norm(v, axis=1) - 1.0).max() < 1e-10
