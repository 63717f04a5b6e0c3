"""What fusion and parity test of six gyros and six accelerometers cost, against three of each.

``python -m tests.benchmarks.redundant`` prints the table. Both begin with counts and end with increments in
b: the compensation of `nav.imu.pulses`, and for six sensors their increments, the fusion, the test of every
sample and those of the windows. Once more in NumPy.
"""

from __future__ import annotations

import sys
from typing import Final

import numpy as np

from nav.imu.geometry import GEOMETRIES
from nav.imu.many import Sensors
from nav.imu.parity import MOST
from nav.imu.pulses import compensate
from nav.imu.redundant import Noise, Redundant, RedundantUnit
from nav.imu.redundant_kernel import State, Tables, fuse
from nav.imu.redundant_readable import Readable
from nav.imu.redundant_sample import quick
from nav.jit import in_place
from nav.types import Vector
from tests.benchmarks.kernels import CALIBRATION, COUNTS
from tests.benchmarks.measure import interleaved, print_table

RATE_HZ: Final = 200.0
SAMPLES: Final = 100_000


@in_place
def three(table: Vector, counts: Vector, out: Vector, n: int) -> None:
    """``n`` samples of three gyros and three accelerometers."""
    for _ in range(n):
        compensate(table, counts, 1.0 / RATE_HZ, out[0], out[1])


@in_place
def six(
    gyros: Tables,
    accels: Tables,
    gyro: State,
    accel: State,
    counts: Vector,
    out: Vector,
    n: int,
) -> None:
    """``n`` samples of six gyros and six accelerometers."""
    tau = 1.0 / RATE_HZ
    for _ in range(n):
        if not quick(accel.hot, counts, MOST, tau, 0.0, 0.0, 0.0, out[1]):
            fuse(accels, accel, tau, out[1], out[2])
        if not quick(gyro.hot, counts, 0, tau, out[1, 0], out[1, 1], out[1, 2], out[0]):
            fuse(gyros, gyro, tau, out[0], out[2])


def unit() -> tuple[Redundant, Redundant, Vector]:
    """Gyros and accelerometers, and counts that agree to a pulse."""
    H = GEOMETRIES["cone"]
    c = CALIBRATION
    kinds = []
    counts = []
    for scale, bias, g, noise, seen in (
        (5e-7, 1e-6, 1e-9, Noise(3e-6, 5e-7, 5e-7, 5e-5), c.gyro_scale_plus * COUNTS[:3]),
        (5e-5, 1e-3, 0.0, Noise(4e-4, 5e-5, 2e-3, 8e-5), c.accel_scale_plus * COUNTS[3:]),
    ):
        plus = np.full(6, scale)
        sensors = Sensors(H, plus, plus, np.full(6, bias), np.full((6, 3), g))
        counts.append(np.round((H @ seen + bias / RATE_HZ) / scale))
        kinds.append(Redundant(sensors, noise, RATE_HZ))
    return kinds[0], kinds[1], np.concatenate([np.pad(one, (0, MOST - 6)) for one in counts])


def measure(rounds: int = 15, samples: int = SAMPLES) -> dict[str, float]:
    """Seconds per sample of each case."""
    gyros, accels, counts = unit()
    table = CALIBRATION.table()
    out = np.zeros((3, 3))
    slow = max(samples // 1000, 2)

    def numpy() -> None:
        twins = Readable(gyros), Readable(accels)
        for _ in range(slow):
            dv = twins[1].sample(counts[MOST : MOST + 6], 1.0 / RATE_HZ, np.zeros(3))[0]
            twins[0].sample(counts[:6], 1.0 / RATE_HZ, dv)

    def fused() -> None:
        six(gyros.tables, accels.tables, gyros.state, accels.state, counts, out, samples)

    calls = max(samples // 10, 2)
    live = RedundantUnit(gyros, accels)

    def three_calls() -> None:
        for _ in range(calls):
            compensate(table, COUNTS, 1.0 / RATE_HZ, out[0], out[1])

    def six_calls() -> None:
        for _ in range(calls):
            live.sample(counts, 1.0 / RATE_HZ, out[0], out[1])

    cases = {
        "three": lambda: three(table, COUNTS, out, samples),
        "six": fused,
        "three, called": three_calls,
        "six, called": six_calls,
        "readable": numpy,
    }
    each = {"three, called": calls, "six, called": calls, "readable": slow}
    times = interleaved(cases, rounds)
    if len(gyros.active) + len(accels.active) < 12:
        raise RuntimeError("a sensor was excluded: not the case that is meant")
    return {name: seconds / each.get(name, samples) for name, seconds in times.items()}


def main() -> int:
    """Print the table."""
    seconds = measure()
    names = {
        "three, called": ("three and three, one call of the driver a sample", "three, called"),
        "six, called": ("six and six with parity tests, one call a sample", "three, called"),
        "three": ("three and three, within compiled code", "three"),
        "six": ("six and six with parity tests, within compiled code", "three"),
        "readable": ("six and six, NumPy twin", "three, called"),
    }
    rows = [
        (text, f"{seconds[name] * 1e9:.0f}", f"{seconds[name] / seconds[of]:.1f}")
        for name, (text, of) in names.items()
    ]
    print_table("counts to increments in b, per inertial sample", ("", "ns", "ratio"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
