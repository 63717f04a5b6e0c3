"""The vertical of a standstill that ends so gently that nobody sees when."""

import math

import numpy as np
import pytest

from nav.align.level import LEVEL, REST_SPEED
from nav.align.types import AlignConfig
from nav.earth import earth_rate_g, gravity_g
from nav.rotation import dcm_from_quat
from nav.types import FixType, GnssFix, ImuSample

LAT, HEIGHT, DT = 0.7, 100.0, 0.02
CREEP = 4.5  # s until the receiver shows that it drives
CONFIG = AlignConfig(
    gyro_bias=5e-7,
    accel_bias=2e-3,
    angle_random_walk=3e-6,
    velocity_random_walk=4e-4,
    C_vb=np.eye(3),
)


def speed(t, rest):
    """Northward, m/s: with the fourth power of the time since it set off."""
    return REST_SPEED * (np.maximum(t - rest, 0.0) / CREEP) ** 4


@pytest.mark.parametrize("rest", [4.0, 12.0, 45.0])
def test_a_creeping_start_does_not_tilt_the_vertical(rest):
    """Perfect sensors: all that is left is what it gained before the standstill's end, as a tilt.

    In half a second of the creep that is 0.03 mm/s; in the two and a half that a fixed two seconds before the
    last fix at rest would grant, 19 mm/s: 28 arcsec of a rest of 12 s.
    """
    state = LEVEL.init(CONFIG, None)
    g, w_ie = gravity_g(LAT, HEIGHT), earth_rate_g(LAT)
    for k in range(1, round((rest + 2.0 * CREEP) / DT)):
        t = k * DT
        dv = -g * DT + np.array([0.0, speed(t, rest) - speed(t - DT, rest), 0.0])
        state, status = LEVEL.step(state, ImuSample(round(t * 1e9), DT, w_ie * DT, dv, "imu"))
        if k % 10 == 0:
            v = np.array([0.0, speed(t, rest), 0.0])
            three = np.full(3, 0.03)
            fix = GnssFix(round(t * 1e9), LAT, 0.1, HEIGHT, three, v, three, FixType.FIX_3D, "gnss")
            state, status = LEVEL.step(state, fix)
        if status.done:
            break
    assert status.done
    C_hb = dcm_from_quat(LEVEL.finish(state).q_gb)
    tilt = math.hypot(C_hb[2, 0], C_hb[2, 1])
    claimed = CONFIG.velocity_random_walk / 9.8 / math.sqrt(rest)
    assert tilt < 0.1 * claimed
