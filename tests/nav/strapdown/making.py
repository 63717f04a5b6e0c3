"""Rides for the tests of the mechanisation: exact increments, and views that have no singularity."""

import math

import numpy as np

from nav import earth
from nav import rotation as rot
from nav.strapdown.kernels import X_C, X_H, X_HEAD, X_Q, X_V
from virtual_bus.manoeuvres import Accelerate, Brake, Climb, Cruise, Profile, Static, STurns, Turn
from virtual_bus.truth import Trajectory, Vehicle, mounting_matrix, roll_per_accel

FLIGHT = (
    Accelerate(duration_s=50.0, speed_m_s=180.0),
    Climb(duration_s=20.0, slope_deg=8.0),
    STurns(duration_s=24.0, angle_deg=12.0),
    Cruise(duration_s=64.0),
    STurns(duration_s=30.0, angle_deg=15.0),
    Turn(duration_s=12.0, angle_deg=60.0),
)
ROAD = (
    Static(duration_s=5.0),
    Accelerate(duration_s=10.0, speed_m_s=18.0),
    STurns(duration_s=40.0, angle_deg=25.0, count=3),
    Climb(duration_s=30.0, slope_deg=5.0),
    Turn(duration_s=12.0, angle_deg=110.0),
    Cruise(duration_s=60.0),
    Turn(duration_s=12.0, angle_deg=-80.0),
    Cruise(duration_s=20.0),
    Brake(duration_s=8.0),
    Static(duration_s=3.0),
)


def ride(manoeuvres, lat, lon, heading, lean=-50.0, height=500.0, mounting=(2.0, -3.0, 10.0)):
    """A `virtual_bus` trajectory from a place (rad, rad) with a heading (rad); ``lean`` in deg per g."""
    blends, speed = [], 0.0
    for manoeuvre in manoeuvres:
        part = manoeuvre.blends(speed)
        blends += part
        speed = round(speed + sum(b.speed for b in part), 9)
    vehicle = Vehicle(np.zeros(3), mounting_matrix(*mounting), roll_per_accel(lean), 0.0)
    return Trajectory(Profile(blends, heading=heading), vehicle, lat, lon, height)


def increments_of(trajectory, hz):
    """Exact samples (M, 6) of all of the ride."""
    step = 1_000_000_000 // hz
    return np.hstack(trajectory.increments(np.arange(0, trajectory.profile.end_ns + 1, step)))


def head_of(state):
    """Head of a state vector (X_HEAD,) of a `TruthState`; n is east-north-up."""
    x = np.zeros(X_HEAD)
    x[X_Q : X_Q + 4] = state.q_gb
    x[X_V : X_V + 3] = state.v_g
    x[X_C : X_C + 9] = earth.position_matrix(state.lat, state.lon).ravel()
    x[X_H] = state.height
    return x


def earth_fixed(x):
    """Position (3,) m, velocity (3,) m/s and attitude C_eb (3, 3) of a head: defined everywhere."""
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    up, h = C_en[:, 2], x[X_H]
    r_n = earth.radii(up[2])[1]
    r_e = np.array([(r_n + h) * up[0], (r_n + h) * up[1], ((1.0 - earth.E2) * r_n + h) * up[2]])
    return r_e, C_en @ x[X_V : X_V + 3], C_en @ rot.dcm_from_quat(x[X_Q : X_Q + 4])


def geographic(x):
    """Latitude, longitude, height, velocity east-north-up and true heading of a head, away from a pole."""
    C_en = x[X_C : X_C + 9].reshape(3, 3)
    lat, lon, _ = earth.position_angles(C_en)
    C_gn = earth.position_matrix(lat, lon).T @ C_en
    heading = rot.euler_from_dcm(C_gn @ rot.dcm_from_quat(x[X_Q : X_Q + 4]))[0]
    return np.array([lat, lon, x[X_H], *(C_gn @ x[X_V : X_V + 3]), math.remainder(heading, math.tau)])
