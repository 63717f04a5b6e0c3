"""Every measurement of the table: a perfect one takes out exactly the error it sees."""

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.filter import states as st
from nav.filter.aiding import earth_fixed
from nav.filter.measurements import MEASUREMENTS
from nav.strapdown.kernels import X_C, X_H, X_Q, X_V
from tests.nav.filter.making import difference, disturbed, nominal

STEPS = np.concatenate(
    [[3.0] * 3, [0.3] * 3, [1e-4] * 3, [1e-4] * 3, [1e-3] * 3, [1e-3] * 3, [1.0], [1e-4] * 18]
)
T = 0.05
SMALL = [1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12]


def parameters():
    p = np.zeros(st.P_SIZE)
    p[st.P_LG : st.P_LG + 3] = [1.0, -2.0, 1.5]
    p[st.P_LO : st.P_LO + 3] = [-0.5, -1.5, -0.7]
    return p


def rate_now(x):
    """w_ib_b at the state's time: what is kept is of half an update before."""
    return x[st.X_W : st.X_W + 3] + x[st.X_WT] * x[st.X_WD : st.X_WD + 3]


def vehicle_velocity(x, p):
    """Velocity of the odometer point in v, by matrices."""
    C_nb = rot.dcm_from_quat(x[X_Q : X_Q + 4])
    C_vb = rot.dcm_from_quat(x[st.X_QV : st.X_QV + 4])
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    w_eb = rate_now(x) - C_nb.T @ C_en.T @ [0, 0, earth.EARTH_RATE]
    return C_vb @ (C_nb.T @ x[X_V : X_V + 3] + np.cross(w_eb, p[st.P_LO : st.P_LO + 3]))


def exact(kind, x, p):
    """z of a perfect measurement made now from the true state ``x``, by matrices; and x for it."""
    C_nb = rot.dcm_from_quat(x[X_Q : X_Q + 4])
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    lat, lon, _ = earth.position_angles(C_en)
    w_eb = rate_now(x) - C_nb.T @ C_en.T @ [0, 0, earth.EARTH_RATE]
    lever = p[st.P_LG : st.P_LG + 3]
    if kind == "gnss_position":
        r = np.array(earth.geodetic_to_xyz(lat, lon, x[X_H])) + C_en @ C_nb @ lever
        return x, np.array([0.0, *r, *SMALL])
    if kind == "gnss_velocity":
        return x, np.array([0.0, *(C_en @ (x[X_V : X_V + 3] + C_nb @ np.cross(w_eb, lever))), *SMALL])
    if kind == "barometer":
        return x, np.array([0.0, x[X_H] + x[st.X_BB], 1e-6])
    u = vehicle_velocity(x, p)
    if kind in ("odometer", "speed"):
        x = with_path(x, u)
        s = u[1] / (1.0 + x[st.X_KO])
        return x, np.array([0.0, T, s * T, 1e-7 * T, 0.0, 1.0] if kind == "odometer" else [0.0, s, 1e-7])
    if kind == "non_holonomic":
        # drive along v's forward axis: choose the velocity so
        C_vb = rot.dcm_from_quat(x[st.X_QV : st.X_QV + 4])
        x = x.copy()
        w = np.cross(w_eb, p[st.P_LO : st.P_LO + 3])
        x[X_V : X_V + 3] = C_nb @ (C_vb.T @ np.array([0.0, 30.0, 0.0]) - w)
        return with_path(x, np.array([0.0, 30.0, 0.0])), np.array([0.0, T, 1e-4, 0.0])
    if kind == "zero_velocity":
        x = x.copy()
        x[X_V : X_V + 3] = 0.0
        return x, np.array([0.0, 1e-7])
    assert kind == "zero_rate"
    rate = C_nb.T @ C_en.T @ [0, 0, earth.EARTH_RATE] + x[st.X_BG : st.X_BG + 3]
    return x, np.array([0.0, T, *rate, 1e-10])


def with_path(x, u):
    x = x.copy()
    x[st.X_PATH : st.X_PATH + 3] = u * T
    x[st.X_PT] = T
    return x


