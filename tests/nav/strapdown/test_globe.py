"""One mechanisation for the whole globe: azimuth laws, poles, date line, equator, quadrants."""

import math
from itertools import product

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.kernels import X_C, X_HEAD, integrate
from nav.strapdown.mechanize import moved, moved_second_order
from tests.nav.strapdown.making import FLIGHT, earth_fixed, geographic, head_of, increments_of, ride

LAWS = {"north": 0.0, "wander": 0.0, "free": 0.0, "rotating": math.radians(1.0 / 60.0)}
HZ = 100
PLACES = {
    "mid latitude": (0.8, 0.2, 0.5),
    "south": (-0.9, -2.0, 4.0),
    "equator": (-0.001, 0.3, 0.2),
    "date line": (0.7, math.pi - 0.002, math.pi / 2),
    "north pole": (math.radians(89.9), 0.4, 0.0),
    "beside the pole": (math.radians(89.9), 3.0, 0.03),
    "south pole": (math.radians(-89.8), 1.0, math.pi),
}


@pytest.fixture(scope="module")
def flights():
    """Truth and samples of one flight from every place."""
    found = {}
    for name, place in PLACES.items():
        trajectory = ride(FLIGHT, *place)
        found[name] = (trajectory, increments_of(trajectory, HZ))
    return found


