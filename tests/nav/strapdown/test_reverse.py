"""Backwards through the same kernels: what went forward comes back to where it began."""

import numpy as np
import pytest

from nav import rotation as rot
from nav.strapdown.azimuth import AZIMUTH_LAWS, azimuth_control
from nav.strapdown.control import control
from nav.strapdown.kernels import M_SIZE, X_A_H, X_HEAD, X_Q, X_V, increments, integrate, strapdown
from nav.strapdown.mechanize import frame_rates
from nav.strapdown.reverse import integrate_back, invert
from tests.nav.strapdown.making import ROAD, earth_fixed, head_of, increments_of, ride

HZ = 100
NOTHING = np.zeros((0, X_HEAD))


@pytest.fixture(scope="module")
def road():
    trajectory = ride(ROAD, 0.84, 0.2, 0.7, lean=4.0)
    assert trajectory.profile.distance(np.array([trajectory.profile.end_ns]))[0] > 2900.0
    return head_of(trajectory.state(0)), increments_of(trajectory, HZ)


@pytest.mark.parametrize("law", AZIMUTH_LAWS)
@pytest.mark.parametrize("n", range(1, 7))
def test_forward_and_back_is_where_it_began(road, n, law):
    """1 mm in 3 km is the promise; what there is, is rounding of the position matrix over 40 000 updates."""
    start, samples = road
    u = azimuth_control(law, 1e-3 if AZIMUTH_LAWS[law].turns else 0.0)
    x = start.copy()
    integrate(x, samples, 1.0 / HZ, n, u, 1, NOTHING)
    assert np.linalg.norm(earth_fixed(x)[0] - earth_fixed(start)[0]) > 1000.0
    integrate_back(x, samples, 1.0 / HZ, n, u, 1, NOTHING)
    (r, v, C), (r0, v0, C0) = earth_fixed(x), earth_fixed(start)
    assert np.linalg.norm(r - r0) < 1e-3 * 0.1
    assert np.linalg.norm(v - v0) < 1e-7
    assert np.abs(C - C0).max() < 1e-11


def test_a_turned_frame_comes_back_too(road):
    start, samples = road
    u = control(w_c=(2e-4, -1e-4, 3e-4), turn=1e-4)
    x = start.copy()
    integrate(x, samples, 1.0 / HZ, 2, u, 1, NOTHING)
    integrate_back(x, samples, 1.0 / HZ, 2, u, 1, NOTHING)
    # w_c tilts n, and v runs away to hundreds of m/s: so does what is left
    assert np.abs(x[X_Q : X_Q + 4] - start[X_Q : X_Q + 4]).max() < 1e-8
    assert np.abs(x[X_V : X_V + 3] - start[X_V : X_V + 3]).max() < 1e-3


@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_discrete_inverse_of_the_attitude_is_exact(n):
    """C(k-1) = exp(w_in T x) C(k) exp(-dtheta x), Yan Gongmin 2008, section 2.2, with rates that stay."""
    rng = np.random.default_rng(n)
    pole = np.array([0.0, 0.6, 0.8])
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = rot.quat_from_rotvec(rng.normal(size=3))
    # C_en with this polar axis
    C_en = np.array([[0.0, -0.8, 0.6], [1.0, 0.0, 0.0], pole])
    u, mid, inc, dt = control(), np.zeros(M_SIZE), np.zeros(6), 0.02
    x[7:16] = C_en.ravel()
    f = frame_rates(pole, 0.0, np.zeros(3))
    steps = rng.normal(size=(50, n, 3)) * 0.05
    path = []
    for step in steps:
        path.append(x[:4].copy())
        # the force that keeps velocity, so that n keeps its rate
        C_nb = rot.dcm_from_quat(x[:4])
        increments(np.concatenate([step.ravel(), np.zeros(3 * n)]), n, inc)
        inc[3:] = C_nb.T @ (-f.gravity_n * dt)
        strapdown(x, inc, dt, u, mid)
        x[4:7], x[7:16], x[16] = 0.0, C_en.ravel(), 0.0
    for step, expected in zip(steps[::-1], path[::-1], strict=True):
        increments(np.concatenate([step.ravel(), np.zeros(3 * n)]), n, inc)
        C_nb = rot.dcm_from_quat(expected)
        inc[3:] = C_nb.T @ (-f.gravity_n * dt)
        invert(inc)
        strapdown(x, inc, -dt, u, mid)
        x[4:7], x[7:16], x[16] = 0.0, C_en.ravel(), 0.0
        # rates of n are those in the middle, which a velocity of g dt^2 w changes by 1e-16 rad/s
        assert min(np.abs(x[:4] - expected).max(), np.abs(x[:4] + expected).max()) < 1e-14


def test_an_increment_undone_twice_is_itself():
    rng = np.random.default_rng(5)
    inc = rng.normal(size=6)
    back = inc.copy()
    invert(back)
    np.testing.assert_array_equal(back[:3], -inc[:3])
    # seen in the axes at the end, the velocity gained is lost again
    np.testing.assert_allclose(-rot.quat_rotate(rot.quat_from_rotvec(inc[:3]), back[3:]), inc[3:], atol=1e-14)
    invert(back)
    np.testing.assert_allclose(back, inc, atol=1e-14)


def test_rows_come_in_the_order_of_the_way_back(road):
    start, samples = road
    x, there, back = start.copy(), np.zeros((200, X_HEAD)), np.zeros((200, X_HEAD))
    integrate(x, samples[:401], 1.0 / HZ, 2, control(), 1, there)
    assert integrate_back(x, samples[:401], 1.0 / HZ, 2, control(), 1, back) == 200
    np.testing.assert_allclose(back[:-1], there[-2::-1], atol=1e-9)
    np.testing.assert_allclose(back[-1], start, atol=1e-9)
    assert back[-1, X_A_H] == 0.0


@pytest.mark.parametrize("gains", [{"velocity_gains": (0.1, 0.0)}, {"height_gains": (0.1, 0.01, 0.0)}])
def test_a_damped_channel_is_refused(road, gains):
    start, samples = road
    with pytest.raises(ValueError, match="does not run backwards"):
        integrate_back(start.copy(), samples, 1.0 / HZ, 2, control(**gains), 1, NOTHING)
