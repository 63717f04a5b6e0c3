"""Truth of a vehicle on a road, from the simulated bench: increments, ticks and fixes."""

from __future__ import annotations

import math

import numpy as np

from nav.types import FixType, GnssFix, OdoSample
from virtual_bus.manoeuvres import Accelerate, Brake, Cruise, Profile, Static, STurns, Turn
from virtual_bus.truth import Trajectory, Vehicle

TICK = 0.08194  # m


def drive(manoeuvres, heading, lat, lon, height, imu=(0.0, 0.0, 0.0), C_vb=None):
    """A trajectory; ``imu`` m from the rear axle, in vehicle axes."""
    blends, speed = [], 0.0
    for m in manoeuvres:
        new = m.blends(speed)
        speed += sum(b.speed for b in new)
        blends += new
    vehicle = Vehicle(np.asarray(imu), np.eye(3) if C_vb is None else C_vb, 0.0, 0.0, None)
    return Trajectory(Profile(blends, heading), vehicle, lat, lon, height)


def road(kind, seconds, speed=5.0):
    """Twenty seconds to get going, then ``seconds`` of a nearly straight or of a winding road."""
    begin = [Static(duration_s=5.0), Accelerate(duration_s=10.0, speed_m_s=speed), Cruise(duration_s=5.0)]
    if kind == "straight":
        part = [STurns(duration_s=60.0, angle_deg=5.0, count=1), Cruise(duration_s=60.0)]
    else:
        part = [
            Turn(duration_s=12.0, angle_deg=90.0),
            Cruise(duration_s=30.0),
            STurns(duration_s=60.0, angle_deg=40.0, count=2),
            Turn(duration_s=12.0, angle_deg=-70.0),
            Cruise(duration_s=20.0),
            Accelerate(duration_s=6.0, speed_m_s=1.6 * speed),
            Turn(duration_s=15.0, angle_deg=120.0),
            Accelerate(duration_s=5.0, speed_m_s=speed),
        ]
    one = sum(m.duration_s for m in part)
    return begin + part * math.ceil((seconds + 5.0) / one)


def stops(speed=14.0, drive_s=150.0, stop_s=10.0):
    """Stop, drive, stop, drive, stop."""
    leg = [
        Accelerate(duration_s=15.0, speed_m_s=speed),
        Turn(duration_s=15.0, angle_deg=60.0),
        Cruise(duration_s=drive_s - 85.0),
        Turn(duration_s=15.0, angle_deg=-100.0),
        Cruise(duration_s=25.0),
        Brake(duration_s=15.0),
        Static(duration_s=stop_s),
    ]
    return [Static(duration_s=stop_s), *leg, *leg]


def times(start_s, seconds, step_s):
    """Nanoseconds (n + 1,) from ``start_s`` on."""
    step = round(step_s * 1e9)
    return round(start_s * 1e9) + step * np.arange(round(seconds / step_s) + 1)


def ticks(trajectory, t_ns, scale=1.0, tick=TICK):
    """Odometer samples between the times, in whole ticks."""
    rolled = trajectory.profile.distance(t_ns) * scale
    whole = np.floor(rolled / tick)
    dt = (t_ns[1] - t_ns[0]) * 1e-9
    distance = np.diff(whole) * tick
    return [OdoSample(int(t), dt, float(d), False, "odo") for t, d in zip(t_ns[1:], distance, strict=True)]


def fixes(trajectory, t_ns, rng, white, correlated, tau, velocity=None, antenna=None):
    """Fixes of the IMU's place, or of ``antenna`` (m, vehicle axes).

    White and lasting errors in m, of velocity in m/s, are level ones; height has twice as much.
    """
    motion = trajectory.motion(t_ns, antenna)
    n, dt = len(t_ns), (t_ns[1] - t_ns[0]) * 1e-9
    size = np.array([1.0, 1.0, 2.0])
    keep = math.exp(-dt / tau)
    slow = np.empty((n, 3))
    slow[0] = correlated * size * rng.standard_normal(3)
    for k in range(1, n):
        slow[k] = keep * slow[k - 1] + math.sqrt(1.0 - keep**2) * correlated * size * rng.standard_normal(3)
    error = slow + white * size * rng.standard_normal((n, 3))
    r = 6.37e6
    out = []
    for k in range(n):
        v = None if velocity is None else motion.v_g[k] + velocity * size * rng.standard_normal(3)
        out.append(
            GnssFix(
                int(t_ns[k]),
                float(motion.lat[k] + error[k, 1] / r),
                float(motion.lon[k] + error[k, 0] / (r * math.cos(motion.lat[k]))),
                float(motion.height[k] + error[k, 2]),
                math.hypot(white, correlated) * size,
                v,
                None if velocity is None else velocity * size,
                FixType.FIX_3D,
                "gnss",
            )
        )
    return out


def merged(*streams):
    """Samples in the order of arrival: a fix takes 60 ms; of equal times the first stream's is first."""
    every = (s for stream in streams for s in stream)
    return sorted(every, key=lambda s: s.t_ns + (60_000_000 if isinstance(s, GnssFix) else 0))
