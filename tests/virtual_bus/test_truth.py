"""Truth against itself: what the IMU feels must be what differentiating or integrating the motion gives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import nav.earth
from tests.virtual_bus.conftest import HEADING, HEIGHT, LAT, LON, trajectory_of
from virtual_bus import ellipsoid
from virtual_bus.ellipsoid import OMEGA
from virtual_bus.manoeuvres import Accelerate, Climb, Cruise, Static, STurns, Turn

STEP_NS = 5_000_000
# central difference of order 8: of a sway of 15 rad/s (two waves) and 0.1 rad it leaves (0.075)^8/630
STENCIL = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


def stencil_times(ride, every_ns=37_000_000):
    """Times (n, 9) around instants whose stencil lies within one blend: the profile is smooth there."""
    t = np.arange(100_000_000, ride.profile.end_ns - 100_000_000, every_ns)
    edges = np.append(ride.profile.start_ns, ride.profile.end_ns)
    clear = np.abs(t[:, None] - edges).min(axis=1) > 5 * STEP_NS
    assert clear.mean() > 0.9
    return t[clear][:, None] + STEP_NS * np.arange(-4, 5)


def earth_rotation(t_ns):
    angle = OMEGA * t_ns * 1e-9
    C = np.zeros((*angle.shape, 3, 3))
    C[..., 0, 0] = C[..., 1, 1] = np.cos(angle)
    C[..., 1, 0] = np.sin(angle)
    C[..., 0, 1] = -C[..., 1, 0]
    C[..., 2, 2] = 1.0
    return C


def attitude_iv(ride, t_ns):
    m = ride.motion(t_ns)
    return earth_rotation(t_ns) @ ellipsoid.axes_eg(m.lat, m.lon) @ m.C_gv, m


def test_body_rate_is_the_derivative_of_attitude(any_ride):
    t = stencil_times(any_ride)
    C, m = attitude_iv(any_ride, t.ravel())
    C = C.reshape(*t.shape, 3, 3)
    rate = np.einsum("k,nkij->nij", STENCIL, C) / (STEP_NS * 1e-9)
    skew = np.swapaxes(C[:, 4], 1, 2) @ rate
    w = np.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), axis=1)
    expected = m.w_iv_v.reshape(*t.shape, 3)[:, 4]
    assert np.abs(expected).max() > 0.4  # it does turn
    assert np.abs(w - expected).max() < 1e-12


def test_specific_force_is_acceleration_less_gravitation(any_ride):
    t = stencil_times(any_ride)
    m = any_ride.motion(t.ravel())
    v_e, r_e = m.v_e.reshape(*t.shape, 3), m.r_e.reshape(*t.shape, 3)[:, 4]
    a_e = np.einsum("k,nki->ni", STENCIL, v_e) / (STEP_NS * 1e-9)
    lat, lon, height = ellipsoid.to_geodetic(r_e)
    C_eg = ellipsoid.axes_eg(lat, lon)
    g_north, g_up = ellipsoid.gravity(lat, height)
    g_e = g_north[:, None] * C_eg[:, :, 1] + g_up[:, None] * C_eg[:, :, 2]
    f_e = a_e + 2.0 * np.cross([0.0, 0.0, OMEGA], v_e[:, 4]) - g_e
    C_gv = m.C_gv.reshape(*t.shape, 3, 3)[:, 4]
    f_v = np.einsum("nji,nkj,nk->ni", C_gv, C_eg, f_e)
    assert np.abs(f_v - m.f_v.reshape(*t.shape, 3)[:, 4]).max() < 1e-8


def test_position_is_the_integral_of_velocity(any_ride):
    x, weight = np.polynomial.legendre.leggauss(10)
    edges = np.unique(
        np.concatenate((any_ride.profile.start_ns, np.arange(0, any_ride.profile.end_ns, 500_000_000)))
    )
    a, b = edges[:-1], edges[1:]
    half = 0.5 * (b - a)
    t = np.rint(a[:, None] + half[:, None] * (1.0 + x)).astype(np.int64)
    v = any_ride.motion(t.ravel()).v_e.reshape(*t.shape, 3)
    travelled = np.cumsum((half * 1e-9)[:, None] * np.einsum("k,nkc->nc", weight, v), axis=0)
    r = any_ride.motion(edges).r_e
    # rounding of 6.4e6 m and half a nanosecond of node rounding at 15 m/s, both about 1e-8 m
    assert np.abs(r[0] + travelled - r[1:]).max() < 1e-7


def test_attitude_is_the_integral_of_body_rate(any_ride):
    """Magnus expansion of order 4 over 5 ms, from increments' own rates, for the whole ride."""
    h = 0.005
    t = np.arange(0, any_ride.profile.end_ns + 1, 5_000_000)
    node = math.sqrt(3.0) / 6.0
    first, second = (
        any_ride.motion(np.rint(t[:-1] + (0.5 + s * node) * 5e6).astype(np.int64)).w_iv_v for s in (-1, 1)
    )
    phi = 0.5 * h * (first + second) + (math.sqrt(3.0) / 12.0) * h * h * np.cross(first, second)
    C, _ = attitude_iv(any_ride, t[[0, -1]])
    A = C[0]
    for p in phi:
        angle = math.sqrt(p @ p)
        K = np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
        A = A @ (np.eye(3) + math.sin(angle) / angle * K + (1 - math.cos(angle)) / angle**2 * K @ K)
    # local error of order h^5 with rates' fourth derivatives below 1e2 rad/s^5
    assert np.abs(A.T @ C[1] - np.eye(3)).max() < 1e-9


