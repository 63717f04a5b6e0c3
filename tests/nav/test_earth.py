"""The Earth model against published WGS-84 values and closed relations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav import earth, rotation

LATS = st.floats(-math.pi / 2, math.pi / 2)
LONS = st.floats(-math.pi, math.pi)
HEIGHTS = st.floats(-11_000.0, 100_000.0)


def test_derived_constants_are_the_published_ones():
    # NIMA TR8350.2, tables 3.3 and 3.4, to the digits printed there
    assert pytest.approx(6356752.3142, abs=5e-5) == earth.SEMI_MINOR
    assert pytest.approx(6.69437999014e-3, abs=5e-15) == earth.E2
    # k of the published gravities, which end at the tenth decimal: 1e-11 of themselves
    k = earth.SEMI_MINOR * earth.GRAVITY_POLE / (earth.SEMI_MAJOR * earth.GRAVITY_EQUATOR) - 1.0
    assert pytest.approx(k, abs=2e-11) == earth.SOMIGLIANA
    assert pytest.approx(0.00344978650684, abs=5e-14) == earth._M


def test_gravity_at_equator_pole_and_mean():
    assert earth.normal_gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.normal_gravity(1.0, 0.0) == pytest.approx(9.8321849378, abs=1e-10)
    # mean over the ellipsoid's area, TR8350.2 table 3.4: 9.7976432222 m/s^2
    s, w = np.polynomial.legendre.leggauss(60)
    area = 1.0 / (1.0 - earth.E2 * s * s) ** 2
    g = np.array([earth.normal_gravity(x, 0.0) for x in s])
    assert np.sum(w * area * g) / np.sum(w * area) == pytest.approx(9.7976432222, abs=1e-9)


@pytest.mark.parametrize("lat", [0.0, 0.6, -1.2, math.pi / 2])
@pytest.mark.parametrize("height", [0.0, 1000.0, 20_000.0])
def test_gravity_is_the_gradient_of_the_normal_potential(lat, height):
    """Independent: closed normal potential (TR8350.2 section 4) differentiated numerically."""
    E = earth.SEMI_MAJOR * math.sqrt(earth.E2)

    def q(u):
        # series of ((1 + 3 u^2/E^2) atan(E/u) - 3 u/E)/2, whose terms cancel to 1e-6 of themselves
        n = np.arange(1, 20)
        return float(np.sum(2 * n * (-1.0) ** (n + 1) * (E / u) ** (2 * n + 1) / (2 * n + 1) / (2 * n + 3)))

    def potential(x, z):
        r2 = x * x + z * z - E * E
        u = math.sqrt(0.5 * r2 * (1 + math.sqrt(1 + 4 * E * E * z * z / (r2 * r2))))
        beta = math.atan2(z * math.hypot(u, E), u * x)
        w2 = earth.EARTH_RATE**2
        return (
            earth.GM / E * math.atan(E / u)
            + 0.5 * w2 * earth.SEMI_MAJOR**2 * q(u) / q(earth.SEMI_MINOR) * (math.sin(beta) ** 2 - 1 / 3)
            + 0.5 * w2 * x * x
        )

    x, _, z = earth.geodetic_to_xyz(lat, 0.0, height)
    d = 50.0
    gx = (potential(x + d, z) - potential(x - d, z)) / (2 * d)
    gz = (potential(x, z + d) - potential(x, z - d)) / (2 * d)
    east, north, up = earth.gravity_g(lat, height)
    s, c = math.sin(lat), math.cos(lat)
    # differences round at 6e7 * 1e-16 / 50 = 1e-10; the expansion in height leaves 4 (h/a)^3 g, the
    # deflection 1.5 % of itself per 20 km and per degree of its series
    bound = 2e-8 + 40.0 * (height / earth.SEMI_MAJOR) ** 3 * 10 + 3e-10 * height
    assert up == pytest.approx(gx * c + gz * s, abs=bound)
    assert north == pytest.approx(-gx * s + gz * c, abs=bound)
    assert east == 0.0


def test_radii_against_meridian_arc():
    """The quarter meridian is 10001965.7293 m (published), the integral of R_M."""
    lat, w = np.polynomial.legendre.leggauss(40)
    lat = (lat + 1) * math.pi / 4
    arc = sum(wi * earth.radii(math.sin(x))[0] for x, wi in zip(lat, w, strict=True)) * math.pi / 4
    assert arc == pytest.approx(10001965.7293, abs=1e-3)
    assert earth.radii(0.0) == pytest.approx((6335439.3273, 6378137.0), abs=1e-3)
    assert earth.radii(1.0) == pytest.approx((6399593.6258, 6399593.6258), abs=1e-3)


@given(LATS, LONS, HEIGHTS)
def test_geodetic_round_trip(lat, lon, height):
    r = earth.geodetic_to_xyz(lat, lon, height)
    back = earth.xyz_to_geodetic(*r)
    # rounding of 6.4e6 m coordinates: 1e-9 m
    assert back[2] == pytest.approx(height, abs=5e-9)
    assert back[0] == pytest.approx(lat, abs=1e-15)
    np.testing.assert_allclose(earth.geodetic_to_xyz(*back), r, atol=1e-8)
    np.testing.assert_allclose(earth.ecef(lat, lon, height), r, atol=1e-8)


def test_geodetic_of_arrays():
    lat, lon, h = earth.geodetic(earth.ecef([0.1, -1.0], [3.0, -2.0], [5.0, 6.0]))
    np.testing.assert_allclose([lat, lon, h], [[0.1, -1.0], [3.0, -2.0], [5.0, 6.0]], atol=1e-8)


@given(LATS, LONS, st.floats(-3.0, 3.0))
def test_position_matrix_round_trip(lat, lon, wander):
    C = earth.position_matrix(lat, lon, wander)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-15)
    assert C[:, 2] == pytest.approx(
        [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)]
    )
    back = earth.position_angles(C)
    # near a pole only the sum of longitude and wander is determined
    np.testing.assert_allclose(earth.position_matrix(*back), C, atol=4e-14)


def test_position_matrix_at_the_pole_is_finite():
    for lat in (math.pi / 2, -math.pi / 2):
        C = np.diag([1.0, 1.0, 1.0]) @ earth.position_matrix(lat, 0.7, 0.2)
        C[2, :2] = 0.0
        C[:2, 2] = 0.0
        np.testing.assert_allclose(earth.position_matrix(*earth.position_angles(C)), C, atol=1e-14)


@given(st.floats(-1.5, 1.5), st.floats(-3.0, 3.0), st.floats(-1000.0, 20000.0))
def test_curvature_gives_the_transport_rate(lat, wander, height):
    C = earth.position_matrix(lat, 0.3, wander)
    kxx, kxy, kyy = earth.curvature(*C[2], height)
    v_g = np.array([30.0, -70.0, 2.0])
    ca, sa = math.cos(wander), math.sin(wander)
    v_x, v_y = ca * v_g[0] + sa * v_g[1], -sa * v_g[0] + ca * v_g[1]
    w_n = np.array([-(kxy * v_x + kyy * v_y), kxx * v_x + kxy * v_y])
    w_g = np.array([ca * w_n[0] - sa * w_n[1], sa * w_n[0] + ca * w_n[1]])
    np.testing.assert_allclose(w_g, earth.transport_rate_g(lat, height, v_g)[:2], rtol=1e-13, atol=1e-19)


def test_earth_rate():
    lat = 0.8
    w_e = earth.position_matrix(lat, 1.0) @ earth.earth_rate_g(lat)
    np.testing.assert_allclose(w_e, [0.0, 0.0, 7.292115e-5], atol=1e-19)


@given(lat=st.floats(-math.pi / 2, math.pi / 2), lon=st.floats(-math.pi, math.pi))
def test_position_quaternion_is_the_position_matrix(lat, lon):
    C_eg = rotation.dcm_from_quat(earth.position_quat(lat, lon))
    assert np.abs(C_eg - earth.position_matrix(lat, lon)).max() < 1e-15


@given(lat=LATS, lon=LONS, other=LATS, east=LONS)
def test_convergence_is_the_turn_between_two_level_frames(lat, lon, other, east):
    turn = rotation.quat_multiply(
        rotation.quat_conjugate(earth.position_quat(other, east)), earth.position_quat(lat, lon)
    )
    if math.hypot(turn[0], turn[3]) < 1e-6:  # the other end of the Earth: any turn will do
        return
    # counter-clockwise components, clockwise bearings
    expected = -2.0 * math.atan2(turn[3], turn[0])
    found = float(earth.convergence(lat, lon, other, east))
    assert abs(found) <= math.pi
    assert math.remainder(found - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_convergence_by_examples():
    assert earth.convergence(0.8, 0.2, 0.8, 0.2 + 1e-5) == pytest.approx(1e-5 * math.sin(0.8))
    # straight over the pole true north becomes true south; along a meridian nothing changes
    assert abs(earth.convergence(1.5, 0.3, 1.5, 0.3 - math.pi)) == pytest.approx(math.pi)
    assert earth.convergence(0.3, 0.5, 1.2, 0.5) == 0.0
    # over the date line
    assert earth.convergence(0.8, math.pi - 1e-5, 0.8, -math.pi) == pytest.approx(1e-5 * math.sin(0.8))
