"""What a vehicle does while a slave on it is aligned from its master, by name, and the slave in arrays.

`FLIGHTS` are variants of the packaged scenario ``transfer``: aircraft, a ship, a car.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from virtual_bus.faults import Faults
from virtual_bus.grades import GRADES, draw_imu
from virtual_bus.manoeuvres import Accelerate, Cruise, Manoeuvre, STurns, Turn, Wiggle, WingRock
from virtual_bus.master import Master, MasterBlock, master_of
from virtual_bus.scenario import Scenario, load
from virtual_bus.sensors import Imu, generator
from virtual_bus.tables import SwayTable
from virtual_bus.truth import Times, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Flight:
    """Manoeuvres, from ``repeat_from`` on again and again, and what is other than on an aircraft."""

    title: str
    manoeuvres: Sequence[Manoeuvre]
    repeat_from: int = -1
    start: dict[str, Any] = field(default_factory=dict)
    vehicle: dict[str, Any] = field(default_factory=dict)
    sway: SwayTable | None = None


_STILL: Final = Cruise(duration_s=56.0)
FLIGHTS: Final = {
    "straight": Flight("straight and level at 200 m/s", [_STILL]),
    "s-turn": Flight("S-turns of 20 degrees in two minutes", [STurns(duration_s=120.0, angle_deg=20.0)]),
    "coordinated-turn": Flight("turns, banked to 33 degrees", [Turn(duration_s=120.0, angle_deg=90.0)]),
    "wing-rock": Flight(
        "the wings rocked once to 30 degrees",
        [Cruise(duration_s=2.0), WingRock(duration_s=2.0, angle_deg=30.0), _STILL],
    ),
    "heading-wiggle": Flight(
        "the nose swung to either side, the path straight",
        [Cruise(duration_s=1.0), Wiggle(duration_s=9.0, angle_deg=5.0, count=3), _STILL],
    ),
    "quick-s-turn": Flight(
        "one S-turn of 3 degrees within nine seconds",
        [Cruise(duration_s=1.0), STurns(duration_s=9.0, angle_deg=3.0), _STILL],
    ),
    "ship-roll": Flight(
        "a ship that rolls in the swell",
        [Cruise(duration_s=60.0)],
        start={"height_m": 10.0, "speed_m_s": 8.0},
        vehicle={"imu_m": (4.0, 15.0, 3.0), "banks": False},
        sway=SwayTable(heading_deg=0.7, pitch_deg=1.5, roll_deg=5.0, slowest_hz=0.08, fastest_hz=0.16),
    ),
    "road-drive": Flight(
        "a car in town",
        [
            Accelerate(duration_s=8.0, speed_m_s=14.0),
            Turn(duration_s=8.0, angle_deg=90.0),
            STurns(duration_s=24.0, angle_deg=20.0, count=2),
            Accelerate(duration_s=6.0, speed_m_s=8.0),
        ],
        repeat_from=0,
        start={"height_m": 400.0, "speed_m_s": 8.0},
        vehicle={"imu_m": (0.4, 1.5, 0.8), "roll_deg_per_g": 3.0, "crab_deg": 0.3, "banks": False},
    ),
}


def scenario_of(manoeuvre: str, base: Scenario | None = None) -> Scenario:
    """The scenario of one of `FLIGHTS`: ``transfer``, or ``base``, with that flown instead.

    Raises KeyError where there is no such flight.
    """
    base = base or load("transfer")
    flight = FLIGHTS[manoeuvre]
    replace = msgspec.structs.replace
    return replace(
        base,
        title=f"Aligned from a master: {flight.title}",
        start=replace(base.start, **flight.start),
        vehicle=replace(base.vehicle, **flight.vehicle),
        manoeuvre=list(flight.manoeuvres),
        repeat_from=flight.repeat_from,
        sway=flight.sway,
    )


@dataclass(frozen=True, slots=True)
class Flown:
    """A slave and its master over a flight, in arrays.

    ``t_ns`` (n + 1,): ends of the slave's intervals; ``dtheta`` (n, 3) rad and ``dv`` (n, 3) m/s are what it
    measures, compensated by its calibration sheet. ``master_ns`` (m,): what the master says holds for, by its
    own account, and ``said`` is that. Truth is in ``trajectory`` and ``master``.
    """

    t_ns: Times
    dtheta: Array
    dv: Array
    master_ns: Times
    said: MasterBlock
    trajectory: Trajectory
    master: Master


def fly(scenario: Scenario, seed: int, seconds: float | None = None) -> Flown:
    """A scenario with a master, of its ``seconds`` or so many: truth, unit and master of the bench's seed.

    Raises ValueError for a scenario without a master.
    """
    table = scenario.master
    if table is None:
        raise ValueError(f"{scenario.title}: no master")
    seconds = scenario.seconds() if seconds is None else seconds
    trajectory = scenario.trajectory(seconds, generator(seed, "vehicle/mounting"))
    grade = GRADES[scenario.grade]
    unit = draw_imu(grade, generator(seed, "imu/unit"))
    imu = Imu(trajectory, grade, unit, generator(seed, "imu"), Faults([]))
    t_ns = _instants(scenario.imu.rate_hz, seconds)
    block = max(1, round(scenario.imu.rate_hz))
    counts = [imu.block(t_ns[k : k + block + 1])[0] for k in range(0, len(t_ns) - 1, block)]
    measured = []
    for triad, part in ((unit.calibrated_gyro, slice(0, 3)), (unit.calibrated_accel, slice(3, 6))):
        output = np.concatenate(counts)[:, part] * triad.scale - np.diff(t_ns)[:, None] * 1e-9 * triad.bias
        measured.append(np.asarray(np.linalg.solve(triad.axes, output.T).T))
    master = master_of(table, trajectory, generator(seed, "master"))
    master_ns = _instants(table.rate_hz, seconds)
    said = master.block(master_ns - round(1e6 * table.age_ms))
    return Flown(t_ns, measured[0], measured[1], master_ns, said, trajectory, master)


def _instants(rate_hz: float, seconds: float) -> Times:
    return np.asarray(np.rint(np.arange(int(seconds * rate_hz) + 1) * (1e9 / rate_hz)).astype(np.int64))