def test_increments_are_integrals_in_imu_axes_and_add_up(any_ride):
    t = np.arange(0, any_ride.profile.end_ns + 1, 5_000_000)
    dtheta, dv = any_ride.increments(t)
    x, weight = np.polynomial.legendre.leggauss(4)
    nodes = np.rint(t[:-1, None] + (x + 1.0) * 2.5e6).astype(np.int64)
    m = any_ride.motion(nodes.ravel())
    C_vb = any_ride.vehicle.C_vb
    for increments, rate in ((dtheta, m.w_iv_v), (dv, m.f_v)):
        mean = 0.5 * np.einsum("k,nkc->nc", weight, (rate @ C_vb).reshape(*nodes.shape, 3))
        # nodes are whole nanoseconds: 0.5 ns of 20 m/s^3 of jerk is 1e-8
        assert np.abs(increments / 0.005 - mean).max() < 1e-8
    for whole, parts in zip(any_ride.increments(t[[0, -1]]), (dtheta, dv), strict=True):
        assert np.abs(whole[0] - parts.sum(axis=0)).max() < 1e-10


@given(cuts=st.lists(st.integers(1, 94_000_000_000), min_size=1, max_size=20, unique=True))
def test_increments_over_any_cuts_sum_to_the_whole(ride, cuts):
    t = np.array([0, *sorted(cuts)])
    parts = ride.increments(t)
    whole = ride.increments(t[[0, -1]])
    for a, b in zip(parts, whole, strict=True):
        # sums of up to 900 m/s in double precision
        assert np.abs(a.sum(axis=0) - b[0]).max() < 1e-11


def test_rest_is_gravity_and_earth_rate(rest):
    state = rest.state(1_234_567_890)
    g = nav.earth.normal_gravity(math.sin(state.lat), state.height)
    assert math.hypot(*state.f_b) == pytest.approx(g, abs=1e-8)
    assert state.f_b[2] == pytest.approx(g, abs=1e-8)
    # the plumb line bends towards the equator by 4e-6 m/s^2 at 500 m
    assert math.hypot(*state.f_b[:2]) == pytest.approx(8.08e-9 * 500.0 * math.sin(2 * LAT), rel=0.01)
    c, s = math.cos(HEADING), math.sin(HEADING)
    level = OMEGA * math.cos(state.lat)
    # east-north-up to right-forward-up at a heading clockwise from north
    expected = [-s * level, c * level, OMEGA * math.sin(state.lat)]
    assert state.w_ib_b == pytest.approx(expected, abs=1e-15)
    assert state.v_g == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert state.heading == pytest.approx(HEADING, abs=1e-14)
    later = rest.state(rest.profile.end_ns)
    assert (later.lat, later.lon, later.height) == (state.lat, state.lon, state.height)


