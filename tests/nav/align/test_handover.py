"""What an alignment hands over of the place of an IMU under an antenna."""

import dataclasses
import math

import numpy as np

from nav.align.handover import imu_place, under_antenna
from nav.rotation import dcm_from_euler, skew
from tests.nav.align import making
from tests.nav.align.making import HEIGHT, LAT, LON, QUICK, standing

ARM = np.array([0.5, -2.0, 1.1])


def metres(a, b):
    """From place ``b`` to place ``a`` (m east, north, up), over a few metres."""
    radius = 6.378e6
    east = radius * math.cos(LAT) * (a[1] - b[1])
    return np.array([east, radius * (a[0] - b[0]), a[2] - b[2]])


def test_a_wrong_attitude_displaces_the_imu_as_its_covariance_says():
    C, antenna, small = dcm_from_euler(0.7, 0.1, -0.2), (LAT, LON, HEIGHT), 1e-4
    truth = imu_place(antenna, C @ ARM)
    # what one radian about east, north, up does to true minus computed place
    wrong = [imu_place(antenna, (np.eye(3) - skew(phi)) @ C @ ARM) for phi in small * np.eye(3)]
    J = np.stack([metres(truth, place) / small for place in wrong], axis=1)
    P = np.diag(np.arange(1.0, 16.0))
    P[6, 12] = P[12, 6] = 0.5  # level and accelerometer
    found = under_antenna(P, C @ ARM)
    # a sphere of the equator's radius is off by up to 0.7 %
    np.testing.assert_allclose(found[0:3, 6:9], J @ P[6:9, 6:9], atol=0.007 * 9.0 * np.linalg.norm(ARM))
    np.testing.assert_allclose(found[0:3, 12], J @ P[6:9, 12], atol=0.007 * np.linalg.norm(ARM))
    np.testing.assert_allclose(
        found[0:3, 0:3], P[0:3, 0:3] + J @ P[6:9, 6:9] @ J.T, atol=0.02 * 9.0 * float(ARM @ ARM)
    )
    np.testing.assert_array_equal(found[3:, 3:], P[3:, 3:])


def test_alignments_at_rest_hand_it_over():
    config = dataclasses.replace(QUICK, gnss_lever_arm=ARM, position=None)
    C_gb, _, _, samples = standing(3, config, 62.0)
    samples = [making.fix(0.5), *samples]
    C = C_gb @ ARM
    for method in ("static", "analytic", "kalman_open", "open_loop"):
        init = making.align(method, samples, config).init
        # heading is known worst: it displaces the IMU across the lever arm
        across = np.array([C[1], -C[0], 0.0]) * init.P[8, 8]
        np.testing.assert_allclose(init.P[0:3, 8], across, atol=0.02 * np.linalg.norm(across))
        np.testing.assert_allclose(init.sigma_p**2, np.diag(init.P)[0:3])
