"""A latitude that is off: what is allowed for it, and what is said of it."""

import math

import numpy as np
import pytest

from nav.align import constant, latitude
from nav.align.apparent import C_i0g, gravity_integrals
from nav.align.types import AlignConfig
from nav.earth import gravity_g
from nav.rotation import dcm_from_quat, quat_from_dcm, quat_from_rotvec, rotvec_from_quat

LAT = math.radians(48.0)
SECONDS = 300.0
TURN = quat_from_rotvec([0.3, -0.2, 1.0])
CONFIG = AlignConfig(gyro_bias=1e-9, accel_bias=1e-6, angle_random_walk=0.0, velocity_random_walk=0.0)


def found(off_deg, noise=1e-5):
    """What gravity's directions over five minutes, to ``noise`` m/s^2, give with a latitude off by that."""
    e = constant.begin(CONFIG, 1e-6, 1e-6, np.full(3, 1e-9))
    C_b0i0 = dcm_from_quat(TURN)
    true = LAT + math.radians(off_deg)
    for t in np.arange(0.0, SECONDS + 1.0, 2.0):
        felt = C_b0i0 @ C_i0g(true, true, 0.0, t) @ gravity_g(true, 0.0)
        said = C_i0g(LAT, LAT, 0.0, t) @ gravity_g(LAT, 0.0)
        e = constant.update(e, constant.design(said), felt, noise**2 * np.eye(3))
    once, _ = gravity_integrals(LAT, 0.0, SECONDS)
    return latitude.solve(e, LAT, C_i0g(LAT, LAT, 0.0, SECONDS), once)


@pytest.mark.parametrize("off_deg", [-0.4, 0.0, 0.2])
def test_it_is_seen_in_how_gravity_turns(off_deg):
    _, seen = found(off_deg)
    assert math.degrees(seen.sigma) < 0.05
    # true gravity without noise: what is left is of second order, and what the priors hold back
    assert math.degrees(seen.off) == pytest.approx(off_deg, abs=0.02)
    said = latitude.contradiction(seen, "the odometer slips")
    assert (said is not None) == (abs(off_deg) > 0.33 + 0.02)
    if said is not None:
        assert all(word in said for word in ("south", "latitude", "a gyro", "the odometer slips"))


@pytest.mark.parametrize("off_deg", [-0.4, -0.1, 0.0, 0.2])
@pytest.mark.parametrize("noise", [1e-5, 1e-4])
def test_the_attitude_of_now_is_as_good_as_it_says_all_the_same(off_deg, noise):
    solved, _ = found(off_deg, noise)
    true = LAT + math.radians(off_deg)
    C_bg = dcm_from_quat(TURN) @ C_i0g(true, true, 0.0, SECONDS)
    phi = rotvec_from_quat(quat_from_dcm(C_bg @ (solved.C @ C_i0g(LAT, LAT, 0.0, SECONDS)).T))
    # the data have no noise, so latitude is all that this is off by
    assert phi @ np.linalg.solve(solved.P[:3, :3], phi) < 1.0
