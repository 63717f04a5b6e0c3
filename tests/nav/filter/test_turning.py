"""The rate of turning at an instant, of means over updates: what carries an antenna on a mast."""

import numpy as np
import pytest

from nav import earth
from nav import rotation as rot
from nav.filter import states as st
from nav.filter.motion import attitude_ago, eb_rate, take_rate
from nav.strapdown.kernels import X_C, X_Q

H = 0.01
SIZE, OMEGA = np.array([0.1, -0.05, 0.02]), 2.0 * np.pi * 1.1


def still():
    x = np.zeros(st.X_SIZE)
    x[X_Q] = 1.0
    x[X_C : X_C + 9] = np.eye(3).ravel()
    return x


def roll(x, updates, h=H):
    """Means over updates of a base that sways by SIZE, from zero on; the time of the last one's end."""
    for k in range(updates):
        a, b = k * h, (k + 1) * h
        mean = SIZE * (np.sin(OMEGA * b) - np.sin(OMEGA * a)) / h
        take_rate(x, *mean, h, True)
    return updates * h


def found(x, tau):
    """w_ib_b by the kernel (3,): at the pole of its frame the Earth turns about the third axis."""
    x_rate, y_rate, z_rate = eb_rate(x, tau)
    return np.array([x_rate, y_rate, z_rate + earth.EARTH_RATE])


@pytest.mark.parametrize("updates", [2, 14, 45, 90])
@pytest.mark.parametrize("tau", [0.0, 0.004, 0.0099])
def test_a_sway_has_its_rate_of_that_instant(updates, tau):
    """A straight line through two means leaves out h^2 / 3 of the second derivative at the end, and no more
    within the update; the mean alone would be off by h / 2 of the first, fifteen times as much."""
    x = still()
    t = roll(x, updates)
    expected = SIZE * OMEGA * np.cos(OMEGA * (t - tau))
    left_out = np.abs(SIZE) * OMEGA**3 * H**2 / 3.0
    assert np.all(np.abs(found(x, tau) - expected) < 1.1 * left_out)


def test_where_a_sway_was_a_moment_ago():
    """Attitude and rate of one instant: an antenna that swings has no mean velocity upwards. With the rate of
    an instant and the attitude of ``tau`` later it has minus tau times the mean squared rate, per metre."""
    tau, lever = 0.006, np.array([0.0, 0.0, 1.0])
    size, up, late = 0.1, [], []
    for k in range(91):
        a, b = (k - 1) * H, k * H
        x = still()
        for first, last in ((a - H, a), (a, b)):
            mean = size * (np.sin(OMEGA * last) - np.sin(OMEGA * first)) / H
            take_rate(x, 0.0, mean, earth.EARTH_RATE, H, True)
        x[X_Q : X_Q + 4] = rot.quat_from_rotvec([0.0, size * np.sin(OMEGA * b), 0.0])
        u = np.cross(eb_rate(x, tau), lever)
        up.append(rot.quat_rotate(np.array(attitude_ago(x, tau)), u)[2])
        late.append(rot.quat_rotate(x[X_Q : X_Q + 4], u)[2])
        np.testing.assert_allclose(
            rot.rotvec_from_quat(np.array(attitude_ago(x, tau)))[1],
            size * np.sin(OMEGA * (b - tau)),
            atol=2e-6,
        )
    swept = 0.5 * (size * OMEGA) ** 2  # mean squared rate, of one period of 91 updates
    assert abs(np.mean(up)) < 0.01 * tau * swept
    assert abs(np.mean(late) + tau * swept) < 0.05 * tau * swept


def test_the_first_update_has_nothing_to_compare_with():
    x = still()
    t = roll(x, 1)
    np.testing.assert_allclose(found(x, 0.0), SIZE * np.sin(OMEGA * t) / H, rtol=1e-12)


def test_a_silence_says_nothing_of_how_the_rate_changes():
    x = still()
    roll(x, 9)
    take_rate(x, 0.0, 0.0, earth.EARTH_RATE, H, False)
    np.testing.assert_array_equal(eb_rate(x, 0.003), 0.0)
    take_rate(x, *SIZE, H, True)
    np.testing.assert_allclose(found(x, 0.0), SIZE, rtol=1e-12)