def flown(flights, place, law, n=2):
    """Rows (seconds, X_HEAD) of the flight from a place, one a second."""
    trajectory, samples = flights[place]
    x, out = head_of(trajectory.state(0)), np.zeros((trajectory.profile.end_ns // 10**9, X_HEAD))
    u = azimuth_control(law, LAWS[law])
    assert integrate(x, samples, 1.0 / HZ, n, u, HZ // n, out) == len(out)
    return out


@pytest.mark.parametrize("place", ["mid latitude", "south", "equator", "date line"])
@pytest.mark.parametrize("law", ["north", "free", "rotating"])
def test_laws_give_the_same_navigation(flights, place, law):
    a = np.array([geographic(x) for x in flown(flights, place, law)])
    b = np.array([geographic(x) for x in flown(flights, place, "wander")])
    difference = a - b
    difference[:, 1] = np.remainder(difference[:, 1] + math.pi, math.tau) - math.pi
    # 1e-9 of: an Earth's radius would be 6 mm, the way of 30 km is 0.03 mm; 180 m/s; a radian
    scale = np.array([30e3 / 6.4e6, 30e3 / 6.4e6, 30e3, 180.0, 180.0, 180.0, 1.0])
    assert np.abs(difference / scale).max() < 1e-9


@pytest.mark.parametrize("law", ["free", "rotating"])
@pytest.mark.parametrize("place", ["north pole", "beside the pole", "south pole"])
def test_laws_give_the_same_navigation_across_a_pole(flights, place, law):
    crossed = np.array([x[X_C + 8] for x in flown(flights, place, law)])
    assert 1.0 - np.abs(crossed).max() < 1e-8  # within a kilometre
    for x, y in zip(flown(flights, place, law), flown(flights, place, "wander"), strict=True):
        for a, b, scale in zip(earth_fixed(x), earth_fixed(y), (30e3, 180.0, 1.0), strict=True):
            assert np.abs(a - b).max() < 1e-9 * scale


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("n", [2, 4])
def test_no_place_is_special(flights, place, n):
    """Errors of a free inertial flight at poles, date line and equator are those of mid latitudes."""
    trajectory, _ = flights[place]
    error = np.zeros(2)
    for second, x in enumerate(flown(flights, place, "wander", n), 1):
        motion = trajectory.motion(np.array([second * 10**9]))
        r_e, v_e, _ = earth_fixed(x)
        error = np.maximum(error, [np.abs(r_e - motion.r_e).max(), np.abs(v_e - motion.v_e).max()])
    # the velocity's bend between two updates: a dt^2/12 a second of change of acceleration, some 2 m/s^2;
    # four samples cannot follow a manoeuvre any better than two, see `test_azimuth`
    assert error[0] < 5e-3
    assert error[1] < 1e-4


def test_the_pole_itself_is_a_place_like_any_other():
    """Standing exactly at the pole: C_en is regular, the answer of the angles gives it back."""
    for sign in (1.0, -1.0):
        C = earth.position_matrix(sign * math.pi / 2, 0.0, 0.6)
        C[2], C[:, 2] = (0.0, 0.0, sign), (0.0, 0.0, sign)
        lat, lon, wander = earth.position_angles(C)
        assert (lat, lon) == (sign * math.pi / 2, 0.0)
        assert wander == pytest.approx(0.6, abs=1e-15)
        w_ie = earth.EARTH_RATE * C[2]
        g = earth.normal_gravity(sign, 0.0)
        x = np.concatenate([[1.0, 0, 0, 0], np.zeros(3), C.ravel(), [0.0, 0.0]])
        sample = np.concatenate([w_ie * 0.01, [0.0, 0.0, g * 0.01]])
        integrate(
            x, np.tile(sample, (60_000, 1)), 0.01, 2, azimuth_control("wander"), 1, np.zeros((0, X_HEAD))
        )
        r_e, v_e, _ = earth_fixed(x)
        # rounding of g grows with the unstable height: 1e-15 g for ten minutes, e-fold in 9.5 minutes
        assert np.abs(r_e - [0.0, 0.0, sign * earth.SEMI_MINOR]).max() < 1e-5
        assert np.abs(v_e).max() < 1e-7


# Textbook chapter "Inertial navigation", Tables 2-6 to 2-8: signs of the denominator and of the principal
# value of the arc tangent, and what is added to it, deg
QUADRANTS = {
    "longitude": {(1, 1): 0, (-1, -1): 180, (-1, 1): -180, (1, -1): 0},
    "heading": {(1, 1): 0, (-1, -1): 180, (-1, 1): 180, (1, -1): 360},
    "roll": {(1, 1): 0, (-1, -1): 180, (-1, 1): -180, (1, -1): 0},
}


@pytest.mark.parametrize("angle", QUADRANTS)
@pytest.mark.parametrize("signs", list(product((1, -1), (1, -1))))
def test_quadrants_are_those_of_the_tables(angle, signs):
    denominator = signs[0] * 0.6
    principal = signs[1] * math.atan(0.75)
    numerator = denominator * math.tan(principal)
    expected = principal + math.radians(QUADRANTS[angle][signs])
    true = math.atan2(numerator, denominator)
    if angle == "longitude":
        C_en = earth.position_matrix(-0.4, true, 2.0)
        assert C_en[0, 2] * denominator > 0.0
        found = earth.position_angles(C_en)[1]
    else:
        heading, roll = (true, 0.2) if angle == "heading" else (5.0, true)
        C_gb = rot.dcm_from_euler(heading, 0.3, roll)
        row = (C_gb[1, 1], C_gb[2, 2])[angle == "roll"]
        assert row * denominator > 0.0
        h, _, r = rot.euler_from_dcm(C_gb)
        found = float(h if angle == "heading" else r)
    assert found == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("wander", [0.5, 2.0, -2.0, -0.5])
def test_wander_has_all_quadrants(wander):
    assert earth.position_angles(earth.position_matrix(1.2, 3.0, wander))[2] == pytest.approx(
        wander, abs=1e-14
    )


def test_position_matrix_to_second_order():
    """What the second-order update loses is a sixth of the angle's cube, and of nothing else."""
    C_en = earth.position_matrix(0.7, 0.2, 0.3)
    direction = np.array([0.6, -0.64, 0.48])
    lost = []
    for size in (1e-2, 2e-2):
        exact = moved(C_en, size * direction)
        np.testing.assert_allclose(exact @ exact.T, np.eye(3), atol=1e-15)
        lost.append(np.abs(C_en.T @ (exact - moved_second_order(C_en, size * direction))))
    np.testing.assert_allclose(lost[0], np.abs(rot.skew(direction)) * 1e-6 / 6.0, rtol=1e-2, atol=1e-9)
    assert lost[1].max() / lost[0].max() == pytest.approx(8.0, rel=2e-3)