SEEN = {
    "gnss_position": [0, 1, 2, 6, 7, 8],
    "gnss_velocity": [0, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11],
    "barometer": [2, 18],
    "odometer": [3, 4, 5, 6, 7, 8, 15, 16, 17],
    "speed": [3, 4, 5, 6, 7, 8, 9, 10, 11, 15, 16, 17],
    "non_holonomic": [3, 4, 5, 6, 7, 8, 16, 17],
    "zero_velocity": [3, 4, 5],
    "zero_rate": [6, 7, 8, 9, 10, 11],
}


def test_every_measurement_is_here():
    assert SEEN.keys() == MEASUREMENTS.keys()
    assert len({m.rank for m in MEASUREMENTS.values()}) == len(MEASUREMENTS)


@pytest.mark.parametrize(("kind", "k"), [(kind, k) for kind, seen in SEEN.items() for k in seen])
def test_takes_out_the_error_it_sees(kind, k):
    """Only state k is uncertain and wrong; after the update it is right again, whatever its sign."""
    p = parameters()
    x, z = exact(kind, nominal(), p)
    e = np.zeros(st.FULL)
    e[k] = STEPS[k]
    y = disturbed(x, e)
    if kind in ("gnss_velocity", "speed") and k in (9, 10, 11):
        # a bias error shows in the corrected rate
        y[st.X_W + k - 9] -= e[k]
    P = np.zeros((st.FULL, st.FULL))
    P[k, k] = (10.0 * STEPS[k]) ** 2
    out = np.zeros(12)
    MEASUREMENTS[kind].kernel(y, P, p, z, np.inf, out)
    # the path since the last odometer epoch is disturbed as if its error were constant, while H knows
    # that a tilt makes it grow: up to 5 % of the weakest entries
    assert abs(difference(y, x)[k]) < 0.05 * STEPS[k]
    assert P[k, k] < (0.5 * STEPS[k]) ** 2 or kind == "zero_rate"


@pytest.mark.parametrize("kind", SEEN)
def test_a_perfect_measurement_has_no_residual(kind):
    p = parameters()
    x, z = exact(kind, nominal(), p)
    y, out, P = x.copy(), np.zeros(12), np.eye(st.FULL)
    nis = MEASUREMENTS[kind].kernel(y, P, p, z, -1.0, out)
    assert nis >= 0.0
    # 6.4e6 m coordinates round at 1e-9
    np.testing.assert_allclose(out[:6], 0.0, atol=2e-8)
    np.testing.assert_array_equal(y, x)


@pytest.mark.parametrize("tau", [0.004, 0.02])
def test_position_between_two_epochs(tau):
    """A fix ``tau`` before the state, of an antenna that turns: exact for a steady rate and acceleration."""
    x, p, C_eg, C_nb, _ = before(tau)
    lat, lon, _ = earth.position_angles(C_eg)
    back = x[X_V : X_V + 3] * tau - 0.5 * x[st.X_A : st.X_A + 3] * tau**2
    r = np.array(earth.geodetic_to_xyz(lat, lon, x[X_H])) + C_eg @ (C_nb @ p[st.P_LG : st.P_LG + 3] - back)
    out = np.zeros(12)
    MEASUREMENTS["gnss_position"].kernel(x.copy(), np.eye(st.FULL), p, np.array([tau, *r, *SMALL]), -1.0, out)
    np.testing.assert_allclose(out[:3], 0.0, atol=1e-8)


