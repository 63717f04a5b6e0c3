"""What goes wrong, and how badly: each fault makes of a scene and a size another scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nav.rotation import dcm_from_quat, quat_from_rotvec
from nav.types import GnssFix, ImuSample, OdoSample, Sample
from tests.align_robust.scenes import Scene

Fault = Callable[[Scene, float, np.random.Generator], Scene]
WHEN = (0.25, 0.9)  # of the time of an alignment


def _changed(scene: Scene, change: Callable[[Sample, float], Sample], C_gb=None) -> Scene:
    """``change`` of every sample and its time (s) since the beginning."""
    samples = [change(s, s.t_ns * 1e-9 - scene.begin) for s in scene.samples]
    return replace(scene, samples=samples, C_gb=C_gb or scene.C_gb)


def _moment(scene: Scene, rng: np.random.Generator) -> float:
    return scene.align * rng.uniform(*WHEN)


def _axis(rng: np.random.Generator) -> np.ndarray:
    return rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]


def _once(scene: Scene, rng, kind: type, change: Callable[[Sample], Sample]) -> Scene:
    """One sample of a kind."""
    at, done = _moment(scene, rng), False

    def apply(sample: Sample, t: float) -> Sample:
        nonlocal done
        if done or t < at or not isinstance(sample, kind):
            return sample
        done = True
        return change(sample)

    return _changed(scene, apply)


def gyro_outlier(scene: Scene, size: float, rng) -> Scene:
    """``size`` rad too much in one sample."""
    d = size * _axis(rng)
    return _once(scene, rng, ImuSample, lambda s: s._replace(dtheta=s.dtheta + d))


def accel_outlier(scene: Scene, size: float, rng) -> Scene:
    """``size`` m/s too much in one sample."""
    d = size * _axis(rng)
    return _once(scene, rng, ImuSample, lambda s: s._replace(dv=s.dv + d))


def _ramp(t: float) -> float:
    """From 0 to 1 in a second, smoothly."""
    x = min(1.0, max(0.0, t))
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def turned(scene: Scene, size: float, rng) -> Scene:
    """Within a second it is turned by ``size`` rad about an axis of the IMU, and stays so."""
    at, axis = _moment(scene, rng), size * _axis(rng)

    def R(t: float) -> np.ndarray:
        return dcm_from_quat(quat_from_rotvec(axis * _ramp(t - at)))

    def apply(s: Sample, t: float) -> Sample:
        if not isinstance(s, ImuSample) or t < at:
            return s
        back = R(t - 0.5 * s.dt).T
        turn = axis * (_ramp(t - at) - _ramp(t - s.dt - at))
        return s._replace(dtheta=back @ s.dtheta + turn, dv=back @ s.dv)

    return _changed(scene, apply, lambda t: scene.C_gb(t) @ R(t - scene.begin))


def shoved(scene: Scene, size: float, rng) -> Scene:
    """Within two seconds it is moved by ``size`` m along an axis of the IMU."""
    at, axis = _moment(scene, rng), size * _axis(rng)

    def speed(t: float) -> float:
        x = min(1.0, max(0.0, 0.5 * (t - at)))
        return 15.0 * x * x * (1.0 - x) ** 2

    def apply(s: Sample, t: float) -> Sample:
        if not isinstance(s, ImuSample):
            return s
        return s._replace(dv=s.dv + axis * (speed(t) - speed(t - s.dt)))

    return _changed(scene, apply)


def latitude(scene: Scene, size: float, rng) -> Scene:
    """The configured position is ``size`` deg off to the south or north."""
    assert scene.config.position is not None
    lat, lon, height = scene.config.position
    off = math.radians(size) * (-1.0 if lat + math.radians(size) > 1.5 else rng.choice([-1.0, 1.0]))
    return replace(scene, config=replace(scene.config, position=(lat + off, lon, height)))


def _stuck(which: str, held: bool) -> Fault:
    def fault(scene: Scene, size: float, rng) -> Scene:
        axis = rng.integers(3)
        at = size * scene.align
        value: float | None = None if held else 0.0

        def apply(s: Sample, t: float) -> Sample:
            nonlocal value
            if not isinstance(s, ImuSample) or t < at:
                return s
            now = getattr(s, which).copy()
            value = float(now[axis]) if value is None else value
            now[axis] = value
            return s._replace(**{which: now})

        return _changed(scene, apply)

    return fault


def slip(seconds: float) -> Fault:
    """Wheels that for ``seconds`` count ``size`` times the way: 0 is a skid."""

    def fault(scene: Scene, size: float, rng) -> Scene:
        at = _moment(scene, rng)

        def apply(s: Sample, t: float) -> Sample:
            if isinstance(s, OdoSample) and at < t <= at + seconds:
                return s._replace(distance=size * s.distance)
            return s

        return _changed(scene, apply)

    return fault


def odometer_outlier(scene: Scene, size: float, rng) -> Scene:
    """``size`` m too much in one sample."""
    return _once(scene, rng, OdoSample, lambda s: s._replace(distance=s.distance + size))


def _moved(fix: GnssFix, d: np.ndarray) -> GnssFix:
    r = 6.37e6
    return fix._replace(
        lat=fix.lat + d[1] / r, lon=fix.lon + d[0] / (r * math.cos(fix.lat)), height=fix.height + d[2]
    )


def fix_outlier(scene: Scene, size: float, rng) -> Scene:
    """One fix is ``size`` m off."""
    d = size * _axis(rng)
    return _once(scene, rng, GnssFix, lambda s: _moved(s, d))


def velocity_outlier(scene: Scene, size: float, rng) -> Scene:
    """The velocity of one fix is ``size`` m/s off."""
    d = size * _axis(rng)
    return _once(scene, rng, GnssFix, lambda s: s._replace(v_g=s.v_g + d))


def fix_jump(scene: Scene, size: float, rng) -> Scene:
    """From some time on, fixes are ``size`` m off."""
    at, d = _moment(scene, rng), size * _axis(rng)

    def apply(s: Sample, t: float) -> Sample:
        return _moved(s, d) if isinstance(s, GnssFix) and t > at else s

    return _changed(scene, apply)


def fix_drag(scene: Scene, size: float, rng) -> Scene:
    """For twenty seconds fixes drift off at ``size`` m/s, and come back at once; velocities say so too."""
    at, d = _moment(scene, rng), size * _axis(rng) * np.array([1.0, 1.0, 0.0])

    def apply(s: Sample, t: float) -> Sample:
        if not isinstance(s, GnssFix) or not at < t < at + 20.0:
            return s
        s = _moved(s, (t - at) * d)
        return s if s.v_g is None else s._replace(v_g=s.v_g + d)

    return _changed(scene, apply)


FAULTS: dict[str, tuple[Fault, tuple[float, ...]]] = {
    "gyro_outlier": (gyro_outlier, (1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.3)),
    "accel_outlier": (accel_outlier, (1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 30.0)),
    "turned": (turned, (1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.1)),
    "shoved": (shoved, (1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0)),
    "latitude": (latitude, (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)),
    "accel_held": (_stuck("dv", True), (0.0, 0.3, 0.7, 0.97)),
    "accel_dead": (_stuck("dv", False), (0.0, 0.3, 0.7, 0.97)),
    "gyro_held": (_stuck("dtheta", True), (0.0, 0.3, 0.7, 0.97)),
    "gyro_dead": (_stuck("dtheta", False), (0.0, 0.3, 0.7, 0.97)),
    "slip_1s": (slip(1.0), (0.0, 0.5, 0.9, 0.97, 1.03, 1.1, 1.5, 3.0)),
    "slip_20s": (slip(20.0), (0.0, 0.5, 0.9, 0.97, 0.99, 1.01, 1.03, 1.1, 1.5, 3.0)),
    "odometer_outlier": (odometer_outlier, (0.03, 0.1, 0.3, 1.0, 3.0, 100.0)),
    "fix_outlier": (fix_outlier, (1.0, 3.0, 10.0, 30.0, 100.0, 1e4)),
    "velocity_outlier": (velocity_outlier, (0.1, 0.3, 1.0, 3.0, 10.0, 100.0)),
    "fix_jump": (fix_jump, (1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)),
    "fix_drag": (fix_drag, (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)),
}