def test_start_is_where_it_was_put(ride):
    axle = ride.motion(np.array([0]), np.zeros(3))
    assert axle.lat[0] == pytest.approx(LAT, abs=1e-15)
    assert axle.lon[0] == pytest.approx(LON, abs=1e-15)
    assert axle.height[0] == pytest.approx(HEIGHT, abs=1e-8)


def test_rear_axle_does_not_slip_without_squat(ride):
    smooth = trajectory_of([Cruise(duration_s=1.0)])
    assert smooth.profile.end_ns == 1_000_000_000
    t = np.arange(0, ride.profile.end_ns, 50_000_000)
    axle = ride.motion(t, np.zeros(3))
    v_v = np.einsum("nji,nj->ni", axle.C_gv, axle.v_g)
    # sideways: to rounding; upwards: squat of the body alone, 2 degrees per g at under 0.5 g
    assert np.abs(v_v[:, 0]).max() < 1e-12
    assert np.abs(v_v[:, 2]).max() < 15.0 * math.radians(1.0)
    assert np.linalg.norm(v_v, axis=1) == pytest.approx(np.abs(ride.profile.speed(t)), abs=1e-9)


def test_distance_is_the_integral_of_speed_and_counts_up_in_reverse(ride):
    t = np.arange(0, ride.profile.end_ns + 1, 1_000_000)
    speed = np.abs(ride.profile.speed(t))
    trapezium = np.concatenate(([0.0], np.cumsum(0.5e-3 * (speed[1:] + speed[:-1]))))
    # trapezium rule: h^2 / 12 times the change of acceleration
    assert np.abs(trapezium - ride.profile.distance(t)).max() < 2e-6
    assert (np.diff(ride.profile.distance(t)) >= 0.0).all()
    assert ride.profile.speed(t).min() < -2.9


def test_rates_and_forces_are_continuous_where_manoeuvres_meet(ride):
    edges = ride.profile.start_ns[1:]
    before, after = ride.motion(edges - 1), ride.motion(edges + 1)
    # 2 ns apart: a jump would not shrink, slopes of 1 rad/s^2 and 20 m/s^3 give 2e-9 and 4e-8
    assert np.abs(after.w_iv_v - before.w_iv_v).max() < 1e-8
    assert np.abs(after.f_v - before.f_v).max() < 1e-7


def test_quaternions_are_the_matrices(ride):
    for t_ns in range(0, ride.profile.end_ns, 3_000_000_000):
        state, m = ride.state(t_ns), ride.motion(np.array([t_ns]))
        for q, C in ((state.q_gv, m.C_gv[0]), (state.q_gb, m.C_gv[0] @ ride.vehicle.C_vb)):
            w, v = q[0], q[1:]
            K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
            assert np.eye(3) + 2 * w * K + 2 * K @ K == pytest.approx(C, abs=1e-14)


@given(
    lat=st.floats(-math.pi / 2, math.pi / 2),
    lon=st.floats(-math.pi, math.pi),
    height=st.floats(-1000.0, 20_000.0),
)
def test_geodetic_round_trip(lat, lon, height):
    r_e = ellipsoid.to_ecef(np.array([lat]), np.array([lon]), np.array([height]))
    back = ellipsoid.to_geodetic(r_e)
    again = ellipsoid.to_ecef(*back)
    assert np.abs(again - r_e).max() < 1e-8
    assert back[0][0] == pytest.approx(lat, abs=1e-14)
    assert back[2][0] == pytest.approx(height, abs=5e-9)