@pytest.mark.parametrize("tau", [0.004, 0.02])
def test_velocities_between_two_epochs(tau):
    """Of an antenna, and of the wheels in the axes that the vehicle had then."""
    x, p, C_eg, C_nb, w_eb = before(tau)
    v = x[X_V : X_V + 3] - x[st.X_A : st.X_A + 3] * tau
    out = np.zeros(12)
    z = np.array([tau, *(C_eg @ (v + C_nb @ np.cross(w_eb, p[st.P_LG : st.P_LG + 3]))), *SMALL])
    MEASUREMENTS["gnss_velocity"].kernel(x.copy(), np.eye(st.FULL), p, z, -1.0, out)
    np.testing.assert_allclose(out[:3], 0.0, atol=1e-8)
    C_vb = rot.dcm_from_quat(x[st.X_QV : st.X_QV + 4])
    wheels = C_vb @ (C_nb.T @ v + np.cross(w_eb, p[st.P_LO : st.P_LO + 3]))
    z = np.array([tau, wheels[1] / (1.0 + x[st.X_KO]), 1e-7])
    MEASUREMENTS["speed"].kernel(x.copy(), np.eye(st.FULL), p, z, -1.0, out)
    assert abs(out[0]) < 1e-8


def before(tau):
    """A state, parameters, and C_en, C_nb and w_eb_b of ``tau`` s before it, turning steadily."""
    x = nominal(wander=0.0)
    x[st.X_WD : st.X_WD + 3] = 0.0
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    C_nb = rot.dcm_from_quat(x[X_Q : X_Q + 4])
    w_eb = rate_now(x) - C_nb.T @ C_en.T @ [0, 0, earth.EARTH_RATE]
    return x, parameters(), C_en, C_nb @ rot.dcm_from_quat(rot.quat_from_rotvec(-w_eb * tau)), w_eb


def test_what_a_receiver_says_of_itself_in_earth_fixed_axes():
    """Components and covariance by matrices; at the pole east and north are those of the longitude."""
    lat, lon, sigmas = np.pi / 2, 0.7, np.array([1.0, 2.0, 3.0])
    z = earth_fixed(lat, lon, np.array([10.0, 20.0, 5.0]), sigmas)
    # at the pole north points back along the meridian, east is where it is everywhere on it
    east, north = np.array([-np.sin(lon), np.cos(lon), 0.0]), -np.array([np.cos(lon), np.sin(lon), 0.0])
    np.testing.assert_allclose(z[:3], 10.0 * east + 20.0 * north + [0.0, 0.0, 5.0], atol=1e-14)
    expected = np.outer(east, east) + 4.0 * np.outer(north, north) + np.diag([0.0, 0.0, 9.0])
    np.testing.assert_allclose(z[3:], expected[np.triu_indices(3)], atol=1e-14)


@pytest.mark.parametrize("wander", [-2.0, 0.4])
def test_noise_is_turned_into_n(wander):
    """With nothing known before, the covariance after a fix is the receiver's, along its own axes."""
    x = nominal(lat=1.2, lon=2.5, wander=wander)
    p = np.zeros(st.P_SIZE)
    sigmas = np.array([0.3, 0.1, 0.2])
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    v_g = earth.position_matrix(1.2, 2.5).T @ C_en @ x[X_V : X_V + 3]
    z = np.array([0.0, *earth_fixed(1.2, 2.5, v_g, sigmas)])
    P = np.zeros((st.FULL, st.FULL))
    P[st.VELOCITY, st.VELOCITY] = 1e6 * np.eye(3)
    MEASUREMENTS["gnss_velocity"].kernel(x, P, p, z, np.inf, np.zeros(12))
    C_gn = earth.position_matrix(1.2, 2.5).T @ C_en
    # P after = (P^-1 + R^-1)^-1: smaller than R by R / P
    np.testing.assert_allclose(C_gn @ P[3:6, 3:6] @ C_gn.T, np.diag(sigmas**2), rtol=1e-6, atol=1e-8)


def test_a_fix_across_the_pole_fits():
    """The receiver is on one side of the pole, the filter believes to be on the other: two metres apart."""
    x = nominal(lat=np.pi / 2 - 1.5e-7, lon=-1.0)
    p = np.zeros(st.P_SIZE)
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    v_e = C_en @ x[X_V : X_V + 3]
    lat, lon = np.pi / 2 - 1.5e-7, 2.0
    v_g = earth.position_matrix(lat, lon).T @ v_e
    out = np.zeros(12)
    z = np.array([0.0, *earth_fixed(lat, lon, v_g, np.full(3, 0.1))])
    MEASUREMENTS["gnss_velocity"].kernel(x, np.eye(st.FULL), p, z, -1.0, out)
    np.testing.assert_allclose(out[:3], 0.0, atol=1e-12)


