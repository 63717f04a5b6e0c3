"""Dead reckoning against a drive's truth, its error theory, and itself backwards."""

import numpy as np
import pytest

from nav import rotation as rot
from nav.strapdown.azimuth import azimuth_control
from nav.strapdown.dead_reckoning import ahead, dead_reckon, dead_reckon_back
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_Q, X_V
from tests.nav.strapdown.making import ROAD, earth_fixed, geographic, head_of, increments_of, ride

HZ = 100
NOTHING = np.zeros((0, X_HEAD))
WANDER = azimuth_control("wander")
C_VB = rot.dcm_from_euler(*np.radians([10.0, 2.0, -3.0]))


@pytest.fixture(scope="module")
def road():
    """Start, end, samples and the way rolled of 3 km that begin and end at rest; the IMU sits askew."""
    trajectory = ride(ROAD, 0.84, 0.2, 0.7, lean=4.0, mounting=(2.0, -3.0, 10.0))
    t = np.arange(0, trajectory.profile.end_ns + 1, 10**9 // HZ)
    rolled = trajectory.profile.distance(t)
    samples = np.column_stack([increments_of(trajectory, HZ)[:, :3], np.diff(rolled)])
    return head_of(trajectory.state(0)), head_of(trajectory.state(trajectory.profile.end_ns)), samples


def reckoned(road, n=2, samples=None, axis=None, u=WANDER, out=NOTHING):
    x = road[0].copy()
    axis = ahead(C_VB) if axis is None else axis
    dead_reckon(x, road[2] if samples is None else samples, 1.0 / HZ, n, axis, u, 1, out)
    return x


def displaced(road, x, end=None):
    """Position of ``x`` against the end (or the start) of the drive, m east, north, up at the start."""
    C_en = road[0][X_C : X_C + 9].reshape(3, 3)
    return C_en.T @ (earth_fixed(x)[0] - earth_fixed(road[1] if end is None else end)[0])


@pytest.mark.parametrize("n", [1, 2, 4])
def test_a_drive_ends_where_it_ends(road, n):
    x = reckoned(road, n)
    # one sample an update knows nothing of the turn of its axis: 1e-6 rad is left of the curves on a slope
    assert np.linalg.norm(displaced(road, x)) < (5e-3 if n == 1 else 1e-4)
    assert np.abs(geographic(x)[3:6]).max() < 1e-6
    assert np.abs(earth_fixed(x)[2] - earth_fixed(road[1])[2]).max() < (3e-6 if n == 1 else 1e-7)


@pytest.mark.parametrize("law", ["north", "free", "rotating"])
def test_azimuth_laws_agree(road, law):
    u = azimuth_control(law, 1e-3 if law == "rotating" else 0.0)
    a, b = earth_fixed(reckoned(road, u=u)), earth_fixed(reckoned(road))
    # mean rates over 20 ms of a frame that turns by 2e-5 in them
    assert np.abs(a[0] - b[0]).max() < 1e-5
    assert np.abs(a[2] - b[2]).max() < 1e-9


def test_velocity_and_height_follow(road):
    out = np.zeros((len(road[2]) // 2, X_HEAD))
    reckoned(road, out=out)
    speed = np.linalg.norm(out[:, X_V : X_V + 3], axis=1)
    measured = road[2][:, 3].reshape(-1, 2).sum(axis=1) * HZ / 2
    np.testing.assert_allclose(speed, measured, atol=1e-4)
    climbed = out[-1, X_H] - road[0][X_H]
    assert climbed == pytest.approx(road[1][X_H] - road[0][X_H], abs=1e-3)
    assert climbed > 20.0


def test_errors_are_those_of_the_theory(road):
    """A thousandth of scale, a milliradian of mounting: 0.1 % of the displacement along, across, and up."""
    start, _, samples = road
    way = samples[:, 3].sum()
    straight = displaced(road, road[1], start)
    clean = reckoned(road)

    def error(**wrong):
        turn = rot.dcm_from_euler(wrong.get("heading", 0.0), wrong.get("pitch", 0.0), 0.0)
        axis = ahead(turn @ C_VB, wrong.get("scale", 0.0))
        return displaced(road, reckoned(road, axis=axis), clean)

    np.testing.assert_allclose(error(scale=1e-3), 1e-3 * straight, atol=2e-6 * way)
    # C_vb nose to the right: the vehicle's forward axis lies to the left of b's, the path turns left
    level = error(heading=1e-3)
    np.testing.assert_allclose(level[:2], 1e-3 * np.array([-straight[1], straight[0]]), atol=2e-5 * way)
    raised = error(pitch=1e-3)
    assert raised[2] == pytest.approx(-1e-3 * way, rel=1e-3)
    # a heading error of the attitude turns the whole path
    x = start.copy()
    turned = rot.quat_multiply(rot.quat_from_rotvec([0.0, 0.0, -1e-3]), start[X_Q : X_Q + 4])
    x[X_Q : X_Q + 4] = turned
    dead_reckon(x, samples, 1.0 / HZ, 2, ahead(C_VB), WANDER, 1, NOTHING)
    np.testing.assert_allclose(
        displaced(road, x, clean)[:2], 1e-3 * np.array([straight[1], -straight[0]]), atol=2e-5 * way
    )


def test_a_scale_that_is_known_is_taken_out(road):
    samples = road[2].copy()
    samples[:, 3] /= 1.02
    axis = ahead(C_VB, 0.02)
    np.testing.assert_allclose(
        displaced(road, reckoned(road, samples=samples, axis=axis), reckoned(road)), 0.0, atol=1e-6
    )


@pytest.mark.parametrize("n", range(1, 7))
def test_back_is_where_it_began(road, n):
    """1 mm in 3 km is asked; rounding of the position matrix over ten thousand updates is left."""
    x, axis = reckoned(road, n), ahead(C_VB, 0.01)
    x = road[0].copy()
    whole = road[2][: len(road[2]) // n * n]
    dead_reckon(x, whole, 1.0 / HZ, n, axis, WANDER, 1, NOTHING)
    assert np.linalg.norm(displaced(road, x, road[0])) > 1000.0
    dead_reckon_back(x, whole, 1.0 / HZ, n, axis, WANDER, 1, NOTHING)
    assert np.linalg.norm(displaced(road, x, road[0])) < 1e-5
    assert np.abs(earth_fixed(x)[2] - earth_fixed(road[0])[2]).max() < 1e-12


def test_attitude_is_tracked_there_and_back(road):
    """Without a way it is attitude tracking: Earth rate is taken out, and backwards is the exact inverse."""
    still = road[2].copy()
    still[:, 3] = 0.0
    x = reckoned(road, samples=still)
    np.testing.assert_allclose(x[X_C : X_C + 9], road[0][X_C : X_C + 9], atol=1e-14)
    dead_reckon_back(x, still, 1.0 / HZ, 2, ahead(C_VB), WANDER, 1, NOTHING)
    assert np.abs(x[X_Q : X_Q + 4] - road[0][X_Q : X_Q + 4]).max() < 1e-12
