"""The phi form and the psi form against their sources, against each other, and against the filter's model."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag

from nav import earth
from nav.errors import geographic as geo
from nav.errors import psi
from nav.errors.model import error_dynamics
from nav.rotation import skew

CASES = [
    # lat, height, v_g, f_g
    (0.8, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)),
    (0.5, 9000.0, (220.0, -130.0, 6.0), (1.5, -3.0, 11.0)),
    (-1.2, 300.0, (-30.0, 25.0, -2.0), (-0.4, 0.2, 9.6)),
    (0.0, 20000.0, (-300.0, 260.0, 20.0), (4.0, 6.0, 5.0)),
]
# one of each state makes effects of like size in the others: angles as rad, metres per Earth radius,
# velocities per Schuler speed
RADIUS = 6.37e6
METRES = np.array([1.0] * 3 + [1e-3] * 3 + [1.0 / RADIUS] * 3)
ANGLES = np.array([1.0 / RADIUS, 1.0 / RADIUS, 1.0] + [1e-3] * 3 + [1.0 / RADIUS] * 3)


def rates(lat, height, v, f):
    """w_ie, w_en, the rate of v, and the rates of latitude and height."""
    w_ie, w_en = earth.earth_rate_g(lat), earth.transport_rate_g(lat, height, v)
    dv = np.asarray(f) - np.cross(2.0 * w_ie + w_en, v) + earth.gravity_g(lat, height)
    d_lat, _, d_h = geo.metres_to_angles(lat, height) @ v
    return w_ie, w_en, dv, d_lat, d_h


@pytest.mark.parametrize("case", CASES)
def test_phi_form_is_the_textbooks(case):
    """Equations (2-84), (2-87), (2-88), element by element.

    The text leaves out how the radii change with latitude and height, which is e^2 (0.7 %) of the transport
    rate's elements and all of the height's; its 2 w_s^2 is normal gravity's gradient but for f and m (1 %).
    """
    lat, h, v, f = case
    (vx, vy, vz), (fx, fy, fz) = v, f
    r_m, r_n = earth.radii(math.sin(lat))
    M, N = r_m + h, r_n + h
    W, s, c, t = earth.EARTH_RATE, math.sin(lat), math.cos(lat), math.tan(lat)
    g = earth.normal_gravity(s, h)
    printed = np.zeros((9, 9))
    printed[0, 4] = 1 / M
    printed[1, [0, 3]] = vx / N / c * t, 1 / (N * c)
    printed[2, 5] = 1.0
    printed[3, 0] = 2 * W * (c * vy + s * vz) + vx * vy / (N * c * c)
    printed[3, 3:9] = vy / N * t - vz / N, 2 * W * s + vx / N * t, -(2 * W * c + vx / N), 0, -fz, fy
    printed[4, 0] = -(2 * W * c + vx / (N * c * c)) * vx
    printed[4, 3:9] = -2 * (W * s + vx / N * t), -vz / M, -vy / M, fz, 0, -fx
    printed[5, [0, 2]] = -2 * W * s * vx, 2 * g / M
    printed[5, 3:9] = 2 * (W * c + vx / N), 2 * vy / M, 0, -fy, fx, 0
    printed[6, [4, 7, 8]] = -1 / M, W * s + vx / N * t, -(W * c + vx / N)
    printed[7, [0, 3, 6, 8]] = -W * s, 1 / N, -(W * s + vx / N * t), -vy / M
    printed[8, [0, 3, 6, 7]] = W * c + vx / (N * c * c), t / N, W * c + vx / N, vy / M
    F = geo.phi_dynamics(lat, h, v, f)
    np.testing.assert_allclose(F[:, 3:], printed[:, 3:], rtol=1e-12, atol=1e-20)
    assert F[5, 2] == pytest.approx(printed[5, 2], rel=0.01)
    assert not F[:, 1].any()
    # the latitude's column: e^2 (up to 3 of it, in the meridian) of the transport rate and of gravity
    transport = np.linalg.norm(earth.transport_rate_g(lat, h, v)) / c
    speed = np.linalg.norm(v)
    slack = 3 * earth.E2 * np.array([transport] * 3 + [transport * speed] * 2 + [g] + [transport] * 3)
    assert np.all(np.abs(F[:, 0] - printed[:, 0]) <= slack + 1e-20)


def ned(vector):
    return np.array([vector[1], vector[0], -vector[2]])


@pytest.mark.parametrize("case", CASES)
def test_psi_form_is_the_excerpts(case):
    """Equation (2.2.5) in north, east, down, the Earth as a sphere in its gravity: e^2 is left."""
    lat, h, v, f = case
    r_m, r_n = earth.radii(math.sin(lat))
    east, north = v[0] / (r_n + h), v[1] / (r_m + h)
    lon_rate, lat_rate = east / math.cos(lat), north
    W, s, c = earth.EARTH_RATE, math.sin(lat), math.cos(lat)
    rho = np.array([lon_rate * c, -lat_rate, -lon_rate * s])
    omega = np.array([(W + lon_rate) * c, -lat_rate, -(W + lon_rate) * s])
    twice = np.array([(2 * W + lon_rate) * c, -lat_rate, -(2 * W + lon_rate) * s])
    g, R = earth.normal_gravity(s, h), r_n + h
    A = np.zeros((9, 9))
    A[0:3, 0:3], A[0:3, 3:6] = -skew(rho), np.eye(3)
    A[3:6, 0:3] = np.diag([-g / R, -g / R, 2 * g / R])
    A[3:6, 3:6], A[3:6, 6:9] = -skew(twice), skew(ned(f))
    A[6:9, 6:9] = -skew(omega)
    turn = block_diag(*[np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])] * 3)
    F = psi.psi_dynamics(
        earth.earth_rate_g(lat), earth.transport_rate_g(lat, h, v), f, psi.gravity_gradient(lat, h)
    )
    ours = turn @ F @ turn
    gravity = (slice(3, 6), slice(0, 3))
    np.testing.assert_allclose(ours[gravity], A[gravity], atol=3 * earth.E2 * g / R)
    ours[gravity] = A[gravity]
    np.testing.assert_allclose(ours, A, rtol=1e-12, atol=1e-20)


def test_turn_of_the_frame_is_the_excerpts():
    """Equation (2.2.12) in north, east, down: (dlon cos L, -dL, -dlon sin L)."""
    lat, h, dr = 0.7, 2000.0, np.array([30.0, -50.0, 7.0])
    d_lat, d_lon, _ = geo.metres_to_angles(lat, h) @ dr
    turn = ned(geo.frame_turn(lat, h) @ dr)
    np.testing.assert_allclose(turn, [d_lon * math.cos(lat), -d_lat, -d_lon * math.sin(lat)], rtol=1e-14)


@pytest.mark.parametrize("lat", [-1.3, -0.4, 0.3, 0.9, 1.4])
@pytest.mark.parametrize("height", [0.0, 15000.0])
def test_gravity_is_differentiated(lat, height):
    """Differences of gravity over 2 km along each axis; a field without curl has a symmetric gradient."""
    C = earth.position_matrix(lat, 0.0)
    r = np.array(earth.geodetic_to_xyz(lat, 0.0, height))
    gradient = np.empty((3, 3))
    for k in range(3):
        ends = []
        for side in (1.0, -1.0):
            place = earth.xyz_to_geodetic(*(r + side * 1e3 * C[:, k]))
            ends.append(C.T @ earth.position_matrix(*place[:2]) @ earth.gravity_g(place[0], place[2]))
        gradient[:, k] = (ends[0] - ends[1]) / 2e3
    ours = psi.gravity_gradient(lat, height)
    # twice the square of 1 km over the radius
    np.testing.assert_allclose(ours, gradient, atol=5e-8 * 1.54e-6)
    # the plumb line's bend is rounded to three digits, and of first order in height
    assert abs(ours[1, 2] - ours[2, 1]) < 5e-5 * 1.54e-6


def total(lat, height, v):
    """psi states to phi states, positions as angles."""
    T = psi.phi_from_psi(geo.frame_turn(lat, height), v)
    return block_diag(geo.metres_to_angles(lat, height), np.eye(6)) @ T


def within(limit):
    return st.floats(-limit, limit, allow_nan=False)


@given(
    lat=within(1.45),
    height=st.floats(-500.0, 30000.0),
    v=st.tuples(within(400.0), within(400.0), within(50.0)),
    f=st.tuples(within(30.0), within(30.0), within(30.0)),
)
def test_the_two_forms_are_one(lat, height, v, f):
    """F_phi = (T F_psi + dT/dt) / T in every element, dT/dt by central difference along the motion.

    Elements grow with the tangent of latitude and its square, 8 and 70 at 83 degrees: so does the rounding of
    the difference, and its remainder, the square of the step's part of the way to the pole.
    """
    v = np.array(v)
    w_ie, w_en, dv, d_lat, d_h = rates(lat, height, v, f)
    d = 0.1
    T = total(lat, height, v)
    ahead = total(lat + d * d_lat, height + d * d_h, v + d * dv)
    behind = total(lat - d * d_lat, height - d * d_h, v - d * dv)
    F = psi.psi_dynamics(w_ie, w_en, f, psi.gravity_gradient(lat, height))
    F = (T @ F + (ahead - behind) / (2 * d)) @ np.linalg.inv(T)
    error = (F - geo.phi_dynamics(lat, height, v, f)) * ANGLES / ANGLES[:, None]
    # of 3e-3, the largest element in these units but for the force over g
    assert np.max(np.abs(error)) < 1e-11 / math.cos(lat) ** 2


def local(case, wander, spin):
    """A case in level axes that turn by ``spin`` about up: pole, D, rates, velocity, force, gradient, dv."""
    lat, h, v, f = case
    C_gn = earth.position_matrix(0.0, 0.0).T @ earth.position_matrix(0.0, 0.0, wander)
    pole, v_n, f_n = earth.position_matrix(lat, 0.0, wander)[2], C_gn.T @ v, C_gn.T @ f
    D = shortest(pole, h)
    w_ie, w_en = earth.EARTH_RATE * pole, D @ v_n + np.array([0.0, 0.0, spin])
    dv = f_n - np.cross(2.0 * w_ie + w_en, v_n) + C_gn.T @ earth.gravity_g(lat, h)
    return pole, D, w_ie, w_en, v_n, f_n, C_gn.T @ psi.gravity_gradient(lat, h) @ C_gn, dv


def shortest(pole, height):
    """D of the shortest turn: that of the wander frame carried along."""
    kxx, kxy, kyy = earth.curvature(*pole, height)
    return np.array([[-kxy, -kyy, 0.0], [kxx, kxy, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(("wander", "spin"), [(0.0, 0.0), (2.5, 0.0), (-0.7, 3e-4), (1.0, -7e-5)])
@pytest.mark.parametrize("case", CASES)
def test_filters_model_is_the_psi_form(case, wander, spin):
    """The model of the filter has its true frame one shortest turn from the computed one: T without dtheta_z.

    It takes one mean radius where a height or the motion changes the transport rate, and 2 g / R for the
    gradient of gravity: e^2 of those elements, and all of gravity's change with latitude (e^2 of g / R).
    ``spin`` is the vertical transport rate of an azimuth law.
    """
    pole, D, w_ie, w_en, v, f, gradient, dv = local(case, wander, spin)
    h, d = case[1], 0.1
    dp = -np.cross(w_en, pole)
    T = psi.phi_from_psi(D, v)
    rate = (
        psi.phi_from_psi(shortest(pole + d * dp, h + d * v[2]), v + d * dv)
        - psi.phi_from_psi(shortest(pole - d * dp, h - d * v[2]), v - d * dv)
    ) / (2 * d)
    F = (T @ psi.psi_dynamics(w_ie, w_en, f, gradient) + rate) @ np.linalg.inv(T)
    r_m, r_n = earth.radii(pole[2])
    g_r = earth.normal_gravity(pole[2], h) / (math.sqrt(r_m * r_n) + h)
    curved = earth.curvature(*pole, h)
    ours = error_dynamics(np.eye(3), f, np.zeros(3), v, w_ie, w_en, curved, 2.0 * g_r)[:9, :9]
    error = np.abs(F - ours) * METRES / METRES[:, None]
    # columns of velocity and attitude: nothing is left out
    assert np.max(error[:, 3:]) < 1e-11
    moving = 2 * earth.E2 * np.linalg.norm(w_en[:2])
    slack = np.array(
        [
            [moving] * 3,
            [1.1 * earth.E2 * g_r * 1e3 + moving * np.linalg.norm(v) * 1e3 / RADIUS] * 3,
            [moving] * 3,
        ]
    ).ravel()
    assert np.all(error[:, :3] <= slack[:, None] + 1e-11)


def test_geographic_phi_is_the_filters_and_a_turn_about_the_vertical():
    """One psi, two definitions of the true frame: phi differs by dlon sin L about up, dv by its product."""
    lat, h, v = 0.9, 4000.0, np.array([150.0, 80.0, -3.0])
    dr = np.array([400.0, -700.0, 20.0])
    x = np.concatenate([dr, [0.3, -0.2, 0.1], [1e-4, 2e-4, -3e-4]])
    whole = psi.phi_from_psi(geo.frame_turn(lat, h), v) @ x
    D = geo.frame_turn(lat, h)
    D[2] = 0.0
    short = psi.phi_from_psi(D, v) @ x
    spin = np.array([0.0, 0.0, (geo.metres_to_angles(lat, h) @ dr)[1] * math.sin(lat)])
    np.testing.assert_allclose(whole[6:] - short[6:], spin, atol=1e-18)
    np.testing.assert_allclose(whole[3:6] - short[3:6], -np.cross(spin, v), atol=1e-14)
    np.testing.assert_array_equal(shortest(earth.position_matrix(lat, 0.0)[2], h)[2], D[2])
    np.testing.assert_allclose(shortest(earth.position_matrix(lat, 0.0)[2], h), D, rtol=1e-12, atol=1e-22)