def crossing(lean, p, P, walk):
    """Predicted variances (right, up) of the velocity across at 30 m/s north, body leaning ``lean`` rad."""
    x = nominal(v=(0.0, 30.0, 0.0))
    x[X_Q : X_Q + 4] = rot.quat_from_dcm(rot.dcm_from_euler(0.0, 0.0, lean))
    x[st.X_QV : st.X_QV + 4] = 1.0, 0.0, 0.0, 0.0
    out = np.zeros(12)
    z = np.array([0.0, T, 0.0, walk])
    MEASUREMENTS["non_holonomic"].kernel(with_path(x, np.array([0.0, 30.0, 0.0])), P, p, z, np.inf, out)
    return out[6:8] ** 2


@pytest.mark.parametrize("lean", [-0.05, 0.02, 0.1])
def test_a_body_that_leans_sees_part_of_a_walk_along_the_road_upward(lean):
    road = 1e-3**2 * 30.0 / T  # a walk over the metres rolled, as a mean velocity
    seen = crossing(lean, np.zeros(st.P_SIZE), np.eye(st.BASIC) * 1e-18, 1e-3)
    np.testing.assert_allclose(seen, road * np.array([np.cos(lean) ** 2, np.sin(lean) ** 2]), rtol=1e-6)


def test_noise_within_an_interval_reaches_its_mean_by_a_third():
    """Velocity known before, a random walk since: variance q T at the end, q T / 3 of the mean."""
    p, q = np.zeros(st.P_SIZE), 1e-4
    p[st.P_Q + 3 : st.P_Q + 6] = q
    P = np.eye(st.BASIC) * 1e-18
    P[st.VELOCITY, st.VELOCITY] = q * T * np.eye(3)
    np.testing.assert_allclose(crossing(0.0, p, P, 0.0), q * T / 3.0, rtol=1e-6)


@pytest.mark.parametrize("jerk", [0.0, 3.0])
def test_a_start_tells_wheels_nothing_of_the_heading(jerk):
    """Of an IMU with a wrong azimuth the wheels see what they expect: it turned all of the velocity, too."""
    heading, off, force = 0.7, 0.1, 2.0
    x = nominal()
    x[X_Q : X_Q + 4] = rot.quat_from_rotvec([0.0, 0.0, heading])
    x[st.X_QV : st.X_QV + 4] = [1.0, 0.0, 0.0, 0.0]
    x[st.X_W : st.X_W + 3] = x[st.X_WD : st.X_WD + 3] = 0.0
    ahead = rot.dcm_from_quat(x[X_Q : X_Q + 4])[:, 1]
    acceleration = force + jerk * T
    x[X_V : X_V + 3] = ahead * (force * T + 0.5 * jerk * T**2)
    x[st.X_A : st.X_A + 3] = ahead * acceleration
    x[st.X_F : st.X_F + 3] = [0.0, acceleration, 9.8]
    x[st.X_PT] = T
    x[st.X_PATH : st.X_PATH + 3] = [0.0, 0.5 * force * T**2 + jerk * T**3 / 6.0, 0.0]
    P = np.eye(st.BASIC) * 1e-18
    turned = off * np.cross([0.0, 0.0, 1.0], x[X_V : X_V + 3])
    P[3:6, 3:6] += np.outer(turned, turned)
    P[3:6, 8] = P[8, 3:6] = -off * turned
    P[8, 8] = off**2
    out = np.zeros(12)
    MEASUREMENTS["non_holonomic"].kernel(
        x.copy(), P, np.zeros(st.P_SIZE), np.array([0.0, T, 1e-4, 0.0]), np.inf, out
    )
    # what a linear model of a turned velocity leaves out is allowed for, and nothing else
    speed = np.linalg.norm(x[st.X_PATH : st.X_PATH + 3]) / T
    expected = np.hypot(1e-4, 0.5 * speed * off**2)
    np.testing.assert_allclose(out[6:8], expected, rtol=1e-3)
