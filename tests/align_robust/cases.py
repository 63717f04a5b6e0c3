"""Which fault can meet which alignment, on which scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from tests.align_robust import scenes
from tests.align_robust.faults import FAULTS
from tests.align_robust.scenes import Scene

SENSORS = ("gyro_outlier", "accel_outlier", "accel_held", "accel_dead", "gyro_held", "gyro_dead")
AT_REST = (*SENSORS, "turned", "shoved", "latitude")
WHEELS = ("slip_1s", "slip_20s", "odometer_outlier")
FIXES = ("fix_outlier", "velocity_outlier", "fix_jump", "fix_drag")

SCENES: dict[str, Callable[[int], Scene]] = {
    "standing": scenes.standing,
    "swaying": scenes.swaying,
    "rolling": scenes.rolling,
    "tracked": scenes.tracked,
    "consumer": scenes.consumer,
}
INERTIAL = ("inertial_single", "inertial", "inertial_wahba")
STANDING = (
    "static",
    "analytic",
    "open_loop",
    "kalman_closed",
    "kalman_open",
    "kalman_psi",
    "gyrocompass",
    "rapid_gyrocompass",
    *INERTIAL,
    "large_angle",
    "stored",
)
TRIED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "standing": (STANDING, AT_REST),
    "swaying": (INERTIAL, AT_REST),
    "rolling": (("odometer", "moving_gyrocompass"), (*SENSORS, *WHEELS, "latitude")),
    "tracked": (("gnss",), (*SENSORS, *FIXES)),
    "consumer": (("motion",), (*SENSORS, *FIXES)),
}

WORDS: dict[str, str] = {
    "gyro_outlier": "gyro|turned|turns",
    "accel_outlier": "accelerometer|pushed|moves",
    "turned": "turned|turns|tilts|moves|moved|gyro",
    "shoved": "pushed|moves|moved|accelerometer",
    "latitude": "latitude",
    "accel_held": "accelerometer is stuck",
    "accel_dead": "accelerometer is stuck",
    "gyro_held": "gyro is stuck",
    "gyro_dead": "gyro is stuck",
    "slip_1s": "wheel|odometer",
    "slip_20s": "wheel|odometer",
    "odometer_outlier": "wheel|odometer",
    "fix_outlier": "GNSS",
    "velocity_outlier": "GNSS",
    "fix_jump": "GNSS",
    "fix_drag": "GNSS",
}
"""What one of the refusals must say."""


class Case(NamedTuple):
    """A method on a scene, and what happens to it."""

    method: str
    scene: str
    fault: str

    def scenes(self, seed: int, part: slice = slice(None)) -> Iterator[tuple[float, Scene]]:
        """Sizes of the fault, all or a ``part``, and what each makes of the scene."""
        fault, sizes = FAULTS[self.fault]
        for k, size in list(enumerate(sizes))[part]:
            yield size, fault(SCENES[self.scene](seed), size, np.random.default_rng([seed, k]))


def cases() -> list[Case]:
    """All of them."""
    return [
        Case(method, scene, fault)
        for scene, (methods, faults) in TRIED.items()
        for method in methods
        for fault in faults
    ]
