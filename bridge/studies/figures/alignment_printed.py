"""What the printed methods do where they fail: small studies, of no use to a navigator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from bridge.studies.alignment_runs import Scene
from bridge.studies.alignment_truth import HEIGHT, LAT, Vector, misalignment
from nav.align.apparent import A_P, A_T, C_i0g, add, attitude, gravity_integrals, tracker
from nav.align.large_bank import SIZE, Noise, mean, start, step
from nav.filter.ukf import symmetric_points
from nav.rotation import quat_from_dcm
from nav.types import ImuSample, Sample

TILT: Final = math.radians(30.0)


def double_integration(samples: Sequence[Sample], seconds: float) -> Vector:
    """q_gb (4,) by integrating twice from rest, between two instants: Yan Gongmin 2008, eqs. (3-37), (3-22).

    What the IMU, off the centre of the sway, moves at when it begins is taken for zero.
    """
    track = tracker(0)
    rows = []
    for s in samples:
        if not isinstance(s, ImuSample):
            continue
        add(*track, s.dtheta, s.dv, s.dt, s.t_ns, False)
        if abs(s.t_ns * 1e-9 - 0.5 * seconds) < 1e-6 or abs(s.t_ns * 1e-9 - seconds) < 1e-6:
            rows.append(track.row.copy())
    half, m = rows
    u_l, u_m = (gravity_integrals(LAT, HEIGHT, float(r[A_T]))[1] for r in rows)
    C = _frame(m[A_P : A_P + 3], half[A_P : A_P + 3]) @ _frame(u_m, u_l).T
    return quat_from_dcm(C_i0g(LAT, LAT, 0.0, seconds).T @ C.T @ attitude(m))


def _frame(m: Vector, other: Vector) -> Vector:
    a = m / np.linalg.norm(m)
    b = np.cross(a, other) / np.linalg.norm(np.cross(a, other))
    return np.stack([a, b, np.cross(a, b)], axis=1)


def one_filter(scene: Scene, seconds: int) -> float:
    """Error of heading (rad) of one unscented filter for the whole circle, in blocks of a second at rest.

    Yan Gongmin 2008, section 4.5: from a level that is off by 30 deg, with an azimuth that may be anything.
    """
    config, dt = scene.config, next(s.dt for s in scene.samples if isinstance(s, ImuSample))
    inertial = [s for s in scene.samples if isinstance(s, ImuSample)][: round((seconds + 1) / dt)]
    turn = np.sum(np.reshape([s.dtheta for s in inertial], (seconds + 1, -1, 3)), axis=1)
    dv = np.sum(np.reshape([s.dv for s in inertial], (seconds + 1, -1, 3)), axis=1)
    noise = Noise(config.gyro_bias, config.angle_random_walk, config.velocity_random_walk, config.sway)
    assert config.position is not None
    bank = start(config.position, np.eye(3), TILT, noise, symmetric_points(SIZE), 1)
    for k in range(1, seconds + 1):
        bank, _, _ = step(bank, turn[k], dv[k], 1.0)
    return float(misalignment(scene.C_gb(round(seconds * 1e9)), quat_from_dcm(mean(bank).C))[2])
