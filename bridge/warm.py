"""Compile every kernel of the navigators before a bus is opened: none may pause the loop later."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np

from bridge.digest import canonical_row
from nav.align import AlignConfig, NavInit
from nav.align.types import TransferConfig
from nav.navigator import ImuErrors, Navigator, NavigatorConfig
from nav.transfer import methods
from nav.types import (
    BaroSample,
    FixType,
    GnssFix,
    ImuSample,
    MasterState,
    Mode,
    OdoSample,
    S,
    Sample,
    Solution,
    SpeedSample,
)

_DT_NS: Final = 5_000_000
_LAT: Final = 0.8
_RADIUS: Final = 6.37e6


@cache
def warm_up(alignments: frozenset[str] = frozenset(methods())) -> None:
    """Drive throw-away navigators through everything that a real one may do, a few seconds each.

    ``alignments`` are the names of those that can come to pass.
    """
    for name in sorted(alignments):
        # found mounting and scale states are other paths through the same kernels
        for C_vb, scale in ((np.eye(3), 0.0), (None, 1e-4)):
            navigator = Navigator(_config(name, C_vb, scale))
            navigator.start(0)
            for sample in _journey():
                navigator.step(sample)
    navigator = Navigator(_config("motion", np.eye(3), 1e-4))
    navigator.begin(_start())
    for sample in _journey():
        navigator.step(sample)
    canonical_row(Solution(0, Mode.STANDBY, 0, np.zeros(S.SIZE)))


def _config(alignment: str, C_vb: np.ndarray | None, scale: float) -> NavigatorConfig:
    imu = ImuErrors(1e-5, 1e-3, 1e-6, 1e-2, 1e-7, 1e-3, gyro_scale=scale, accel_scale=scale)
    return NavigatorConfig(
        imu=imu,
        alignment=alignment,
        C_vb=C_vb,
        odometer=True,
        non_holonomic=0.1,
        zero_rate=1e-3,
        replay_updates=1,
        align=AlignConfig(
            gyro_bias=imu.gyro_bias,
            accel_bias=imu.accel_bias,
            angle_random_walk=imu.angle_random_walk,
            velocity_random_walk=imu.velocity_random_walk,
            coarse_s=0.5,
            fine_s=0.5,
            C_vb=C_vb,
            rest_s=0.5,
            transfer=TransferConfig(flexure=np.full(3, 1e-3), duration=1.0, sigma=np.full(3, 1.0)),
        ),
    )


def _start() -> NavInit:
    three = np.ones(3)
    return NavInit(
        t_ns=0,
        lat=_LAT,
        lon=0.0,
        height=0.0,
        v_g=np.zeros(3),
        q_gb=np.array([1.0, 0.0, 0.0, 0.0]),
        P_phi=np.eye(3) * 1e-4,
        sigma_v=three,
        sigma_p=three,
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        sigma_gyro_bias=three * 1e-6,
        sigma_accel_bias=three * 1e-2,
    )


def _journey() -> list[Sample]:
    """Three seconds at rest, then northward at a growing speed, every aid on the way, some of it late."""
    samples: list[Sample] = []
    north = speed = 0.0
    rate = 7.292115e-5 * np.array([0.0, math.cos(_LAT), math.sin(_LAT)])
    dt = _DT_NS * 1e-9
    for k in range(1, 1601):
        t_ns = k * _DT_NS
        force = 1.0 if k > 600 else 0.0
        speed += force * dt
        north += speed * dt
        dv = np.array([0.0, force, 9.81]) * dt
        samples.append(ImuSample(t_ns, dt, rate * dt, dv, "imu"))
        if k % 4 == 0:
            samples.append(OdoSample(t_ns, 4 * dt, speed * 4 * dt, k <= 600, "odometer"))
        if k % 20 == 0:
            samples.append(SpeedSample(t_ns, speed, 0.1, "speed"))
            samples.append(BaroSample(t_ns, 0.0, 1.0, "baro"))
        lat, v_g, sigma = _LAT + north / _RADIUS, np.array([0.0, speed, 0.0]), np.ones(3)
        if k % 10 == 0:
            level, f = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, force, 9.81])
            own = (sigma, 0.1 * sigma, 1e-3 * sigma)
            samples.append(MasterState(t_ns, lat, 0.0, 0.0, v_g, level, rate, f, *own, True, "master"))
        if k % 40 == 0:
            late_ns = t_ns - (k % 3) * 10 * _DT_NS
            samples.append(GnssFix(late_ns, lat, 0.0, 0.0, sigma, v_g, 0.1 * sigma, FixType.FIX_3D, "gnss"))
    return samples
