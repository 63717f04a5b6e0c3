"""The cable of the IMU is pulled while the vehicle drives."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from bridge.studies.headless import fly
from virtual_bus import scenario
from virtual_bus.faults import Drop


@pytest.mark.parametrize("pulled_s", [0.5, 8.0])
def test_navigation_comes_back_and_knows_how_well(pulled_s: float) -> None:
    """After a long silence nobody knows where the vehicle turned to: it must be aligned on its way."""
    drive = scenario.load("drive")
    pulled = Drop(device="imu", start_s=90.0, duration_s=pulled_s)
    drive = msgspec.structs.replace(drive, fault=[*drive.fault, pulled])
    flown = fly(drive, 1, 200.0, (150.0, 170.0, 190.0))
    # navigating again within a minute, and from then on without a break
    np.testing.assert_allclose(flown.t_s, (150.0, 170.0, 190.0), atol=0.1)
    for error, covariance in zip(flown.error, flown.covariance, strict=True):
        for part in (slice(0, 3), slice(3, 6), slice(6, 9)):
            nees = error[part] @ np.linalg.solve(covariance[part, part], error[part])
            assert nees < 21.1  # 99.99 % of chi-square with 3: six of them are looked at
