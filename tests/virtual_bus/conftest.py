from __future__ import annotations

import math

import numpy as np
import pytest

from virtual_bus.manoeuvres import (
    Accelerate,
    Brake,
    Climb,
    Cruise,
    Descend,
    Profile,
    Static,
    STurns,
    Turn,
    Wiggle,
    WingRock,
)
from virtual_bus.sway import FASTEST_HZ, Sway
from virtual_bus.truth import Trajectory, Vehicle, mounting_matrix, roll_per_accel

LAT, LON, HEIGHT, HEADING = math.radians(48.0), math.radians(11.0), 500.0, 0.7


def trajectory_of(
    manoeuvres,
    imu=(0.2, 1.5, 0.8),
    lean=(4.0, 2.0),
    lat=LAT,
    lon=LON,
    heading=HEADING,
    mounting=(2.0, -3.0, 10.0),
    sway=None,
    speed=0.0,
    banks=False,
):
    blends, begin = [], speed
    for manoeuvre in manoeuvres:
        part = manoeuvre.blends(speed)
        blends += part
        speed = round(speed + sum(b.speed for b in part), 9)
    vehicle = Vehicle(
        imu=np.array(imu),
        C_vb=mounting_matrix(*mounting),
        roll_per_accel=roll_per_accel(lean[0]),
        pitch_per_accel=roll_per_accel(lean[1]),
        sway=sway,
        banks=banks,
    )
    return Trajectory(Profile(blends, heading=heading, speed=begin), vehicle, lat, lon, HEIGHT)


def sway(begins_s=None):
    """As fast and as strong as any."""
    return Sway(np.radians([2.0, 3.0, 4.0]), 0.1, FASTEST_HZ, begins_s, np.random.default_rng(7))


@pytest.fixture(scope="session")
def ride():
    """Every manoeuvre there is, forward and in reverse, with a leaning body and a lever arm."""
    return trajectory_of(
        [
            Static(duration_s=5.0),
            Accelerate(duration_s=8.0, speed_m_s=15.0),
            Cruise(duration_s=3.3),
            Turn(duration_s=6.0, angle_deg=90.0),
            STurns(duration_s=20.0, angle_deg=25.0, count=2),
            Climb(duration_s=20.0, slope_deg=5.0),
            Descend(duration_s=12.0, slope_deg=3.0),
            Brake(duration_s=5.5),
            Accelerate(duration_s=4.0, speed_m_s=-3.0),
            Turn(duration_s=8.0, angle_deg=-60.0),
            Brake(duration_s=3.0),
        ]
    )


@pytest.fixture(scope="session")
def flight():
    """An aircraft that banks into its curves and rolls and yaws about its path, its IMU out on a wing."""
    return trajectory_of(
        [
            Cruise(duration_s=2.0),
            WingRock(duration_s=2.0, angle_deg=30.0),
            Turn(duration_s=15.0, angle_deg=30.0),
            Wiggle(duration_s=6.0, angle_deg=4.0, count=2),
            STurns(duration_s=40.0, angle_deg=15.0),
            Accelerate(duration_s=10.0, speed_m_s=180.0),
        ],
        imu=(4.0, -0.5, -0.6),
        lean=(0.0, 0.0),
        speed=200.0,
        banks=True,
    )


@pytest.fixture(
    scope="session", params=["driven", "flown", "swaying", "swaying after rest", "swaying on the way"]
)
def any_ride(request, ride, flight):
    """The ride, the flight, and bases that sway where they stand and as they go."""
    if request.param in ("driven", "flown"):
        return ride if request.param == "driven" else flight
    if request.param == "swaying on the way":
        return trajectory_of(
            [Static(duration_s=4.0), Accelerate(duration_s=8.0, speed_m_s=12.0)], sway=sway()
        )
    return trajectory_of([Static(duration_s=30.0)], sway=sway(3.0 if "rest" in request.param else None))


@pytest.fixture(scope="session")
def rest():
    """At rest for two hours, the IMU on the axle and its axes along the vehicle's."""
    return trajectory_of([Static(duration_s=7200.0)], imu=(0.0, 0.0, 0.0), mounting=(0.0, 0.0, 0.0))
