"""Solutions and outputs made from plain numbers."""

from __future__ import annotations

import math

import numpy as np

from bridge.outputs import SolutionOut
from nav.types import Mode, S, Solution, SolutionFlag

VALID = SolutionFlag.POSITION | SolutionFlag.VELOCITY | SolutionFlag.LEVEL | SolutionFlag.HEADING


def quaternion(roll: float, pitch: float, heading: float) -> np.ndarray:
    """C_gv by the definition of the angles: heading about -up, pitch about right, roll about forward."""

    def about(axis: int, angle: float) -> np.ndarray:
        q = np.zeros(4)
        q[0], q[1 + axis] = math.cos(angle / 2), math.sin(angle / 2)
        return q

    def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
        return np.array([w, *v])

    return times(times(about(2, -heading), about(0, pitch)), about(1, roll))


def solution(
    t_ns: int = 5_000_000_000,
    *,
    lat_deg: float = 48.14,
    lon_deg: float = 11.58,
    height: float = 600.0,
    v: tuple[float, float, float] = (3.0, 4.0, -0.5),
    roll_deg: float = 2.0,
    pitch_deg: float = -3.0,
    heading_deg: float = 200.0,
    w: tuple[float, float, float] = (0.01, -0.02, 0.03),
    f: tuple[float, float, float] = (0.1, 0.2, 9.81),
    sigma_p: tuple[float, float, float] = (0.4, 0.5, 0.9),
    mode: Mode = Mode.NAVIGATE,
    flags: int = int(VALID),
) -> Solution:
    state = np.full(S.SIZE, 0.001)
    state[S.LAT], state[S.LON], state[S.HEIGHT] = math.radians(lat_deg), math.radians(lon_deg), height
    state[S.V], state[S.W], state[S.F], state[S.SIGMA_P] = v, w, f, sigma_p
    state[S.Q] = quaternion(math.radians(roll_deg), math.radians(pitch_deg), math.radians(heading_deg))
    state[S.SIGMA_V] = 0.02, 0.03, 0.04
    state[S.SIGMA_PHI] = np.radians((0.05, 0.05, 0.2))
    return Solution(t_ns, mode, flags, state)


def unknown(t_ns: int = 5_000_000_000, mode: Mode = Mode.ALIGN) -> Solution:
    return Solution(t_ns, mode, 0, np.full(S.SIZE, math.nan))


def out(s: Solution, late_ns: int = 1_000_000) -> SolutionOut:
    return SolutionOut("main", s, s.t_ns + late_ns)