def test_normal_gravity_at_equator_and_pole():
    """NIMA TR8350.2, table 3.4: theoretical gravity at the equator and at the poles."""
    g = ellipsoid.normal_gravity(np.array([0.0, math.pi / 2]), np.zeros(2))
    assert g == pytest.approx([9.7803253359, 9.8321849378], abs=2e-10)


def test_the_navigators_earth_agrees():
    for lat in np.linspace(-1.5, 1.5, 13):
        for height in (-100.0, 0.0, 3000.0):
            ours = ellipsoid.normal_gravity(np.array(lat), np.array(height))
            assert nav.earth.normal_gravity(math.sin(lat), height) == pytest.approx(float(ours), abs=1e-8)
        r_m, r_n = ellipsoid.radii(np.sin(np.array(lat)))
        assert nav.earth.radii(math.sin(lat)) == pytest.approx((float(r_m), float(r_n)), abs=1e-6)


def test_a_static_manoeuvre_needs_a_stop():
    with pytest.raises(ValueError, match="brake to 0"):
        Static(duration_s=1.0).blends(3.0)


PLACES = {
    "over the north pole, within metres": (math.pi / 2 - 1e-5, 0.3, 0.01),
    "from the south pole itself": (-math.pi / 2, 2.0, 1.0),
    "across the date line": (1.2, math.pi - 3e-6, 1.3),
    "across the equator": (-2e-5, -1.0, 0.4),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_truth_is_as_exact_there(place):
    lat, lon, heading = PLACES[place]
    ride = trajectory_of(
        [
            Static(duration_s=1.0),
            Accelerate(duration_s=3.0, speed_m_s=20.0),
            STurns(duration_s=6.0, angle_deg=10.0),
            Climb(duration_s=4.0, slope_deg=4.0),
            Turn(duration_s=3.0, angle_deg=40.0),
        ],
        lat=lat,
        lon=lon,
        heading=heading,
    )
    start = ride.state(0, np.zeros(3))
    # at the pole itself the bearing belongs to the longitude that is told with it
    assert math.remainder(start.heading - heading - (start.lon - lon) * math.sin(lat), 2 * math.pi) == (
        pytest.approx(0.0, abs=1e-14)
    )
    test_body_rate_is_the_derivative_of_attitude(ride)
    test_specific_force_is_acceleration_less_gravitation(ride)
    test_position_is_the_integral_of_velocity(ride)
    t = np.arange(0, ride.profile.end_ns, 20_000_000)
    m = ride.motion(t, np.zeros(3))
    assert np.abs(m.lat).max() <= math.pi / 2
    assert np.abs(m.lon).max() <= math.pi
    # what is told in geographic terms is the motion through Earth-fixed space
    assert np.abs(ellipsoid.to_ecef(m.lat, m.lon, m.height) - m.r_e).max() < 1e-8
    C_eg = ellipsoid.axes_eg(m.lat, m.lon)
    assert np.abs(np.einsum("nij,nj->ni", C_eg, m.v_g) - m.v_e).max() < 1e-13
    if "north pole" in place:
        assert m.lat.max() > math.pi / 2 - 5.0 / 6.4e6
        assert np.abs(np.diff(np.unwrap(m.lon))).sum() > 2.0


def test_straight_on_is_nearly_a_great_circle_and_leads_over_the_pole():
    ride = trajectory_of(
        [Accelerate(duration_s=10.0, speed_m_s=300.0), Cruise(duration_s=140.0)],
        imu=(0.0, 0.0, 0.0),
        lat=math.radians(89.8),
        lon=0.7,
        heading=0.0,
    )
    m = ride.motion(np.linspace(0, ride.profile.end_ns, 200).astype(np.int64))
    # in the plane of the meridian all the way, to rounding of 6.4e6 m
    assert np.abs(m.r_e @ [-math.sin(0.7), math.cos(0.7), 0.0]).max() < 1e-6
    assert m.lat.max() > math.radians(89.99)
    assert m.lat[-1] < math.radians(89.82)
    assert math.remainder(m.lon[-1] - 0.7 - math.pi, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
