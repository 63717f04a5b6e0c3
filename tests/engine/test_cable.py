"""The cable of the IMU is pulled while the vehicle drives."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from bridge.engine import Engine
from bridge.frame import RawFrame
from bridge.outputs import ModeChange
from bridge.studies.headless import configuration, fly
from nav.types import Mode
from virtual_bus import scenario
from virtual_bus.bus import Bench
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


def test_a_silent_imu_is_said_while_it_is_silent() -> None:
    """Nobody may look at a mode of NAVIGATE while nothing is integrated any more."""
    drive = scenario.load("drive")
    pulled = Drop(device="imu", start_s=90.0, duration_s=20.0)
    bench = Bench(msgspec.structs.replace(drive, fault=[pulled]), seed=1, seconds=100.0)
    config = configuration(bench)
    engine = Engine(config)
    changes = [
        output
        for seq, frame in enumerate(bench.due(bench.end_ns))
        for output in engine.feed(RawFrame(seq, frame.t_ns, 1, frame.frame_id, frame.data))
        if isinstance(output, ModeChange)
    ]
    assert changes[-1].new is Mode.DEGRADED
    assert "no inertial data" in changes[-1].reason
    limit_s = config.navigators["main"].gap_limit_s
    # counted from the last sample, which is an interval before the cable; noticed by the next wheel sample
    assert 89.99 + limit_s < changes[-1].t_ns * 1e-9 < 90.5 + limit_s
